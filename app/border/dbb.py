"""Algorithm 1: P_i, sampled points around the mobile base l_m, and DBB_i, a subset of P_i."""

from dataclasses import dataclass

import numpy as np

from app.strict import Array

POINT_UNIT = 1e-4  # [m] resolution of the stored points
DISTANCE_UNIT = 1e-5  # [m] resolution of the stored distances
POINT_RANGE = 3.2  # [m] largest coordinate that can be stored


@dataclass(frozen=True, eq=False)
class Cloud:
    """P_i, the sampled points of pair i of L_m (arm and base), sorted by height."""

    pair: str  # name of the pair, such as `lm-lEE`
    points: Array
    """(N, 3) int16 points in units of 0.1 mm, in the base's frame, by ascending height."""
    distances: Array  # (N,) uint16 distances d_m of the points, in units of 10 µm

    def __len__(self) -> int:
        return len(self.distances)

    @property
    def points_m(self) -> Array:
        """(N, 3) [m] the points in the base's frame."""
        return self.points * POINT_UNIT

    @property
    def d_m(self) -> Array:
        """(N,) [m] distances of the points to l_m."""
        return self.distances * DISTANCE_UNIT


def make_cloud(pair: str, points: Array, distances: Array) -> Cloud:
    """The cloud of a pair from points (N, 3) and distances (N,) as in `Cloud`, in any order."""
    x, y, z = points.astype(np.int64).T
    # A single sort key of height, y and x is several times faster than three keys.
    order = np.argsort((z << 32) + (y << 16) + x, kind="stable")  # fast for nearly sorted keys
    return Cloud(pair, _frozen(points[order]), _frozen(distances[order]))


def quantise_points(points: Array) -> Array:
    """Convert points (N, 3) [m] to int16 in units of 0.1 mm; coordinates are clipped to ±3.2 m."""
    return np.rint(np.clip(points, -POINT_RANGE, POINT_RANGE) / POINT_UNIT).astype(np.int16)


def quantise_distances(distances: Array) -> Array:
    """Convert distances (N,) [m] to uint16 in units of 10 µm; they are clipped to 0 to 0.65 m."""
    return np.rint(np.clip(distances, 0.0, 0.65) / DISTANCE_UNIT).astype(np.uint16)


def _frozen(array: Array) -> Array:
    array = np.ascontiguousarray(array)
    array.setflags(write=False)
    return array


SAME_HEIGHT = 0.005  # [m] heights whose difference is at most this count as the same


@dataclass(frozen=True)
class Border:
    """DBB_i, the border of one pair of arm and base, in the base's frame, sorted by height."""

    pair: str
    d_b: float  # [m] d_b of (3)
    eps: float  # [m] ε of (3)
    points: Array  # (N, 3) [m]

    def __len__(self) -> int:
        return len(self.points)

    @property
    def heights(self) -> Array:
        """(N,) [m] heights of the points."""
        return self.points[:, 2]

    def same_height(self, z: float, half_thickness: float = SAME_HEIGHT) -> Array:
        """DBB_xy (M, 3) [m] of Algorithm 3: the points within `half_thickness` [m] of height z."""
        first = self.heights.searchsorted(z - half_thickness, "left")
        last = self.heights.searchsorted(z + half_thickness, "right")
        return self.points[first:last]


def construct_dbb(cloud: Cloud, d_b: float, eps: float) -> Border:
    """ConstructDBB: the points of P_i whose distance to l_m differs from d_b [m] by at most ε [m].

    Paper: Eq. (3).
    """
    slack = eps - DISTANCE_UNIT / 2  # so that also the distances before rounding satisfy (3)
    low = int(np.ceil((d_b - slack) / DISTANCE_UNIT))
    high = int(np.floor((d_b + slack) / DISTANCE_UNIT))
    chosen = (cloud.distances >= low) & (cloud.distances <= high)
    return Border(cloud.pair, d_b, eps, _frozen(cloud.points[chosen] * POINT_UNIT))
