"""The tasks of a control step, and their continuous transition (§3.2 to §3.4).

T_sca has rows J q̈ = b, each with an activation β. The tasks below T_sca (end-effector, posture,
guided arm, base at rest) are one strictly convex objective ½ q̈ᵀ H q̈ + cᵀ q̈. A row of T_sca is
either a spring against the solution of this objective (`insert_rows`) or blended with it
(`blend_base`). Thus the result is continuous when rows enter or leave; the paper's hierarchy of
strict levels jumps where levels become dependent. q̈ (n,) begins with the n_b entries of the base.
"""

import math
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin

from app.compiled import compiled
from app.control.qp import cholesky, dot, fill, forward, put, put_rows, solved, times
from app.strict import Array

_SHORTEST_RISE = 0.02  # [m] shortest distance over which β rises from 0 to 1


class Reference(NamedTuple):
    """Desired motion of the end-effector, in the world."""

    pose: pin.SE3
    """T_world_ee."""
    velocity: Array
    """(6,) velocity: linear [m/s], then angular [rad/s]."""
    acceleration: Array
    """(6,) acceleration: linear [m/s²], then angular [rad/s²]."""


@compiled()
def cubic(s: float) -> float:
    """A smooth step: 0 for s < 0, 1 for s > 1, between them a cubic with slope 0 at both ends."""
    s = min(max(s, 0.0), 1.0)
    return s * s * (3.0 - 2.0 * s)


@compiled()
def activation(d: float, d_b: float, d_full: float) -> float:
    """β [-] of a link pair at the signed distance d [m], with a continuous derivative in d.

    β is 0 for d ≥ d_b, 1 for d ≤ d_b − `rise_length`, and a cubic between.

    Paper: Figure 10; there d_b = 0.15 m and d_full = 0.05 m.
    """
    return cubic((d_b - d) / rise_length(d_b, d_full))


@compiled()
def rise_length(d_b: float, d_full: float) -> float:
    """[m] the distance over which β rises: d_b − d_full, at least `_SHORTEST_RISE`."""
    return max(d_b - d_full, _SHORTEST_RISE)


@compiled()
def mobile_activation(beta: Array) -> float:
    """β_m, the largest of the activations (n_mob,) of the pairs of arm and base (L_m).

    Paper: Eq. (28).
    """
    largest = 0.0
    for each in beta:
        largest = max(largest, each)
    return largest


@compiled()
def generate_rep_acc(d_dot: Any, k_p: float, k_v: float) -> Any:
    """ẍ_r = k_p − k_v ḋ [m/s²], which separates the links of a pair.

    Paper: Eq. (20), where ḋ is nᵀ(ṗ_b − ṗ_a). `d_dot` [m/s] is ḋ of one pair, or an array of the ḋ
    of several pairs, and the result has the same form. k_p is in m/s², k_v in 1/s.
    """
    return k_p - k_v * d_dot


@compiled()
def generate_rep_force_acc(n: Array, velocity: Array, k_p: float, k_v: float) -> Array:
    """ẍ_rep = k_p n − k_v ṗ (3,) [m/s²]: pushes the arm's closest point away from the base.

    n (3,) is the normal from the base to the arm, of length 1 or less, ṗ (3,) [m/s] the velocity of
    the closest point relative to the base; k_p is in m/s², k_v in 1/s. docs/comparison.md describes
    the compared method `repulsive`.
    """
    return k_p * n - k_v * velocity


