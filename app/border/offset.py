"""The exact offset of the mobile base, {p : distance to l_m = d_b}, as horizontal contours.

The offset is the border as a continuous surface. It also replaces sampled points at heights without
points, so that an acting point exists at every height.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from app.border.dbb import Cloud, construct_dbb
from app.border.mobile import ConvexPart, MobileBody
from app.border.nearest import BLOCK, BorderSearch, Table, level
from app.config import BorderConfig
from app.robot.model import RobotModel, kept_per_model
from app.strict import Array

RAYS = 360  # number of rays from the centre of a slice
_STEP = 0.01  # [m] distance between heights, and along the arcs above the top and below the bottom
_HIGH_BOTTOM = 0.8  # [-] smallest height of a shape's bottom / d_b with an arc below the bottom
_ANGLES = np.linspace(0.0, 2 * np.pi, RAYS, endpoint=False)
_RAYS = np.column_stack([np.cos(_ANGLES), np.sin(_ANGLES), np.zeros(RAYS)])
_TOUCHING = 2e-6  # [m] tolerance with which flush shapes count as outside of each other
_ALONE = 1.0  # [m] upper bound of `_shown`, which is its value if there are no other shapes

_Level = tuple[float, Array, Array]  # height [m], centre (2,) [m], lengths of the rays [m]


class OffsetContours:
    """The contours of the offset of l_m, a union of convex shapes, at each height.

    Each shape has a ring at each height of its offset. The contours are the parts of the rings
    outside of the other shapes' offsets: one closed curve, or several with islands and holes.
    """

    def __init__(self, model: RobotModel, d_b: float) -> None:
        """Trace all contours for a buffer distance d_b [m]."""
        self.d_b = d_b
        traced = [(part, trace_rings(part, d_b)) for part in MobileBody(model).parts]
        traced = _outermost([each for each in traced if len(each[1].heights)], d_b)
        self.rings: tuple[Rings, ...] = tuple(rings for _, rings, _ in traced)
        """Rings of each visible shape, in the order of decreasing horizontal size; empty if l_m has
        no offset above the floor."""
        self.table = _table(self.rings, [shown for *_, shown in traced])

    def within(self, z: float) -> float:
        """[m] the height nearest to z [m] that has a contour."""
        return level(self.table.firsts, self.table.heights, z)

    def contours(self, z: float) -> list[Array]:
        """The contour at height z [m], the visible pieces of all rings, as polylines (K, 2) [m]."""
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
    """The pieces (K, 2) [m] of a closed ring that are outside of the other shapes' offsets.

    `ring` and `shown` are one row of the fields `vertices` and `shown` of a `Table`.
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


@kept_per_model(4)
def offset_contours(model: RobotModel, d_b: float) -> OffsetContours:
    """The contours for a buffer distance d_b [m]; cached for each model."""
    return OffsetContours(model, d_b)


@kept_per_model(8)
def border_of(model: RobotModel, clouds: tuple[Cloud, ...], config: BorderConfig) -> BorderSearch:
    """The border of the clouds' pairs, of the configured kind; cached for each model."""
    table = offset_contours(model, config.d_b).table
    if config.kind == "surface":
        return BorderSearch(table)
    return BorderSearch(table, [construct_dbb(each, config.d_b, config.eps) for each in clouds])


def _outermost(
    traced: list[tuple[ConvexPart, Rings]], d_b: float
) -> list[tuple[ConvexPart, Rings, Array]]:
    """The visible shapes by decreasing horizontal size, with the result of `_shown` for each."""
    traced = sorted(traced, key=lambda each: -float(np.prod((each[0].upper - each[0].lower)[:2])))
    kept = list(range(len(traced)))
    for k in reversed(range(len(traced))):  # a hidden shape hides no other shape
        others = [traced[j][0] for j in kept if j != k]
        if others and (_shown(traced[k][1], others, d_b) <= 0.0).all():
            kept.remove(k)
    return [
        (*traced[k], _shown(traced[k][1], [traced[j][0] for j in kept if j != k], d_b))
        for k in kept
    ]


def _shown(rings: Rings, others: list[ConvexPart], d_b: float) -> Array:
    """(H, RAYS + 1) [m] signed distance of each vertex from the other offsets, at most 1 m."""
    points = np.empty((*rings.vertices.shape[:2], 3))
    points[..., :2], points[..., 2] = rings.vertices, rings.heights[:, None]
    found = [each.distances(points.reshape(-1, 3)).reshape(points.shape[:2]) for each in others]
    return np.min([np.full(points.shape[:2], d_b + _ALONE), *found], axis=0) - d_b + _TOUCHING


