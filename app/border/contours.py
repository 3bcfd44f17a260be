"""Kernels of the search on contours: closed polygons in plan, one a height, blended in between.

Vertices and unit tangents stand as x + iy in rows (H, R + 1), the first one of a row repeated at
its end, so that what follows a vertex stands beside it. A place along a contour is told in rays:
the number of the edge and the share of its length.
"""

from __future__ import annotations

import math

import numpy as np

from app.compiled import compiled

Array = np.ndarray

_TABLES = "f8[:], b1[:], c16[:,:], c16[:,:]"  # heights, which equal the next, vertices, tangents


@compiled("Tuple((i8, f8))(f8[:], f8)")
def place(heights: Array, z: float) -> tuple[int, float]:
    """Index of the polygon at or below z, and how far up to the next one, [0, 1); z is in range."""
    k = int(np.searchsorted(heights, z, side="right")) - 1
    if heights[k] == z:
        return k, 0.0
    return k, float((z - heights[k]) / (heights[k + 1] - heights[k]))


@compiled()
def _between(heights: Array, same: Array, z: float) -> tuple[int, float]:
    """The same, but nowhere between two equal polygons."""
    k, share = place(heights, z)
    return (k, 0.0) if share > 0.0 and same[k] else (k, share)


@compiled()
def _entry(rows: Array, i: int, k: int, share: float) -> complex:
    """The i-th entry of the k-th row, moved towards the next one by a share."""
    below = rows[k, i]
    return below if share == 0.0 else below + share * (rows[k + 1, i] - below)


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
def _point_of_edge(
    start: complex, end: complex, t: complex, t_next: complex, along: float
) -> tuple[float, float, float, float]:
    """Point x, y and unit tangent of an edge at a share of its length, from both its vertices."""
    xy, tangent = start + along * (end - start), t + along * (t_next - t)
    tangent /= abs(tangent)
    return xy.real, xy.imag, tangent.real, tangent.imag


@compiled(f"UniTuple(f8, 4)({_TABLES}, f8, f8)")
def point_at(
    heights: Array, same: Array, vertices: Array, tangents: Array, ray: float, z: float
) -> tuple[float, float, float, float]:
    """Point x, y and unit tangent of the contour at a height and a place along it, in rays."""
    rays = vertices.shape[1] - 1
    k, share = _between(heights, same, z)
    i = int(ray % rays) % rays
    return _point_of_edge(
        _entry(vertices, i, k, share),
        _entry(vertices, i + 1, k, share),
        _entry(tangents, i, k, share),
        _entry(tangents, i + 1, k, share),
        (ray % rays) % 1.0,
    )


@compiled(f"UniTuple(f8, 5)({_TABLES}, f8, f8, f8)")
def nearest_point(
    heights: Array, same: Array, vertices: Array, tangents: Array, x: float, y: float, z: float
) -> tuple[float, float, float, float, float]:
    """Point x, y and unit tangent nearest to (x, y) on the contour at a height, and its ray."""
    rays = vertices.shape[1] - 1
    k, share = _between(heights, same, z)
    p = complex(x, y)
    best, best_along, least = -1, 0.0, np.inf
    start, t = _entry(vertices, 0, k, share), _entry(tangents, 0, k, share)
    ahead = ((p - start) * t.conjugate()).real >= 0.0  # seen along the contour, p is past a vertex
    for i in range(rays):
        end, t_next = _entry(vertices, i + 1, k, share), _entry(tangents, i + 1, k, share)
        next_ahead = ((p - end) * t_next.conjugate()).real >= 0.0
        if ahead and not next_ahead:
            along = _foot(p - start, end - start, t, t_next)
            away = abs(p - start - along * (end - start))
            if away < least:
                best, best_along, least = i, along, away
        start, t, ahead = end, t_next, next_ahead
    if best < 0:  # p is as far from all of the contour
        for i in range(rays):
            away = abs(p - _entry(vertices, i, k, share))
            if away < least:
                best, least = i, away
    x_n, y_n, t_x, t_y = _point_of_edge(
        _entry(vertices, best, k, share),
        _entry(vertices, best + 1, k, share),
        _entry(tangents, best, k, share),
        _entry(tangents, best + 1, k, share),
        best_along,
    )
    return x_n, y_n, t_x, t_y, best + best_along


@compiled("UniTuple(f8, 2)(f8[:], f8[:], f8[:], f8)")
def gap_at(heights: Array, centre: Array, half: Array, z: float) -> tuple[float, float]:
    """[rays] middle and half width of the gap at a height, from those of each contour."""
    k, share = place(heights, z)
    if share == 0.0:
        return centre[k], half[k]
    return (
        centre[k] + share * (centre[k + 1] - centre[k]),
        half[k] + share * (half[k + 1] - half[k]),
    )


@compiled(f"UniTuple(f8, 4)({_TABLES}, f8[:], f8[:], f8[:])")
def nearest_in_reach(
    heights: Array,
    same: Array,
    vertices: Array,
    tangents: Array,
    centre: Array,
    half: Array,
    p: Array,
) -> tuple[float, float, float, float]:
    """`nearest_point` to p (3,) at the nearest height there is, and at a gap's nearer end if in it.

    `centre` and `half` are those of the gaps, one a height, in rays.
    """
    rays = vertices.shape[1] - 1
    z = min(max(p[2], heights[0]), heights[-1])
    x, y, t_x, t_y, ray = nearest_point(heights, same, vertices, tangents, p[0], p[1], z)
    middle, width = gap_at(heights, centre, half, z)
    inside = (ray - middle + rays / 2) % rays - rays / 2
    if abs(inside) < width:
        end = middle + (width if inside >= 0.0 else -width)
        return point_at(heights, same, vertices, tangents, end, z)
    return x, y, t_x, t_y