@compiled()
def generate_avoidance_task(
    base_rows: Array,
    xdd_m: Array,
    beta_m: float,
    J_r: Array,
    b_r: Array,
    beta_r: Array,
    J_sca: Array,
    b_sca: Array,
    B: Array,
) -> None:
    """Write the rows of T_sca: those of the base, then those of the pairs within the arm.

    The base's rows are [J_m O] q̈ = ẍ_m with J̇_m = 0: `base_rows` (n_b, n) and `xdd_m` (n_b,)
    [m/s² or rad/s²], all with the activation `beta_m`. The pairs within the arm (L_m^c) have the
    Jacobians `J_r` (k, n) of (21), the right-hand sides `b_r` (k,) [m/s²] ẍ_r − J̇_r q̇, and the
    activations `beta_r` (k,). The outputs are the first n_b + k rows of J_sca, of ẍ_sca − J̇_sca q̇
    (`b_sca`), and of the diagonal `B`.

    Paper: Eq. (16), (19), (22), (23), (24), (25), (27).
    """
    n_b, end = len(xdd_m), len(xdd_m) + len(b_r)
    put_rows(J_sca, base_rows)
    put_rows(J_sca[n_b:], J_r)
    put(b_sca[:n_b], xdd_m)
    put(b_sca[n_b:end], b_r)
    fill(B[:n_b], beta_m)
    put(B[n_b:end], beta_r)


@compiled()
def rotation_vector(R: Array) -> Array:
    """(3,) [rad] axis of the rotation R (3, 3) times its angle, which is within [0, π]."""
    trace = R[0, 0] + R[1, 1] + R[2, 2]
    q = np.empty(4)  # w, then the vector part, by the largest of the four
    if trace > 0.0:
        s = 2.0 * math.sqrt(1.0 + trace)
        q[0] = 0.25 * s
        q[1], q[2], q[3] = (R[2, 1] - R[1, 2]) / s, (R[0, 2] - R[2, 0]) / s, (R[1, 0] - R[0, 1]) / s
    else:
        i = 0
        for k in range(1, 3):
            i = k if R[k, k] > R[i, i] else i
        j, k = (i + 1) % 3, (i + 2) % 3
        s = 2.0 * math.sqrt(1.0 + R[i, i] - R[j, j] - R[k, k])
        q[0] = (R[k, j] - R[j, k]) / s
        q[1 + i], q[1 + j], q[1 + k] = 0.25 * s, (R[i, j] + R[j, i]) / s, (R[i, k] + R[k, i]) / s
    if q[0] < 0.0:
        q = -q
    length = math.sqrt(q[1] ** 2 + q[2] ** 2 + q[3] ** 2)
    per = 2.0 / q[0] if length < 1e-9 else 2.0 * math.atan2(length, q[0]) / length
    return per * q[1:]


@compiled()
def rotation_by(vector: Array) -> Array:
    """(3, 3) rotation of a rotation vector (3,) [rad]."""
    x, y, z = vector[0], vector[1], vector[2]
    angle = math.sqrt(x * x + y * y + z * z)
    if angle > 1e-6:
        s, c = math.sin(angle) / angle, (1.0 - math.cos(angle)) / angle**2
    else:
        s, c = 1.0, 0.5
    R = np.empty((3, 3))
    R[0, 0], R[0, 1], R[0, 2] = 1.0 - c * (y * y + z * z), c * x * y - s * z, c * x * z + s * y
    R[1, 0], R[1, 1], R[1, 2] = c * x * y + s * z, 1.0 - c * (x * x + z * z), c * y * z - s * x
    R[2, 0], R[2, 1], R[2, 2] = c * x * z - s * y, c * y * z + s * x, 1.0 - c * (x * x + y * y)
    return R


@compiled()
def pose_error(p: Array, R: Array, p_ref: Array, R_ref: Array) -> Array:
    """x_d ⊖ x, (6,): the linear error [m], then the angular error [rad] as a rotation vector.

    `p` (3,) [m] and `R` (3, 3) are the present pose, `p_ref` and `R_ref` the desired one. Poses and
    errors are in axes of the world.
    """
    error, turn = np.empty(6), np.empty((3, 3))
    for i in range(3):
        error[i] = p_ref[i] - p[i]
        for j in range(3):
            turn[i, j] = R_ref[i, 0] * R[j, 0] + R_ref[i, 1] * R[j, 1] + R_ref[i, 2] * R[j, 2]
    put(error[3:], rotation_vector(turn))
    return error


