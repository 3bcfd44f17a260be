"""Where the arm reaches the contours of several shapes, ring by ring."""

from __future__ import annotations

import numpy as np

from app.border.dbb import Border
from app.border.gaps import (
    LEAST_POINTS,
    NEAR_CONTOUR,
    NEAR_HEIGHT,
    Gap,
    gaps_between,
    without_leaps,
)
from app.border.offset import RAYS, OffsetContours, ray_from

Array = np.ndarray

_INSIDE = 20.0  # [rays] beyond that far from a gap it does not matter how far


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
        seen = zip(rings.heights, rings.centres, rings.vertices, strict=True)
        found = [_gaps(border, z, centre, ring) for z, centre, ring in seen]
        for gaps in without_leaps(found, rings.heights, RAYS):
            rows.append(_from_ends([gap for gap in gaps if _shows(gap, shown[len(rows)])]))
    reached = np.array(rows)
    return np.concatenate([reached, reached[:, :1]], axis=1)


def _gaps(border: Border, z: float, centre: Array, ring: Array) -> list[Gap] | None:
    """The gaps of one ring, hidden ones too; None if too few points are near."""
    points = border.same_height(float(z), NEAR_HEIGHT)[:, :2]
    cell = np.rint(ray_from(points, centre)).astype(int) % RAYS
    cell = cell[np.linalg.norm(points - ring[cell], axis=1) < NEAR_CONTOUR]
    if len(cell) < LEAST_POINTS:
        return None
    filled = np.unique(cell)
    return gaps_between(zip(filled, np.append(filled[1:], filled[0] + RAYS), strict=True))


def _shows(gap: Gap, shown: Array) -> bool:
    """Whether any of a gap's rays is not hidden by other shapes."""
    return bool(shown[np.arange(int(gap.first), int(gap.last) + 1) % RAYS].any())


def _from_ends(gaps: list[Gap]) -> Array:
    """(RAYS,) [rays] from the ends of the gaps of one ring."""
    found, every = np.full(RAYS, _INSIDE), np.arange(-RAYS, 2 * RAYS)
    for gap in gaps:
        outside = np.maximum(gap.first - every, every - gap.last)
        found = np.minimum(found, outside.reshape(3, RAYS).min(axis=0))
    return found
