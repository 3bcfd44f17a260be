"""The exact offset of the mobile robot, {p : distance to l_m = d_b}, as horizontal contours.

It stands in wherever the border's cloud has no point at a height: never an empty slice, never a
zero force.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from app.border import contours
from app.border.mobile import ConvexPart, MobileBody
from app.border.rings import RAYS as RAYS
from app.border.rings import Rings, Tables, trace_rings
from app.border.union import BLOCK, nearest_of_union
from app.robot.model import RobotModel

Array = np.ndarray

_TOUCHING = 2e-6  # [m] by which flush shapes still count as outside of each other


class OnContour(NamedTuple):
    """A point of a contour.

    Attributes:
        xy: (2,) [m] in the base's frame.
        tangent: (2,) unit vector along the contour, with l_m on its left; turns continuously
            along it.
        ray: [-] where along the contour, in rays, from 0 to `RAYS`; with several shapes that of the
            k-th begins at k `RAYS`.
    """

    xy: Array
    tangent: Array
    ray: float


class Searched(NamedTuple):
    """The first arguments of `app.border.union.nearest_of_union`, in their order."""

    firsts: Array
    heights: Array
    vertices: Array
    tangents: Array
    shown: Array
    reached: Array
    clear: Array
    spans: Array


class Union(NamedTuple):
    """The rings of several shapes as the kernel `app.border.union.nearest_of_union` takes them.

    Attributes:
        firsts: (K + 1,) row of each shape's first ring, and the number of rows.
        heights: (N,) [m] of the rings, ascending for each shape.
        vertices, tangents: (N, RAYS + 1) as x + iy.
        shown: (N, RAYS + 1) [m] by how much the vertices lie outside of the other shapes' offsets.
        spans: (N, RAYS / BLOCK) [m] from the middle vertex of a block of edges to its others.
    """

    firsts: Array
    heights: Array
    vertices: Array
    tangents: Array
    shown: Array
    spans: Array

    def searched(self, reached: Array) -> Searched:
        """For the search, with (N, RAYS + 1) of what is reached."""
        open_ = (self.shown > 0.0) & (reached > 0.0)
        clear = open_[:, :-1] & open_[:, 1:]
        return Searched(*self[:5], reached, clear, self.spans)


class OffsetContours:
    """The contours of the offset of l_m, a union of convex shapes, at each height.

    Each shape has a stack of rings around it, blended vertex by vertex between two heights. The
    contours of one shape are its rings. Those of several are what of the rings lies outside of the
    other shapes' offsets, which may be several islands, and holes.

    Attributes:
        d_b: [m] buffer distance.
        rings: Of each shape that is not hidden in the others, at least one.
        union: The rings of several shapes; None if there is one.
        heights: (H,) [m] of the first shape's rings, ascending, from the floor to its top plus d_b.
        vertices: (H, RAYS + 1, 2) [m] its rings in the base's frame, counter-clockwise, the first
            vertex repeated.
        tables: The same for the kernels.
    """

    def __init__(self, model: RobotModel, d_b: float) -> None:
        """Trace all contours for a buffer distance d_b [m]."""
        self.d_b = d_b
        traced = [(part, trace_rings(part, d_b)) for part in MobileBody(model).parts]
        traced = _outermost([each for each in traced if len(each[1].heights)], d_b)
        self.rings: tuple[Rings, ...] = tuple(rings for _, rings, _ in traced)
        self.union = None
        if len(self.rings) > 1:
            self.union = _union(self.rings, [shown for *_, shown in traced])
        self._searched: Searched | None = None
        if self.union is not None:
            self._searched = self.union.searched(np.ones_like(self.union.shown))
        first = self.rings[0] if self.rings else _NOTHING
        self.tables, self.vertices, self.heights = first.tables, first.vertices, first.heights

    @property
    def is_empty(self) -> bool:
        """Whether l_m has no offset above the floor."""
        return not self.rings

    def within(self, z: float) -> float:
        """[m] the height nearest to z that there is."""
        ends = (min(max(z, float(r.heights[0])), float(r.heights[-1])) for r in self.rings)
        return min(ends, key=lambda end: abs(end - z))

    def contours(self, z: float) -> list[Array]:
        """(K, 2) [m] each, the polygons at a height z [m]: closed ones, or one piece a shape."""
        if self.union is None:
            ring = self.contour(z)
            return [] if ring is None else [ring]
        return self.pieces(z, np.ones_like(self.union.shown))

    def pieces(self, z: float, reached: Array) -> list[Array]:
        """(K, 2) [m] each, the pieces of several shapes' rings that are shown and reached.

        Args:
            z: [m] height.
            reached: (N, RAYS + 1) negative where the arm never is, as the rows of `union`.
        """
        assert self.union is not None
        found: list[Array] = []
        for j, rings in enumerate(self.rings):
            if not rings.heights[0] <= z <= rings.heights[-1]:
                continue
            k, share = contours.place(rings.heights, z)
            rows = int(self.union.firsts[j]) + np.array([k, min(k + 1, len(rings.heights) - 1)])
            weights = np.array([1.0 - share, share])
            open_ = np.minimum(weights @ self.union.shown[rows], weights @ reached[rows])
            found += _pieces(weights @ self.union.vertices[rows], open_)
        return found

    def contour(self, z: float) -> Array | None:
        """(RAYS + 1, 2) [m] the first shape's ring at a height z [m], None where it has none."""
        if not self._has(z):
            return None
        k, share = contours.place(self.heights, z)
        if share == 0.0:
            return self.vertices[k]
        return (1.0 - share) * self.vertices[k] + share * self.vertices[k + 1]

    def nearest(self, p_xy: Array, z: float) -> OnContour | None:
        """The point of the contours at a height that is nearest to p.

        It moves continuously with p, but where p has two nearest points (the medial axis).

        Args:
            p_xy: (2,) [m] in the base's frame.
            z: [m] height above the floor.

        Returns:
            None where there is no contour at that height.
        """
        if self.union is None:
            if not self._has(z):
                return None
            x, y, t_x, t_y, ray = contours.nearest_point(*self.tables, p_xy[0], p_xy[1], z)
            return OnContour(np.array([x, y]), np.array([t_x, t_y]), ray)
        if self.within(z) != z:
            return None
        assert self._searched is not None
        _, ray, x, y, t_x, t_y = nearest_of_union(*self._searched, p_xy[0], p_xy[1], z)
        return OnContour(np.array([x, y]), np.array([t_x, t_y]), ray)

    def at(self, ray: float, z: float) -> OnContour | None:
        """The contour's point at a place along it.

        Args:
            ray: [-] in rays; whole turns do not matter, unless there are several shapes.
            z: [m] height above the floor.

        Returns:
            None where there is no contour at that height.
        """
        shape = 0 if self.union is None else min(int(ray // RAYS), len(self.rings) - 1)
        tables = self.rings[shape].tables if self.rings else self.tables
        if not len(tables.heights) or not tables.heights[0] <= z <= tables.heights[-1]:
            return None
        x, y, t_x, t_y = contours.point_at(*tables, ray, z)
        return OnContour(np.array([x, y]), np.array([t_x, t_y]), ray % (len(self.rings) * RAYS))

    def ray_of(self, points_xy: Array) -> Array:
        """(N,) on which ray of the first shape's lowest ring points (N, 2) [m] lie."""
        return ray_from(points_xy, self.rings[0].centres[0])

    def _has(self, z: float) -> bool:
        return len(self.heights) > 0 and self.heights[0] <= z <= self.heights[-1]


def ray_from(points_xy: Array, centre: Array) -> Array:
    """(N,) on which ray from a centre (2,) [m] points (N, 2) [m] lie, from 0 to `RAYS`."""
    out = points_xy - centre
    return np.arctan2(out[:, 1], out[:, 0]) % (2 * np.pi) * (RAYS / (2 * np.pi))


_NOTHING = Rings(
    np.empty((0, 2)),
    np.empty((0, RAYS + 1, 2)),
    Tables(np.empty(0), np.empty(0, bool), *np.empty((2, 0, RAYS + 1), complex)),
)


def _outermost(
    traced: list[tuple[ConvexPart, Rings]], d_b: float
) -> list[tuple[ConvexPart, Rings, Array]]:
    """The shapes that the others do not hide, the largest in plan first, and how far they show."""
    traced = sorted(traced, key=lambda each: -float(np.prod((each[0].upper - each[0].lower)[:2])))
    kept = list(range(len(traced)))
    for k in reversed(range(len(traced))):  # a shape that hides in the others hides none of them
        others = [traced[j][0] for j in kept if j != k]
        if others and (_shown(traced[k][1], others, d_b) <= 0.0).all():
            kept.remove(k)
    return [
        (*traced[k], _shown(traced[k][1], [traced[j][0] for j in kept if j != k], d_b))
        for k in kept
    ]


def _shown(rings: Rings, others: list[ConvexPart], d_b: float) -> Array:
    """(H, RAYS + 1) [m] by how much the vertices lie outside of the other shapes' offsets."""
    H, V, _ = rings.vertices.shape
    points = np.concatenate(
        [rings.vertices, np.broadcast_to(rings.heights[:, None, None], (H, V, 1))], axis=2
    ).reshape(-1, 3)
    least = np.full(len(points), np.inf)
    for other in others:
        np.minimum(least, other.distances(points), out=least)
    return least.reshape(H, V) - d_b + _TOUCHING


def _union(rings: tuple[Rings, ...], shown: list[Array]) -> Union:
    vertices = np.concatenate([r.tables.vertices for r in rings])
    blocks = np.arange(0, RAYS, BLOCK)[:, None] + np.arange(BLOCK + 1)
    middles = vertices[:, blocks[:, BLOCK // 2]]
    return Union(
        np.cumsum([0, *(len(r.heights) for r in rings)]),
        np.concatenate([r.heights for r in rings]),
        vertices,
        np.concatenate([r.tables.tangents for r in rings]),
        np.concatenate(shown),
        np.abs(vertices[:, blocks] - middles[:, :, None]).max(axis=2),
    )


def _pieces(ring: Array, open_: Array) -> list[Array]:
    """(K, 2) [m] each, where a closed ring (RAYS + 1,) as x + iy has a value of zero or more."""
    if (open_ >= 0.0).all():
        return [np.column_stack([ring.real, ring.imag])]
    turned = int(np.argmin(open_[:-1]))  # begin where it is cut
    ring, open_ = (np.append(np.roll(a[:-1], -turned), a[turned]) for a in (ring, open_))
    found: list[Array] = []
    piece: list[complex] = []
    for i in range(len(ring) - 1):
        a, b = open_[i], open_[i + 1]
        if (a < 0.0) != (b < 0.0):
            crossing = ring[i] + a / (a - b) * (ring[i + 1] - ring[i])
            piece.append(complex(crossing))
        if b >= 0.0:
            piece.append(complex(ring[i + 1]))
        elif piece:
            found.append(np.array([[v.real, v.imag] for v in piece]))
            piece = []
    return found
