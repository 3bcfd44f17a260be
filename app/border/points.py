"""The border as the paper has it: the sampled points, searched at the height of the hand."""

from __future__ import annotations

import math

import numpy as np

from app.border.contours import Foot
from app.border.dbb import Border
from app.border.offset import OffsetContours

Array = np.ndarray


class BorderPoints:
    """DBB_i as points; where a height has none, the exact offset of l_m takes their place."""

    def __init__(self, border: Border, offset: OffsetContours) -> None:
        """The sampled border of one pair, and the exact offset of l_m for the same d_b."""
        self._border, self._offset = border, offset

    def nearest(self, p: Array) -> Foot | None:
        """FindSameHeight and FindMinDistancePoint: the point nearest to p at p's height.

        The tangent is at right angles to the way from p to that point. Where p lies on the border,
        which is known to within ε, that way has no direction: there it is the offset's tangent.

        Paper: Algorithm 3, lines 1 to 4.

        Args:
            p: (3,) [m] in the base's frame.

        Returns:
            None only if l_m has no border at all.
        """
        exact = None
        points = self._border.same_height(float(p[2]))
        if len(points):
            ways = points[:, :2] - p[:2]
            x, y, _ = points[np.einsum("ij,ij->i", ways, ways).argmin()].tolist()
        elif (exact := self._offset.nearest(p)) is not None:
            x, y, _ = exact.p.tolist()
        else:
            return None
        p_n = np.array([x, y, p[2]])
        length = math.hypot(x - float(p[0]), y - float(p[1]))
        if length > self._border.eps:
            return Foot(p_n, np.array([(p[1] - y) / length, (x - p[0]) / length, 0.0]))
        exact = exact or self._offset.nearest(p_n)
        return Foot(p_n, np.array([0.0, 1.0, 0.0]) if exact is None else exact.t)
