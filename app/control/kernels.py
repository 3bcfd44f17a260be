"""Kernels of the control step: limits, torques, and what the tasks below ask."""

import math

import numpy as np

from app.compiled import compiled
from app.control.active_sets import backward, cholesky, forward, times
from app.strict import Array


@compiled("f8[:,::1](f8[:], f8[:], f8[:,:], f8)")
def position_bounds(q: Array, qd: Array, limits: Array, rate: float) -> Array:
    """(2, n_m) λ² (q_limit - q) - 2 λ q̇, towards the lower and the upper limit."""
    return rate**2 * (limits - q) - 2 * rate * qd


@compiled("f8[:,::1](f8[:], f8[:,:], f8)")
def velocity_bounds(qd: Array, limits: Array, rate: float) -> Array:
    """(2, n_m) κ (q̇_limit - q̇), towards the lower and the upper limit."""
    return rate * (limits - qd)


@compiled("f8[::1](f8[:], f8[:], f8[:], f8, f8)")
def second_order(Jdqd: Array, speed: Array, h: Array, rate: float, leaving: float) -> Array:
    """-2 λ ḣ - λ² max(h, -v/λ) - J̇ q̇, with v the fastest that what is too near leaves."""
    return -2.0 * rate * speed - rate**2 * np.maximum(h, -leaving / rate) - Jdqd


@compiled()
def _joint_bounds(
    q: Array, qd: Array, q_limits: Array, qd_limits: Array, position_rate: float, speed_rate: float
) -> Array:
    """(2, n_m) the lower and the upper one on q̈_m: the tighter of position and velocity."""
    position = position_bounds(q, qd, q_limits, position_rate)
    velocity = velocity_bounds(qd, qd_limits, speed_rate)
    found = np.empty_like(position)
    for i in range(len(q)):
        lower = max(position[0, i], velocity[0, i])
        upper = min(position[1, i], velocity[1, i])
        found[0, i], found[1, i] = min(lower, upper), max(lower, upper)
    return found


@compiled()
def _in_reach(
    M: Array,
    h: Array,
    torque: Array,
    rate: float,
    bounds: Array,
    room: Array,
    qdd_b: Array,
    pushed: Array,
) -> Array:
    """The bounds (2, n_m) on q̈_m, brought in reach of each joint's own torque.

    No joint asks for more than its own torque gives in this step while the others' are in the
    middle of what they may be. If it asked for all at once, the torques of all others would swing
    from end to end for it, each too late, and throw an arm that is overpowered about. Nor does a
    joint gain speed faster than it could stop gaining: at the rate r of its torque q̈_i changes by
    (M⁻¹)_ii r, so that it may be √(2 (M⁻¹)_ii r v) with v left to the velocity limit.

    Args:
        M: (n, n) of (26).
        h: (n,) of (26).
        torque: (2, n_m) the least and the largest ones of this step.
        rate: [N m/s] at which they change.
        bounds: (2, n_m) on q̈_m.
        room: (2, n_m) of q̇_m to its lower and its upper limit.
        qdd_b: (n_b,) of the base.
        pushed: (n_m,) of q̈_m, by those who push.
    """
    found = np.empty_like(bounds)
    n_b, n_m, (low, high) = len(qdd_b), len(pushed), (torque[0], torque[1])
    L, acting = cholesky(M[n_b:, n_b:]), 0.5 * (low + high) - h[n_b:]
    qdd = pushed + backward(L, forward(L, acting - times(M[n_b:, :n_b], qdd_b)))
    for i in range(n_m):
        unit = np.zeros(n_m)
        unit[i] = 1.0
        moved = (forward(L, unit) ** 2).sum()
        own = 0.5 * moved * (high[i] - low[i])
        slower = math.sqrt(2.0 * moved * rate * max(-room[0, i], 0.0))
        faster = math.sqrt(2.0 * moved * rate * max(room[1, i], 0.0))
        lower = max(bounds[0, i], min(-slower, bounds[1, i]))
        upper = min(bounds[1, i], max(faster, bounds[0, i]))
        found[0, i], found[1, i] = min(lower, qdd[i] + own), max(upper, qdd[i] - own)
    return found


