"""The exact offset of the mobile robot, {p : distance to l_m = d_b}, as horizontal contours.

It stands in wherever the border's cloud has no point at a height: never an empty slice, never a
zero force.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from app.border import contours
from app.border.mobile import ConvexPart, MobileBody
from app.border.ray_ends import ray_ends
from app.robot.model import RobotModel

Array = np.ndarray

RAYS = 360
_STEP = 0.01  # [m] between heights, and along the arc above the top
_TOLERANCE = 1e-6  # [m] of the distance on a contour
_MAX_NEWTON = 30


class OnContour(NamedTuple):
    """A point of a contour.

    Attributes:
        xy: (2,) [m] in the base's frame.
        tangent: (2,) unit vector along the contour, counter-clockwise from above; turns
            continuously along it.
        ray: [-] where along the contour, in rays, from 0 to `RAYS`.
    """

    xy: Array
    tangent: Array
    ray: float


class Tables(NamedTuple):
    """The contours as the kernels of `app.border.contours` take them.

    Attributes:
        heights: (H,) [m], ascending.
        same: (H - 1,) whether a contour equals the next one above.
        vertices: (H, RAYS + 1) as x + iy [m].
        tangents: (H, RAYS + 1) unit tangents at the vertices.
    """

    heights: Array
    same: Array
    vertices: Array
    tangents: Array


class OffsetContours:
    """Closed polygons around l_m, one a height, each vertex at the distance d_b.

    Vertices stand on rays from a centre of l_m. Where l_m is not star-shaped in plan, what the rays
    do not see is bridged: the contour is then its outer hull along the rays. Between two heights
    the polygons are blended vertex by vertex.

    Attributes:
        d_b: [m] buffer distance.
        heights: (H,) [m] of the polygons, ascending from the floor to l_m's top plus d_b.
        vertices: (H, RAYS + 1, 2) [m] in the base's frame, counter-clockwise, the first one
            repeated.
        tables: The same for the kernels.
    """

    def __init__(self, model: RobotModel, d_b: float) -> None:
        """Trace all contours for a buffer distance d_b [m]."""
        self.d_b = d_b
        body = MobileBody(model)
        angles = np.linspace(0.0, 2 * np.pi, RAYS, endpoint=False)
        rays = np.column_stack([np.cos(angles), np.sin(angles)])
        centre = self._centre = _centre(body)
        heights, rings = [], []
        ends = [None] * len(body.parts)
        for z in _levels(float(body.upper[2]), d_b):
            ends = [
                _ray_ends(part, centre, rays, float(z), d_b, start)
                for part, start in zip(body.parts, ends, strict=True)
            ]
            outermost = np.max(ends, axis=0)
            if not np.isfinite(outermost).all():
                continue
            ring = centre + outermost[:, None] * rays
            heights.append(z)
            rings.append(np.concatenate([ring, ring[:1]]))
        self.heights = np.array(heights)
        self.vertices = np.array(rings)
        corners = self.vertices[..., 0] + 1j * self.vertices[..., 1]
        # Beside upright walls polygons repeat and need no blending.
        same = (self.vertices[1:] == self.vertices[:-1]).all(axis=(1, 2))
        self.tables = Tables(
            self.heights, same, corners, _vertex_tangents(np.diff(corners, axis=1))
        )

    def within(self, z: float) -> float:
        """[m] the height nearest to z that there is."""
        return min(max(z, float(self.heights[0])), float(self.heights[-1]))

    def contour(self, z: float) -> Array | None:
        """(RAYS + 1, 2) [m] closed polygon at a height z [m], or None where there is none."""
        at = self.place(z)
        if at is None:
            return None
        k, share = at
        if share == 0.0:
            return self.vertices[k]
        return (1.0 - share) * self.vertices[k] + share * self.vertices[k + 1]

    def nearest(self, p_xy: Array, z: float) -> OnContour | None:
        """The point of the contour at a height that is nearest to p.

        It moves continuously with p, but where p has two nearest points (the medial axis).

        Args:
            p_xy: (2,) [m] in the base's frame.
            z: [m] height above the floor.

        Returns:
            None where there is no contour at that height.
        """
        if not self._has(z):
            return None
        x, y, t_x, t_y, ray = contours.nearest_point(*self.tables, p_xy[0], p_xy[1], z)
        return OnContour(np.array([x, y]), np.array([t_x, t_y]), ray)

    def at(self, ray: float, z: float) -> OnContour | None:
        """The contour's point at a place along it.

        Args:
            ray: [-] in rays; whole turns do not matter.
            z: [m] height above the floor.

        Returns:
            None where there is no contour at that height.
        """
        if not self._has(z):
            return None
        x, y, t_x, t_y = contours.point_at(*self.tables, ray, z)
        return OnContour(np.array([x, y]), np.array([t_x, t_y]), ray % RAYS)

    def ray_of(self, points_xy: Array) -> Array:
        """(N,) on which ray points (N, 2) [m] lie, from 0 to `RAYS`."""
        out = points_xy - self._centre
        return np.arctan2(out[:, 1], out[:, 0]) % (2 * np.pi) * (RAYS / (2 * np.pi))

    def place(self, z: float) -> tuple[int, float] | None:
        """Index of the polygon at or below a height [m], and how far up to the next one, [0, 1).

        None where there is no contour.
        """
        return contours.place(self.heights, z) if self._has(z) else None

    def _has(self, z: float) -> bool:
        return len(self.heights) > 0 and self.heights[0] <= z <= self.heights[-1]


def _vertex_tangents(edges: Array) -> Array:
    """Unit tangents at the vertices, as x + iy: between those of the two edges there.

    Args:
        edges: (H, RAYS).

    Returns:
        (H, RAYS + 1), the first one repeated.
    """
    directions = edges / np.abs(edges)
    tangents = directions + np.roll(directions, 1, axis=1)
    tangents /= np.abs(tangents)
    return np.concatenate([tangents, tangents[:, :1]], axis=1)


def _centre(body: MobileBody) -> Array:
    """(2,) [m] the point in plan from which the rays start: inside of the largest part's box."""
    part = max(body.parts, key=lambda p: float(np.prod((p.upper - p.lower)[:2])))
    return (part.lower[:2] + part.upper[:2]) / 2


