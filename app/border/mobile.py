"""Exact distance of points to a convex shape, and to the mobile base (DistanceToMobile).

The distances are those of the collision library. For boxes and round shapes, these compiled
functions are much faster than the library.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import coal
import numpy as np
import pinocchio as pin

from app.compiled import compiled
from app.robot.model import RobotModel
from app.strict import Array

_BOX, _CAPSULE, _CYLINDER, _HULL = range(4)
_FLAT = 1e-9  # [m] tolerance for points in a plane


class ConvexPart(NamedTuple):
    """One convex shape of l_m, in the base's frame."""

    shapes: Shapes  # only this shape
    lower: Array  # (3,) [m] lowest corner of the box of `bounds` around the shape
    upper: Array  # (3,) [m] highest corner of this box

    @classmethod
    def of(cls, geometry: coal.CollisionGeometry, placement: pin.SE3) -> ConvexPart:
        """The part with one shape of coal, placed at `placement` in the base's frame."""
        return cls(Shapes.of(geometry, placement), *bounds(geometry, placement))


class MobileBody:
    """l_m: its convex `parts`; `lower` and `upper` (3,) [m] are corners of a box around them."""

    def __init__(self, model: RobotModel) -> None:
        name = model.description.mobile_body.name
        # The frame of the planar joint of l_m, on the floor, is the base's frame.
        objects = [model.geometry.geometryObjects[i] for i in model.shape_ids[name]]
        self.parts = [ConvexPart.of(each.geometry, each.placement) for each in objects]
        self.lower = np.min([part.lower for part in self.parts], axis=0)
        self.upper = np.max([part.upper for part in self.parts], axis=0)
        self._shapes = Shapes.together([part.shapes for part in self.parts])

    def distance(self, points: Array) -> Array:
        """(N,) [m] signed distances of points (N, 3) [m] in the base's frame."""
        return self._shapes.distances_and_normals(points)[:, 0]


def bounds(geometry: coal.CollisionGeometry, placement: pin.SE3) -> tuple[Array, Array]:
    """The lowest and the highest corner (3,) [m] of an axis-aligned box around a placed shape."""
    geometry.computeLocalAABB()
    centre = placement.act(geometry.aabb_center)
    box = geometry.aabb_local
    half = np.abs(placement.rotation) @ np.array([box.width(), box.height(), box.depth()]) / 2
    return centre - half, centre + half


class Shapes(NamedTuple):
    """Convex shapes in the format of the compiled functions."""

    rows: Array
    """(P, 16) kind (1); size (3): half sides [m], or radius and half length [m], or the first index
    of a hull's triangles and the index after the last; R (9); origin [m] (3). A sphere is a capsule
    without length."""
    triangles: Array
    """(T, 4, 3) triangles of the hulls: three corners [m] and the outward unit normal, in the
    hull's frame."""

    @classmethod
    def of(cls, geometry: coal.CollisionGeometry, placement: pin.SE3) -> Shapes:
        """One shape of coal, placed at `placement` in the frame of the shapes."""
        triangles = np.empty((0, 4, 3))
        if isinstance(geometry, coal.Box):
            kind, size = _BOX, geometry.halfSide
        elif isinstance(geometry, coal.Sphere):
            kind, size = _CAPSULE, (geometry.radius, 0.0, 0.0)
        elif isinstance(geometry, coal.Capsule | coal.Cylinder):
            kind = _CAPSULE if isinstance(geometry, coal.Capsule) else _CYLINDER
            size = (geometry.radius, geometry.halfLength, 0.0)
        else:
            triangles = _triangles(geometry)
            kind, size = _HULL, (0, len(triangles), 0)
        row = np.concatenate([[kind], size, placement.rotation.ravel(), placement.translation])
        return cls(row[None], triangles)

    @classmethod
    def together(cls, shapes: Sequence[Shapes]) -> Shapes:
        """The shapes of several `Shapes` in one, in their order."""
        rows = np.concatenate([np.empty((0, 16)), *(each.rows for each in shapes)])
        triangles = np.concatenate([np.empty((0, 4, 3)), *(each.triangles for each in shapes)])
        firsts = np.cumsum([0, *(len(each.triangles) for each in shapes)])[:-1]
        before = np.repeat(firsts, [len(each.rows) for each in shapes])
        rows[:, 1:3] += np.where(rows[:, 0] == _HULL, before, 0)[:, None]
        return cls(rows, triangles)

    def distances_and_normals(self, points: Array) -> Array:
        """(N, 4) signed distances [m] of points (N, 3) [m] to the nearest shape, with gradients."""
        return _distances_and_normals(*self, points)


