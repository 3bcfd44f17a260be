"""The border for the search of the acting point: as a surface, or as points as in the paper.

The surface is the exact offset of l_m, which the points sample: a point and its nearest point on it
move together, at a cost that does not depend on the number of points. It is closed: no point is
searched where the arm never is, and near there the reachability in the score leads away.
"""

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numba import types

from app.border.contours import Foot, Table, nearest_point
from app.border.dbb import SAME_HEIGHT, Border, Cloud, construct_dbb
from app.border.offset import OffsetContours, offset_contours
from app.compiled import compiled
from app.config import BorderConfig
from app.robot.model import RobotModel, kept_per_model
from app.strict import Array
from app.structs import assemble, make_struct, struct_type

_f8, _c16, _i8 = types.f8, types.c16, types.i8
_BORDER: dict[str, Any] = {  # first the fields of the offset's `Table`
    "firsts": types.Array(_i8, 1, "C"),
    "heights": types.Array(_f8, 1, "C"),
    "vertices": types.Array(_c16, 2, "C"),
    "tangents": types.Array(_c16, 2, "C"),
    "shown": types.Array(_f8, 2, "C"),
    "spans": types.Array(_f8, 2, "C"),
    "as_points": types.b1,  # whether the points are searched
    "points": types.Array(_f8, 2, "C"),  # (N, 3) [m] of all pairs, each by ascending height
    "sampled": types.Array(_i8, 1, "C"),  # (pairs + 1,) first index of each pair, and N
    "eps": _f8,  # [m] ε of (3)
}
_Values: Any = NamedTuple("_Values", [(each, Any) for each in _BORDER])  # type: ignore[misc]
BORDER = struct_type(_Values, _BORDER)
"""The struct of a border, for signatures of compiled functions."""


@compiled(BORDER.made_from)
def _make(values: Any) -> Any:
    return assemble(values)


@compiled()
def nearest_sample(
    points: Array, first: int, end: int, p: Array, eps: float
) -> tuple[Array, Array, bool]:
    """FindSameHeight and FindMinDistancePoint among sampled border points.

    The tangent is perpendicular to the line from p to the point. If p is on the border, within ε,
    that line has no direction.

    Paper: Algorithm 3, lines 1 to 4.

    Args:
        points: (N, 3) [m] border points of all pairs, for each pair by ascending height.
        first: Index of the first point of the pair.
        end: Index after its last point.
        p: (3,) [m]
        eps: [m] ε of (3).

    Returns:
        (3,) [m] the point at the height of p, (3,) the tangent there, NaN without a
        direction, and whether the height has points.
    """
    low, high = p[2] - SAME_HEIGHT, p[2] + SAME_HEIGHT
    heights = points[first:end, 2]
    i, j = np.searchsorted(heights, low, side="left"), np.searchsorted(heights, high, side="right")
    least, p_n, t = np.inf, np.array([0.0, 0.0, p[2]]), np.full(3, np.nan)
    for k in range(first + i, first + j):
        far = (points[k, 0] - p[0]) ** 2 + (points[k, 1] - p[1]) ** 2
        if far < least:
            least, p_n[0], p_n[1] = far, points[k, 0], points[k, 1]
    length = math.sqrt(least)
    if eps < length < np.inf:
        t[0], t[1], t[2] = (p[1] - p_n[1]) / length, (p_n[0] - p[0]) / length, 0.0
    return p_n, t, least < np.inf


@compiled()
def nearest_border(border: Any, pair: int, p: Array) -> tuple[Array, Array]:
    """The border's point nearest to p (3,) [m] at its height, and the unit tangent there.

    It is one of the pair's sampled points if the border consists of points and has some at this
    height. Otherwise it belongs to the surface, the exact offset of l_m, which is the same for all
    pairs. NaN if l_m has no border at all.
    """
    if border.as_points:
        first, end = border.sampled[pair], border.sampled[pair + 1]
        p_n, t, found = nearest_sample(border.points, first, end, p, border.eps)
        if found and math.isnan(t[0]):
            exact = _nearest_offset(border, p_n)
            t = exact[1] if not math.isnan(exact[1, 0]) else np.array([0.0, 1.0, 0.0])
        if found:
            return p_n, t
    exact = _nearest_offset(border, p)
    return exact[0], exact[1]


@compiled()
def _nearest_offset(border: Any, p: Array) -> Array:
    if len(border.heights) == 0:
        return np.full((2, 3), np.nan)
    return nearest_point(
        border.firsts,
        border.heights,
        border.vertices,
        border.tangents,
        border.shown,
        border.spans,
        p,
    )


class BorderSearch:
    """A border, as points if there are any, in the form of compiled functions."""

    def __init__(self, offset: OffsetContours, borders: Sequence[Border] = ()) -> None:
        """The exact offset of l_m, and the sampled border of each pair for the same d_b."""
        table = Table(*map(np.ascontiguousarray, offset.table))
        points = np.concatenate([np.empty((0, 3)), *(border.points for border in borders)])
        sampled = np.cumsum([0, *map(len, borders)])
        eps = borders[0].eps if borders else 0.0
        values = _Values(*table, bool(borders), points, sampled, eps)
        self.struct = make_struct(_make, values)
        """`BORDER` of it."""

    def nearest(self, p: Array) -> Foot | None:
        """The point nearest to p, (3,) [m], at its height, of the first pair; None without any."""
        foot = Foot(*nearest_border(self.struct, 0, np.ascontiguousarray(p, dtype=float)))
        return None if math.isnan(foot.p[0]) else foot


@kept_per_model(8)
def border_of(model: RobotModel, clouds: tuple[Cloud, ...], config: BorderConfig) -> BorderSearch:
    """The border of the clouds' pairs, of the configured kind; cached per model."""
    offset = offset_contours(model, config.d_b)
    if config.kind == "surface":
        return BorderSearch(offset)
    return BorderSearch(offset, [construct_dbb(each, config.d_b, config.eps) for each in clouds])
