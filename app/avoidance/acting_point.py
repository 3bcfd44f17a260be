"""FindActingPoint: where on the border the force acts (Algorithm 3).

The search is done in the base's frame. The border moves with the base, whose motion is planar, so
nothing changes but the cost: one point is transformed instead of fifty thousand.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from app.border.dbb import Border
from app.border.offset import OffsetContours, OnContour
from app.border.score import ScoreField, uphill
from app.config import ForceConfig

Array = np.ndarray


class ActingPoint(NamedTuple):
    """Result of Algorithm 3, in the base's frame; all at the height of p_b.

    Attributes:
        p_n: (3,) [m] point of the border nearest to p_b at its height.
        p_t: (3,) [m] p_n moved along the tangent towards a better score.
        p_act: (3,) [m] acting point, the point of the border nearest to p_t.
        t: (3,) unit tangent, horizontal.
        alpha: [m] step size.
    """

    p_n: Array
    p_t: Array
    p_act: Array
    t: Array
    alpha: float


def step_size(d: float, score: float, force: ForceConfig) -> float:
    """α, in proportion to d / |S(p_n)| and bounded below and above, in metres.

    Paper: Eq. (13). Bounds as Figure 8b asks: too large a step leaves no component of the force
    along the line between the hand and the border.
    """
    if score == 0.0:
        return force.alpha_max
    return float(
        np.clip(force.alpha_gain * max(d, 0.0) / abs(score), force.alpha_min, force.alpha_max)
    )


def tangential_step(gradient: Array, t: Array, alpha: float) -> Array:
    """α (∇S·t / ‖∇S‖) t, (3,) [m].

    Paper: Eq. (12). On the wheel axis ∇S = 0 and the quotient is 0/0; its limit from both sides is
    the direction +e_x.
    """
    return alpha * float(uphill(gradient) @ t) * t


class ActingPointFinder:
    """Algorithm 3 for one pair of L_m: its border, and the exact offset of l_m behind it."""

    def __init__(self, border: Border, offset: OffsetContours, field: ScoreField) -> None:
        self._border = border
        self._offset = offset
        self._field = field

    def find_acting_point(self, p_b: Array, d: float, force: ForceConfig) -> ActingPoint | None:
        """The acting point for the closest point p_b.

        Where the cloud has no point at p_b's height, the exact offset of l_m takes its place: an
        empty slice must never mean no force.

        Paper: Algorithm 3.

        Args:
            p_b: (3,) [m] closest point on the arm, in the base's frame.
            d: [m] distance of the pair.
            force: Step bounds.

        Returns:
            The acting point, or None if l_m has no border at all.
        """
        z = float(p_b[2])
        p_n = self._nearest(p_b, z)
        if p_n is None:
            return None
        t = self._tangent(p_b, p_n)
        alpha = step_size(d, float(self._field.score(p_n)), force)
        p_t = p_n + tangential_step(self._field.gradient(p_n), t, alpha)
        p_act = self._nearest(p_t, z)
        assert p_act is not None
        return ActingPoint(p_n, p_t, p_act, t, alpha)

    def _nearest(self, p: Array, z: float) -> Array | None:
        """FindSameHeight and FindMinDistancePoint: the border's point nearest to p at height z."""
        same_height = self._border.same_height(z)
        if len(same_height):
            offsets = same_height[:, :2] - p[:2]
            nearest = same_height[np.argmin(np.einsum("ij,ij->i", offsets, offsets))]
            return np.array([nearest[0], nearest[1], z])
        on_offset = self._on_offset(p)
        return None if on_offset is None else np.array([*on_offset.xy, z])

    def _on_offset(self, p: Array) -> OnContour | None:
        """The nearest point of the exact offset at p's height, or at the nearest height it has."""
        heights = self._offset.heights
        if not len(heights):
            return None
        return self._offset.nearest(p[:2], min(max(float(p[2]), heights[0]), heights[-1]))

    def _tangent(self, p_b: Array, p_n: Array) -> Array:
        """Horizontal unit vector at right angles to p_n - p_b.

        Where p_b lies on the border, which is known to within ε, that line has no direction: there
        it is the tangent of the slice.
        """
        along = p_n[:2] - p_b[:2]
        length = float(np.hypot(*along))
        if length > self._border.eps:
            return np.array([-along[1], along[0], 0.0]) / length
        on_offset = self._on_offset(p_n)
        if on_offset is not None:
            return np.array([*on_offset.tangent, 0.0])
        return (
            np.array([0.0, 1.0, 0.0])
            if length == 0.0
            else np.array([-along[1], along[0], 0.0]) / length
        )
