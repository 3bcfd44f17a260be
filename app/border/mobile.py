"""Exact distance of points to a convex shape, and to the mobile robot's (DistanceToMobile).

Boxes, spheres, capsules and cylinders are measured by a kernel, with the same answers as by the
collision library, fifty times faster: so a border for another d_b is there at once.
"""

import math

import coal
import numpy as np
import pinocchio as pin

from app.compiled import compiled
from app.robot.model import RobotModel
from app.strict import Array

_BOX, _CAPSULE, _CYLINDER = range(3)
_MAX_NEWTON = 30


class ConvexPart:
    """One convex shape of l_m, fixed in the base's frame."""

    def __init__(self, geometry: coal.CollisionGeometry, placement: pin.SE3) -> None:
        self.lower, self.upper = bounds(geometry, placement)
        """(3,) [m] corners of a box around it, along the base's axes."""
        self._placement, self._measures = placement, _measures(geometry)
        self._T_shape = coal.Transform3s(placement.rotation, placement.translation)
        self._T_point = coal.Transform3s()
        self._request, self._result = coal.DistanceRequest(), coal.DistanceResult()
        # The functor points to its two shapes without owning them: they must live as long as it.
        self._geometry, self._point = geometry, coal.Sphere(0.0)
        self._compute = coal.ComputeDistance(self._geometry, self._point)

    def distance(self, point: Array) -> float:
        """[m] signed distance of a point (3,) [m]."""
        self._T_point.setTranslation(point)
        self._result.clear()
        return self._compute(self._T_shape, self._T_point, self._request, self._result)

    def distance_and_normal(self, point: Array) -> tuple[float, Array]:
        """The same, and the unit vector (3,) from the shape to the point."""
        found = self._distances_and_normals(point[None])[0]
        return found.item(0), found[1:]

    def nearest(self, point: Array) -> Array:
        """(3,) [m] the point of the shape's surface nearest to a point (3,) [m]."""
        d, normal = self.distance_and_normal(point)
        return point - d * normal

    def distances(self, points: Array) -> Array:
        """(N,) [m] signed distances of points (N, 3) [m]."""
        return self._distances_and_normals(points)[:, 0]

    def ray_ends(self, origin: Array, rays: Array, start: Array, d_b: float) -> Array:
        """How far along each ray the shape's offset ends.

        The distance to a convex shape is a convex function along a ray: from any start on the
        rising side Newton's first step lands at the outer root or beyond it, and the next ones come
        down to it.

        Args:
            origin: (3,) [m] from which all rays start.
            rays: (K, 3) unit vectors.
            start: (K,) [m] first guesses, beyond the shape.
            d_b: [m] the offset.

        Returns:
            (K,) [m], minus infinity where a ray misses the offset.
        """
        tolerance = 1e-6 if self._measures is None else 1e-9  # [m] of the distance at a ray's end
        s, ends, left = start.copy(), np.full(len(rays), -np.inf), np.arange(len(rays))
        for _ in range(_MAX_NEWTON):
            found = self._distances_and_normals(origin + s[left, None] * rays[left])
            off, slope = found[:, 0] - d_b, (found[:, 1:] * rays[left]).sum(axis=1)
            there, rising = np.abs(off) < tolerance, slope > 1e-9
            on_border = left[there & (slope >= 0.0)]
            ends[on_border] = s[on_border]
            further = ~there & rising
            left = left[further]
            if not len(left):
                return ends
            s[left] -= off[further] / slope[further]
        ends[left] = s[left]
        return ends

    def _distances_and_normals(self, points: Array) -> Array:
        """(N, 4) signed distances [m] of points (N, 3) [m], and unit vectors to them."""
        if self._measures is not None:
            at = self._placement
            return distances_and_normals(*self._measures, at.rotation, at.translation, points)
        found = np.empty((len(points), 4))
        for row, point in zip(found, points, strict=True):
            row[0], row[1:] = self.distance(point), self._result.normal
        return found


class MobileBody:
    """l_m: a union of convex parts."""

    def __init__(self, model: RobotModel) -> None:
        name = model.description.mobile_body.name
        objects = [model.geometry.geometryObjects[i] for i in model.shape_ids[name]]
        # The planar joint that carries l_m has its frame on the floor: the base's frame.
        self.parts = [ConvexPart(o.geometry, o.placement) for o in objects]
        self.lower = np.min([part.lower for part in self.parts], axis=0)
        self.upper = np.max([part.upper for part in self.parts], axis=0)
        """(3,) [m] corners of a box around it, along the base's axes."""

    def distance(self, points: Array) -> Array:
        """(N,) [m] signed distances of points (N, 3) [m] in the base's frame."""
        return np.array([min(part.distance(p) for part in self.parts) for p in points])


def bounds(geometry: coal.CollisionGeometry, placement: pin.SE3) -> tuple[Array, Array]:
    """(3,) [m] corners of a box around a placed shape: the placed box around the shape."""
    geometry.computeLocalAABB()
    centre = placement.act(geometry.aabb_center)
    box = geometry.aabb_local
    half = np.abs(placement.rotation) @ np.array([box.width(), box.height(), box.depth()]) / 2
    return centre - half, centre + half


def _measures(geometry: coal.CollisionGeometry) -> tuple[int, Array] | None:
    """Kind of a shape of coal's, and its (3,) [m] half sides, or radius and half length.

    None for a shape that the kernel does not know; a sphere is a capsule without length.
    """
    if isinstance(geometry, coal.Box):
        return _BOX, np.array(geometry.halfSide, dtype=float)
    if isinstance(geometry, coal.Sphere):
        return _CAPSULE, np.array([geometry.radius, 0.0, 0.0])
    if isinstance(geometry, coal.Capsule):
        return _CAPSULE, np.array([geometry.radius, geometry.halfLength, 0.0])
    if isinstance(geometry, coal.Cylinder):
        return _CYLINDER, np.array([geometry.radius, geometry.halfLength, 0.0])
    return None


@compiled()
def _signed_distance(
    kind: int, size: Array, x: float, y: float, z: float
) -> tuple[float, float, float, float]:
    """Signed distance [m] of a point in the shape's frame, and its gradient there."""
    if kind == _CAPSULE:
        z_out = z - min(max(z, -size[1]), size[1])
        far = math.sqrt(x * x + y * y + z_out * z_out)
        if far == 0.0:
            return -size[0], 1.0, 0.0, 0.0
        return far - size[0], x / far, y / far, z_out / far
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


@compiled("f8[:,::1](i8, f8[:], f8[:,:], f8[:], f8[:,:])")
def distances_and_normals(kind: int, size: Array, R: Array, p: Array, points: Array) -> Array:
    """(N, 4) signed distances [m] and their gradients, of points (N, 3) [m] to a shape.

    Its kind and size are those of `_measures`, its axes are R (3, 3), its origin is p (3,) [m].
    """
    found = np.empty((len(points), 4))
    at = np.empty(3)  # in the shape's frame
    for k in range(len(points)):
        for i in range(3):
            at[i] = 0.0
            for j in range(3):
                at[i] += R[j, i] * (points[k, j] - p[j])
        found[k, 0], n_x, n_y, n_z = _signed_distance(kind, size, at[0], at[1], at[2])
        for j in range(3):
            found[k, 1 + j] = R[j, 0] * n_x + R[j, 1] * n_y + R[j, 2] * n_z
    return found