def _table(rings: tuple[Rings, ...], shown: list[Array]) -> Table:
    none = np.empty((0, RAYS + 1))
    corners = np.concatenate([np.empty((0, RAYS + 1, 2)), *(r.vertices for r in rings)])
    vertices = corners[..., 0] + 1j * corners[..., 1]
    blocks = np.arange(0, RAYS, BLOCK)[:, None] + np.arange(BLOCK + 1)
    middles = vertices[:, blocks[:, BLOCK // 2]]
    return Table(
        np.cumsum([0, *(len(r.heights) for r in rings)]),
        np.concatenate([none[:, 0], *(r.heights for r in rings)]),
        vertices,
        np.concatenate([none.astype(complex), *(r.tangents for r in rings)]),
        np.concatenate([none, *shown]),
        np.abs(vertices[:, blocks] - middles[:, :, None]).max(axis=2, initial=0.0),
    )


class Rings(NamedTuple):
    """Closed polygons around one convex shape, one at each height, with vertices at d_m = d_b."""

    heights: Array
    """(H,) [m] heights, ascending."""
    vertices: Array
    """(H, RAYS + 1, 2) [m] vertices in the base's frame, counter-clockwise; the last vertex is the
    first."""
    tangents: Array
    """(H, RAYS + 1) unit tangents at the vertices, as x + iy."""


def trace_rings(part: ConvexPart, d_b: float) -> Rings:
    """Trace the part above the floor of a convex shape's offset at the distance d_b [m].

    Rays start at the centre of the shape. If a slice of the offset does not contain this centre,
    for example for a slanted shape, the rays at each height start at the centre of the slice.
    """
    tracer = _Tracer(part, d_b)
    heights = _levels(float(part.lower[2]), float(part.upper[2]), d_b)
    found = tracer.from_middle(heights) or tracer.from_slices(heights)
    kept = np.array([z for z, _, _ in found])
    centres = np.array([centre for _, centre, _ in found]).reshape(-1, 2)
    ends = np.array([ends for _, _, ends in found]).reshape(-1, RAYS)
    rings = centres[:, None] + ends[:, :, None] * _RAYS[:, :2]
    vertices = np.concatenate([rings, rings[:, :1]], axis=1)
    tangents = _vertex_tangents(np.diff(vertices[..., 0] + 1j * vertices[..., 1], axis=1))
    return Rings(kept, vertices, tangents)


class _Tracer:
    """Follows rays to the boundary of one shape's offset, height by height."""

    def __init__(self, part: ConvexPart, d_b: float) -> None:
        self._part, self._d_b = part, d_b
        self._middle = (part.lower[:2] + part.upper[:2]) / 2

    def from_middle(self, heights: Array) -> list[_Level] | None:
        """Trace all heights with a slice from the shape's centre; None if a slice is beside it."""
        found: list[_Level] = []
        ends: Array | None = None
        for z in heights:
            ends = self._ends(self._middle, float(z), ends)
            hits = np.isfinite(ends)
            if hits.all():
                found.append((float(z), self._middle, ends))
            elif hits.any():
                return None
        return found

    def from_slices(self, heights: Array) -> list[_Level]:
        """Trace each height from the centre of the slice at this height."""
        found: list[_Level] = []
        centre = self._middle
        for z in heights:
            inside = self._inside(centre, float(z))
            if inside is None:
                continue
            ring = inside + self._ends(inside, float(z), None)[:, None] * _RAYS[:, :2]
            centre = (ring.min(axis=0) + ring.max(axis=0)) / 2
            ends = self._ends(centre, float(z), None)
            if np.isfinite(ends).all():
                found.append((float(z), centre, ends))
        return found

    def _inside(self, centre: Array, z: float) -> Array | None:
        """A point (2,) [m] inside the slice at height z [m], or None if the slice is empty.

        Rays that start outside of the slice end at its far side. The mean of these ends is inside,
        because the slice is convex.
        """
        d, normal = self._part.distance_and_normal(np.array([*centre, z]))
        nearest = centre - d * normal[:2]
        for start in (centre, nearest, self._middle):
            ends = self._ends(start, z, None)
            hits = np.isfinite(ends)
            if hits.all():
                return start
            if hits.any():
                inside = (start + ends[hits, None] * _RAYS[hits, :2]).mean(axis=0)
                if np.isfinite(self._ends(inside, z, None)).all():
                    return inside
        return None

    def _ends(self, centre: Array, z: float, start: Array | None) -> Array:
        """(RAYS,) [m] lengths of rays at height z, from estimates `start`; −inf without a hit."""
        part = self._part
        outside = float(np.abs([part.lower[:2], part.upper[:2]]).max())
        beyond = 2 * (outside + self._d_b + float(np.abs(centre).max()))
        first = np.full(RAYS, beyond)
        if start is not None:
            first = np.where(np.isfinite(start), start, beyond)
        return part.ray_ends(np.array([*centre, z]), _RAYS, first, self._d_b)


def _vertex_tangents(edges: Array) -> Array:
    """Unit tangents (H, RAYS + 1) at the vertices of rings: the mean directions of the two adjacent
    edges (H, RAYS), as x + iy.
    """
    directions = edges / np.abs(edges)
    tangents = directions + np.roll(directions, 1, axis=1)
    tangents /= np.abs(tangents)
    return np.concatenate([tangents, tangents[:, :1]], axis=1)


def _levels(bottom: float, top: float, d_b: float) -> Array:
    """(H,) [m] the heights at which a shape's offset is traced.

    They start at the floor or, for a shape high above the floor, on an arc below its bottom. They
    are at most 10 mm apart: in height beside the shape, along the arc above and below it.
    """
    low = bottom if bottom > _HIGH_BOTTOM * d_b else min(0.0, top)
    arc = np.linspace(0.0, np.pi / 2, int(np.ceil(d_b * np.pi / 2 / _STEP)) + 1)[1:]
    # At the end of the arc the offset is flat, and rays are tangent to it: stop just before.
    arc[-1] -= 1e-3
    beside = np.linspace(low, top, max(2, int(np.ceil((top - low) / _STEP)) + 1))
    under = (low - d_b * np.sin(arc))[::-1] if low > 0.0 else np.empty(0)
    levels = np.concatenate([under, beside, top + d_b * np.sin(arc)])
    return levels if levels[0] >= 0.0 else np.concatenate([[0.0], levels[levels > 0.0]])
