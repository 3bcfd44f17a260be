"""The border point nearest to a query point: p_n of Algorithm 3.

The border is a surface, the exact offset of l_m, or consists of points as in the paper, which are
within ε of the surface. The surface also covers regions that the arm never reaches: the arm's
closest point is never there, and the reachability in the score leads away from such regions.

At each traced height, a visible shape of l_m has a ring: the boundary of the offset's slice, as a
closed polygon. The parts of all rings outside of the other shapes' offsets form the contour: one
closed curve, or several curves around islands or holes. Between the heights of two rings, the
vertices and their distances to the other offsets are interpolated; two rings cross where such a
distance is zero.
"""

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numba import types

from app.border.dbb import SAME_HEIGHT, Border
from app.compiled import compiled
from app.strict import Array
from app.structs import StructType

_SAME_CORNER = 0.01  # [m] largest distance of two ends that belong to the same corner
_TOUCHING = 1e-9  # [m] distance below which the direction to a corner is undefined
BLOCK = 24  # [-] number of edges in a block of the search; a ring has a whole number of blocks
Best = tuple[float, complex, complex]
"""Nearest point so far: its distance [m], the point [m] and its unit tangent, both as x + iy."""
Corner = tuple[complex, complex, bool]
"""A crossing of a ring with another shape's offset: the point [m] and the unit tangent as x + iy,
and whether the visible part of the ring starts there."""


class OffsetContours(NamedTuple):
    """The contours of the offset of l_m at each height: the rings of all visible shapes, as rows of
    the arrays (N, …). The first vertex of a ring is repeated at its end.
    """

    firsts: Array  # (K + 1,) row of each shape's first ring, and the number of rows
    heights: Array  # (N,) [m] heights of the rings, ascending for each shape
    vertices: Array  # (N, R + 1) [m] vertices as x + iy
    tangents: Array  # (N, R + 1) unit tangents at the vertices, as x + iy
    shown: Array
    """(N, R + 1) [m] signed distance of each vertex from the other offsets; negative if hidden."""
    spans: Array
    """(N, R / BLOCK) [m] largest distance of a vertex from the middle vertex of its block."""

    def contours(self, z: float) -> list[Array]:
        """The contour at height z [m]: polylines (K, 2) [m] of the visible pieces of all rings."""
        found = []
        for first, end in zip(self.firsts[:-1], self.firsts[1:], strict=True):
            heights = self.heights[first:end]
            if not heights[0] <= z <= heights[-1]:
                continue
            k = min(int(np.searchsorted(heights, z, "right")) - 1, len(heights) - 2)
            share = (z - heights[k]) / (heights[k + 1] - heights[k])
            rows, weights = first + k + np.arange(2), (1.0 - share, share)
            found += _pieces(weights @ self.vertices[rows], weights @ self.shown[rows])
        return found

    def curves(self, z: float) -> list[Array]:
        """Curves (K, 3) [m] at height z [m]: the contour, if any, or else the nearest in height."""
        at = level(self.firsts, self.heights, z)
        return [np.column_stack([c, np.full(len(c), z)]) for c in self.contours(at)]


def _pieces(ring: Array, shown: Array) -> list[Array]:
    """The visible pieces (K, 2) [m] of a ring of vertices with the distances `shown`."""
    if (shown >= 0.0).all():
        return [np.column_stack([ring.real, ring.imag])]
    turned = int(np.argmin(shown[:-1]))  # start at a hidden vertex
    ring, shown = (np.append(np.roll(a[:-1], -turned), a[turned]) for a in (ring, shown))
    i = np.flatnonzero((shown[:-1] < 0.0) != (shown[1:] < 0.0))
    crossings = ring[i] + shown[i] / (shown[i] - shown[i + 1]) * (ring[i + 1] - ring[i])
    ring, visible = np.insert(ring, i + 1, crossings), np.insert(shown >= 0.0, i + 1, True)
    pieces = np.split(ring, np.flatnonzero(np.diff(visible)) + 1)[1::2]
    return [np.column_stack([piece.real, piece.imag]) for piece in pieces]


_BORDER: dict[str, Any] = {  # first the fields of `OffsetContours`
    "firsts": types.i8[::1],
    "heights": types.f8[::1],
    "vertices": types.c16[:, ::1],
    "tangents": types.c16[:, ::1],
    "shown": types.f8[:, ::1],
    "spans": types.f8[:, ::1],
    "as_points": types.b1,  # whether the points are searched
    "points": types.f8[:, ::1],  # (N, 3) [m] of all pairs, those of each pair by ascending height
    "sampled": types.i8[::1],  # (pairs + 1,) first index of each pair in `points`, and N
    "eps": types.f8,  # [m] ε of (3)
}
_Values: Any = NamedTuple("_Values", [(each, Any) for each in _BORDER])  # type: ignore[misc]
BORDER = StructType("_Values", _BORDER)  # the kind of struct of a border


