"""Limits of the robot as bounds on its accelerations: those of torques hard, the others soft."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache

import numpy as np

from app.avoidance.barrier import BarrierRow
from app.compiled import compiled
from app.config import LimitConfig
from app.control.linear_algebra import minimum
from app.control.qp import Limits
from app.robot.state import RobotState

Array = np.ndarray


def position_bounds(state: RobotState, config: LimitConfig) -> Array:
    """(2, n_m) bounds on q̈_m from the position limits, the lower and the upper [rad/s² or m/s²].

    A joint at distance e from its limit may accelerate towards it at most by λ² e - 2 λ q̇, which
    lets it reach the limit without overshoot.
    """
    rate, m = config.position_rate, state.measurement
    return rate**2 * (state.model.q_limits - m.q_m) - 2 * rate * m.qd_m


def velocity_bounds(state: RobotState, config: LimitConfig) -> Array:
    """(2, n_m) κ (±q̇_max - q̇), towards the lower and the upper velocity limit [rad/s² or m/s²]."""
    return config.velocity_rate * (state.model.qd_limits - state.measurement.qd_m)


def joint_bounds(state: RobotState, config: LimitConfig) -> tuple[Array, Array]:
    """(n_m,) lower and (n_m,) upper bound on q̈_m: the tighter of position and velocity."""
    position, velocity = position_bounds(state, config), velocity_bounds(state, config)
    lower, upper = np.maximum(position[0], velocity[0]), np.minimum(position[1], velocity[1])
    return np.minimum(lower, upper), np.maximum(lower, upper)


@lru_cache(maxsize=32)
def softness_of(hard: int, joints: int, barriers: int, softness: float) -> Array:
    """(hard + joints + barriers,) [-] 0 of what is hard, ε² of joints, ε³ of barriers.

    With ε of a row of T_sca each kind gives way to the next: tasks to rows, rows to the joints'
    limits, and these, where torques do not suffice for both, to a distance. Not to be written to.
    """
    return np.repeat([0.0, softness**2, softness**3], [hard, joints, barriers])


def arm_limits(
    state: RobotState,
    config: LimitConfig,
    barriers: Sequence[BarrierRow],
    *,
    softness: float,
    qdd_b: Array,
    pushed: Array,
    torque: tuple[Array, Array],
) -> Limits:
    """Limits of the arm's accelerations q̈_m under a given motion of the base.

    Hard are the torques; soft the joints' positions and velocities and the barriers. What others
    exert on the arm moves it too: these are kept by q̈_m + M_aa⁻¹ r, the acceleration that the arm
    will have.

    Args:
        state: The robot's state.
        config: How fast limits may be approached.
        barriers: Distances that are kept.
        softness: [-] ε of `softness_of`.
        qdd_b: (n_b,) the base's reduced acceleration.
        pushed: (n_m,) [N m or N] r, the torques that others exert on the arm.
        torque: (n_m,) the smallest and (n_m,) the largest torque [N m or N] of this step.
    """
    model, m = state.model, state.measurement
    J = np.array([row.J for row in barriers]).reshape(len(barriers), model.n)
    least = np.array([row.l for row in barriers])
    bounds = _arm_bounds(
        state.M,
        state.h,
        m.q_m,
        m.qd_m,
        model.q_limits,
        model.qd_limits,
        config.position_rate,
        config.velocity_rate,
        qdd_b,
        *torque,
        J,
        least,
        -minimum(state.M[model.n_b :, model.n_b :], pushed)[0],
    )
    return Limits(*bounds, softness_of(model.n_m, model.n_m, len(barriers), softness))


@compiled(
    "Tuple((f8[:,::1], f8[::1], f8[::1]))(f8[:,:], f8[:], f8[:], f8[:], f8[:,:], f8[:,:], f8, f8, "
    "f8[:], f8[:], f8[:], f8[:,:], f8[:], f8[:])"
)
def _arm_bounds(
    M: Array,
    h: Array,
    q_m: Array,
    qd_m: Array,
    q_limits: Array,
    qd_limits: Array,
    position_rate: float,
    velocity_rate: float,
    qdd_b: Array,
    low: Array,
    high: Array,
    J: Array,
    least: Array,
    extra: Array,
) -> tuple[Array, Array, Array]:
    """C, l and u of `arm_limits`: rows of torques, of joints, of barriers; `extra` is M_aa⁻¹ r."""
    n_m, n_b, k = len(q_m), len(qdd_b), len(least)
    m = 2 * n_m + k
    C, l, u = np.zeros((m, n_m)), np.empty(m), np.full(m, np.inf)
    for i in range(n_m):
        there = h[n_b + i]
        for j in range(n_b):
            there += M[n_b + i, j] * qdd_b[j]
        for j in range(n_m):
            C[i, j] = M[n_b + i, n_b + j]
        l[i], u[i] = low[i] - there, high[i] - there
        braking = 2 * position_rate * qd_m[i]
        lower = max(
            position_rate**2 * (q_limits[0, i] - q_m[i]) - braking,
            velocity_rate * (qd_limits[0, i] - qd_m[i]),
        )
        upper = min(
            position_rate**2 * (q_limits[1, i] - q_m[i]) - braking,
            velocity_rate * (qd_limits[1, i] - qd_m[i]),
        )
        C[n_m + i, i] = 1.0
        l[n_m + i], u[n_m + i] = min(lower, upper) - extra[i], max(lower, upper) - extra[i]
    for i in range(k):
        l[2 * n_m + i] = least[i]
        for j in range(n_b):
            l[2 * n_m + i] -= J[i, j] * qdd_b[j]
        for j in range(n_m):
            C[2 * n_m + i, j] = J[i, n_b + j]
            l[2 * n_m + i] -= J[i, n_b + j] * extra[j]
    return C, l, u


def robot_limits(
    state: RobotState,
    config: LimitConfig,
    barriers: Sequence[BarrierRow] = (),
    *,
    softness: float,
) -> Limits:
    """Limits of base and arm together: hard torques and base accelerations, the others soft.

    Args:
        state: The robot's state.
        config: How fast limits may be approached.
        barriers: Distances that are kept.
        softness: [-] ε of `softness_of`.
    """
    model, n_b, n_m = state.model, state.model.n_b, state.model.n_m
    h_a, most = state.h[n_b:], model.base_acceleration_max
    lower, upper = joint_bounds(state, config)
    base, joints = np.zeros((len(most), model.n)), np.zeros((n_m, model.n))
    base[:, :n_b], joints[:, n_b:] = model.J_m, np.eye(n_m)
    C = np.vstack([state.M[n_b:], base, joints, *(row.J for row in barriers)])
    l = np.concatenate([-model.tau_max - h_a, -most, lower, [row.l for row in barriers]])
    u = np.concatenate([model.tau_max - h_a, most, upper, np.full(len(barriers), np.inf)])
    return Limits(C, l, u, softness_of(n_m + len(most), n_m, len(barriers), softness))