@compiled()
def end_effector_task(
    pose: Array, velocity: Array, acceleration: Array, k_p: float, k_v: float, max_speed: float
) -> tuple[Array, float]:
    """T_2 ∈ ℝ⁶: J_ee q̈ + J̇_ee q̇ + w = ẍ_d + k_v (ẋ_d − ẋ) + k_p (x_d ⊖ x).

    The norms of the linear and of the angular part of k_p (x_d ⊖ x) are bounded by k_v times
    `max_speed` [m/s and rad/s]. Therefore the end-effector approaches a distant target at this
    speed. `pose` (6,) [m, rad] is x_d ⊖ x, `velocity` (6,) [m/s, rad/s] is ẋ_d − ẋ, and
    `acceleration` (6,) [m/s², rad/s²] is ẍ_d − J̇_ee q̇. k_p is in 1/s², k_v in 1/s. Returns b (6,)
    of J_ee q̈ = b, and λ [m²], the squared norm of the bounded pose error (rad count as m).

    Paper: Eq. (26), its task T_2.
    """
    b, rest = np.empty(6), 0.0
    for part in range(0, 6, 3):
        at = slice(part, part + 3)
        pull = k_p * pose[at]
        pull *= min(k_v * max_speed / max(math.sqrt(dot(pull, pull)), 1e-12), 1.0)
        put(b[at], acceleration[at] + k_v * velocity[at] + pull)
        for each in pull:
            rest += each * each
    return b, rest / max(k_p, 1e-12) ** 2


@compiled()
def add_tracking(
    H: Array, c: Array, J: Array, b: Array, lm_damping: float, velocity: Array, weight: float
) -> tuple[Array, Array]:
    """Add T_2 to the posture task (H, c): the cost ½ w ‖J_ee q̈ − b‖² with a large weight w [-].

    If a limit or another task nearly contradicted T_2 as a strict level, this level would demand
    unbounded accelerations. The weighted task has an error in proportion to 1/w instead.
    A remaining pose error adds the cost ½ w λ ‖q̈ + k_v q̇‖² in the metric H, where λ [m²] is the
    square of this error (`lm_damping`): the damping of Levenberg and Marquardt in the form by
    Sugihara (2011). Thus an arm at full stretch comes to rest. J (6, n) is J_ee, b (6,) the
    right-hand side of T_2, `velocity` (n,) k_v q̇; H is (n, n), c (n,). Returns (n, n) and (n,):
    (1 + w λ) H + w JᵀJ, and c + w (λ H k_v q̇ − Jᵀ b).

    Paper: Eq. (26).
    """
    n, (k, _) = len(c), J.shape
    H_all, c_all = np.empty((n, n)), np.empty(n)
    for i in range(n):
        damped = driven = 0.0
        for j in range(n):
            both = 0.0
            for l in range(k):
                both += J[l, i] * J[l, j]
            H_all[i, j] = H[i, j] + weight * (lm_damping * H[i, j] + both)
            damped += H[i, j] * velocity[j]
        for l in range(k):
            driven += J[l, i] * b[l]
        c_all[i] = c[i] + weight * (lm_damping * damped - driven)
    return H_all, c_all


@compiled()
def posture_objective(
    qd: Array,
    q_m: Array,
    q_posture: Array,
    q_limits: Array,
    arm: tuple[float, float, float],
    base: tuple[float, float],
) -> tuple[Array, Array]:
    """H (n, n) and c (n,) that damp the arm, move it towards a posture, and bring the base to rest.

    Without this task (26) does not determine the motion in the null space of T_2: the paper's robot
    has nine accelerations, and T_2 six rows. A joint also has a restoring acceleration proportional
    to s⁵, where s is 0 in the middle of its range and ±1 at a limit: a joint leaves its limit if
    the other tasks can be satisfied away from this limit.

    `qd` (n,) is q̇. `q_m` and `q_posture` (n_m,) [rad or m] are the joint positions and the
    posture, `q_limits` (2, n_m) the lower and upper joint limits. `arm` has the stiffness towards
    the posture [1/s²], the damping of the joints [1/s], and the restoring acceleration at a joint
    limit, relative to half the range [1/s²]; `base` has the cost of the base's acceleration,
    relative to a joint's [-], and its damping [1/s].
    """
    n, n_m = len(qd), len(q_m)
    n_b = n - n_m
    stiffness, damping, joint_centering = arm
    base_weight, base_damping = base
    H, c = np.zeros((n, n)), np.empty(n)
    for i in range(n_b):
        H[i, i] = base_weight
        c[i] = base_weight * base_damping * qd[i]
    for i in range(n_m):
        half = 0.5 * (q_limits[1, i] - q_limits[0, i])
        share = (q_m[i] - q_limits[0, i]) / half - 1.0
        H[n_b + i, n_b + i] = 1.0
        c[n_b + i] = (
            damping * qd[n_b + i]
            - stiffness * (q_posture[i] - q_m[i])
            + joint_centering * half * share**5
        )
    return H, c


