"""GenerateRepAcc: an acceleration in one dimension that parts the links of a pair (§3.2)."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from app.avoidance.distances import ClosestPoints
from app.config import RepulsionConfig
from app.robot.state import RobotState

Array = np.ndarray

_NEAR = 0.02  # [m] below this distance the turning of the normal is taken as at this distance


class DistanceJacobian(NamedTuple):
    """How a pair's distance moves: ḋ = J q̇ and d̈ = J q̈ + J̇ q̇.

    Attributes:
        J: (n,) Jacobian of the distance.
        Jdqd: [m/s²] J̇ q̇, the turning of the normal included.
        speed: [m/s] ḋ.
    """

    J: Array
    Jdqd: float
    speed: float


def distance_jacobian(state: RobotState, closest: ClosestPoints) -> DistanceJacobian:
    """J = uᵀ(J_b - J_a), with the closest points fixed to their links for the step.

    u is the collision library's signed normal: the printed (p_b - p_a)/‖p_b - p_a‖ flips in
    penetration.

    Paper: Eq. (21).
    """
    u = closest.n
    joint_a, joint_b = _joints(state, closest)
    relative = _relative_jacobian(state, closest)
    velocity = relative @ state.qd
    speed = float(u @ velocity)
    across = velocity - speed * u
    bias = state.point_bias(joint_b, closest.p_b) - state.point_bias(joint_a, closest.p_a)
    turning = float(across @ across) / max(closest.d, _NEAR)
    return DistanceJacobian(u @ relative, float(u @ bias) + turning, speed)


def distance_speed(state: RobotState, closest: ClosestPoints) -> float:
    """ḋ [m/s] of a pair, negative while it closes; the `speed` of `distance_jacobian` alone."""
    return float(closest.n @ (_relative_jacobian(state, closest) @ state.qd))


def _relative_jacobian(state: RobotState, closest: ClosestPoints) -> Array:
    """J_b - J_a of the closest points, (3, n)."""
    joint_a, joint_b = _joints(state, closest)
    return state.point_jacobian(joint_b, closest.p_b) - state.point_jacobian(joint_a, closest.p_a)


def _joints(state: RobotState, closest: ClosestPoints) -> tuple[int, int]:
    return state.model.body_joint(closest.pair.a), state.model.body_joint(closest.pair.b)


class RepulsiveRow(NamedTuple):
    """One row of the avoidance task.

    Attributes:
        J_r: (n,) Jacobian of the distance.
        Jdqd: [m/s²] J̇_r q̇.
        xdd_r: [m/s²] desired acceleration of the distance.
    """

    J_r: Array
    Jdqd: float
    xdd_r: float


def generate_rep_acc(
    state: RobotState, closest: ClosestPoints, config: RepulsionConfig
) -> RepulsiveRow:
    """The repulsive acceleration of one pair and its Jacobian, ẍ_r = k_p - k_v uᵀ(ṗ_b - ṗ_a).

    Paper: Eq. (20).

    Args:
        state: The robot's state.
        closest: Closest points of the pair.
        config: Gains k_p and k_v.
    """
    row = distance_jacobian(state, closest)
    return RepulsiveRow(row.J, row.Jdqd, config.k_p - config.k_v * row.speed)
