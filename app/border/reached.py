"""Where the arm reaches the contours of several shapes, ring by ring."""

from __future__ import annotations

import numpy as np

from app.border.dbb import Border
from app.border.gaps import LEAST_GAP, LEAST_POINTS, MARGIN, NEAR_CONTOUR, NEAR_HEIGHT
from app.border.offset import RAYS, OffsetContours, ray_from

Array = np.ndarray

_INSIDE = 20.0  # [rays] beyond that far from a gap it does not matter how far


def find_reached(border: Border, offset: OffsetContours) -> Array:
    """The parts of several shapes' rings near which the border has points.

    A gap is a stretch of a ring without points. What other shapes hide has none and belongs to it,
    but a stretch that is all hidden is no gap.

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
        for z, centre, ring in zip(rings.heights, rings.centres, rings.vertices, strict=True):
            points = border.same_height(float(z), NEAR_HEIGHT)[:, :2]
            rows.append(_row(points, centre, ring, shown[len(rows)]))
    reached = np.array(rows)
    return np.concatenate([reached, reached[:, :1]], axis=1)


def _row(points: Array, centre: Array, ring: Array, shown: Array) -> Array:
    """(RAYS,) [rays] from the ends of the gaps of one ring."""
    cell = np.rint(ray_from(points, centre)).astype(int) % RAYS
    cell = cell[np.linalg.norm(points - ring[cell], axis=1) < NEAR_CONTOUR]
    found = np.full(RAYS, _INSIDE)
    if len(cell) < LEAST_POINTS:
        return found
    filled = np.unique(cell)
    for before, after in zip(filled, np.append(filled[1:], filled[0] + RAYS), strict=True):
        empty = np.arange(before + 1, after)
        if after - before < LEAST_GAP or not shown[empty % RAYS].any():
            continue
        ends = before + MARGIN, after - MARGIN
        every = np.arange(before, before + RAYS)
        inside = np.minimum(every - ends[0], ends[1] - every)  # positive in the gap
        inside = np.maximum(inside, -_INSIDE)
        found[every % RAYS] = np.minimum(found[every % RAYS], -inside)
    return found