@compiled()
def level(firsts: Array, heights: Array, z: float) -> float:
    """[m] the height nearest to z at which a shape has a ring; z without rings."""
    best, distance = z, np.inf
    for j in range(len(firsts) - 1):
        at = min(max(z, heights[firsts[j]]), heights[firsts[j + 1] - 1])
        if abs(at - z) < distance:
            best, distance = at, abs(at - z)
    return float(best)


@compiled()
def _row(heights: Array, first: int, last: int, z: float) -> tuple[int, int, float]:
    """Rows in [first, last) below and above z (one row twice at its height), and z's fraction."""
    k = first + int(np.searchsorted(heights[first:last], z, side="right")) - 1
    if heights[k] == z or k + 1 == last:
        return k, k, 0.0
    return k, k + 1, float((z - heights[k]) / (heights[k + 1] - heights[k]))


@compiled()
def _blend(low: Array, high: Array, share: float, i: int | slice) -> Array:
    return low[i] + share * (high[i] - low[i])


@compiled()
def _search_edges(
    ring: Array, tangents: Array, shown: Array, p: complex, best: Best, corners: list[Corner]
) -> Best:
    """Search a block of edges for a point nearer to p than `best`; add the block's corners."""
    ahead = _dot(p - ring[0], tangents[0]) >= 0.0
    for i in range(BLOCK):
        edge, turn = ring[i + 1] - ring[i], tangents[i + 1] - tangents[i]
        next_ahead = _dot(p - ring[i + 1], tangents[i + 1]) >= 0.0
        first, last = _shown_part(shown[i], shown[i + 1])
        if first <= last and ahead and not next_ahead:
            along = _foot(p - ring[i], edge, tangents[i], tangents[i + 1])
            if first <= along <= last:
                best = _nearer(best, p, ring[i] + along * edge, tangents[i] + along * turn)
        for along, end, begins in ((first, 0.0, True), (last, 1.0, False)):
            if first <= last and along != end:
                at, t = ring[i] + along * edge, tangents[i] + along * turn
                corners.append((at, t / abs(t), begins))
        ahead = next_ahead
    return best


@compiled()
def _search_corners(p: complex, best: Best, corners: list[Corner]) -> Best:
    """Search the corners of the contour, where one ring's visible part ends and another's begins,
    for a point nearer to p than `best`. Its tangent is perpendicular to the line to p.
    """
    # The two ends differ by the interpolation error; the contour includes the segment between them.
    met = np.zeros(len(corners), np.bool_)
    for at, t, begins in corners:
        if begins:
            continue
        other, apart = -1, _SAME_CORNER
        for c, (start, _, is_start) in enumerate(corners):
            if is_start and abs(start - at) < apart:
                other, apart = c, abs(start - at)
        if other >= 0:
            met[other] = True
            way, both = corners[other][0] - at, t + corners[other][1]
            if apart > 0.0:
                at += min(max(_dot(p - at, way) / (apart * apart), 0.0), 1.0) * way
            t = both if abs(both) > _TOUCHING else t
        best = _nearer(best, p, at, _square(p, at, t))
    for c, (at, t, begins) in enumerate(corners):
        if begins and not met[c]:  # the ring that ends there is too far away to be searched
            best = _nearer(best, p, at, _square(p, at, t))
    return best


@compiled()
def _nearer(best: Best, p: complex, at: complex, tangent: complex) -> Best:
    """`best`, or the point `at` with its tangent if that is nearer to p."""
    away = abs(p - at)
    return (away, at, tangent / abs(tangent)) if away < best[0] else best


@compiled()
def _dot(a: complex, b: complex) -> float:
    return (a * b.conjugate()).real


@compiled()
def _foot(to_p: complex, edge: complex, t: complex, t_next: complex) -> float:
    """The fraction along an edge at which the line to p is perpendicular to the tangent, which is
    interpolated from t to t_next; `to_p` leads from the edge's start to p.
    """
    # (to_p - s edge) · (t + s (t_next - t)) = a s² + b s + c
    a = -_dot(edge, t_next - t)
    b = _dot(to_p, t_next - t) - _dot(edge, t)
    c = _dot(to_p, t)
    root = -2.0 * c / (b - math.sqrt(max(b * b - 4.0 * a * c, 0.0))) if c > 0.0 else 0.0
    return min(max(root, 0.0), 1.0)


@compiled()
def _shown_part(start: float, end: float) -> tuple[float, float]:
    """Where a linear function from `start` to `end` is not negative, as fractions of an edge."""
    if start < 0.0 and end < 0.0:
        return 1.0, 0.0  # nowhere
    first = start / (start - end) if start < 0.0 else 0.0
    last = start / (start - end) if end < 0.0 else 1.0
    return first, last