@compiled(
    "Tuple((f8[:,::1], f8[::1], f8[::1]))"
    "(f8[:,:], f8[:], f8[:,:], f8, f8[:], f8[:], f8[:,:], f8[:,:], f8, f8, f8[:], f8[:],"
    " f8[:,:], f8[:])"
)
def limit_rows(
    M: Array,
    h: Array,
    torque: Array,
    torque_rate: float,
    q: Array,
    qd: Array,
    q_limits: Array,
    qd_limits: Array,
    position_rate: float,
    speed_rate: float,
    qdd_b: Array,
    pushed: Array,
    J: Array,
    least: Array,
) -> tuple[Array, Array, Array]:
    """C (m, n), l (m,) and u (m,) of torques, joints and distances.

    Args:
        M: (n, n) of (26).
        h: (n,) of (26).
        torque: (2, n_m) the least and the largest ones.
        torque_rate: [N m/s] at which they change, or infinite: joints need not be in reach of them.
        q: (n_m,) positions.
        qd: (n_m,) velocities.
        q_limits: (2, n_m) the lower and the upper ones.
        qd_limits: (2, n_m) the same; joints' rows are in shares of the upper ones.
        position_rate: [1/s] of `position_bounds`.
        speed_rate: [1/s] of `velocity_bounds`.
        qdd_b: (n_b,) of the base.
        pushed: (n_m,) of q̈_m, by those who push.
        J: (k, n) of the distances.
        least: (k,) of J q̈.
    """
    n, n_m, k, unit = len(M), len(q), len(least), qd_limits[1]
    bounds = _joint_bounds(q, qd, q_limits, qd_limits, position_rate, speed_rate)
    if torque_rate < math.inf:
        room = qd_limits - qd
        bounds = _in_reach(M, h, torque, torque_rate, bounds, room, qdd_b, pushed)
    n_b, m = n - n_m, 2 * n_m + k
    C, l, u = np.zeros((m, n)), np.empty(m), np.full(m, np.inf)
    for i in range(n_m):
        joint, row = n_b + i, n_m + i
        C[i] = M[joint]
        l[i], u[i] = torque[0, i] - h[joint], torque[1, i] - h[joint]
        C[row, joint] = 1.0 / unit[i]
        l[row], u[row] = (bounds[0, i] - pushed[i]) / unit[i], (bounds[1, i] - pushed[i]) / unit[i]
    for i in range(k):
        C[2 * n_m + i] = J[i]
        l[2 * n_m + i] = least[i] - (J[i, n_b:] * pushed).sum()
    return C, l, u


@compiled("f8[::1](f8[:], f8[:,:], f8, f8)")
def reaction(d: Array, J: Array, f: float, d_b: float) -> Array:
    """Jᵀ f (1 - d/d_b) [N m or N] (n_m,) of the distances d (k,) within d_b; J (k, n_m)."""
    u_a = np.zeros(J.shape[1])
    for i in range(len(d)):
        share = f * min(max(1.0 - d[i] / d_b, 0.0), 1.0)
        for j in range(len(u_a)):
            u_a[j] += share * J[i, j]
    return u_a


@compiled("f8[::1](f8[:], f8[:], f8[:])")
def clipped(values: Array, low: Array, high: Array) -> Array:
    """Values within bounds; `np.clip` costs twice as much on so few."""
    found = np.empty_like(values)
    for i in range(len(values)):
        found[i] = min(max(values[i], low[i]), high[i])
    return found


@compiled("f8[:,::1](f8[:], f8[:], f8)")
def torque_range(last: Array, most: Array, change: float) -> Array:
    """(2, n_m) the smallest and the largest torque, `change` from the last one at most."""
    found = np.empty((2, len(last)))
    for i in range(len(last)):
        at = min(max(last[i], -most[i]), most[i])
        found[0, i], found[1, i] = max(at - change, -most[i]), min(at + change, most[i])
    return found


@compiled("f8[::1](f8[:], f8[:], f8[:], f8[:,:], f8, f8, f8)")
def towards_posture(
    q: Array, qd: Array, posture: Array, limits: Array, pull: float, drag: float, centring: float
) -> Array:
    """(n_m,) c_m of `app.control.tasks.posture_objective`."""
    c = np.empty(len(q))
    for i in range(len(q)):
        half = 0.5 * (limits[1, i] - limits[0, i])
        out = (q[i] - limits[0, i]) / half - 1.0
        c[i] = drag * qd[i] - pull * (posture[i] - q[i]) + centring * half * out**5
    return c


