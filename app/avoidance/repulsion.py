"""GenerateRepAcc: an acceleration in one dimension that parts the links of a pair (§3.2)."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from app.avoidance.distances import ClosestPoints
from app.config import RepulsionConfig
from app.robot.state import RobotState

Array = np.ndarray

class DistanceJacobian(NamedTuple):
    """How a pair's distance moves: ḋ = J q̇ and d̈ = J q̈ + J̇ q̇.

    Attributes:
        J: (n,) Jacobian of the distance.
        Jdqd: [m/s²] J̇ q̇, with the turning of l_a.
        speed: [m/s] ḋ.
    """

    J: Array
    Jdqd: float
    speed: float


def distance_jacobian(state: RobotState, closest: ClosestPoints) -> DistanceJacobian:
    """J = uᵀ(J_b - J_a) at the core of l_b, with u fixed to l_a.

    u is the collision library's signed normal: the printed (p_b - p_a)/‖p_b - p_a‖ flips in
    penetration. A face keeps its normal while the closest points of a round link slide along it,
    and the point of the link's core, its radius behind p_b, stays: there d̈ is exact. The curvature
    |v_⊥|²/d of the distance of two fixed points would be ten times as wrong as none.

    Paper: Eq. (21).
    """
    model, pair = state.model, closest.pair
    joint_a, joint_b = model.body_joint(pair.a), model.body_joint(pair.b)
    return DistanceJacobian(*state.pair_motion(joint_a, joint_b, closest.core, closest.n))


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