def _triangles(geometry: coal.CollisionGeometry) -> Array:
    """The `triangles` of a hull, without very thin ones: rounding makes their normals wrong."""
    points = geometry.points()
    found = (geometry.polygons(i) for i in range(geometry.num_polygons))
    corners = points[[[each[k] for k in range(3)] for each in found]]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    with np.errstate(invalid="ignore"):  # triangles without an area get NaN, and are left out
        normals /= np.linalg.norm(normals, axis=1)[:, None]
    offsets = (normals * corners[:, 0]).sum(axis=1)
    outermost = np.array([(points @ n).max() for n in normals])
    return np.concatenate([corners, normals[:, None]], axis=1)[outermost - offsets < _FLAT]


@compiled()
def _on_triangle(
    triangle: Array, x: float, y: float, z: float, over: float
) -> tuple[float, float, float]:
    """The point of a triangle nearest to P = (x, y, z); P is `over` [m] above its plane."""
    n, foot, square = triangle[3], (0.0, 0.0, 0.0), np.inf
    f_x, f_y, f_z = x - over * n[0], y - over * n[1], z - over * n[2]
    for i in range(3):
        a, b = triangle[i], triangle[(i + 1) % 3]
        u, v, w = b[0] - a[0], b[1] - a[1], b[2] - a[2]
        p, q, r = f_x - a[0], f_y - a[1], f_z - a[2]
        if n[0] * (v * r - w * q) + n[1] * (w * p - u * r) + n[2] * (u * q - v * p) >= 0.0:
            continue  # on the inner side of this edge
        share = min(max((u * p + v * q + w * r) / (u * u + v * v + w * w), 0.0), 1.0)
        p, q, r = p - share * u, q - share * v, r - share * w
        if p * p + q * q + r * r < square:
            square = p * p + q * q + r * r
            foot = (f_x - p, f_y - q, f_z - r)
    return foot if square < np.inf else (f_x, f_y, f_z)


@compiled()
def _over(triangle: Array, x: float, y: float, z: float) -> float:
    """[m] signed distance of (x, y, z) [m] from the plane of a triangle of `Shapes`."""
    a, n = triangle[0], triangle[3]
    return n[0] * (x - a[0]) + n[1] * (y - a[1]) + n[2] * (z - a[2])


@compiled()
def _reach(triangle: Array, p: float, q: float, r: float) -> float:
    """The largest scalar product of (p, q, r) with a corner of a triangle of `Shapes`."""
    a, b, c = triangle[0], triangle[1], triangle[2]
    return max(
        a[0] * p + a[1] * q + a[2] * r,
        max(b[0] * p + b[1] * q + b[2] * r, c[0] * p + c[1] * q + c[2] * r),
    )


_Signed = tuple[float, float, float, float]  # a signed distance [m], and its gradient (3)


@compiled()
def _hull_distance(triangles: Array, x: float, y: float, z: float) -> _Signed:
    """Signed distance [m] of (x, y, z) [m] to a hull (inside: to the nearest plane), gradient."""
    deepest, face = -np.inf, 0
    for k in range(len(triangles)):
        over = _over(triangles[k], x, y, z)
        if over > deepest:
            deepest, face = over, k
    n = triangles[face, 3]
    if deepest <= 0.0:
        return deepest, n[0], n[1], n[2]
    u, v, w = _on_triangle(triangles[face], x, y, z, deepest)
    p, q, r = x - u, y - v, z - w
    level, square = p * u + q * v + r * w, p * p + q * q + r * r
    # Only a triangle with a corner beyond the plane through (u, v, w), perpendicular to the line to
    # (x, y, z), can be nearer.
    for k in range(len(triangles)):
        if _reach(triangles[k], p, q, r) <= level:
            continue
        a, b, c = _on_triangle(triangles[k], x, y, z, _over(triangles[k], x, y, z))
        far = (x - a) ** 2 + (y - b) ** 2 + (z - c) ** 2
        if far < square:
            p, q, r = x - a, y - b, z - c
            level, square = p * a + q * b + r * c, far
    far = math.sqrt(square)
    if far < _FLAT:
        return far, n[0], n[1], n[2]
    return far, p / far, q / far, r / far