def _levels(top: float, d_b: float) -> Array:
    """(H,) [m] heights: every 10 mm beside l_m, then every 10 mm of arc over its upper edge."""
    beside = np.linspace(0.0, top, max(2, int(np.ceil(top / _STEP)) + 1))
    arc = np.linspace(0.0, np.pi / 2, int(np.ceil(d_b * np.pi / 2 / _STEP)) + 1)[1:]
    # At the very end the contour lies on the flat of the offset, where rays graze: stop just short.
    arc[-1] -= 1e-3
    return np.concatenate([beside, top + d_b * np.sin(arc)])


def _ray_ends(
    part: ConvexPart, centre: Array, rays: Array, z: float, d_b: float, start: Array | None
) -> Array:
    """(RAYS,) [m] how far along each ray the offset of one part ends; −inf where it misses it."""
    outside = float(np.abs(np.concatenate([part.lower, part.upper])[[0, 1, 3, 4]]).max())
    beyond = 2 * (outside + d_b + float(np.abs(centre).max()))
    first = np.full(len(rays), beyond)
    if start is not None:
        first = np.where(np.isfinite(start), start, beyond)
    origin = np.array([centre[0], centre[1], z])
    if part.measures is not None:
        at = part.placement
        return ray_ends(*part.measures, at.rotation, at.translation, rays, origin, first, d_b)
    pairs = zip(rays.tolist(), first.tolist(), strict=True)
    return np.array([_newton(part, origin, ray, s, d_b) for ray, s in pairs])


def _newton(part: ConvexPart, origin: Array, ray: Sequence[float], s: float, d_b: float) -> float:
    """`app.border.ray_ends.ray_ends` for one ray and any convex part."""
    point = origin.copy()
    for _ in range(_MAX_NEWTON):
        point[0], point[1] = origin[0] + s * ray[0], origin[1] + s * ray[1]
        d, normal = part.distance_and_normal(point)
        slope = normal[0] * ray[0] + normal[1] * ray[1]
        if abs(d - d_b) < _TOLERANCE:
            return s if slope >= 0.0 else -np.inf
        if slope <= 1e-9:
            return -np.inf
        s -= (d - d_b) / slope
    return s
