"""The compared method of §4.2.1: a repulsive force on the arm, in three dimensions."""

from __future__ import annotations

from app.avoidance.distances import ClosestPoints
from app.avoidance.task import TaskRows
from app.config import RepulsionConfig
from app.robot.state import RobotState


def generate_rep_force_acc(
    state: RobotState, closest: ClosestPoints, config: RepulsionConfig, beta: float
) -> TaskRows:
    """T_rep ∈ ℝ³, the compared method: the arm's closest point is pushed away from the base.

    ẍ_rep = k_p u - k_v (ṗ_b - ṗ_a), realised by the arm alone: the base's columns are zero.
    §4.2.1 names the method; its force on the closest point and its damping are Dietrich's.

    Args:
        state: The robot's state.
        closest: Closest points of a pair of L_m.
        config: Gains k_p and k_v.
        beta: [-] activation parameter of the pair.

    Returns:
        Three rows, in axes of the world.
    """
    joint = state.model.body_joint(closest.pair.b)
    J = state.point_jacobian(joint, closest.p_b)
    J[:, : state.model.n_b] = 0.0
    velocity = J @ state.qd  # relative to the base
    return TaskRows(
        J,
        state.point_bias(joint, closest.p_b),
        config.k_p * closest.n - config.k_v * velocity,
        beta,
    )
