"""How far the arm keeps its hand in place while the base moves under it.

The method moves the base and leaves the hand to the arm. An arm that lacks a joint for that, or
stands at full stretch, does not hold the hand: the base takes it along, the distance stays what it
was, and the base would drive on with the hand before it. Our extension.
"""

from __future__ import annotations

import numpy as np

from app.compiled import compiled
from app.robot.state import RobotState

Array = np.ndarray


def carried(state: RobotState, speed: float) -> Array:
    """(3, n_b) R: what the hand's place moves by the base's axes, less what the arm makes up for.

    R = (1 + (J Q² Jᵀ / v²)²)⁻¹ J_b with J and J_b the arm's and the base's part of the hand's
    Jacobian and Q the joints' largest speeds: along a direction in which they move the hand at v,
    half of the base's motion is left, and along one of twice that speed a seventeenth.

    Args:
        state: The robot's state.
        speed: [m/s] v.
    """
    model = state.model
    return _carried(state.J_ee, model.qd_max, model.J_m_inv, speed)


def base_with_hand(
    state: RobotState, wanted: Array, held: Array, weight: float, taken: Array
) -> Array:
    """The base's acceleration nearest to the wanted one that does not take the hand along, (n_b,).

    The least of (a - a_wanted)ᵀ I (a - a_wanted) + w m ‖R K (a - a_held)‖²: as if a mass hung on
    the hand where the arm does not follow. Where it does, R = 0 and this is the wanted one.

    Args:
        state: The robot's state.
        wanted: (n_b,) [m/s² or rad/s²] of (29).
        held: (n_b,) with which the hand does what its own task asks.
        weight: [-] w, of the hand in masses of the base.
        taken: (3, n_b) R of `carried` times K, what the admittance law makes of an acceleration.
    """
    base = state.model.description.base
    inertia = np.array([base.inertia_kgm2 if axis.angular else base.mass_kg for axis in base.axes])
    return _with_hand(wanted, held, inertia, weight * base.mass_kg, taken)


@compiled("f8[:,::1](f8[:,:], f8[:], f8[:,:], f8)")
def _carried(J_ee: Array, qd_max: Array, J_m_inv: Array, speed: float) -> Array:
    n_b, n_m = len(J_m_inv), len(qd_max)
    follows = np.zeros((3, 3))
    for i in range(3):
        for j in range(3):
            for k in range(n_m):
                follows[i, j] += J_ee[i, n_b + k] * J_ee[j, n_b + k] * (qd_max[k] / speed) ** 2
    left, moved = np.eye(3), np.zeros((3, n_b))
    for i in range(3):
        for j in range(3):
            for k in range(3):
                left[i, j] += follows[i, k] * follows[k, j]
        for j in range(n_b):
            for k in range(n_b):
                moved[i, j] += J_ee[i, k] * J_m_inv[k, j]
    return np.ascontiguousarray(np.linalg.solve(left, moved))


@compiled("f8[::1](f8[:], f8[:], f8[:], f8, f8[:,:])")
def _with_hand(wanted: Array, held: Array, inertia: Array, mass: float, taken: Array) -> Array:
    n_b = len(inertia)
    hung, right = np.diag(inertia), np.empty(n_b)
    for i in range(n_b):
        right[i] = inertia[i] * (wanted[i] - held[i])
        for j in range(n_b):
            for k in range(len(taken)):
                hung[i, j] += mass * taken[k, i] * taken[k, j]
    return held + np.linalg.solve(hung, right)
