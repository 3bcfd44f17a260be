"""FindActingPoint: where on the border the force acts (Algorithm 3).

The search is done in the base's frame. The border moves with the base, whose motion is planar, so
nothing changes but the cost: one point is transformed instead of fifty thousand.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from app.border.score import ScoreField, uphill
from app.border.surface import NearestBorder
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
    proportional = force.alpha_gain * max(d, 0.0) / abs(score)
    return min(max(proportional, force.alpha_min), force.alpha_max)


def tangential_step(gradient: Array, t: Array, alpha: float) -> Array:
    """α (∇S·t / ‖∇S‖) t, (3,) [m].

    Paper: Eq. (12). On the wheel axis ∇S = 0 and the quotient is 0/0; its limit from both sides is
    the direction +e_x.
    """
    return alpha * float(uphill(gradient) @ t) * t


class ActingPointFinder:
    """Algorithm 3 for one pair of L_m, on its border as points or as a surface.

    Attributes:
        field: The pair's score.
    """

    def __init__(self, border: NearestBorder, field: ScoreField) -> None:
        self.field = field
        self._border = border

    def find_acting_point(self, p_b: Array, d: float, force: ForceConfig) -> ActingPoint | None:
        """The acting point for the closest point p_b.

        Paper: Algorithm 3.

        Args:
            p_b: (3,) [m] closest point on the arm, in the base's frame.
            d: [m] distance of the pair.
            force: Step bounds.

        Returns:
            The acting point, or None if l_m has no border at all.
        """
        foot = self._border.nearest(p_b)
        if foot is None:
            return None
        p_n, t = foot
        score, gradient = self.field.at_point(p_n)
        alpha = step_size(d, score / self.field.base.score_unit, force)
        p_t = p_n + tangential_step(gradient, t, alpha)
        nearest = self._border.nearest(p_t)
        assert nearest is not None
        return ActingPoint(p_n, p_t, nearest.p, t, alpha)
