"""Kernels of the search for the nearest point of contours: rings of convex shapes, cut where they
meet.

The boundary of a union of convex slices is what of each slice's ring lies outside of the others:
one closed curve or several, around islands or holes. Rings are closed polygons, one a height,
blended vertex by vertex between two heights, and so is how far they lie outside of the other
shapes: where that is zero two rings cross. All of it moves continuously with the height.

Vertices and unit tangents stand as x + iy in rows (N, R + 1), the first one of a row repeated at
its end, so that what follows a vertex stands beside it.
"""

from __future__ import annotations

import math

import numpy as np

from app.compiled import compiled

Array = np.ndarray

_MOST_CORNERS = 64
_SAME_CORNER = 0.01  # [m] between the two ends that meet in one corner, at most
_CHORD = 1e-4  # [m] by which a gap's end, on a chord of the true curve, may seem nearer than it is
_TOUCHING = 1e-9  # [m] nearer to a corner than that a way to it has no direction

BLOCK = 24
"""[-] edges that are looked at or left out together; the rings have a multiple of them."""


@compiled()
def _row(heights: Array, first: int, last: int, z: float) -> tuple[int, float]:
    """Row of the ring at or below z among rows first to last, and the share up to the next one."""
    k = first + int(np.searchsorted(heights[first:last], z, side="right")) - 1
    if heights[k] == z or k + 1 == last:
        return k, 0.0
    return k, float((z - heights[k]) / (heights[k + 1] - heights[k]))


@compiled()
def _foot(to_p: complex, edge: complex, t: complex, t_next: complex) -> float:
    """The share of an edge from which p lies at a right angle to the contour's tangent.

    The tangent is blended along the edge. The foot of p on the bare polygon would jump over
    its corners: seen from inside, a corner is never nearest.
    """
    turn = (t_next - t).conjugate()
    # (to_p - s edge) · (t + s (t_next - t)) = a s² + b s + c
    a = -(edge * turn).real
    b = (to_p * turn - edge * t.conjugate()).real
    c = (to_p * t.conjugate()).real
    root = -2.0 * c / (b - math.sqrt(max(b * b - 4.0 * a * c, 0.0))) if c > 0.0 else 0.0
    return min(max(root, 0.0), 1.0)


@compiled()
def _clip(low: float, high: float, start: float, end: float) -> tuple[float, float]:
    """The part of [low, high] where a value that goes from start to end is not negative."""
    if start < 0.0 and end < 0.0:
        return 1.0, 0.0
    if start < 0.0:
        return max(low, start / (start - end)), high
    if end < 0.0:
        return low, min(high, start / (start - end))
    return low, high


@compiled()
def _level(firsts: Array, heights: Array, z: float) -> float:
    """[m] the height nearest to z at which any shape has a ring."""
    best, least = z, np.inf
    for j in range(len(firsts) - 1):
        at = min(max(z, heights[firsts[j]]), heights[firsts[j + 1] - 1])
        if abs(at - z) < least:
            best, least = at, abs(at - z)
    return float(best)


@compiled()
def _bound(vertices: Array, spans: Array, k: int, share: float, block: int, p: complex) -> float:
    """[m] no point of a block of a ring's edges is nearer to p."""
    up = k + 1 if share > 0.0 else k
    middle = block * BLOCK + BLOCK // 2
    at = vertices[k, middle] + share * (vertices[up, middle] - vertices[k, middle])
    span = spans[k, block] + share * (spans[up, block] - spans[k, block])
    return max(abs(p - at) - span, 0.0)


@compiled()
def _square(p: complex, foot: complex, along: complex) -> complex:
    """The unit tangent at right angles to the way from p to its foot, on the side of `along`."""
    way = p - foot
    length = abs(way)
    if length < _TOUCHING:
        return along / abs(along)
    t = way * 1j / length
    return t if (t * along.conjugate()).real >= 0.0 else -t


