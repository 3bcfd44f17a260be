"""The border as the paper has it: the sampled points, searched at the height of the hand."""

from __future__ import annotations

import numpy as np

from app.border.dbb import Border
from app.border.offset import OffsetContours, OnContour
from app.border.surface import Foot, on_surface

Array = np.ndarray


class BorderPoints:
    """DBB_i as points; where a height has none, the exact offset of l_m takes their place."""

    def __init__(self, border: Border, offset: OffsetContours) -> None:
        """The sampled border of one pair, and the exact offset of l_m for the same d_b."""
        self._border = border
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
        z = float(p[2])
        points = self._border.same_height(z)
        if not len(points):
            found = on_surface(self._offset, p)
            return None if found is None else self._foot(p, found.xy, found)
        offsets = points[:, :2] - p[:2]
        xy = points[np.argmin(np.einsum("ij,ij->i", offsets, offsets)), :2]
        return self._foot(p, xy, None)

    def _foot(self, p: Array, xy: Array, found: OnContour | None) -> Foot:
        p_n = np.array([xy[0], xy[1], p[2]])
        along = xy - p[:2]
        length = float(np.hypot(*along))
        if length > self._border.eps:
            return Foot(p_n, np.array([-along[1], along[0], 0.0]) / length)
        found = found or on_surface(self._offset, p_n)
        t = found.tangent if found is not None else np.array([0.0, 1.0])
        return Foot(p_n, np.array([*t, 0.0]))
