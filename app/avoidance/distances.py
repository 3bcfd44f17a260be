"""FindClosestPoints: signed distances of all link pairs, with a normal that keeps its sign."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from app.robot.link_pairs import Pair, PairDistances
from app.robot.state import RobotState

Array = np.ndarray


class ClosestPoints(NamedTuple):
    """The closest points of one link pair, in the world.

    Attributes:
        pair: The link pair; `a` is nearer to the base than `b`.
        d: [m] signed distance, negative in penetration.
        p_a: (3,) [m] closest point on `a`.
        p_b: (3,) [m] closest point on `b`.
        n: (3,) unit normal from `a` to `b`: moving `b` along it increases d, in penetration too.
    """

    pair: Pair
    d: float
    p_a: Array
    p_b: Array
    n: Array


class DistanceMonitor:
    """Distances of a fixed set of link pairs at the robot's present state."""

    def __init__(self, state: RobotState, pairs: Sequence[Pair]) -> None:
        """Prepare the pairs, in the order of the results; `state` is read at each call."""
        self._state = state
        self._distances = PairDistances(state.model, pairs)

    def find_closest_points(self) -> list[ClosestPoints]:
        """The closest points of every pair.

        Paper: Algorithm 2, lines 4 and 9. The direction is the collision library's signed normal,
        not p_b - p_a, which flips in penetration and would turn repulsion into attraction.
        """
        self._distances.update_from(self._state.data)
        return [
            ClosestPoints(pair, *self._distances.closest(i))
            for i, pair in enumerate(self._distances.pairs)
        ]

    def distances(self) -> tuple[float, ...]:
        """[m] the signed distance of every pair, without the points."""
        self._distances.update_from(self._state.data)
        return tuple(self._distances.distance(i) for i in range(len(self._distances.pairs)))
