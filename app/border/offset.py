"""The exact offset of the mobile robot, {p : distance to l_m = d_b}, as horizontal contours.

It stands in wherever the border's cloud has no point at a height: never an empty slice, never a
zero force.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from app.border.contours import BLOCK, nearest_point
from app.border.mobile import ConvexPart, MobileBody
from app.border.rings import RAYS, Rings, trace_rings
from app.robot.model import RobotModel

Array = np.ndarray

_TOUCHING = 2e-6  # [m] by which flush shapes still count as outside of each other
_ALONE = 1.0  # [m] by which a shape counts as outside of others where there is none


class OnContour(NamedTuple):
    """A point of a contour, in the base's frame.

    Attributes:
        xy: (2,) [m].
        tangent: (2,) unit vector along the contour, with l_m on its left; turns continuously
            along it.
    """

    xy: Array
    tangent: Array


class Searched(NamedTuple):
    """The first arguments of `app.border.contours.nearest_point`, in their order."""

    firsts: Array
    heights: Array
    vertices: Array
    tangents: Array
    shown: Array
    reached: Array
    clear: Array
    spans: Array


class Contours(NamedTuple):
    """The rings of all shapes as the kernel `app.border.contours.nearest_point` takes them.

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
    contours are what of the rings lies outside of the other shapes' offsets: one closed curve of a
    single shape, else maybe several islands, and holes.

    Attributes:
        d_b: [m] buffer distance.
        rings: Of each shape that is not hidden in the others, the largest in plan first; none if
            l_m has no offset above the floor.
        table: The same for the search.
    """

    def __init__(self, model: RobotModel, d_b: float) -> None:
        """Trace all contours for a buffer distance d_b [m]."""
        self.d_b = d_b
        traced = [(part, trace_rings(part, d_b)) for part in MobileBody(model).parts]
        traced = _outermost([each for each in traced if len(each[1].heights)], d_b)
        self.rings: tuple[Rings, ...] = tuple(rings for _, rings, _ in traced)
        self.table = _table(self.rings, [shown for *_, shown in traced])
        self._searched = self.table.searched(np.ones_like(self.table.shown))

    @property
    def is_empty(self) -> bool:
        """Whether l_m has no offset above the floor."""
        return not self.rings

    def within(self, z: float) -> float:
        """[m] the height nearest to z that there is."""
        ends = (min(max(z, float(r.heights[0])), float(r.heights[-1])) for r in self.rings)
        return min(ends, key=lambda end: abs(end - z))

    def contours(self, z: float, reached: Array | None = None) -> list[Array]:
        """(K, 2) [m] each, the polygons at a height: closed ones, or the open pieces of each ring.

        Args:
            z: [m] height.
            reached: (N, RAYS + 1) negative where the arm never is, as the rows of `table`; if it is
                not given, the arm is everywhere.
        """
        found: list[Array] = []
        for j, rings in enumerate(self.rings):
            if not rings.heights[0] <= z <= rings.heights[-1]:
                continue
            k = min(int(np.searchsorted(rings.heights, z, "right")) - 1, len(rings.heights) - 2)
            share = (z - rings.heights[k]) / (rings.heights[k + 1] - rings.heights[k])
            rows, weights = int(self.table.firsts[j]) + k + np.arange(2), (1.0 - share, share)
            open_ = weights @ self.table.shown[rows]
            if reached is not None:
                open_ = np.minimum(open_, weights @ reached[rows])
            found += _pieces(weights @ self.table.vertices[rows], open_)
        return found

    def nearest(self, p_xy: Array, z: float) -> OnContour | None:
        """The point of the contours at a height that is nearest to p.

        It moves continuously with p, but where p has two nearest points (the medial axis).

        Args:
            p_xy: (2,) [m] in the base's frame.
            z: [m] height above the floor.

        Returns:
            None where there is no contour at that height.
        """
        if self.is_empty or self.within(z) != z:
            return None
        _, _, x, y, t_x, t_y = nearest_point(*self._searched, np.array([p_xy[0], p_xy[1], z]))
        return OnContour(np.array([x, y]), np.array([t_x, t_y]))


def ray_from(points_xy: Array, centre: Array) -> Array:
    """(N,) on which ray from a centre (2,) [m] points (N, 2) [m] lie, from 0 to `RAYS`."""
    out = points_xy - centre
    return np.arctan2(out[:, 1], out[:, 0]) % (2 * np.pi) * (RAYS / (2 * np.pi))


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
    least = np.full(len(points), d_b + _ALONE)
    for other in others:
        np.minimum(least, other.distances(points), out=least)
    return least.reshape(H, V) - d_b + _TOUCHING


def _table(rings: tuple[Rings, ...], shown: list[Array]) -> Contours:
    none = np.empty((0, RAYS + 1))
    corners = np.concatenate([np.empty((0, RAYS + 1, 2)), *(r.vertices for r in rings)])
    vertices = corners[..., 0] + 1j * corners[..., 1]
    blocks = np.arange(0, RAYS, BLOCK)[:, None] + np.arange(BLOCK + 1)
    middles = vertices[:, blocks[:, BLOCK // 2]]
    return Contours(
        np.cumsum([0, *(len(r.heights) for r in rings)]),
        np.concatenate([none[:, 0], *(r.heights for r in rings)]),
        vertices,
        np.concatenate([none.astype(complex), *(r.tangents for r in rings)]),
        np.concatenate([none, *shown]),
        np.abs(vertices[:, blocks] - middles[:, :, None]).max(axis=2, initial=0.0),
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
