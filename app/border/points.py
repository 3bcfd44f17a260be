"""The border as the paper has it: the sampled points, searched at the height of the hand."""

from __future__ import annotations

import math

import numpy as np

from app.border.box_tree import BoxTree
from app.border.dbb import SAME_HEIGHT, Border
from app.border.offset import OffsetContours, OnContour
from app.border.surface import Foot, on_surface

Array = np.ndarray


class BorderPoints:
    """DBB_i as points; where a height has none, the exact offset of l_m takes their place."""

    def __init__(self, border: Border, offset: OffsetContours) -> None:
        """The sampled border of one pair, and the exact offset of l_m for the same d_b."""
        self._eps = border.eps
        self._tree = BoxTree(border.points)
        self._offset = offset

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
        xy = self._in_plan(p)
        if xy is not None:
            return self._foot(p, xy, None)
        found = on_surface(self._offset, p)
        if found is None:
            return None
        x, y = found.xy.tolist()
        return self._foot(p, (x, y), found)

    def _in_plan(self, p: Array) -> tuple[float, float] | None:
        """[m] the point nearest in plan among those of p's height, or None if there is none."""
        return self._tree.nearest(p, SAME_HEIGHT)

    def _foot(self, p: Array, xy: tuple[float, float], found: OnContour | None) -> Foot:
        p_n = np.array([*xy, p[2]])
        x, y = xy[0] - float(p[0]), xy[1] - float(p[1])
        length = math.hypot(x, y)
        if length > self._eps:
            return Foot(p_n, np.array([-y / length, x / length, 0.0]))
        found = found or on_surface(self._offset, p_n)
        t = found.tangent if found is not None else np.array([0.0, 1.0])
        return Foot(p_n, np.array([*t, 0.0]))
