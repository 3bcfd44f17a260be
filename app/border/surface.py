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
from app.border.gaps import (
    LEAST_POINTS,
    NEAR_CONTOUR,
    NEAR_HEIGHT,
    gaps_between,
    widest_gaps,
    without_leaps,
)
from app.border.offset import RAYS, OffsetContours, OnContour
from app.border.reached import find_reached
from app.border.union import nearest_of_union

Array = np.ndarray


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


class OpenPart(NamedTuple):
    """The part of each contour that the arm never reaches, in rays.

    Attributes:
        centre: (H,) middle of the gap, continuous from height to height.
        half: (H,) half of its width, 0 where the whole contour is reached.
    """

    centre: Array
    half: Array


class BorderSurface:
    """DBB_i as a surface, for nearest points at a height.

    Attributes:
        gap: Where the contours of a single shape are open.
    """

    def __init__(self, border: Border, offset: OffsetContours) -> None:
        """Open the offset's contours where the border has no points.

        Args:
            border: The sampled border of one pair.
            offset: The exact offset of l_m for the same d_b.
        """
        self._offset = offset
        self.gap = find_gap(border, offset)
        self._reached = self._searched = None
        if offset.union is not None:
            self._reached = find_reached(border, offset)
            self._searched = offset.union.searched(self._reached)

    def nearest(self, p: Array) -> Foot | None:
        """The surface's point at p's height that is nearest to p.

        Heights beyond the surface are taken as its lowest or its highest. In a gap it is the end of
        the contour that is nearer along it; with several shapes the nearest one of all contours.

        Args:
            p: (3,) [m] in the base's frame.

        Returns:
            None only if l_m has no offset at all.
        """
        if self._offset.is_empty:
            return None
        if self._searched is not None:
            d, _, x, y, t_x, t_y = nearest_of_union(*self._searched, p[0], p[1], p[2])
            if not np.isfinite(d):  # nothing is reached at this height: as if all of it were
                return self._on_exact(p)
        else:
            x, y, t_x, t_y = contours.nearest_in_reach(*self._offset.tables, *self.gap, p)
        return Foot(np.array([x, y, p[2]]), np.array([t_x, t_y, 0.0]))

    def _on_exact(self, p: Array) -> Foot | None:
        found = on_surface(self._offset, p)
        return (
            None
            if found is None
            else Foot(np.append(found.xy, p[2]), np.append(found.tangent, 0.0))
        )

    def curves(self, z: float) -> list[Array]:
        """The surface's curves at a height, closed, or open where the arm never is.

        Args:
            z: [m] in the base's frame; beyond the surface its lowest or highest curves are given.

        Returns:
            (K, 3) [m] each, in the base's frame, at that height; none if l_m has no offset at all.
        """
        if self._offset.is_empty:
            return []
        level = self._offset.within(z)
        if self._reached is not None:
            flat = self._offset.pieces(level, self._reached)
        else:
            flat = [self._open_ring(level)]
        return [np.column_stack([curve, np.full(len(curve), z)]) for curve in flat]

    def _open_ring(self, level: float) -> Array:
        """(K, 2) [m] the contour at a height that there is, without its gap."""
        ring = self._offset.contour(level)
        assert ring is not None
        centre, half = contours.gap_at(self._offset.heights, *self.gap, level)
        if half > 0.0:
            first, last = np.ceil(centre + half), np.floor(centre - half + RAYS)
            ring = ring[np.arange(int(first), int(last) + 1) % RAYS]
        return ring


def on_surface(offset: OffsetContours, p: Array) -> OnContour | None:
    """The nearest point of the exact offset at p's height, or at the nearest height it has."""
    return offset.nearest(p[:2], offset.within(float(p[2]))) if not offset.is_empty else None


def find_gap(border: Border, offset: OffsetContours) -> OpenPart:
    """The widest part of each contour near which the border has no points."""
    heights = offset.heights
    if not len(heights):
        return OpenPart(np.zeros(0), np.zeros(0))
    first = border.heights.searchsorted(heights - NEAR_HEIGHT, "left")
    last = border.heights.searchsorted(heights + NEAR_HEIGHT, "right")
    points = border.points
    centre, width = widest_gaps(
        points[:, 0].copy(),
        points[:, 1].copy(),
        offset.ray_of(points[:, :2]),
        first,
        last,
        offset.tables.vertices,
        NEAR_CONTOUR,
        LEAST_POINTS,
    )
    gaps = [
        None if np.isnan(w) else gaps_between([(c - w / 2, c + w / 2)])
        for c, w in zip(centre.tolist(), width.tolist(), strict=True)
    ]
    ends = np.full((len(heights), 2), np.nan)
    for k, of_height in enumerate(without_leaps(gaps, heights, RAYS)):
        if of_height:
            ends[k] = of_height[0]
    known = np.flatnonzero(np.isfinite(ends[:, 0]))
    if not len(known):
        return OpenPart(np.zeros(len(heights)), np.zeros(len(heights)))
    turns = np.unwrap(ends[known].mean(axis=1), period=RAYS)
    half = np.nan_to_num((ends[:, 1] - ends[:, 0]) / 2)
    return OpenPart(np.interp(np.arange(len(heights)), known, turns), half)
