"""The border as a continuous surface: closed contours at each height, open where the arm never is.

Its contours are those of the exact offset, which the cloud samples. The cloud says which part of
each contour the arm can reach: where it leaves a wide gap, the contour is open there. A point and
its nearest point on the surface move together, at a cost that does not depend on the cloud.
`BorderPoints` is the border as the paper has it: the sampled points alone.
"""

import math
from collections.abc import Iterable, Sequence
from itertools import compress
from typing import NamedTuple

import numpy as np

from app.border.contours import Contours, Foot, NearestBorder
from app.border.dbb import Border, Cloud, construct_dbb
from app.border.offset import RAYS, OffsetContours, offset_contours, ray_from
from app.config import BorderConfig
from app.robot.model import RobotModel, kept_per_model
from app.strict import Array

_NEAR_HEIGHT = 0.015  # [m] points that far above and below tell where a contour is reached
_NEAR_CONTOUR = 0.05  # [m] from a contour; over the top, points of other heights lie inside of it
_LEAST_POINTS = 20  # [-] fewer tell nothing
_LEAST_GAP = 40.0  # [rays] narrower gaps are chance
_MARGIN = 10.0  # [rays] by which a gap is kept narrower on either side: samples are not everywhere
_INSIDE = 20.0  # [rays] beyond that far from a gap it does not matter how far
STEEPEST_GAP = 1500.0  # [rays/m] by which either end of a gap may move from height to height


class BorderSurface(Contours):
    """DBB_i as a surface: the offset's contours, open where the border has no points."""

    def __init__(self, border: Border, offset: OffsetContours) -> None:
        """The sampled border of one pair, and the exact offset of l_m for the same d_b."""
        super().__init__(offset.table._replace(reached=find_reached(border, offset)))


class BorderPoints:
    """DBB_i as points; where a height has none, the exact offset of l_m takes their place."""

    def __init__(self, border: Border, offset: OffsetContours) -> None:
        """The sampled border of one pair, and the exact offset of l_m for the same d_b."""
        self._border, self._offset = border, offset

    def nearest(self, p: Array) -> Foot | None:
        """FindSameHeight and FindMinDistancePoint: the point nearest to p, (3,) [m], at its height.

        The tangent is at right angles to the way from p to that point. Where p lies on the border,
        which is known to within ε, that way has no direction: there it is the offset's tangent.
        None only if l_m has no border at all.

        Paper: Algorithm 3, lines 1 to 4.
        """
        exact = None
        points = self._border.same_height(float(p[2]))
        if len(points):
            ways = points[:, :2] - p[:2]
            x, y, _ = points[np.einsum("ij,ij->i", ways, ways).argmin()].tolist()
        elif (exact := self._offset.nearest(p)) is not None:
            x, y, _ = exact.p.tolist()
        else:
            return None
        p_n = np.array([x, y, p[2]])
        length = math.hypot(x - float(p[0]), y - float(p[1]))
        if length > self._border.eps:
            return Foot(p_n, np.array([(p[1] - y) / length, (x - p[0]) / length, 0.0]))
        exact = exact or self._offset.nearest(p_n)
        return Foot(p_n, np.array([0.0, 1.0, 0.0]) if exact is None else exact.t)


BORDERS = {"surface": BorderSurface, "points": BorderPoints}
"""Kinds of border, by the name in the configuration."""


@kept_per_model(8)
def border_of(model: RobotModel, cloud: Cloud, config: BorderConfig) -> NearestBorder:
    """The border of a cloud's pair, of the configured kind; made once: each controller asks."""
    border = construct_dbb(cloud, config.d_b, config.eps)
    return BORDERS[config.kind](border, offset_contours(model, config.d_b))


class Gap(NamedTuple):
    """A stretch of a closed contour that the arm never reaches, counted in its rays."""

    first: float
    """Where it begins."""
    last: float
    """Where it ends, more than `first` also where it goes beyond the last ray."""


def gaps_between(stretches: Iterable[tuple[float, float]]) -> list[Gap]:
    """What stretches without points tell: the narrow ones nothing, the others a gap within each.

    A stretch goes from the last point before it to the first one after it [rays].
    """
    return [
        Gap(before + _MARGIN, after - _MARGIN)
        for before, after in stretches
        if after - before >= _LEAST_GAP
    ]


def without_leaps(
    contours: Sequence[list[Gap] | None], heights: Array, rays: int
) -> list[list[Gap]]:
    """Gaps narrowed until none leaps from height to height, (H,) [m] ascending.

    Else one would open within a single height where the border begins, and the foot race. A contour
    that tells nothing is None: between contours that tell something it has the gaps of the next
    lower of them, else it has none.
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


def find_reached(border: Border, offset: OffsetContours) -> Array:
    """The parts of the rings near which the border has points.

    A gap is a stretch of a ring without points. What other shapes hide has none and belongs to it,
    but a stretch that is all hidden is no gap. From ring to ring an end moves by `STEEPEST_GAP` at
    most.

    Returns:
        (N, RAYS + 1) [rays] from a gap's end, negative inside of it, as the rows of `Table`.
        Blended between heights, a gap that is not there at the next one closes from its ends.
    """
    rows: list[Array] = []
    shown = offset.table.shown[:, :-1] > 0.0
    for rings in offset.rings:
        seen = zip(rings.heights, rings.centres, rings.vertices, strict=True)
        found = [_gaps(border, z, centre, ring) for z, centre, ring in seen]
        for gaps in without_leaps(found, rings.heights, RAYS):
            ring = shown[len(rows)]  # a gap all of whose rays other shapes hide is none
            within = (np.arange(int(gap.first), int(gap.last) + 1) % RAYS for gap in gaps)
            showing = [ring[rays].any() for rays in within]
            rows.append(_from_ends(list(compress(gaps, showing))))
    reached = np.array(rows).reshape(-1, RAYS)
    return np.concatenate([reached, reached[:, :1]], axis=1)


def _gaps(border: Border, z: float, centre: Array, ring: Array) -> list[Gap] | None:
    """The gaps of one ring, hidden ones too; None if too few points are near."""
    points = border.same_height(float(z), _NEAR_HEIGHT)[:, :2]
    cell = np.rint(ray_from(points, centre)).astype(int) % RAYS
    cell = cell[np.linalg.norm(points - ring[cell], axis=1) < _NEAR_CONTOUR]
    if len(cell) < _LEAST_POINTS:
        return None
    filled = np.unique(cell)
    return gaps_between(zip(filled, np.append(filled[1:], filled[0] + RAYS), strict=True))


def _from_ends(gaps: list[Gap]) -> Array:
    """(RAYS,) [rays] from the ends of the gaps of one ring."""
    found, every = np.full(RAYS, _INSIDE), np.arange(-RAYS, 2 * RAYS)
    for gap in gaps:
        outside = np.maximum(gap.first - every, every - gap.last)
        found = np.minimum(found, outside.reshape(3, RAYS).min(axis=0))
    return found
