"""The border on which the acting point is searched: as a surface, or as the paper has it.

The surface is the exact offset of l_m, which the cloud samples: a point and its nearest point on it
move together, at a cost that does not depend on the cloud. It is closed: where the arm never is,
nobody asks, and near there the reachability in the score leads away. `BorderPoints` is the border
as the paper has it: the sampled points alone.
"""

import math

import numpy as np

from app.border.contours import Foot, NearestBorder
from app.border.dbb import Border, Cloud, construct_dbb
from app.border.offset import OffsetContours, offset_contours
from app.config import BorderConfig
from app.robot.model import RobotModel, kept_per_model
from app.strict import Array


class BorderPoints:
    """DBB_i as points; where a height has none, the exact offset of l_m takes their place."""

    def __init__(self, border: Border, offset: OffsetContours) -> None:
        """The sampled border of one pair, and the exact offset of l_m for the same d_b."""
        self._border, self._offset = border, offset

    def nearest(self, p: Array) -> Foot | None:
        """FindSameHeight and FindMinDistancePoint: the point nearest to p, (3,) [m], at its height.

        The tangent is at right angles to the way from p to that point. Where p lies on the border,
        which is known to within ε, that way has no direction: there it is the offset's tangent.
        None only if l_m has no border at all.

        Paper: Algorithm 3, lines 1 to 4.
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


@kept_per_model(8)
def border_of(model: RobotModel, cloud: Cloud, config: BorderConfig) -> NearestBorder:
    """The border of a cloud's pair, of the configured kind; made once: each controller asks."""
    offset = offset_contours(model, config.d_b)
    if config.kind == "surface":
        return offset
    return BorderPoints(construct_dbb(cloud, config.d_b, config.eps), offset)
