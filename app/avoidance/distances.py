"""FindClosestPoints: signed distances of all link pairs, with a normal that keeps its sign."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from app.avoidance.closest_point import SmoothPoint
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
        core: (3,) [m] the point of the core of `b` behind p_b: its radius farther along n.
    """

    pair: Pair
    d: float
    p_a: Array
    p_b: Array
    n: Array
    core: Array


class DistanceMonitor:
    """Distances of a fixed set of link pairs at the robot's present state."""

    def __init__(self, state: RobotState, pairs: Sequence[Pair]) -> None:
        """Prepare the pairs, in the order of the results; `state` is read at each call."""
        self._state = state
        self._distances = PairDistances(state.model, pairs)
        self._smooth = [SmoothPoint(state.model, pair) for pair in pairs]

    def find_closest_points(
        self, *, within: float = -math.inf, blend: float = math.nan
    ) -> list[ClosestPoints]:
        """The closest points of every pair; within a distance such as move continuously.

        Paper: Algorithm 2, lines 4 and 9. The direction is the collision library's signed normal,
        not p_b - p_a, which flips in penetration and would turn repulsion into attraction.

        Args:
            within: [m] such as the buffer distance; by default all are the library's own.
            blend: [m] of `SmoothPoint`.
        """
        self._distances.update_from(self._state.data)
        found = []
        for i, (pair, smooth) in enumerate(zip(self._distances.pairs, self._smooth, strict=True)):
            d = self._distances.distance(i)
            if d < within:
                p_a, p_b, core, n = smooth.find(self._state.data, blend)
            else:
                _, p_a, p_b, n = self._distances.closest(i)
                core = p_b
            found.append(ClosestPoints(pair, d, p_a, p_b, n, core))
        return found

    def distances(self) -> tuple[float, ...]:
        """[m] the signed distance of every pair, without the points."""
        self._distances.update_from(self._state.data)
        return tuple(self._distances.distance(i) for i in range(len(self._distances.pairs)))
