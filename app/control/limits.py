"""What the robot keeps whatever its tasks ask: torques, joints' ranges and speeds, distances.

All of it bounds accelerations of a QP. Torques are hard; joints and distances give in where they
contradict each other. What others exert on the arm moves it too, so the latter are kept by the
acceleration that the arm will have.
"""

from __future__ import annotations

import math
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from app.avoidance.task import Distances
from app.config import BarrierConfig, Config, LimitConfig
from app.control import kernels
from app.control.qp import Limits
from app.robot.model import RobotModel
from app.robot.state import RobotState
from app.strict import Array


def barrier_bounds(left: Distances, config: BarrierConfig) -> Array:
    """(k,) lower bounds [m/s²] on J q̈, so that no distance falls below 0, (k,) of them left.

    It asks for ḧ + 2 λ ḣ + λ² h ≥ 0, with h what is left: a pair that begins with ḣ + λ h ≥ 0
    never comes nearer, and one that begins nearer, in penetration too, leaves at the rate λ, at
    `barrier.leaving` at most: h counts down to that speed over λ. It is the second-order form of
    the barriers ḣ + λ h ≥ 0 that libraries for velocities use.
    """
    return kernels.second_order(left.Jdqd, left.speed, left.d, config.rate, config.leaving)


def position_bounds(state: RobotState, config: LimitConfig) -> Array:
    """(2, n_m) bounds on q̈_m from the position limits, the lower and the upper [rad/s² or m/s²].

    A joint at distance e from its limit may accelerate towards it at most by λ² e - 2 λ q̇, which
    lets it reach the limit without overshoot.
    """
    m = state.measurement
    return kernels.position_bounds(m.q_m, m.qd_m, state.model.q_limits, config.position_rate)


def velocity_bounds(state: RobotState, config: LimitConfig) -> Array:
    """(2, n_m) κ (±q̇_max - q̇), towards the lower and the upper velocity limit [rad/s² or m/s²]."""
    return kernels.velocity_bounds(
        state.measurement.qd_m, state.model.qd_limits, config.velocity_rate
    )


class ArmNow(NamedTuple):
    """What bounds the arm's part of a step, beside the robot's state."""

    qdd_b: Array
    """(n_b,) q̈ of the base."""
    torque: Array
    """(2, n_m) the smallest and the largest torque [N m or N] of this step."""
    pushed: Array
    """(n_m,) [rad/s² or m/s²] what others who push the arm add to q̈_m."""


def robot_limits(
    state: RobotState,
    config: Config,
    kept: Distances | None = None,
    *,
    arm: ArmNow | None = None,
) -> Limits:
    """Limits on q̈ of base and arm: torques, then joints, then barriers.

    With ε = `task.softness` of a row of T_sca each kind gives way to the next: tasks to rows, rows
    (ε) to joints' limits and distances (ε²), and these to torques. Where torques do not suffice for
    both, joints and distances share what is missed: neither is bought by throwing the other away.
    The arm's part asks of no joint what its own torque does not give, in this step, or in time to
    end below its velocity limit.

    Args:
        state: The robot's state.
        config: How fast limits may be approached.
        kept: Distances that are kept, as what is left of them.
        arm: For the arm's part; else any torque up to the joints' own may act in this step, and
            nobody pushes.
    """
    model, M, h = state.model, state.M, state.h
    J, least = np.zeros((0, model.n)), np.zeros(0)
    if kept is not None:
        J, least = kept.J, barrier_bounds(kept, config.barrier)
    m, limit, rate = state.measurement, config.limit, config.limit.torque_rate
    moving = (
        m.q_m,
        m.qd_m,
        model.q_limits,
        model.qd_limits,
        limit.position_rate,
        limit.velocity_rate,
    )
    if arm is None:
        arm = ArmNow(np.zeros(model.n_b), model.tau_limits, np.zeros(model.n_m))
        rate = math.inf
    qdd_b, torque, pushed = arm
    return Limits(
        *kernels.limit_rows(M, h, torque, rate, *moving, qdd_b, pushed, J, least),
        _softness(model.n_m, len(least), config.task.softness),
    )


@lru_cache(maxsize=32)
def _softness(n_m: int, barriers: int, softness: float) -> Array:
    """(m,) [-] of torques, joints and barriers, not to be written to."""
    return np.repeat([0.0, softness**2], [n_m, n_m + barriers])


def base_limits(model: RobotModel) -> Limits:
    """Limits on q̈ of the base's accelerations, hard."""
    most = model.base_acceleration_max
    return Limits(model.base_rows, -most, most, np.zeros(model.n_b))


def force_bound(state: RobotState, distance: Distances) -> float:
    """[N] a push on the arm's closest point towards the other body that the arm can bear.

    A force F against the normal asks each joint for the torque g_i + J_i F, with J_i how the joint
    moves the distance. It stands while none of them is at its limit, up to

        F = min_i (τ_i - g_i sgn J_i) / |J_i|,

    of which a pair that comes nearer at the speed v needs v²/(2 d) / (J M⁻¹ Jᵀ) to stop within d.
    Beyond it the arm holds for a moment by its inertia, and joints may exceed their speeds. It is 0
    where it cannot stop in time even if nobody pushes, and at contact.
    """
    n_b, ((d,), (row,), _, (speed,)) = state.model.n_b, distance
    J, g = row[n_b:], state.g[n_b:]
    moved = np.abs(J) > 1e-9  # [m/rad or -]
    if d <= 0.0 or not moved.any():
        return 0.0
    static = np.min((state.model.tau_max - g * np.sign(J))[moved] / np.abs(J)[moved])
    stopping = min(speed, 0.0) ** 2 / (2.0 * d)
    return max(float(static - stopping / (J @ np.linalg.solve(state.M[n_b:, n_b:], J))), 0.0)