@compiled()
def _visible(
    shown: Array, reached: Array, k: int, up: int, share: float, i: int
) -> tuple[float, float, float, float]:
    """The part of an edge that is shown and reached, and that which is shown, as shares of it."""
    hidden_low, hidden_high = _clip(
        0.0,
        1.0,
        shown[k, i] + share * (shown[up, i] - shown[k, i]),
        shown[k, i + 1] + share * (shown[up, i + 1] - shown[k, i + 1]),
    )
    low, high = _clip(
        hidden_low,
        hidden_high,
        reached[k, i] + share * (reached[up, i] - reached[k, i]),
        reached[k, i + 1] + share * (reached[up, i + 1] - reached[k, i + 1]),
    )
    return low, high, hidden_low, hidden_high


@compiled()
def _take(
    best: Array, p: complex, at: complex, tangent: complex, place: float, further: float = 0.0
) -> None:
    """Keep a point of the contours if it is the nearest so far: `best` is distance, place, x, …

    It counts as `further` [m] away than it is.
    """
    away = abs(p - at) + further
    if away < best[0]:
        tangent /= abs(tangent)
        best[0], best[1] = away, place
        best[2], best[3], best[4], best[5] = at.real, at.imag, tangent.real, tangent.imag


@compiled()
def _search_block(
    vertices: Array,
    tangents: Array,
    shown: Array,
    reached: Array,
    clear: Array,
    k: int,
    share: float,
    block: int,
    p: complex,
    first: float,
    best: Array,
    corners: Array,
    count: int,
) -> int:
    """Look for nearer points on some edges of a ring, and add its corners to the `count` there are.

    Rows of `corners` are x, y, tangent, place, and whether the ring goes on there or ends.
    """
    up = k + 1 if share > 0.0 else k
    i = block * BLOCK
    start = vertices[k, i] + share * (vertices[up, i] - vertices[k, i])
    t = tangents[k, i] + share * (tangents[up, i] - tangents[k, i])
    ahead = ((p - start) * t.conjugate()).real >= 0.0
    for i in range(block * BLOCK, (block + 1) * BLOCK):
        end = vertices[k, i + 1] + share * (vertices[up, i + 1] - vertices[k, i + 1])
        t_next = tangents[k, i + 1] + share * (tangents[up, i + 1] - tangents[k, i + 1])
        next_ahead = ((p - end) * t_next.conjugate()).real >= 0.0
        whole = clear[k, i] and clear[up, i]
        low, high, hidden_low, hidden_high = 0.0, 1.0, 0.0, 1.0
        if not whole:
            low, high, hidden_low, hidden_high = _visible(shown, reached, k, up, share, i)
        if ahead and not next_ahead and low <= high:
            along = _foot(p - start, end - start, t, t_next)
            if low <= along <= high:
                at, turn = start + along * (end - start), t + along * (t_next - t)
                _take(best, p, at, turn, first + i + along)
        if not whole and low <= high:
            for side in range(2):
                along = low if side == 0 else high
                if along == float(side):
                    continue
                at, turn = start + along * (end - start), t + along * (t_next - t)
                if along != (hidden_low if side == 0 else hidden_high):  # the reach ends there
                    _take(best, p, at, turn, first + i + along, _CHORD)
                elif count < len(corners):
                    turn /= abs(turn)
                    corners[count, 0], corners[count, 1] = at.real, at.imag
                    corners[count, 2], corners[count, 3] = turn.real, turn.imag
                    corners[count, 4], corners[count, 5] = first + i + along, 1.0 - side
                    count += 1
        start, t, ahead = end, t_next, next_ahead
    return count


