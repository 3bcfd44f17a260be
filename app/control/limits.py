"""Limits of the robot as bounds on its accelerations, always with a point that satisfies them."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache

import numpy as np

from app.avoidance.barrier import BarrierRow
from app.config import LimitConfig
from app.control.hqp import Limits
from app.robot.model import RobotModel
from app.robot.state import RobotState

Array = np.ndarray


def acceleration_bounds(state: RobotState, config: LimitConfig) -> tuple[Array, Array]:
    """Bounds on q̈_m that keep the arm's joints within their position and velocity limits.

    A joint at distance e from its limit may accelerate towards it at most by λ² e - 2 λ q̇, which
    lets it reach the limit without overshoot; and by κ (q̇_max - q̇).

    Returns:
        (n_m,) lower and (n_m,) upper bound [rad/s² or m/s²], lower ≤ upper.
    """
    from_position, from_velocity = position_bounds(state, config), velocity_bounds(state, config)
    lower = np.maximum(from_position[0], from_velocity[0])
    upper = np.minimum(from_position[1], from_velocity[1])
    return np.minimum(lower, upper), np.maximum(lower, upper)


def position_bounds(state: RobotState, config: LimitConfig) -> Array:
    """(2, n_m) λ² e - 2 λ q̇ towards the lower and the upper position limit [rad/s² or m/s²]."""
    rate, m = config.position_rate, state.measurement
    return rate**2 * (state.model.q_limits - m.q_m) - 2 * rate * m.qd_m


def velocity_bounds(state: RobotState, config: LimitConfig) -> Array:
    """(2, n_m) κ (±q̇_max - q̇), towards the lower and the upper velocity limit [rad/s² or m/s²]."""
    return config.velocity_rate * (state.model.qd_limits - state.measurement.qd_m)


def with_barriers(limits: Limits, barriers: Sequence[BarrierRow]) -> Limits:
    """The same limits and J q̈ ≥ l for each barrier."""
    if not barriers:
        return limits
    return Limits(
        np.vstack([limits.C, *(row.J for row in barriers)]),
        np.concatenate([limits.l, [row.l for row in barriers]]),
        np.concatenate([limits.u, np.full(len(barriers), np.inf)]),
    )


def robot_limits(state: RobotState, config: LimitConfig, qdd_b: Array) -> Limits:
    """Torque, joint and base limits as l ≤ C q̈ ≤ u.

    Where the joint bounds ask for more than the torques can do, they are widened to the nearest
    acceleration that the torques allow, so that the limits never contradict each other.

    Args:
        state: The robot's state.
        config: How fast limits may be approached.
        qdd_b: (2,) [rad/s²] the wheels' acceleration with which that is judged.
    """
    model = state.model
    M_a, h_a = state.M[2:], state.h[2:]
    lower, upper = acceleration_bounds(state, config)
    tau_lower, tau_upper = -model.tau_max - h_a, model.tau_max - h_a
    coupling = M_a[:, :2] @ qdd_b
    tamest = np.minimum(np.maximum(lower, 0.0), upper)  # nearest to no acceleration
    wanted = M_a[:, 2:] @ tamest + coupling
    possible = np.minimum(np.maximum(wanted, tau_lower), tau_upper)
    if (possible != wanted).any():
        tamest = np.linalg.solve(M_a[:, 2:], possible - coupling)
        lower, upper = np.minimum(lower, tamest), np.maximum(upper, tamest)
    C = _constant_rows(model).copy()
    C[: model.n_m] = M_a
    base_limit = model.base_acceleration_max
    return Limits(
        C,
        np.concatenate([tau_lower, lower, -base_limit]),
        np.concatenate([tau_upper, upper, base_limit]),
    )


@lru_cache(maxsize=8)
def _constant_rows(model: RobotModel) -> Array:
    """(2 n_m + 2, n) the rows of all limits, zero where those of the torques are."""
    n_m = model.n_m
    C = np.zeros((2 * n_m + 2, model.n))
    C[n_m : 2 * n_m, 2:] = np.eye(n_m)
    C[2 * n_m :, :2] = model.J_m
    return C
