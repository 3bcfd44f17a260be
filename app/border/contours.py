"""Horizontal contours of a union of convex shapes, and the nearest point of a contour.

At each height, every shape has a ring: the boundary of its slice, as a closed polygon. The contour
of the union consists of those parts of the rings that are outside of the other shapes. It is one
closed curve, or several curves around islands or holes. Between two heights of the table, the
vertices of a ring, and the distances of the vertices to the other shapes, are interpolated. Two
rings cross where such a distance is zero. The contour changes continuously with the height.
"""

import math
from typing import NamedTuple, Protocol

import numpy as np

from app.compiled import compiled
from app.strict import Array

_SAME_CORNER = 0.01  # [m] largest distance of two ends that belong to the same corner
_TOUCHING = 1e-9  # [m] distance below which the direction to a corner is undefined

BLOCK = 24  # [-] number of edges in a block of the search; a ring has a whole number of blocks

Best = tuple[float, complex, complex]
"""Distance [m] of the nearest point that the search has found, the point [m], and the unit tangent
there, both as x + iy."""
Corner = tuple[complex, complex, bool]
"""A crossing of a ring with another shape: the point [m] and the unit tangent as x + iy, and
whether the visible part of the ring starts there."""


class Foot(NamedTuple):
    """The point of a border nearest to a point at the same height, in the base's frame."""

    p: Array
    """(3,) [m] the point of the border."""
    t: Array
    """(3,) horizontal unit tangent there, with l_m on its left."""


class NearestBorder(Protocol):
    """The interface of a border for the search of the acting point."""

    def nearest(self, p: Array) -> Foot | None:
        """The border's point nearest to p (3,) [m] at the height of p; None without a border."""
        ...


class Table(NamedTuple):
    """The rings of all shapes. The first vertex of a row is repeated at its end."""

    firsts: Array
    """(K + 1,) row of each shape's first ring, and the number of rows."""
    heights: Array
    """(N,) [m] heights of the rings, ascending for each shape."""
    vertices: Array
    """(N, R + 1) [m] vertices as x + iy."""
    tangents: Array
    """(N, R + 1) unit tangents at the vertices, as x + iy."""
    shown: Array
    """(N, R + 1) [m] distance of the vertices to the other shapes, positive outside."""
    spans: Array
    """(N, R / BLOCK) [m] largest distance between the middle vertex and another vertex of a
    block."""


class Contours:
    """Horizontal contours around a union of convex shapes."""

    def __init__(self, table: Table) -> None:
        self.table = table

    def within(self, z: float) -> float:
        """[m] the height nearest to z [m] that has a contour."""
        return level(self.table.firsts, self.table.heights, z)

    def nearest(self, p: Array) -> Foot | None:
        """The contour's point nearest to p (3,) [m], in the base's frame, at the height of p.

        The point moves continuously with p, except if p crosses the medial axis, where two points
        are nearest. If p is below or above all contours, the lowest or highest contour is used.
        The result is None if there are no contours.
        """
        if not len(self.table.heights):
            return None
        foot = nearest_point(*self.table, p)
        return Foot(foot[0], foot[1])

    def contours(self, z: float) -> list[Array]:
        """The contour at height z [m] as polygons (K, 2) [m].

        A ring that the other shapes hide in part is divided into its visible pieces. A shape
        without a ring at z is left out.
        """
        table, found = self.table, []
        for first, end in zip(table.firsts[:-1], table.firsts[1:], strict=True):
            heights = table.heights[first:end]
            if not heights[0] <= z <= heights[-1]:
                continue
            k = min(int(np.searchsorted(heights, z, "right")) - 1, len(heights) - 2)
            share = (z - heights[k]) / (heights[k + 1] - heights[k])
            rows, weights = first + k + np.arange(2), (1.0 - share, share)
            found += _pieces(weights @ table.vertices[rows], weights @ table.shown[rows])
        return found

    def curves(self, z: float) -> list[Array]:
        """The contour at the available height nearest to z [m] as curves (K, 3) [m], drawn at z."""
        if not len(self.table.heights):
            return []
        return [np.column_stack([c, np.full(len(c), z)]) for c in self.contours(self.within(z))]


def _pieces(ring: Array, shown: Array) -> list[Array]:
    """The visible pieces (K, 2) [m] of a closed ring.

    Args:
        ring: (R + 1,) [m] vertices as x + iy.
        shown: (R + 1,) [m] distance of the vertices to the other shapes, negative where hidden.
    """
    if (shown >= 0.0).all():
        return [np.column_stack([ring.real, ring.imag])]
    turned = int(np.argmin(shown[:-1]))  # start at a hidden vertex
    ring, shown = (np.append(np.roll(a[:-1], -turned), a[turned]) for a in (ring, shown))
    found: list[Array] = []
    piece: list[complex] = []
    for i in range(len(ring) - 1):
        a, b = shown[i], shown[i + 1]
        if (a < 0.0) != (b < 0.0):
            piece.append(complex(ring[i] + a / (a - b) * (ring[i + 1] - ring[i])))
        if b >= 0.0:
            piece.append(complex(ring[i + 1]))
        elif piece:
            found.append(np.array([[v.real, v.imag] for v in piece]))
            piece = []
    return found


