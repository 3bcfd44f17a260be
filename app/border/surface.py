"""The border as a continuous surface: closed contours at each height, open where the arm never is.

Its contours are those of the exact offset, which the cloud samples. The cloud says which part of
each contour the arm can reach: where it leaves a wide gap, the contour is open there. A point and
its nearest point on the surface move together, at a cost that does not depend on the cloud.
"""

from __future__ import annotations

import math
from typing import NamedTuple, Protocol

import numpy as np

from app.border.contours import nearest_point
from app.border.dbb import Border
from app.border.offset import OffsetContours, OnContour
from app.border.reached import find_reached

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


class BorderSurface:
    """DBB_i as a surface, for nearest points at a height.

    Attributes:
        reached: (N, RAYS + 1) where the contours are open, as of `find_reached`.
    """

    def __init__(self, border: Border, offset: OffsetContours) -> None:
        """Open the offset's contours where the border has no points.

        Args:
            border: The sampled border of one pair.
            offset: The exact offset of l_m for the same d_b.
        """
        self._offset = offset
        self.reached = find_reached(border, offset)
        self._searched = offset.table.searched(self.reached)

    def nearest(self, p: Array) -> Foot | None:
        """The surface's point at p's height that is nearest to p.

        Heights beyond the surface are taken as its lowest or its highest. In a gap it is the end of
        a contour.

        Args:
            p: (3,) [m] in the base's frame.

        Returns:
            None only if l_m has no offset at all.
        """
        if self._offset.is_empty:
            return None
        d, _, x, y, t_x, t_y = nearest_point(*self._searched, p)
        if d == math.inf:  # nothing is reached at this height: as if all of it were
            found = on_surface(self._offset, p)
            assert found is not None
            return Foot(np.append(found.xy, p[2]), np.append(found.tangent, 0.0))
        return Foot(np.array([x, y, p[2]]), np.array([t_x, t_y, 0.0]))

    def curves(self, z: float) -> list[Array]:
        """The surface's curves at a height, closed, or open where the arm never is.

        Args:
            z: [m] in the base's frame; beyond the surface its lowest or highest curves are given.

        Returns:
            (K, 3) [m] each, in the base's frame, at that height; none if l_m has no offset at all.
        """
        if self._offset.is_empty:
            return []
        flat = self._offset.contours(self._offset.within(z), self.reached)
        return [np.column_stack([curve, np.full(len(curve), z)]) for curve in flat]


def on_surface(offset: OffsetContours, p: Array) -> OnContour | None:
    """The nearest point of the exact offset at p's height, or at the nearest height it has."""
    return offset.nearest(p[:2], offset.within(float(p[2]))) if not offset.is_empty else None
