"""Continuous task transition (§3.4): rows of T_sca join the tasks below by their activations.

The paper's hierarchy of strict levels jumps where levels become dependent. Here the tasks below are
one strictly convex objective, and each row of T_sca is a spring against the solution of these
tasks: the result is continuous in its data when rows enter or leave.
"""

import numpy as np

from app.compiled import compiled
from app.control.qp import backward, cholesky, forward
from app.strict import Array
from app.structs import put


@compiled()
def insert_rows(
    H: Array, c: Array, J: Array, b: Array, beta: Array, least: float, fixed: int
) -> tuple[Array, Array]:
    """The tasks below (H, c) with rows of T_sca above them, each in proportion to its activation.

    Row i is a spring between J_i q̈ and b_i = ẍ_i − J̇_i q̇. Its compliance is (1 − β_i)/β_i times
    J_i H⁻¹ J_iᵀ, the compliance of the tasks below along this row. Without other rows, row i yields

        J_i q̈ = β_i b_i + (1 − β_i) J_i q̈*_∖i,

    the blend of (29). With other rows, row i has no effect at β_i = 0, and at β_i = 1 it is
    satisfied up to `least`. The paper's blend, of all rows with the solution without any of them,
    jumps when a row enters while a different row is active. The computing time is proportional to
    the number of rows.

    Paper: Eq. (29).

    Args:
        H: (n, n) symmetric positive definite.
        c: (n,) linear term of the tasks below.
        J: (k, n) rows J_i of T_sca.
        b: (k,) right-hand sides b_i.
        beta: (k,) [-] activations β_i.
        least: [-] remaining share of a row's compliance at β = 1.
        fixed: Number of fixed first entries of q̈, which do not contribute to J_i H⁻¹ J_iᵀ.

    Returns:
        (n, n) H + Σ w_i J_iᵀ J_i and (n,) c − Σ w_i b_i J_iᵀ, with
        w_i = β_i / ((1 − β_i + least) J_i H⁻¹ J_iᵀ).
    """
    H, c, L = H.copy(), c.copy(), cholesky(H[fixed:, fixed:])
    for i in range(len(b)):
        if beta[i] <= 0.0:
            continue
        a = forward(L, J[i, fixed:])
        compliance = 1e-12
        for j in range(len(a)):
            compliance += a[j] ** 2
        w = beta[i] / ((1.0 - beta[i] + least) * compliance)
        for j in range(len(c)):
            c[j] -= w * b[i] * J[i, j]
            for l in range(len(c)):
                H[j, l] += w * J[i, j] * J[i, l]
    return H, c


@compiled()
def clip(values: Array, low: Array, high: Array) -> Array:
    """The values (k,), limited to the bounds `low` and `high` (k,)."""
    found = np.empty_like(values)
    for i in range(len(values)):
        found[i] = min(max(values[i], low[i]), high[i])
    return found


@compiled()
def blend_base(free: Array, xdd_m: Array, beta_m: float) -> Array:
    """β_m ẍ_m + (1 − β_m) ẍ_free, (n_b,): the blend of (29) for the base's rows.

    Paper: Eq. (29), the base's rows.
    """
    return beta_m * xdd_m + (1.0 - beta_m) * free


@compiled()
def uncompensated_base_jacobian(J_ee: Array, qd_max: Array, J_m_inv: Array, speed: float) -> Array:
    """R (3, n_b): end-effector motion by the base's axes that the arm cannot compensate.

    The method moves the base, and the arm has to compensate the motion of the end-effector. An arm
    that lacks a joint for that, or is at full stretch, cannot do so: the base drags the
    end-effector along, the distance stays the same, and the base would continue. Our extension: R =
    (1 + (J Q² Jᵀ / v²)²)⁻¹ J_b, with J and J_b the arm's and the base's part of the end-effector's
    linear Jacobian, Q the speed limits of the joints and v a speed. Along a direction in which the
    joints can move the end-effector at v, half of the base's motion remains; at 2 v, one
    seventeenth.

    Args:
        J_ee: (6, n) end-effector Jacobian.
        qd_max: (n_m,) [rad/s or m/s] speed limits of the joints.
        J_m_inv: (n_b, n_b) from the base's axes to q̇_b.
        speed: [m/s] v.
    """
    n_b, n_m = len(J_m_inv), len(qd_max)
    follows = np.zeros((3, 3))
    for i in range(3):
        for j in range(3):
            for k in range(n_m):
                follows[i, j] += J_ee[i, n_b + k] * J_ee[j, n_b + k] * (qd_max[k] / speed) ** 2
    rest, moved = np.eye(3), np.zeros((3, n_b))
    for i in range(3):
        for j in range(3):
            for k in range(3):
                rest[i, j] += follows[i, k] * follows[k, j]
        for j in range(n_b):
            for k in range(n_b):
                moved[i, j] += J_ee[i, k] * J_m_inv[k, j]
    L, found = cholesky(rest), np.empty_like(moved)
    for j in range(n_b):
        put(found[:, j], backward(L, forward(L, moved[:, j])))
    return found


@compiled()
def limit_ee_drag(desired: Array, hold: Array, inertia: Array, mass: float, drag: Array) -> Array:
    """The base acceleration nearest to the desired one that does not drag the end-effector along.

    The result a minimises (a − a_des)ᵀ I (a − a_des) + m ‖D (a − a_hold)‖². The second term acts
    like a mass m on the end-effector along directions in which the arm does not compensate the
    base's motion. Along all other directions D is 0, and a equals a_des.

    Args:
        desired: (n_b,) [m/s² or rad/s²] a_des.
        hold: (n_b,) [m/s² or rad/s²] a_hold: with it the end-effector fulfils its task.
        inertia: (n_b,) [kg or kg m²] diagonal of I, the base's inertia.
        mass: [kg] m.
        drag: (3, n_b) D: `uncompensated_base_jacobian` times the gain of the admittance law.
    """
    n_b = len(inertia)
    hung, right = np.zeros((n_b, n_b)), np.empty(n_b)
    for i in range(n_b):
        hung[i, i] = inertia[i]
        right[i] = inertia[i] * (desired[i] - hold[i])
        for j in range(n_b):
            for k in range(len(drag)):
                hung[i, j] += mass * drag[k, i] * drag[k, j]
    L = cholesky(hung)
    return hold + backward(L, forward(L, right))
