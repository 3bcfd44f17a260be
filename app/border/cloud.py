"""P_i of Algorithm 1: points of an arm's body around the mobile robot, with their distances d_m."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

Array = np.ndarray

POINT_UNIT = 1e-4
"""[m] resolution of the kept points."""
DISTANCE_UNIT = 1e-5
"""[m] resolution of the kept distances."""
POINT_RANGE = 3.2
"""[m] largest coordinate that can be kept."""


@dataclass(frozen=True)
class Cloud:
    """P_i of one pair of L_m, sorted by height.

    Attributes:
        pair: Name of the pair, as in `lm-lEE`.
        points: (N, 3) int16 in units of 0.1 mm, in the base's frame; column 2 ascends.
        distances: (N,) uint16 in units of 10 µm, d_m of exactly these points.
    """

    pair: str
    points: Array
    distances: Array

    def __len__(self) -> int:
        return len(self.distances)

    @property
    def points_m(self) -> Array:
        """(N, 3) [m] the points in the base's frame."""
        return self.points * POINT_UNIT

    def points_m_at(self, chosen: Array) -> Array:
        """(M, 3) [m] the points at the indices `chosen` (M,)."""
        return self.points[chosen] * POINT_UNIT

    @property
    def d_m(self) -> Array:
        """(N,) [m] their distances to l_m."""
        return self.distances * DISTANCE_UNIT


def make_cloud(pair: str, points: Array, distances: Array) -> Cloud:
    """A cloud from points in any order.

    Args:
        pair: Name of the pair.
        points: (N, 3) int16 as in `Cloud`.
        distances: (N,) uint16 as in `Cloud`.
    """
    x, y, z = points.astype(np.int64).T
    # One key of height, then y, then x: sorting it is several times faster than by three keys.
    order = np.argsort((z << 32) + (y << 16) + x)
    return Cloud(pair, _frozen(points[order]), _frozen(distances[order]))


def quantise_points(points: Array) -> Array:
    """(N, 3) int16 from points (N, 3) [m]; beyond the range they stop at its end."""
    return np.rint(np.clip(points, -POINT_RANGE, POINT_RANGE) / POINT_UNIT).astype(np.int16)


def quantise_distances(distances: Array) -> Array:
    """(N,) uint16 from distances (N,) [m] of zero or more."""
    return np.rint(np.clip(distances, 0.0, 0.65) / DISTANCE_UNIT).astype(np.uint16)


def _frozen(array: Array) -> Array:
    array = np.ascontiguousarray(array)
    array.setflags(write=False)
    return array
