"""The robot's limits as rows l ≤ C q̈ ≤ u: torques, joint positions and speeds, distances.

Torque limits are hard. Limits of joints and distances are soft: if they contradict each other or
the torque limits, the QP still has a solution. In the arm's QP, limits of joints and distances
constrain the arm's total acceleration: the sum of q̈_m and the acceleration by external forces.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from app.compiled import compiled
from app.control.qp import cholesky, clip, fill, forward, inverse_diagonal, put, solved, times
from app.strict import Array


@compiled()
def torque_range(u_last: Array, tau_max: Array, change: float) -> tuple[Array, Array]:
    """Smallest and largest torques (n_m,) [N m or N]: `u_last` ± `change`, within ±`tau_max`."""
    at = clip(u_last, -tau_max, tau_max)
    return np.maximum(at - change, -tau_max), np.minimum(at + change, tau_max)


@compiled()
def position_bound(q: float, qd: float, limit: float, rate: float) -> float:
    """λ² (q_limit − q) − 2 λ q̇ [rad/s² or m/s²]: bound on q̈ by a position limit of a joint.

    λ is `rate` [1/s]. With the distance e from the limit, the acceleration towards the limit is at
    most λ² e + 2 λ ė. Thus a joint that starts with −ė ≤ λ e does not pass the limit.
    """
    return rate**2 * (limit - q) - 2 * rate * qd


@compiled()
def velocity_bound(qd: float, limit: float, rate: float) -> float:
    """κ (±q̇_max − q̇) [rad/s² or m/s²]: bound on q̈ by a speed limit ±q̇_max; κ = `rate` [1/s]."""
    return rate * (limit - qd)


@compiled()
def barrier_bound(Jdqd: float, d_dot: float, h: float, rate: float, max_speed: float) -> float:
    """The lower bound [m/s²] on J q̈ that keeps h = d − d_min [m] from becoming negative.

    ḧ + 2 λ ḣ + λ² h ≥ 0: a pair that starts with ḣ + λ h ≥ 0 never comes nearer than d_min. A pair
    that starts nearer, even in penetration, separates at the rate λ (`rate` [1/s]), at most at
    `max_speed` [m/s], because an h below −2 max_speed/λ counts as this value. `Jdqd` [m/s²] is the
    acceleration of the distance at q̈ = 0, `d_dot` [m/s] its speed.
    """
    return -2.0 * rate * d_dot - rate**2 * max(h, -2.0 * max_speed / rate) - Jdqd


@compiled()
def joint_bounds(
    q: Array,
    qd: Array,
    q_limits: Array,
    qd_limits: Array,
    position_rate: float,
    speed_rate: float,
    fastest: float,
) -> Array:
    """(2, n_m) [rad/s² or m/s²] lower and upper bounds on q̈_m, from position and speed limits.

    For each joint and side, the tightest of four bounds counts: the bounds by position and by speed
    with their own rates [1/s], and the same two with rates of at most `fastest` [1/s]. A slow rate
    brakes early, a fast one brakes strongly. If a lower bound exceeds the upper bound of the same
    joint, the two are exchanged. `q` and `qd` (n_m,) are the joints' positions and speeds; the rows
    of `q_limits` and `qd_limits` (2, n_m) are lower and upper limits.
    """
    found = np.empty((2, len(q)))
    for i in range(len(q)):
        lower, upper = -math.inf, math.inf
        for slowest in (math.inf, fastest):
            by_position, by_speed = min(position_rate, slowest), min(speed_rate, slowest)
            lower = max(lower, position_bound(q[i], qd[i], q_limits[0, i], by_position))
            lower = max(lower, velocity_bound(qd[i], qd_limits[0, i], by_speed))
            upper = min(upper, position_bound(q[i], qd[i], q_limits[1, i], by_position))
            upper = min(upper, velocity_bound(qd[i], qd_limits[1, i], by_speed))
        found[0, i], found[1, i] = min(lower, upper), max(lower, upper)
    return found


@compiled()
def torque_reachable_bounds(
    robot: Any, gains: Any, w: Any, bounds: Array, qd_limits: Array
) -> Array:
    """(2, n_m) the `bounds` on q̈_m, changed so that each joint can satisfy them by its own torque.

    First, the acceleration towards a speed limit is bounded: if a joint's torque changes at the
    rate r [N m/s or N/s], its acceleration q̈_i changes at the rate (M_aa⁻¹)_ii r. A joint whose
    speed is below its limit by v can therefore end the acceleration √(2 (M_aa⁻¹)_ii r v) in time.
    Then no bound demands more than the joint's torque achieves in this step, with the other torques
    in the middle of their ranges. If one joint demanded more, the other torques would switch
    between their limits, and an arm at its torque limits would become unstable. `qd_limits`
    (2, n_m) are the speed limits, reduced by their margin.
    """
    found, n_b, u_min, u_max = np.empty_like(bounds), robot.n_b, w.u_min, w.u_max
    base = times(w.M[n_b:, :n_b], times(robot.J_m_inv, w.a_base_meas))
    qdd = w.x_est[2] + solved(w.L_aa, 0.5 * (u_min + u_max) - w.h[n_b:] - base)
    inverse, room = inverse_diagonal(w.L_aa), qd_limits - w.qd_m
    for i in range(len(qdd)):
        moved = inverse[i]
        own = 0.5 * moved * (u_max[i] - u_min[i])
        slower = math.sqrt(2.0 * moved * gains.torque_rate * max(-room[0, i], 0.0))
        faster = math.sqrt(2.0 * moved * gains.torque_rate * max(room[1, i], 0.0))
        lower = max(bounds[0, i], min(-slower, bounds[1, i]))
        upper = min(bounds[1, i], max(faster, bounds[0, i]))
        found[0, i], found[1, i] = min(lower, qdd[i] + own), max(upper, qdd[i] - own)
    return found


@compiled()
def torque_rows(
    M: Array, h: Array, u_min: Array, u_max: Array, C: Array, l: Array, u: Array
) -> None:
    """Write the torque limits of M_a q̈ + h_a into the first n_m rows of C (m, n), l and u (m,)."""
    n_m = len(u_min)
    n_b = len(h) - n_m
    for i in range(n_m):
        put(C[i], M[n_b + i])
        l[i], u[i] = u_min[i] - h[n_b + i], u_max[i] - h[n_b + i]


@compiled()
def joint_rows(bounds: Array, qdd_ext: Array, unit: Array, C: Array, l: Array, u: Array) -> None:
    """Write the bounds (2, n_m) on q̈_m + `qdd_ext` into C (n_m, n), l and u (n_m,).

    Each row is divided by its `unit` (n_m,), the speed limit of the joint, so that a violation
    costs the same for every joint. `qdd_ext` (n_m,) is the external acceleration.
    """
    n_m = len(unit)
    n_b = C.shape[1] - n_m
    for i in range(n_m):
        fill(C[i], 0.0)
        C[i, n_b + i] = 1.0 / unit[i]
        l[i], u[i] = (bounds[0, i] - qdd_ext[i]) / unit[i], (bounds[1, i] - qdd_ext[i]) / unit[i]


@compiled()
def force_bound(d: float, J: Array, d_dot: float, M: Array, load: Array, tau_max: Array) -> float:
    """[N] largest push on the arm's closest point towards the other body that the arm can resist.

    A push F against the normal requires the torque t_i + J_i F of joint i, with the distance's
    Jacobian J_i and the torque t_i without the push. The torques stay within their limits τ_i up to

        F_0 = min_i (τ_i − t_i sgn J_i) / |J_i|.

    The result is F_0 minus the force v²/(2 d) / (J M⁻¹ Jᵀ), with the arm's parts of J and M. This
    force stops a pair that approaches at the speed v within the distance d. Against a larger push
    the arm resists for a moment by its inertia, and joints can exceed their speed limits. The
    result is at least 0; it is 0 at contact, and if no joint of the arm changes the distance.

    `d` [m] is the signed distance, `d_dot` [m/s] its derivative, J (n,) its Jacobian, and M (n, n)
    the inertia matrix. `load` (n,) has the torques t: the gravity terms at rest, or
    `steady_torques`. `tau_max` (n_m,) has the τ_i.
    """
    n_b, static = len(J) - len(tau_max), np.inf
    for i in range(len(tau_max)):
        moved = J[n_b + i]
        if abs(moved) > 1e-9:  # [m/rad or -]
            static = min(static, (tau_max[i] - load[n_b + i] * np.sign(moved)) / abs(moved))
    if d <= 0.0 or static == np.inf:
        return 0.0
    a = forward(cholesky(M[n_b:, n_b:]), J[n_b:])
    return float(max(static - min(d_dot, 0.0) ** 2 / (2.0 * d) / (a**2).sum(), 0.0))


@compiled()
def steady_torques(M: Array, h: Array, qdd: Array) -> Array:
    """(n,) torque for each entry of q̇ that keeps this entry constant, without external forces.

    The other entries have their present accelerations q̈ (n,): a wrist at its speed limit needs more
    torque while an elbow brakes. M (n, n) and h (n,) are the step's quantities.
    """
    return h + M @ qdd - np.diag(M) * qdd
