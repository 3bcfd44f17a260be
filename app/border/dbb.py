"""Algorithm 1: the distance buffer border as a selection from P_i."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from app.border.cloud import DISTANCE_UNIT, Cloud

Array = np.ndarray

SAME_HEIGHT = 0.005
"""[m] how far from a height a point still counts as of that height."""


@dataclass(frozen=True)
class Border:
    """DBB_i of one pair of L_m, in the base's frame, sorted by height.

    Attributes:
        pair: Name of the pair, as in `lm-lEE`.
        d_b: [m] buffer distance.
        eps: [m] tolerance ε.
        points: (N, 3) [m], column 2 ascends.
        heights: (N,) [m] column 2 of the points, contiguous.
    """

    pair: str
    d_b: float
    eps: float
    points: Array
    heights: Array

    def __len__(self) -> int:
        return len(self.points)

    def same_height(self, z: float, half_thickness: float = SAME_HEIGHT) -> Array:
        """DBB_xy: FindSameHeight of Algorithm 3, in O(log N) and without a copy.

        Args:
            z: [m] height above the floor.
            half_thickness: [m] half of the slice's thickness.

        Returns:
            (M, 3) [m] a view of the points whose height is within `half_thickness` of z.
        """
        first = self.heights.searchsorted(z - half_thickness, "left")
        last = self.heights.searchsorted(z + half_thickness, "right")
        return self.points[first:last]


def construct_dbb(cloud: Cloud, d_b: float, eps: float) -> Border:
    """ConstructDBB: the points of P_i whose distance to l_m is d_b within ε.

    Paper: Eq. (3).

    Kept distances are rounded, so the selection is narrower by half of their resolution: each point
    is within ε of d_b when measured again.

    Args:
        cloud: P_i with its distances d_m.
        d_b: [m] buffer distance.
        eps: [m] tolerance ε.

    Returns:
        The border, empty where P_i has no such points.
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
