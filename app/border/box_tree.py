"""The nearest of many points in plan, among those within a range of heights.

The points stand in a balanced tree of boxes: each halves its points across its longest side. A
search looks into few boxes, however dense the points are.
"""

from __future__ import annotations

import numpy as np

from app.compiled import compiled

Array = np.ndarray

_LEAF = 24  # points, or up to twice as many, that are searched one by one
_DEEPEST = 64


class BoxTree:
    """Points (N, 3), sorted once, for `nearest`."""

    def __init__(self, points: Array) -> None:
        """Sort a copy of the points (N, 3) [m]."""
        self._points = np.array(points, dtype=float, order="C")
        levels = max(0, (len(points) // _LEAF).bit_length() - 1)
        self._boxes = np.empty((2 ** (levels + 1) - 1, 2, 3))
        if len(points):
            _sort(self._points, self._boxes)

    def nearest(self, p: Array, half_thickness: float) -> tuple[float, float] | None:
        """Where in plan the point nearest to p in plan is, or None if none is as high as p.

        Args:
            p: (3,) [m].
            half_thickness: [m] by which heights may differ.
        """
        if not len(self._points):
            return None
        found = _search(self._points, self._boxes, p, half_thickness)
        return None if found < 0 else (self._points[found, 0], self._points[found, 1])


@compiled()
def _partition(points: Array, low: int, high: int, middle: int, axis: int) -> None:
    """Put the points from low to before high in an order in which those before middle are less."""
    while high - low > 1:
        a, b, c = points[low, axis], points[(low + high) // 2, axis], points[high - 1, axis]
        pivot = max(min(a, b), min(max(a, b), c))
        i, j = low, high - 1
        while i <= j:
            while points[i, axis] < pivot:
                i += 1
            while points[j, axis] > pivot:
                j -= 1
            if i <= j:
                for k in range(3):
                    points[i, k], points[j, k] = points[j, k], points[i, k]
                i, j = i + 1, j - 1
        if middle <= j:
            high = j + 1
        elif middle >= i:
            low = i
        else:
            return


@compiled("void(f8[:,:], f8[:,:,:])")
def _sort(points: Array, boxes: Array) -> None:
    """Sort the points, in place, and write the box of each node: its children are 2k+1, 2k+2."""
    low, high = np.empty(len(boxes), np.int64), np.empty(len(boxes), np.int64)
    low[0], high[0] = 0, len(points)
    for node in range(len(boxes)):
        box = boxes[node]
        box[0], box[1] = np.inf, -np.inf
        for i in range(low[node], high[node]):
            for k in range(3):
                box[0, k] = min(box[0, k], points[i, k])
                box[1, k] = max(box[1, k], points[i, k])
        child = 2 * node + 1
        if child < len(boxes):
            middle = (low[node] + high[node]) // 2
            axis = int(np.argmax(box[1] - box[0]))
            _partition(points, low[node], high[node], middle, axis)
            low[child], high[child] = low[node], middle
            low[child + 1], high[child + 1] = middle, high[node]


@compiled()
def _away(box: Array, p: Array, half_thickness: float) -> float:
    """[m²] squared distance in plan from p to a box; infinite if it has no such heights."""
    if box[0, 2] > p[2] + half_thickness or box[1, 2] < p[2] - half_thickness:
        return np.inf
    x = max(box[0, 0] - p[0], 0.0, p[0] - box[1, 0])
    y = max(box[0, 1] - p[1], 0.0, p[1] - box[1, 1])
    return x * x + y * y


@compiled("i8(f8[:,:], f8[:,:,:], f8[:], f8)")
def _search(points: Array, boxes: Array, p: Array, half_thickness: float) -> int:
    """Index of the nearest point, -1 if there is none."""
    found, least = -1, np.inf
    waiting, size = np.empty((_DEEPEST, 3), np.int64), 1  # nodes with the points in them
    waiting[0, 0], waiting[0, 1], waiting[0, 2] = 0, 0, len(points)
    while size > 0:
        size -= 1
        node, low, high = waiting[size]
        if _away(boxes[node], p, half_thickness) >= least:
            continue
        child = 2 * node + 1
        if child >= len(boxes):
            for i in range(low, high):
                if abs(points[i, 2] - p[2]) <= half_thickness:
                    away = (points[i, 0] - p[0]) ** 2 + (points[i, 1] - p[1]) ** 2
                    if away < least:
                        found, least = i, away
            continue
        middle = (low + high) // 2
        first = _away(boxes[child], p, half_thickness)
        second = _away(boxes[child + 1], p, half_thickness)
        nearer = 1 if first <= second else 0  # the nearer one is put on top
        waiting[size + nearer, 0], waiting[size + nearer, 1] = child, low
        waiting[size + nearer, 2] = middle
        waiting[size + 1 - nearer, 0], waiting[size + 1 - nearer, 1] = child + 1, middle
        waiting[size + 1 - nearer, 2] = high
        size += 2
    return found