@compiled()
def level(firsts: Array, heights: Array, z: float) -> float:
    """[m] the height nearest to z [m] at which any shape has a ring."""
    best, distance = z, np.inf
    for j in range(len(firsts) - 1):
        at = min(max(z, heights[firsts[j]]), heights[firsts[j + 1] - 1])
        if abs(at - z) < distance:
            best, distance = at, abs(at - z)
    return float(best)


@compiled()
def _row(heights: Array, first: int, last: int, z: float) -> tuple[int, float]:
    """Row of the ring at or below z, from `first` to before `last`; fraction to the next ring."""
    k = first + int(np.searchsorted(heights[first:last], z, side="right")) - 1
    if heights[k] == z or k + 1 == last:
        return k, 0.0
    return k, float((z - heights[k]) / (heights[k + 1] - heights[k]))


@compiled()
def _above(k: int, share: float) -> int:
    return k + 1 if share > 0.0 else k


@compiled()
def _blend(low: Array, high: Array, share: float, i: int | slice) -> Array:
    return low[i] + share * (high[i] - low[i])


@compiled()
def _search_edges(
    ring: Array,
    tangents: Array,
    shown: Array,
    p: complex,
    best: Best,
    corners: list[Corner],
) -> Best:
    """Search a block of a ring's edges for a nearer point than `best`; add the block's corners."""
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
    """Search the corners, where the visible part of one ring ends and that of another begins, for a
    nearer point.

    These two points of a corner differ by the interpolation error; the segment between them belongs
    to the contour. At a corner the tangent is perpendicular to the line to p.
    """
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
    """The nearer to p of the point `best` and the point `at`."""
    away = abs(p - at)
    return (away, at, tangent / abs(tangent)) if away < best[0] else best


@compiled()
def _dot(a: complex, b: complex) -> float:
    return (a * b.conjugate()).real


@compiled()
def _foot(to_p: complex, edge: complex, t: complex, t_next: complex) -> float:
    """The fraction along an edge at which the line to p is perpendicular to the contour's tangent.

    The tangent is interpolated along the edge. Without this interpolation, the nearest point would
    jump at the polygon's vertices, because a vertex is never nearest to a point inside.
    """
    # (to_p - s edge) · (t + s (t_next - t)) = a s² + b s + c
    a = -_dot(edge, t_next - t)
    b = _dot(to_p, t_next - t) - _dot(edge, t)
    c = _dot(to_p, t)
    root = -2.0 * c / (b - math.sqrt(max(b * b - 4.0 * a * c, 0.0))) if c > 0.0 else 0.0
    return min(max(root, 0.0), 1.0)


@compiled()
def _shown_part(start: float, end: float) -> tuple[float, float]:
    """The interval of fractions along an edge, within [0, 1], with a nonnegative linear value.

    `start` and `end` are the values at the ends of the edge; the interval can be empty.
    """
    if start < 0.0 and end < 0.0:
        return 1.0, 0.0
    first = start / (start - end) if start < 0.0 else 0.0
    last = start / (start - end) if end < 0.0 else 1.0
    return first, last


@compiled()
def _square(p: complex, foot: complex, along: complex) -> complex:
    """The unit vector perpendicular to the line from p to `foot`, in the sense of `along`."""
    way = p - foot
    length = abs(way)
    if length < _TOUCHING:
        return along / abs(along)
    t = way * 1j / length
    return t if _dot(t, along) >= 0.0 else -t


@compiled()
def nearest_point(
    firsts: Array,
    heights: Array,
    vertices: Array,
    tangents: Array,
    shown: Array,
    spans: Array,
    at: Array,
) -> Array:
    """The contour's point nearest to the point `at` (3,) [m]; the other arguments are a `Table`.

    If there is no contour at the point's height, the nearest available height is used. At each
    height of the table, at least one part of a ring is outside of all other shapes. Blocks of edges
    are searched in the order of their distance, until the next block is farther than the nearest
    point, so the cost hardly grows with the number of shapes.

    Returns:
        (2, 3) p and t of `Foot`.
    """
    z, p = level(firsts, heights, at[2]), complex(at[0], at[1])
    shapes, blocks = len(firsts) - 1, spans.shape[1]
    rows, shares = np.zeros(shapes, np.int64), np.zeros(shapes)
    bounds = np.full((shapes, blocks), np.inf)  # [m] lower bounds of the distances of blocks
    for j in range(shapes):
        if heights[firsts[j]] <= z <= heights[firsts[j + 1] - 1]:
            k, share = _row(heights, firsts[j], firsts[j + 1], z)
            rows[j], shares[j], up = k, share, _above(k, share)
            for b in range(blocks):
                middle = _blend(vertices[k], vertices[up], share, b * BLOCK + BLOCK // 2)
                bounds[j, b] = max(abs(p - middle) - _blend(spans[k], spans[up], share, b), 0.0)
    best, corners = (np.inf, 0j, 1 + 0j), [(0j, 0j, False) for _ in range(0)]
    for _ in range(bounds.size):
        nearest = int(np.argmin(bounds))
        j, b = nearest // blocks, nearest % blocks
        if not (bounds[j, b] < np.inf and bounds[j, b] <= best[0] + _SAME_CORNER):
            break
        bounds[j, b] = np.inf
        k, share, i = int(rows[j]), float(shares[j]), slice(b * BLOCK, (b + 1) * BLOCK + 1)
        up = _above(k, share)
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
