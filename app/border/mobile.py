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
        self.placed = _placed(geometry, placement)
        """(1, 16) of `distances_and_normals`; None for a shape that only the library knows."""
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
        tolerance = 1e-6 if self.placed is None else 1e-9  # [m] of the distance at a ray's end
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
        if self.placed is not None:
            return distances_and_normals(self.placed, points)
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


def _placed(geometry: coal.CollisionGeometry, placement: pin.SE3) -> Array | None:
    """Kind of a shape of coal's, half sides or radius and half length (3,) [m], axes, origin [m].

    None for a shape that the kernels do not know; a sphere is a capsule without length.
    """
    if isinstance(geometry, coal.Box):
        kind, size = _BOX, geometry.halfSide
    elif isinstance(geometry, coal.Sphere):
        kind, size = _CAPSULE, (geometry.radius, 0.0, 0.0)
    elif isinstance(geometry, coal.Capsule | coal.Cylinder):
        kind = _CAPSULE if isinstance(geometry, coal.Capsule) else _CYLINDER
        size = (geometry.radius, geometry.halfLength, 0.0)
    else:
        return None
    return np.concatenate([[kind], size, placement.rotation.ravel(), placement.translation])[None]


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


@compiled()
def _nearest_of(shapes: Array, x: float, y: float, z: float) -> tuple[float, float, float, float]:
    """Signed distance [m] of a point to the nearest of some shapes, and its gradient there."""
    best = (np.inf, 0.0, 0.0, 0.0)
    for k in range(len(shapes)):
        R, a, b, c = shapes[k, 4:13], x - shapes[k, 13], y - shapes[k, 14], z - shapes[k, 15]
        d, n_x, n_y, n_z = _signed_distance(
            int(shapes[k, 0]),
            shapes[k, 1:4],
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


@compiled("f8[:,::1](f8[:,:], f8[:,:])")
def distances_and_normals(shapes: Array, points: Array) -> Array:
    """(N, 4) signed distances [m] of points (N, 3) [m] to the nearest of shapes, and gradients.

    A shape's row of (P, 16) has its kind, its size, its axes as R (3, 3), and its origin [m].
    """
    found = np.empty((len(points), 4))
    for k in range(len(points)):
        found[k] = _nearest_of(shapes, points[k, 0], points[k, 1], points[k, 2])
    return found


@compiled()
def _act(R: Array, p: Array, x: float, y: float, z: float) -> tuple[float, float, float]:
    """R (x, y, z) + p."""
    return (
        p[0] + R[0, 0] * x + R[0, 1] * y + R[0, 2] * z,
        p[1] + R[1, 0] * x + R[1, 1] * y + R[1, 2] * z,
        p[2] + R[2, 0] * x + R[2, 1] * y + R[2, 2] * z,
    )


@compiled("f8[:,::1](f8[:,:], f8[:,:], f8[:,:], f8[:,:], f8[:,:], f8[:], f8[:,:], f8[:], f8)")
def mean_nearest(
    shapes: Array,
    corners: Array,
    nodes: Array,
    faces: Array,
    R_a: Array,
    p_a: Array,
    R_b: Array,
    p_b: Array,
    blend: float,
) -> Array:
    """(4, 3) points of two bodies, the normal, and the point of the second's core: `SmoothPoint`.

    Args:
        shapes: (P, 16) of body `a`, as of `distances_and_normals`.
        corners: (C, 3) [m] of body `a`.
        nodes: (K, 4) [m] of body `b` and their radii.
        faces: (F, 16) shapes of body `b` that are nearest to a corner of `a` anywhere.
        R_a: (3, 3) axes of `a`.
        p_a: (3,) [m] origin of `a`.
        R_b: (3, 3) axes of `b`.
        p_b: (3,) [m] origin of `b`.
        blend: [m] τ.
    """
    count, size = len(nodes), len(nodes) + len(faces) * len(corners)
    at, d, R, none = np.empty((size, 3)), np.empty(size), np.empty((3, 3)), np.zeros(3)
    for i in range(3):  # of b, as a sees it
        R[:, i] = _act(R_a.T, none, R_b[0, i], R_b[1, i], R_b[2, i])
    p = np.array(_act(R_a.T, none, p_b[0] - p_a[0], p_b[1] - p_a[1], p_b[2] - p_a[2]))
    for k in range(size):
        radius = 0.0
        if k < count:
            at[k], radius = _act(R, p, nodes[k, 0], nodes[k, 1], nodes[k, 2]), nodes[k, 3]
        else:
            f, c = divmod(k - count, len(corners))
            x, y, z = corners[c, 0] - p[0], corners[c, 1] - p[1], corners[c, 2] - p[2]
            x, y, z = _act(R.T, none, x, y, z)
            d_c, n_x, n_y, n_z = _nearest_of(faces[f : f + 1], x, y, z)
            at[k] = _act(R, p, x - d_c * n_x, y - d_c * n_y, z - d_c * n_z)
        d[k] = _nearest_of(shapes, at[k, 0], at[k, 1], at[k, 2])[0] - radius
    weights = np.exp((d.min() - d) / blend)
    weights /= weights.sum()
    x = y = z = radius = 0.0
    for k in range(size):
        x, y, z = x + weights[k] * at[k, 0], y + weights[k] * at[k, 1], z + weights[k] * at[k, 2]
        radius += weights[k] * (nodes[k, 3] if k < count else 0.0)
    nearest, total, found = _nearest_of(shapes, x, y, z)[0], 0.0, np.zeros((4, 3))
    for k in range(len(shapes)):
        d_k, n_x, n_y, n_z = _nearest_of(shapes[k : k + 1], x, y, z)
        weight, n = math.exp((nearest - d_k) / blend), np.array(_act(R_a, none, n_x, n_y, n_z))
        total += weight
        found[0] -= weight * d_k * n
        found[2] += weight * n
    found[3] = _act(R_a, p_a, x, y, z)
    found[2] /= total
    found[0], found[1] = found[3] + found[0] / total, found[3] - radius * found[2]
    return found
