"""Limits of the robot as bounds on its accelerations, always with a point that satisfies them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from app.avoidance.barrier import BarrierRow
from app.compiled import compiled
from app.config import LimitConfig
from app.control.hqp import Limits
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

    The joints' are the tighter ones of `position_bounds` and `velocity_bounds`.
    Where the joint bounds ask for more than the torques can do, they are widened to the nearest
    acceleration that the torques allow, so that the limits never contradict each other.

    Args:
        state: The robot's state.
        config: How fast limits may be approached.
        qdd_b: (n_b,) the base's reduced acceleration with which that is judged.
    """
    model, m = state.model, state.measurement
    return Limits(
        *_bounds(
            state.M, state.h, m.q_m, m.qd_m, model.q_limits, model.qd_limits, model.tau_max,
            model.J_m, model.base_acceleration_max, config.position_rate, config.velocity_rate,
            qdd_b,
        )
    )  # fmt: skip


@compiled(
    "Tuple((f8[:,::1], f8[::1], f8[::1]))(f8[:,:], f8[:], f8[:], f8[:], f8[:,:], f8[:,:], f8[:], "
    "f8[:,:], f8[:], f8, f8, f8[:])"
)
def _bounds(
    M: Array, h: Array, q_m: Array, qd_m: Array, q_limits: Array, qd_limits: Array, tau_max: Array,
    J_m: Array, base_limit: Array, position_rate: float, velocity_rate: float, qdd_b: Array,
) -> tuple[Array, Array, Array]:  # fmt: skip
    """C, l and u of `robot_limits`: rows of torques, of joints, of the base."""
    n_m, n, n_b = len(q_m), len(h), len(qdd_b)
    rows = 2 * n_m + len(base_limit)
    C, l, u = np.zeros((rows, n)), np.empty(rows), np.empty(rows)
    tamest, coupling, wanted = np.empty(n_m), np.zeros(n_m), np.empty(n_m)
    torques_do = True
    for i in range(n_m):
        braking = 2 * position_rate * qd_m[i]
        lower = max(
            position_rate**2 * (q_limits[0, i] - q_m[i]) - braking,
            velocity_rate * (qd_limits[0, i] - qd_m[i]),
        )
        upper = min(
            position_rate**2 * (q_limits[1, i] - q_m[i]) - braking,
            velocity_rate * (qd_limits[1, i] - qd_m[i]),
        )
        l[n_m + i], u[n_m + i] = min(lower, upper), max(lower, upper)
        tamest[i] = min(max(l[n_m + i], 0.0), u[n_m + i])  # nearest to no acceleration
        C[n_m + i, n_b + i] = 1.0
    for i in range(n_m):
        for j in range(n):
            C[i, j] = M[n_b + i, j]
        for j in range(n_b):
            coupling[i] += M[n_b + i, j] * qdd_b[j]
        wanted[i] = coupling[i]
        for j in range(n_m):
            wanted[i] += M[n_b + i, n_b + j] * tamest[j]
        l[i], u[i] = -tau_max[i] - h[n_b + i], tau_max[i] - h[n_b + i]
        torques_do = torques_do and l[i] <= wanted[i] <= u[i]
    if not torques_do:
        wanted = np.minimum(np.maximum(wanted, l[:n_m]), u[:n_m])
        tamest = np.linalg.solve(M[n_b:, n_b:].copy(), wanted - coupling)
        for i in range(n_m):
            l[n_m + i], u[n_m + i] = min(l[n_m + i], tamest[i]), max(u[n_m + i], tamest[i])
    for i in range(len(base_limit)):
        for j in range(n_b):
            C[2 * n_m + i, j] = J_m[i, j]
        l[2 * n_m + i], u[2 * n_m + i] = -base_limit[i], base_limit[i]
    return C, l, u