@compiled()
def _search_corners(p: complex, best: Array, corners: Array, count: int) -> None:
    """Look for nearer points where a ring ends and another one goes on.

    The two ends differ by what the rings are off: the way from one to the other belongs to the
    contour. At a corner the tangent turns with the point that asks.
    """
    met = np.zeros(count, np.bool_)
    for c in range(count):
        if corners[c, 5] == 1.0:
            continue
        at, t = complex(corners[c, 0], corners[c, 1]), complex(corners[c, 2], corners[c, 3])
        other, apart = -1, _SAME_CORNER
        for e in range(count):
            away = abs(complex(corners[e, 0], corners[e, 1]) - at)
            if corners[e, 5] == 1.0 and away < apart:
                other, apart = e, away
        if other >= 0:
            met[other] = True
            way = complex(corners[other, 0], corners[other, 1]) - at
            if apart > 0.0:
                share = ((p - at) * way.conjugate()).real / (apart * apart)
                at += min(max(share, 0.0), 1.0) * way
            both = t + complex(corners[other, 2], corners[other, 3])
            t = both if abs(both) > _TOUCHING else t
        _take(best, p, at, _square(p, at, t), corners[c, 4])
    for c in range(count):  # those that no ring leads to: its shape is farther away
        if corners[c, 5] == 1.0 and not met[c]:
            at, t = complex(corners[c, 0], corners[c, 1]), complex(corners[c, 2], corners[c, 3])
            _take(best, p, at, _square(p, at, t), corners[c, 4])


@compiled(
    "UniTuple(f8, 6)(i8[:], f8[:], c16[:,:], c16[:,:], f8[:,:], f8[:,:], b1[:,:], f8[:,:], f8[:])"
)
def nearest_point(
    firsts: Array,
    heights: Array,
    vertices: Array,
    tangents: Array,
    shown: Array,
    reached: Array,
    clear: Array,
    spans: Array,
    at: Array,
) -> tuple[float, float, float, float, float, float]:
    """The point of the contours that is nearest to a point, at the height nearest to its own.

    Blocks of edges are searched from near to far, until the next one is farther than what was
    found: so the cost hardly grows with the number of shapes.

    Args:
        firsts: (K + 1,) row of the first ring of each shape, and the number of rows.
        heights: (N,) [m] of the rings, ascending for each shape.
        vertices: (N, R + 1) as x + iy [m].
        tangents: (N, R + 1) unit tangents at the vertices.
        shown: (N, R + 1) [m] by how much the vertices lie outside of the other shapes' offsets.
        reached: (N, R + 1) negative where the arm never is.
        clear: (N, R) whether both are positive at both ends of an edge.
        spans: (N, R / BLOCK) [m] how far the vertices of a block are from its middle one, at most.
        at: (3,) [m] the point, in the base's frame.

    Returns:
        Distance [m], place, x, y and the unit tangent there. The place is the shape's number times
        R plus the place along its ring; the distance is infinite if nothing was found.
    """
    rays, shapes = vertices.shape[1] - 1, len(firsts) - 1
    z = _level(firsts, heights, at[2])
    p = complex(at[0], at[1])
    blocks = rays // BLOCK
    rows, shares = np.zeros(shapes, np.int64), np.zeros(shapes)
    bounds = np.full(shapes * blocks, np.inf)
    for j in range(shapes):
        if heights[firsts[j]] <= z <= heights[firsts[j + 1] - 1]:
            rows[j], shares[j] = _row(heights, firsts[j], firsts[j + 1], z)
            for b in range(blocks):
                bounds[j * blocks + b] = _bound(vertices, spans, rows[j], shares[j], b, p)
    best = np.zeros(6)
    best[0], best[4] = np.inf, 1.0
    corners, count = np.empty((_MOST_CORNERS, 6)), 0
    for _ in range(len(bounds)):
        nearest = int(np.argmin(bounds))
        if not (bounds[nearest] < np.inf and bounds[nearest] <= best[0] + _SAME_CORNER):
            break
        bounds[nearest] = np.inf
        j, b = nearest // blocks, nearest % blocks
        count = _search_block(
            vertices,
            tangents,
            shown,
            reached,
            clear,
            int(rows[j]),
            float(shares[j]),
            b,
            p,
            float(j * rays),
            best,
            corners,
            count,
        )
    _search_corners(p, best, corners, count)
    if best[0] < np.inf:
        best[0] = abs(p - complex(best[2], best[3]))
    return best[0], best[1], best[2], best[3], best[4], best[5]
