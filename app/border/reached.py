"""Where the arm reaches the contours of several shapes, ring by ring."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from app.border.dbb import Border
from app.border.gaps import (
    LEAST_GAP,
    LEAST_POINTS,
    MARGIN,
    NEAR_CONTOUR,
    NEAR_HEIGHT,
    STEEPEST_GAP,
)
from app.border.offset import RAYS, OffsetContours, ray_from

Array = np.ndarray

_INSIDE = 20.0  # [rays] beyond that far from a gap it does not matter how far


class _Gap(NamedTuple):
    """A stretch of a ring, or one beyond the first ray, that the arm never reaches [rays]."""

    first: float
    last: float


def find_reached(border: Border, offset: OffsetContours) -> Array:
    """The parts of several shapes' rings near which the border has points.

    A gap is a stretch of a ring without points. What other shapes hide has none and belongs to it,
    but a stretch that is all hidden is no gap. From ring to ring an end moves by `STEEPEST_GAP` at
    most.

    Args:
        border: The sampled border of one pair.
        offset: The exact offset of l_m for the same d_b.

    Returns:
        (N, RAYS + 1) [rays] from a gap's end, negative inside of it, as the rows of `Union`.
        Blended between heights, a gap that is not there at the next one closes from its ends.
    """
    assert offset.union is not None
    rows: list[Array] = []
    shown = offset.union.shown[:, :-1] > 0.0
    for rings in offset.rings:
        gaps = []
        for z, centre, ring in zip(rings.heights, rings.centres, rings.vertices, strict=True):
            points = border.same_height(float(z), NEAR_HEIGHT)[:, :2]
            gaps.append(_gaps(points, centre, ring, shown[len(rows) + len(gaps)]))
        rows += [_from_ends(of_ring) for of_ring in _without_leaps(gaps, rings.heights)]
    reached = np.array(rows)
    return np.concatenate([reached, reached[:, :1]], axis=1)


def _gaps(points: Array, centre: Array, ring: Array, shown: Array) -> list[_Gap]:
    """The gaps of one ring."""
    cell = np.rint(ray_from(points, centre)).astype(int) % RAYS
    cell = cell[np.linalg.norm(points - ring[cell], axis=1) < NEAR_CONTOUR]
    if len(cell) < LEAST_POINTS:
        return []
    filled = np.unique(cell)
    found = []
    for before, after in zip(filled, np.append(filled[1:], filled[0] + RAYS), strict=True):
        empty = np.arange(before + 1, after)
        if after - before >= LEAST_GAP and shown[empty % RAYS].any():
            found.append(_Gap(before + MARGIN, after - MARGIN))
    return found


def _without_leaps(rings: list[list[_Gap]], heights: Array) -> list[list[_Gap]]:
    """Gaps narrowed until none leaps from ring to ring."""
    rings = list(rings)
    upward = [(k, k - 1) for k in range(1, len(rings))]
    for k, beside in upward + [(below, above) for above, below in reversed(upward)]:
        further = STEEPEST_GAP * abs(float(heights[k] - heights[beside]))
        rings[k] = [_narrowed(gap, rings[beside], further) for gap in rings[k]]
    return rings


def _narrowed(gap: _Gap, beside: list[_Gap], further: float) -> _Gap:
    """A gap within the one that it overlaps most beside it, or about its middle if none does."""
    middle = (gap.first + gap.last) / 2
    turned = [_Gap(*np.add(other, turn)) for other in beside for turn in (-RAYS, 0, RAYS)]
    overlaps = [min(gap.last, other.last) - max(gap.first, other.first) for other in turned]
    widest = int(np.argmax(overlaps)) if overlaps else 0
    most = turned[widest] if overlaps and overlaps[widest] > 0.0 else _Gap(middle, middle)
    return _Gap(max(gap.first, most.first - further), min(gap.last, most.last + further))


def _from_ends(gaps: list[_Gap]) -> Array:
    """(RAYS,) [rays] from the ends of the gaps of one ring."""
    found, every = np.full(RAYS, _INSIDE), np.arange(-RAYS, 2 * RAYS)
    for gap in gaps:
        outside = np.maximum(gap.first - every, every - gap.last)
        found = np.minimum(found, outside.reshape(3, RAYS).min(axis=0))
    return found
