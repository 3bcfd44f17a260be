"""A distance as an inequality: the arm's last resort, and the compared method of libraries."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from app.avoidance.distances import ClosestPoints
from app.avoidance.repulsion import distance_jacobian
from app.config import BarrierConfig
from app.robot.state import RobotState

Array = np.ndarray


class BarrierRow(NamedTuple):
    """J q̈ ≥ l.

    Attributes:
        J: (n,) Jacobian of the distance.
        l: [m/s²] lower bound.
    """

    J: Array
    l: float


def barrier_row(state: RobotState, closest: ClosestPoints, config: BarrierConfig) -> BarrierRow:
    """The row that keeps a pair's distance above d_min, for the base's columns as for the arm's.

    With h = d - d_min it asks for ḧ + 2 λ ḣ + λ² h ≥ 0: a pair that begins with ḣ + λ h ≥ 0 never
    comes nearer than d_min, and one that begins nearer, in penetration too, leaves at the rate λ,
    at `barrier.leaving` at most: h counts down to that speed over λ.
    It is the second-order form of the barriers ḣ + λ h ≥ 0 that libraries for velocities use.

    Args:
        state: The robot's state.
        closest: Closest points of the pair.
        config: d_min, λ and the speed.
    """
    row = distance_jacobian(state, closest)
    h = max(closest.d - config.d_min, -config.leaving / config.rate)
    return BarrierRow(row.J, -2 * config.rate * row.speed - config.rate**2 * h - row.Jdqd)
