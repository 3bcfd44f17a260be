"""The border as a continuous surface: one closed contour a height, open where the arm never is.

Its contours are those of the exact offset, which the cloud samples. The cloud says which part of
each contour the arm can reach: where it leaves a wide gap, the contour is open there. A point and
its nearest point on the surface move together, at a cost that does not depend on the cloud.
"""

from __future__ import annotations

from typing import NamedTuple, Protocol

import numpy as np

from app.border import contours
from app.border.dbb import Border
from app.border.offset import RAYS, OffsetContours, OnContour

Array = np.ndarray

_NEAR_HEIGHT = 0.015  # [m] points that far above and below tell where a contour is reached
_NEAR_CONTOUR = 0.05  # [m] from a contour; over the top, points of other heights lie inside of it
_LEAST_POINTS = 20  # [-] fewer tell nothing
_LEAST_GAP = 40.0  # [rays] narrower gaps are chance
_MARGIN = 10.0  # [rays] by which a gap is kept narrower on either side: samples are not everywhere


class Foot(NamedTuple):
    """The point of a border nearest to a point at the same height, in the base's frame.

    Attributes:
        p: (3,) [m] the point of the border.
        t: (3,) horizontal unit tangent there.
    """

    p: Array
    t: Array


class NearestBorder(Protocol):
    """What the search for the acting point asks of a border."""

    def nearest(self, p: Array) -> Foot | None:
        """The point nearest to p, (3,) [m], at its height; None only if there is no border."""
        ...


class Gap(NamedTuple):
    """The part of each contour that the arm never reaches, in rays.

    Attributes:
        centre: (H,) middle of the gap, continuous from height to height.
        half: (H,) half of its width, 0 where the whole contour is reached.
    """

    centre: Array
    half: Array


class BorderSurface:
    """DBB_i as a surface, for nearest points at a height."""

    def __init__(self, border: Border, offset: OffsetContours) -> None:
        """Open the offset's contours where the border has no points.

        Args:
            border: The sampled border of one pair.
            offset: The exact offset of l_m for the same d_b.
        """
        self._offset = offset
        self.gap = find_gap(border, offset)

    def nearest(self, p: Array) -> Foot | None:
        """The surface's point at p's height that is nearest to p.

        Heights beyond the surface are taken as its lowest or its highest. In a gap it is the end of
        the contour that is nearer along it.

        Args:
            p: (3,) [m] in the base's frame.

        Returns:
            None only if l_m has no offset at all.
        """
        if not len(self._offset.heights):
            return None
        x, y, t_x, t_y = contours.nearest_in_reach(*self._offset.tables, *self.gap, p)
        return Foot(np.array([x, y, p[2]]), np.array([t_x, t_y, 0.0]))

    def contour(self, z: float) -> Array | None:
        """The surface's curve at a height, closed or open in the gap.

        Args:
            z: [m] in the base's frame; beyond the surface its lowest or highest curve is given.

        Returns:
            (K, 3) [m] in the base's frame, at that height; None if l_m has no offset at all.
        """
        if not len(self._offset.heights):
            return None
        level = self._offset.within(z)
        ring = self._offset.contour(level)
        assert ring is not None
        centre, half = self._gap_at(level)
        if half > 0.0:
            first, last = np.ceil(centre + half), np.floor(centre - half + RAYS)
            ring = ring[np.arange(int(first), int(last) + 1) % RAYS]
        return np.column_stack([ring, np.full(len(ring), z)])

    def _gap_at(self, z: float) -> tuple[float, float]:
        """[rays] middle and half width of the gap at a height that the offset has."""
        return contours.gap_at(self._offset.heights, *self.gap, z)


def on_surface(offset: OffsetContours, p: Array) -> OnContour | None:
    """The nearest point of the exact offset at p's height, or at the nearest height it has."""
    return offset.nearest(p[:2], offset.within(float(p[2]))) if len(offset.heights) else None


def find_gap(border: Border, offset: OffsetContours) -> Gap:
    """The widest part of each contour near which the border has no points."""
    heights = offset.heights
    first = border.heights.searchsorted(heights - _NEAR_HEIGHT, "left")
    last = border.heights.searchsorted(heights + _NEAR_HEIGHT, "right")
    points = border.points
    centre, width = contours.widest_gaps(
        points[:, 0].copy(), points[:, 1].copy(), offset.ray_of(points[:, :2]), first, last,
        offset.tables.vertices, _NEAR_CONTOUR, _LEAST_POINTS,
    )  # fmt: skip
    found = width >= _LEAST_GAP
    half = np.where(found, width / 2 - _MARGIN, 0.0)
    centre[~found] = np.nan
    known = np.flatnonzero(np.isfinite(centre))
    if not len(known):
        return Gap(np.zeros(len(heights)), half)
    turns = np.unwrap(centre[known], period=RAYS)
    return Gap(np.interp(np.arange(len(heights)), known, turns), half)