@compiled()
def free_arm_torque(g: Array, qd: Array, joint_damping: Array) -> Array:
    """u_0 = g_a − D q̇_a (n_m,) [N m or N]: gravity compensation and damping D of the joints."""
    n_b = len(g) - len(joint_damping)
    return g[n_b:] - joint_damping * qd[n_b:]


@compiled()
def guided_objective(M: Array, h: Array, u_0: Array) -> tuple[Array, Array]:
    """H = M (n, n) and c (n,) of the task of a guided arm: ½ (u_a − u_0)ᵀ M_aa⁻¹ (u_a − u_0).

    u_0 (n_m,) [N m or N] is the torque without T_sca. H and c are valid for a fixed acceleration of
    the base: then the Hessian for q̈_a is M_aa, the minimum is at u_a = u_0, and each row of T_sca
    adds a torque along its J_rᵀ. There is no posture task, because the person would feel it.
    """
    n_b, c = len(h) - len(u_0), np.zeros(len(h))
    put(c[n_b:], h[n_b:] - u_0)
    return M, c


@compiled()
def add_base_rest_task(
    H: Array, c: Array, L_aa: Array, qd: Array, weight: float, damping: float, n_b: int
) -> tuple[Array, Array]:
    """H and c of a guided arm for a free base, with the task that brings this base to rest.

    H and c are those of `guided_objective`, `L_aa` is the Cholesky factor of M_aa, `qd` (n,) is q̇.
    `weight` [-] and `damping` [1/s] are the two numbers of `base` in `posture_objective`.
    """
    n = len(c)
    H, c = H.copy(), c.copy()
    share = np.empty((n - n_b, n_b + 1))
    for j in range(n_b):
        put(share[:, j], solved(L_aa, H[n_b:, j]))
    put(share[:, n_b], solved(L_aa, c[n_b:]))
    M_ab = H[n_b:, :n_b].copy()
    for i in range(n_b):
        for j in range(n_b):
            H[i, j] = weight if i == j else 0.0
            for k in range(n - n_b):
                H[i, j] += M_ab[k, i] * share[k, j]
        c[i] = weight * damping * qd[i]
        for k in range(n - n_b):
            c[i] += M_ab[k, i] * share[k, n_b]
    return H, c


@compiled()
def reaction_torque(d: Array, J: Array, f: float, d_b: float, n_b: int) -> Array:
    """Σ J_aᵀ f (1 − d/d_b) (n_m,) [N m or N]: the arm's reaction to the force on the base.

    This is our extension. The force (14) acts on the base alone; without a reaction a released arm
    would stay in the buffer, and the base would continue to move. `d` (k,) [m] and `J` (k, n) are
    distances and Jacobians of the pairs of arm and base, f [N] is the force at contact, and d_b [m]
    the buffer distance. 1 − d/d_b is limited to 0 … 1, and J_a is the arm's part of J.
    """
    u = np.zeros(J.shape[1] - n_b)
    for i in range(len(d)):
        share = f * min(max(1.0 - d[i] / d_b, 0.0), 1.0)
        if share > 0.0:
            u += share * J[i, n_b:]
    return u


