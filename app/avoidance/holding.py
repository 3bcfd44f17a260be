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

    R = (1 + (J Q² Jᵀ / v²)²)⁻¹ J_b with J and J_b the arm's and the base's part of the hand's
    Jacobian and Q the joints' largest speeds: along a direction in which they move the hand at v,
    half of the base's motion is left, and along one of twice that speed a seventeenth.
    """
    model = state.model
    J = state.J_ee[:3, model.n_b :] * model.qd_max
    follows = J @ J.T / config.speed**2
    left = np.linalg.solve(np.eye(3) + follows @ follows, state.J_ee[:3, : model.n_b])
    return left @ model.J_m_inv


def base_with_hand(
    state: RobotState, wanted: Array, held: Array, gain: Array, weight: float, R: Array
) -> Array:
    """The base's acceleration nearest to the wanted one that does not take the hand along, (n_b,).

    The least of (a - a_wanted)ᵀ I (a - a_wanted) + w m ‖R K (a - a_held)‖²: as if a mass hung on
    the hand where the arm does not follow. Where it does, R = 0 and this is the wanted one.

    Args:
        state: The robot's state.
        wanted: (n_b,) [m/s² or rad/s²] of (29).
        held: (n_b,) with which the hand does what its own task asks.
        gain: (n_b,) [-] K, what the admittance law makes of an acceleration.
        weight: [-] w, of the hand in masses of the base.
        R: (3, n_b) of `carried`.
    """
    base = state.model.description.base
    inertia = np.array([base.inertia_kgm2 if axis.angular else base.mass_kg for axis in base.axes])
    taken = R * gain
    hung = np.diag(inertia) + weight * base.mass_kg * taken.T @ taken
    return held + np.linalg.solve(hung, inertia * (wanted - held))