@compiled("Tuple((f8[::1], f8))(f8[:], f8[:], f8[:], f8, f8, f8)")
def to_reference(
    pose: Array, velocity: Array, acceleration: Array, k_p: float, k_v: float, most: float
) -> tuple[Array, float]:
    """(6,) acceleration + k_v velocity + k_p pose of an end-effector's error, and the pull's way.

    The linear and the angular part of the pull k_p pose are at most `most`; its way [m²] is
    ‖pull / k_p‖².
    """
    b, left = acceleration + k_v * velocity, 0.0
    for part in (slice(0, 3), slice(3, 6)):
        pull = k_p * pose[part]
        pull *= min(1.0, most / max(math.sqrt((pull**2).sum()), 1e-12))
        b[part] += pull
        left += (pull**2).sum()
    return b, left / max(k_p, 1e-12) ** 2


@compiled("Tuple((f8[:,::1], f8[::1]))(f8[:,:], f8[:], f8[:,:], f8[:], f8, f8[:], f8)")
def with_task(
    H: Array, c: Array, J: Array, b: Array, give: float, drag: Array, weight: float
) -> tuple[Array, Array]:
    """(1 + w λ) H + w Jᵀ J and c + w (λ H drag - Jᵀ b)."""
    n, (k, _) = len(c), J.shape
    H_all, c_all = np.empty((n, n)), np.empty(n)
    for i in range(n):
        dragged = asked = 0.0
        for j in range(n):
            both = 0.0
            for l in range(k):
                both += J[l, i] * J[l, j]
            H_all[i, j] = H[i, j] + weight * (give * H[i, j] + both)
            dragged += H[i, j] * drag[j]
        for l in range(k):
            asked += J[l, i] * b[l]
        c_all[i] = c[i] + weight * (give * dragged - asked)
    return H_all, c_all


@compiled("UniTuple(f8[::1], 3)(f8[:], f8[:], f8, f8[:], f8[:], f8[:], f8[:], f8[:])")
def base_blend(
    free: Array,
    xdd: Array,
    beta: float,
    low: Array,
    high: Array,
    gain: Array,
    drag: Array,
    velocity: Array,
) -> tuple[Array, Array, Array]:
    """β ẍ + (1 - β) ẍ_free of (29); the same within low and high; what is asked for ẍ_free.

    All (n_b,). Of an acceleration a the admittance law makes gain (a - drag ν), so that a base that
    is to have ẍ_free is asked ẍ_free / gain + drag ν.
    """
    wanted, asked = np.empty(len(free)), np.empty(len(free))
    for i in range(len(free)):
        wanted[i] = beta * xdd[i] + (1.0 - beta) * free[i]
        asked[i] = free[i] / gain[i] + drag[i] * velocity[i]
    return wanted, clipped(wanted, low, high), asked


@compiled("f8[:,::1](f8[:,:], f8[:], f8[:,:], f8)")
def carried(J_ee: Array, qd_max: Array, J_m_inv: Array, speed: float) -> Array:
    """R (3, n_b) of `app.control.tasks.carried`."""
    n_b, n_m = len(J_m_inv), len(qd_max)
    follows = np.zeros((3, 3))
    for i in range(3):
        for j in range(3):
            for k in range(n_m):
                follows[i, j] += J_ee[i, n_b + k] * J_ee[j, n_b + k] * (qd_max[k] / speed) ** 2
    left, moved = np.eye(3), np.zeros((3, n_b))
    for i in range(3):
        for j in range(3):
            for k in range(3):
                left[i, j] += follows[i, k] * follows[k, j]
        for j in range(n_b):
            for k in range(n_b):
                moved[i, j] += J_ee[i, k] * J_m_inv[k, j]
    L, found = cholesky(left), np.empty_like(moved)
    for j in range(n_b):
        found[:, j] = backward(L, forward(L, moved[:, j]))
    return found


@compiled("f8[::1](f8[:], f8[:], f8[:], f8, f8[:,:])")
def with_hand(wanted: Array, held: Array, inertia: Array, mass: float, taken: Array) -> Array:
    """The least (n_b,) of (a - a_wanted)ᵀ I (a - a_wanted) + mass ‖taken (a - a_held)‖²."""
    n_b = len(inertia)
    hung, right = np.diag(inertia), np.empty(n_b)
    for i in range(n_b):
        right[i] = inertia[i] * (wanted[i] - held[i])
        for j in range(n_b):
            for k in range(len(taken)):
                hung[i, j] += mass * taken[k, i] * taken[k, j]
    L = cholesky(hung)
    return held + backward(L, forward(L, right))