@compiled()
def insert_rows(
    H: Array, c: Array, J: Array, b: Array, beta: Array, least: float, fixed: int
) -> tuple[Array, Array]:
    """Add rows of T_sca to the tasks below, ½ q̈ᵀ H q̈ + cᵀ q̈, as springs that follow β.

    Row i is a spring between J_i q̈ and b_i = ẍ_i − J̇_i q̇. With ε = `least`, its compliance is
    (1 − β_i + ε)/β_i times J_i H⁻¹ J_iᵀ, the compliance of the tasks below along row i. For ε = 0
    and without other rows, row i yields

        J_i q̈ = β_i b_i + (1 − β_i) J_i q̈*_∖i,

    the blend of (29), where q̈*_∖i is the solution without row i. With other rows, row i has no
    effect at β_i = 0, and at β_i = 1 it is satisfied up to an error in proportion to ε. The paper
    blends all rows with the solution without any row: this blend jumps when a second row enters.

    H (n, n) is symmetric positive definite; `J` (k, n), `b` (k,) and `beta` (k,) are the rows. The
    first `fixed` entries of q̈ are fixed, and do not contribute to J_i H⁻¹ J_iᵀ. Returns (n, n)
    H + Σ w_i J_iᵀ J_i and (n,) c − Σ w_i b_i J_iᵀ, with w_i = β_i / ((1 − β_i + ε) J_i H⁻¹ J_iᵀ).

    Paper: Eq. (29).
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
def blend_base(free: Array, xdd_m: Array, beta_m: float) -> Array:
    """β_m ẍ_m + (1 − β_m) ẍ_free, (n_b,): the blend of (29) for the base's rows.

    Paper: Eq. (29), the base's rows.
    """
    return beta_m * xdd_m + (1.0 - beta_m) * free


@compiled()
def uncompensated_base_jacobian(J_ee: Array, qd_max: Array, J_m_inv: Array, speed: float) -> Array:
    """R (3, n_b) from ν of the base to end-effector velocity that the arm cannot compensate.

    An arm that lacks a joint, or is at full stretch, cannot compensate the base's motion: the base
    drags the end-effector along, the distance stays the same, and the base would continue. Our
    extension: R = (1 + (J Q² Jᵀ / v²)²)⁻¹ J_b. J is the arm's part of the end-effector's linear
    Jacobian in `J_ee` (6, n), and J_b the base's part times `J_m_inv`. Q is the diagonal matrix
    of the joints' speed limits `qd_max` (n_m,) [rad/s or m/s], and v is `speed` [m/s]. Along a
    direction in which the joints can move the end-effector at v, half of the base's motion remains.
    """
    n_b, n_m = len(J_m_inv), len(qd_max)
    follows = np.zeros((3, 3))
    for i in range(3):
        for j in range(3):
            for k in range(n_m):
                follows[i, j] += J_ee[i, n_b + k] * J_ee[j, n_b + k] * (qd_max[k] / speed) ** 2
    rest, moved = np.eye(3), np.empty((3, n_b))
    for i in range(3):
        for j in range(3):
            for k in range(3):
                rest[i, j] += follows[i, k] * follows[k, j]
    L = cholesky(rest)
    for j in range(n_b):
        put(moved[:, j], solved(L, times(J_ee[:3, :n_b], J_m_inv[:, j])))
    return moved


@compiled()
def limit_ee_drag(desired: Array, hold: Array, inertia: Array, mass: float, drag: Array) -> Array:
    """(n_b,) base acceleration near the desired one that drags the end-effector along less.

    The result a minimises (a − a_des)ᵀ I (a − a_des) + m ‖D (a − a_hold)‖². The second term acts
    like a mass m [kg] on the end-effector along directions in which the arm does not compensate the
    base's motion. Along all other directions D is close to 0, and a is close to a_des. With a_hold
    the end-effector fulfils its task. `desired` and `hold` (n_b,) are in m/s² or rad/s², `inertia`
    (n_b,) [kg or kg m²] is the diagonal of I, and `drag` D (3, n_b) is
    `uncompensated_base_jacobian` times the gain of the admittance law.
    """
    n_b = len(inertia)
    hung, right = np.zeros((n_b, n_b)), np.empty(n_b)
    for i in range(n_b):
        hung[i, i] = inertia[i]
        right[i] = inertia[i] * (desired[i] - hold[i])
        for j in range(n_b):
            for k in range(len(drag)):
                hung[i, j] += mass * drag[k, i] * drag[k, j]
    return hold + solved(cholesky(hung), right)
