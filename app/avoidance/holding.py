"""How far the arm keeps its hand in place while the base moves under it.

The method moves the base and leaves the hand to the arm. An arm that lacks a joint for that, or
stands at full stretch, does not hold the hand: the base takes it along, the distance stays what it
was, and the base would drive on with the hand before it. Our extension.
"""

from __future__ import annotations

import numpy as np

from app.config import HoldingConfig
from app.robot.state import RobotState

Array = np.ndarray


def carried(state: RobotState, config: HoldingConfig) -> Array:
    """(3, n_b) R: what the hand's place moves by the base's axes, less what the arm makes up for.

    R = v² (J Q² Jᵀ + v² 1)⁻¹ J_b with J and J_b the arm's and the base's part of the hand's
    Jacobian and Q the joints' largest speeds: along a direction in which the arm moves its hand
    at v or slower, half of the base's motion or more is left.
    """
    model = state.model
    J = state.J_ee[:3, model.n_b :] * model.qd_max
    left = np.linalg.solve(J @ J.T / config.speed**2 + np.eye(3), state.J_ee[:3, : model.n_b])
    return left @ model.J_m_inv


def base_with_hand(state: RobotState, wanted: Array, free: Array, config: HoldingConfig) -> Array:
    """The base's acceleration nearest to the wanted one that does not take the hand along, (n_b,).

    The least of (a - a_wanted)ᵀ I (a - a_wanted) + μ m ‖R (a - a_free)‖²: as if a mass hung on the
    hand where the arm does not follow. Where it does, R = 0 and this is the wanted one.

    Args:
        state: The robot's state.
        wanted: (n_b,) [m/s² or rad/s²] of (29).
        free: (n_b,) without the rows of T_sca, by which the hand does what its own task asks.
        config: v and μ.
    """
    base, R = state.model.description.base, carried(state, config)
    inertia = np.array([base.inertia_kgm2 if axis.angular else base.mass_kg for axis in base.axes])
    hung = np.diag(inertia) + config.weight * base.mass_kg * R.T @ R
    return free + np.linalg.solve(hung, inertia * (wanted - free))
