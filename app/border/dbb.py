"""Algorithm 1: P_i, points of an arm's body around the mobile robot, and the border among them."""

from dataclasses import dataclass

import numpy as np

from app.strict import Array

POINT_UNIT = 1e-4  # [m] resolution of the stored points
DISTANCE_UNIT = 1e-5  # [m] resolution of the stored distances
POINT_RANGE = 3.2  # [m] largest coordinate that can be stored


@dataclass(frozen=True, eq=False)
class Cloud:
    """P_i of one pair of L_m, sorted by height."""

    pair: str
    """Name of the pair, as in `lm-lEE`."""
    points: Array
    """(N, 3) int16 in units of 0.1 mm, in the base's frame; column 2 ascends."""
    distances: Array
    """(N,) uint16 in units of 10 µm, d_m of exactly these points."""

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
    """A cloud from points (N, 3) int16 and distances (N,) uint16, as in `Cloud`, in any order."""
    x, y, z = points.astype(np.int64).T
    # One key of height, then y, then x, because sorting it is several times faster than three keys.
    order = np.argsort((z << 32) + (y << 16) + x)
    return Cloud(pair, _frozen(points[order]), _frozen(distances[order]))


def quantise_points(points: Array) -> Array:
    """(N, 3) int16 from points (N, 3) [m], clipped to the range."""
    return np.rint(np.clip(points, -POINT_RANGE, POINT_RANGE) / POINT_UNIT).astype(np.int16)


def quantise_distances(distances: Array) -> Array:
    """(N,) uint16 from distances (N,) [m] ≥ 0."""
    return np.rint(np.clip(distances, 0.0, 0.65) / DISTANCE_UNIT).astype(np.uint16)


def _frozen(array: Array) -> Array:
    array = np.ascontiguousarray(array)
    array.setflags(write=False)
    return array


SAME_HEIGHT = 0.005  # [m] tolerance of the height of a point


@dataclass(frozen=True)
class Border:
    """DBB_i of one pair of L_m, in the base's frame, sorted by height."""

    pair: str
    """Name of the pair, as in `lm-lEE`."""
    d_b: float
    """[m] buffer distance."""
    eps: float
    """[m] tolerance ε."""
    points: Array
    """(N, 3) [m], column 2 ascends."""
    heights: Array
    """(N,) [m] column 2 of the points, contiguous."""

    def __len__(self) -> int:
        return len(self.points)

    def same_height(self, z: float, half_thickness: float = SAME_HEIGHT) -> Array:
        """(M, 3) [m] DBB_xy: FindSameHeight of Algorithm 3, in O(log N) and without a copy.

        A view of the points within a half thickness [m] of a height z [m].
        """
        first = self.heights.searchsorted(z - half_thickness, "left")
        last = self.heights.searchsorted(z + half_thickness, "right")
        return self.points[first:last]


def construct_dbb(cloud: Cloud, d_b: float, eps: float) -> Border:
    """ConstructDBB: the points of P_i whose distance to l_m is d_b within ε, both [m].

    Paper: Eq. (3).

    Stored distances are rounded, so the selection is narrower by half of their resolution: each
    point is within ε of d_b when measured again. The border is empty if P_i has no such points.
    """
    slack = eps - DISTANCE_UNIT / 2
    low = int(np.ceil((d_b - slack) / DISTANCE_UNIT))
    high = int(np.floor((d_b + slack) / DISTANCE_UNIT))
    chosen = np.flatnonzero((cloud.distances >= low) & (cloud.distances <= high))
    points = cloud.points_m_at(chosen)
    heights = np.ascontiguousarray(points[:, 2])
    points.setflags(write=False)
    heights.setflags(write=False)
    return Border(cloud.pair, d_b, eps, points, heights)