@compiled()
def _square(p: complex, foot: complex, along: complex) -> complex:
    """The unit vector perpendicular to the line from p to `foot`, on the side of `along`."""
    way = p - foot
    length = abs(way)
    if length < _TOUCHING:
        return along / abs(along)
    t = way * 1j / length
    return t if _dot(t, along) >= 0.0 else -t


@compiled()
def nearest_offset(border: Any, at: Array) -> Array:
    """(2, 3) the point [m] on the contour of a `BORDER` nearest to `at` (3,) [m], and the tangent.

    The tangent is a horizontal unit vector with l_m on its left. Without a contour at the height of
    `at`, the contour nearest in height is moved to this height; without any contour, x and y of
    point and tangent are NaN. Blocks of edges are searched in the order of their distance, until
    the next block is farther than the nearest point.
    """
    firsts, heights, vertices = border.firsts, border.heights, border.vertices
    tangents, shown, spans = border.tangents, border.shown, border.spans
    z, p = level(firsts, heights, at[2]), complex(at[0], at[1])
    shapes, blocks = len(firsts) - 1, spans.shape[1]
    rows, ups, shares = np.zeros(shapes, np.int64), np.zeros(shapes, np.int64), np.zeros(shapes)
    bounds = np.full((shapes, blocks), np.inf)  # [m] lower bounds of the distances of blocks
    for j in range(shapes):
        if heights[firsts[j]] <= z <= heights[firsts[j + 1] - 1]:
            k, up, share = _row(heights, firsts[j], firsts[j + 1], z)
            rows[j], ups[j], shares[j] = k, up, share
            for b in range(blocks):
                middle = _blend(vertices[k], vertices[up], share, b * BLOCK + BLOCK // 2)
                bounds[j, b] = max(abs(p - middle) - _blend(spans[k], spans[up], share, b), 0.0)
    best: Best = (np.inf, complex(np.nan, np.nan), complex(np.nan, np.nan))
    corners = [(0j, 0j, False) for _ in range(0)]
    for _ in range(bounds.size):
        nearest = int(np.argmin(bounds))
        j, b = nearest // blocks, nearest % blocks
        if not (bounds[j, b] < np.inf and bounds[j, b] <= best[0] + _SAME_CORNER):
            break
        bounds[j, b] = np.inf
        k, up, share = int(rows[j]), int(ups[j]), float(shares[j])
        i = slice(b * BLOCK, (b + 1) * BLOCK + 1)
        best = _search_edges(
            _blend(vertices[k], vertices[up], share, i),
            _blend(tangents[k], tangents[up], share, i),
            _blend(shown[k], shown[up], share, i),
            p,
            best,
            corners,
        )
    _, point, tangent = _search_corners(p, best, corners)
    return np.array([[point.real, point.imag, at[2]], [tangent.real, tangent.imag, 0.0]])


@compiled()
def nearest_sample(
    points: Array, first: int, end: int, p: Array, eps: float
) -> tuple[Array, Array, bool]:
    """FindSameHeight and FindMinDistancePoint: the sampled border point nearest to p (3,) [m].

    The pair's border points are those from `first` to `end` - 1 of `points` (N, 3) [m], by
    ascending height; `eps` [m] is ε of (3). The results are the nearest point (3,) [m], moved to
    the height of p; the unit tangent (3,), perpendicular to the line from p to this point, or NaN
    if this line is at most ε long; and whether there are points at this height. If there are none,
    the first two results are invalid.

    Paper: Algorithm 3, lines 1 to 4.
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
    """The point (3,) [m] of a `BORDER` nearest to p (3,) [m] at the height of p, and the tangent.

    If the border consists of points, and the pair with the index `pair` has some at this height,
    the result is that of `nearest_sample`; the surface's tangent replaces a NaN. Otherwise the
    result is that of `nearest_offset`. If l_m has no border, x and y of both are NaN.
    """
    if border.as_points:
        first, end = border.sampled[pair], border.sampled[pair + 1]
        p_n, t, found = nearest_sample(border.points, first, end, p, border.eps)
        if found and math.isnan(t[0]):
            exact = nearest_offset(border, p_n)
            t = exact[1] if not math.isnan(exact[1, 0]) else np.array([0.0, 1.0, 0.0])
        if found:
            return p_n, t
    exact = nearest_offset(border, p)
    return exact[0], exact[1]


def border_struct(contours: OffsetContours, borders: Sequence[Border] = ()) -> Any:
    """A struct `BORDER` for a search of the contours or, if there are `borders`, of their points.
    `borders` has the border of each pair of arm and base, all for the d_b of the contours.
    """
    points = np.concatenate([np.empty((0, 3)), *(border.points for border in borders)])
    sampled = np.cumsum([0, *map(len, borders)])
    eps = borders[0].eps if borders else 0.0
    arrays = map(np.ascontiguousarray, contours)
    return BORDER.made_of(_Values(*arrays, bool(borders), points, sampled, eps))
