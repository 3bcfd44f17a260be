"""Up to which force of a person the arm can keep its distance, by its torques alone."""

from __future__ import annotations

import numpy as np

from app.avoidance.distances import ClosestPoints
from app.avoidance.repulsion import distance_jacobian
from app.robot.state import RobotState

Array = np.ndarray


def force_bound(state: RobotState, closest: ClosestPoints) -> float:
    """[N] a push on the arm's closest point towards the other body that the arm can bear.

    A force F against the normal asks each joint for the torque g_i + J_i F, with J_i how the joint
    moves the distance. It stands while none of them is at its limit, up to

        F = min_i (τ_i - g_i sgn J_i) / |J_i|,

    of which a pair that comes nearer at the speed v needs v²/(2 d) / (J M⁻¹ Jᵀ) to stop within d.
    Beyond it the arm holds for a moment by its inertia, and joints may exceed their speeds.

    Args:
        state: The robot's state.
        closest: Closest points of a pair.

    Returns:
        0 where it cannot stop in time even if nobody pushes, and at contact.
    """
    n_b, row = state.model.n_b, distance_jacobian(state, closest)
    J, g = row.J[n_b:], state.g[n_b:]
    moved = np.abs(J) > 1e-9  # [m/rad or -]
    if closest.d <= 0.0 or not moved.any():
        return 0.0
    static = np.min((state.model.tau_max - g * np.sign(J))[moved] / np.abs(J)[moved])
    stopping = min(row.speed, 0.0) ** 2 / (2.0 * closest.d)
    return max(float(static - stopping / (J @ np.linalg.solve(state.M[n_b:, n_b:], J))), 0.0)
