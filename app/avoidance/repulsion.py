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
    J, bias, speed, across = state.pair_motion(*_points(state, closest))
    return DistanceJacobian(J, bias + across / max(closest.d, _NEAR), speed)


def distance_speed(state: RobotState, closest: ClosestPoints) -> float:
    """ḋ [m/s] of a pair, negative while it closes; the `speed` of `distance_jacobian` alone."""
    return state.pair_speed(*_points(state, closest))


def _points(state: RobotState, closest: ClosestPoints) -> tuple[int, Array, int, Array, Array]:
    """Joint and point of either body, and the normal."""
    model, pair = state.model, closest.pair
    return (
        model.body_joint(pair.a), closest.p_a, model.body_joint(pair.b), closest.p_b, closest.n,
    )  # fmt: skip


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
