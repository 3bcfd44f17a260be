"""The border for the search of the acting point: as a surface, or as points as in the paper.

The surface is the exact offset of l_m; the points are its samples. The nearest point of the surface
moves continuously with the query point, except where two points of the surface are equally near.
The time of the search does not depend on the density of the samples. The surface is closed, so it
also covers regions that the arm never reaches. No closest point is ever there, and near such
regions the reachability in the score leads away from them.
"""

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numba import types

from app.border.contours import Table, nearest_point
from app.border.dbb import SAME_HEIGHT, Border, Cloud, construct_dbb
from app.border.offset import OffsetContours, offset_contours
from app.compiled import compiled
from app.config import BorderConfig
from app.robot.model import RobotModel, kept_per_model
from app.strict import Array
from app.structs import struct_type

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
BORDER = struct_type("_Values", _BORDER)
"""The struct of a border, for signatures of compiled functions."""


class Foot(NamedTuple):
    """The point of a border nearest to a point at the same height, in the base's frame."""

    p: Array
    """(3,) [m] the point of the border."""
    t: Array
    """(3,) horizontal unit tangent there; on the surface, l_m is on its left."""


@compiled()
def nearest_sample(
    points: Array, first: int, end: int, p: Array, eps: float
) -> tuple[Array, Array, bool]:
    """FindSameHeight and FindMinDistancePoint for sampled border points.

    The tangent is perpendicular to the line from p to the nearest point. If the horizontal distance
    of the two is at most ε, the direction of this line is undefined.

    Paper: Algorithm 3, lines 1 to 4.

    Args:
        points: (N, 3) [m] border points of all pairs, for each pair by ascending height.
        first: Index of the pair's first point.
        end: Index after the pair's last point.
        p: (3,) [m] the query point.
        eps: [m] ε of (3).

    Returns:
        The nearest point (3,) [m], moved to the height of p; the unit tangent (3,), NaN if it is
        undefined; and whether there are points at this height. Without points, the first two
        results are invalid.
    """
    low, high = p[2] - SAME_HEIGHT, p[2] + SAME_HEIGHT
    heights = points[first:end, 2]
    i, j = np.searchsorted(heights, low, side="left"), np.searchsorted(heights, high, side="right")
    square, p_n, t = np.inf, np.array([0.0, 0.0, p[2]]), np.full(3, np.nan)
    for k in range(first + i, first + j):
        far = (points[k, 0] - p[0]) ** 2 + (points[k, 1] - p[1]) ** 2
        if far < square:
            square, p_n[0], p_n[1] = far, points[k, 0], points[k, 1]
    length = math.sqrt(square)
    if eps < length < np.inf:
        t[0], t[1], t[2] = (p[1] - p_n[1]) / length, (p_n[0] - p[0]) / length, 0.0
    return p_n, t, square < np.inf


@compiled()
def nearest_border(border: Any, pair: int, p: Array) -> tuple[Array, Array]:
    """The point (3,) [m] of a `BORDER` nearest to p (3,) [m] at the height of p, and its tangent.

    All are in the base's frame; `pair` is the number of the pair in L_m. If the border consists of
    points and has points of this pair at this height, the result is one of them, with the tangent
    of `nearest_sample`; where this tangent is undefined, the tangent of the surface replaces it.
    Otherwise the result is a point of the surface, which is the exact offset of l_m for all pairs,
    with the tangent of the contour. Point and tangent are NaN if l_m has no border at all.
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
    """A border in the form that compiled functions use."""

    def __init__(self, offset: OffsetContours, borders: Sequence[Border] = ()) -> None:
        """Prepare the search.

        Args:
            offset: The surface at the distance d_b around l_m.
            borders: The sampled border of each pair, for the same d_b; if empty, the search uses
                only the surface.
        """
        table = Table(*map(np.ascontiguousarray, offset.table))
        points = np.concatenate([np.empty((0, 3)), *(border.points for border in borders)])
        sampled = np.cumsum([0, *map(len, borders)])
        eps = borders[0].eps if borders else 0.0
        values = _Values(*table, bool(borders), points, sampled, eps)
        self.struct = BORDER.made_of(values)
        """The border as a struct `BORDER`."""

    def nearest(self, p: Array) -> Foot | None:
        """The nearest border point of the first pair at the height of p (3,) [m], in the base's
        frame; None if l_m has no border.
        """
        foot = Foot(*nearest_border(self.struct, 0, np.ascontiguousarray(p, dtype=float)))
        return None if math.isnan(foot.p[0]) else foot


@kept_per_model(8)
def border_of(model: RobotModel, clouds: tuple[Cloud, ...], config: BorderConfig) -> BorderSearch:
    """The border of the clouds' pairs, of the configured kind; cached for each model."""
    offset = offset_contours(model, config.d_b)
    if config.kind == "surface":
        return BorderSearch(offset)
    return BorderSearch(offset, [construct_dbb(each, config.d_b, config.eps) for each in clouds])
