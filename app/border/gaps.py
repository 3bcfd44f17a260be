"""Where a contour has no points of the border: the arm is never there."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import NamedTuple

import numpy as np

from app.compiled import compiled

Array = np.ndarray

NEAR_HEIGHT = 0.015
"""[m] points that far above and below tell where a contour is reached."""
NEAR_CONTOUR = 0.05
"""[m] from a contour; over the top, points of other heights lie inside of it."""
LEAST_POINTS = 20
"""[-] fewer tell nothing."""
_LEAST_GAP = 40.0
"""[rays] narrower gaps are chance."""
_MARGIN = 10.0
"""[rays] by which a gap is kept narrower on either side: samples are not everywhere."""
STEEPEST_GAP = 1500.0
"""[rays/m] by which either end of a gap may move from height to height."""


class Gap(NamedTuple):
    """A stretch of a closed contour that the arm never reaches, counted in its rays.

    Attributes:
        first: Where it begins.
        last: Where it ends, more than `first` also where it goes beyond the last ray.
    """

    first: float
    last: float


def gaps_between(stretches: Iterable[tuple[float, float]]) -> list[Gap]:
    """What stretches without points tell: the narrow ones nothing, the others a gap within each.

    Args:
        stretches: [rays] from the last point before each to the first one after it.
    """
    return [
        Gap(before + _MARGIN, after - _MARGIN)
        for before, after in stretches
        if after - before >= _LEAST_GAP
    ]


def without_leaps(
    contours: Sequence[list[Gap] | None], heights: Array, rays: int
) -> list[list[Gap]]:
    """Gaps narrowed until none leaps from height to height.

    Else one would open within a single height where the border begins, and the foot race.

    Args:
        contours: (H,) the gaps of each; None where nothing is told. Between contours that tell
            something such a one has the gaps of the next lower of them, else it has none.
        heights: (H,) [m] ascending.
        rays: Of a contour.
    """
    told = [k for k, gaps in enumerate(contours) if gaps is not None]
    found: list[list[Gap]] = [[] for _ in contours]
    for k in range(told[0], told[-1] + 1) if told else ():
        known = contours[k]
        found[k] = found[k - 1] if known is None else known
    upward = [(k, k - 1) for k in range(1, len(found))]
    for k, beside in upward + [(below, above) for above, below in reversed(upward)]:
        further = STEEPEST_GAP * abs(float(heights[k] - heights[beside]))
        found[k] = [_narrowed(gap, found[beside], further, rays) for gap in found[k]]
    return found


def _narrowed(gap: Gap, beside: Sequence[Gap], further: float, rays: int) -> Gap:
    """A gap within the one that it overlaps most beside it, or about its middle if none does."""
    middle, most = (gap.first + gap.last) / 2, 0.0
    first = last = middle
    for other in beside:
        for turn in (-rays, 0, rays):
            begin, end = other.first + turn, other.last + turn
            overlap = min(gap.last, end) - max(gap.first, begin)
            if overlap > most:
                first, last, most = begin, end, overlap
    return Gap(max(gap.first, first - further), min(gap.last, last + further))


@compiled("Tuple((f8[::1], f8[::1]))(f8[:], f8[:], f8[:], i8[:], i8[:], c16[:,:], f8, i8)")
def widest_gaps(
    x: Array,
    y: Array,
    ray: Array,
    first: Array,
    last: Array,
    vertices: Array,
    near: float,
    least_points: int,
) -> tuple[Array, Array]:
    """The widest part of each contour near which there is no point.

    Args:
        x: (N,) [m] of the points in plan.
        y: (N,) [m] of the points in plan.
        ray: (N,) on which ray each of them lies.
        first: (H,) index of the first point of each contour's height.
        last: (H,) index after the last one.
        vertices: (H, R + 1) as x + iy [m].
        near: [m] within which of the contour's vertex on its ray a point counts.
        least_points: Fewer tell nothing.

    Returns:
        (H,) middle and (H,) width of each gap [rays]; both are NaN where nothing is told.
    """
    H, rays = len(first), vertices.shape[1] - 1
    middle, width = np.zeros(H), np.zeros(H)
    lowest, highest = np.empty(rays), np.empty(rays)  # ray of a point, by whole rays
    for k in range(H):
        lowest[:], highest[:] = np.inf, -np.inf
        count = 0
        for i in range(first[k], last[k]):
            v = vertices[k, round(ray[i]) % rays]
            if (x[i] - v.real) ** 2 + (y[i] - v.imag) ** 2 < near**2:
                cell = int(ray[i]) % rays
                lowest[cell] = min(lowest[cell], ray[i])
                highest[cell] = max(highest[cell], ray[i])
                count += 1
        if count < least_points:
            middle[k] = width[k] = np.nan
            continue
        before = np.max(highest) - rays  # the last point, a turn ago
        for cell in range(rays):
            if lowest[cell] <= highest[cell]:
                if lowest[cell] - before > width[k]:
                    middle[k], width[k] = (before + lowest[cell]) / 2, lowest[cell] - before
                before = highest[cell]
    return middle, width