@compiled()
def _distance(kind: int, size: Array, triangles: Array, x: float, y: float, z: float) -> _Signed:
    """Signed distance [m] of (x, y, z) [m] to a shape, and its gradient, in the shape's frame."""
    if kind == _CAPSULE:
        z_out = z - min(max(z, -size[1]), size[1])
        far = math.sqrt(x * x + y * y + z_out * z_out)
        if far == 0.0:
            return -size[0], 1.0, 0.0, 0.0
        return far - size[0], x / far, y / far, z_out / far
    if kind == _HULL:
        return _hull_distance(triangles[int(size[0]) : int(size[1])], x, y, z)
    if kind == _CYLINDER:
        rho = math.hypot(x, y)
        e_x, e_y = (x / rho, y / rho) if rho > 0.0 else (1.0, 0.0)
        out, over = rho - size[0], abs(z) - size[1]
        up = math.copysign(1.0, z)
        if out <= 0.0 or over <= 0.0:
            return (out, e_x, e_y, 0.0) if out >= over else (over, 0.0, 0.0, up)
        far = math.hypot(out, over)
        return far, e_x * out / far, e_y * out / far, up * over / far
    a, b, c = abs(x) - size[0], abs(y) - size[1], abs(z) - size[2]
    s_x, s_y, s_z = math.copysign(1.0, x), math.copysign(1.0, y), math.copysign(1.0, z)
    if max(a, b, c) <= 0.0:
        if a >= b and a >= c:
            return a, s_x, 0.0, 0.0
        return (b, 0.0, s_y, 0.0) if b >= c else (c, 0.0, 0.0, s_z)
    a, b, c = max(a, 0.0), max(b, 0.0), max(c, 0.0)
    far = math.sqrt(a * a + b * b + c * c)
    return far, s_x * a / far, s_y * b / far, s_z * c / far


@compiled()
def nearest_of(shapes: Array, triangles: Array, x: float, y: float, z: float) -> _Signed:
    """Signed distance [m] of (x, y, z) [m] to the nearest shape, and its gradient (3); `shapes` are
    `Shapes.rows`, `triangles` are `Shapes.triangles`.
    """
    best = (np.inf, 0.0, 0.0, 0.0)
    for k in range(len(shapes)):
        R, a, b, c = shapes[k, 4:13], x - shapes[k, 13], y - shapes[k, 14], z - shapes[k, 15]
        d, n_x, n_y, n_z = _distance(
            int(shapes[k, 0]),
            shapes[k, 1:4],
            triangles,
            R[0] * a + R[3] * b + R[6] * c,
            R[1] * a + R[4] * b + R[7] * c,
            R[2] * a + R[5] * b + R[8] * c,
        )
        if d < best[0]:
            best = (
                d,
                R[0] * n_x + R[1] * n_y + R[2] * n_z,
                R[3] * n_x + R[4] * n_y + R[5] * n_z,
                R[6] * n_x + R[7] * n_y + R[8] * n_z,
            )
    return best


@compiled()
def is_round(row: Array) -> bool:
    """Whether the shape in a row (16,) of `Shapes` is a capsule or a sphere."""
    return bool(row[0] == _CAPSULE)


@compiled("f8[:,::1](f8[:,:], f8[:,:,:], f8[:,:])")
def _distances_and_normals(rows: Array, triangles: Array, points: Array) -> Array:
    found = np.empty((len(points), 4))
    for k in range(len(points)):
        nearest = nearest_of(rows, triangles, points[k, 0], points[k, 1], points[k, 2])
        found[k, 0], found[k, 1], found[k, 2], found[k, 3] = nearest
    return found


@compiled()
def act(R: Array, p: Array, x: float, y: float, z: float) -> tuple[float, float, float]:
    """R (x, y, z) + p, for a rotation R (3, 3) and a translation p (3,)."""
    return (
        p[0] + R[0, 0] * x + R[0, 1] * y + R[0, 2] * z,
        p[1] + R[1, 0] * x + R[1, 1] * y + R[1, 2] * z,
        p[2] + R[2, 0] * x + R[2, 1] * y + R[2, 2] * z,
    )
