"""Distances and the border for the oracle: plain numpy, on boxes, capsules and spheres."""

from __future__ import annotations

from functools import lru_cache
from itertools import product
from typing import NamedTuple

import coal
import numpy as np
import pinocchio as pin

from app.robot.model import RobotModel
from app.robot.shapes import Box, Capsule, Shape, Sphere

Array = np.ndarray
Placed = tuple[Shape, pin.SE3]
"""A shape and its placement."""


def signed_distance(placed: Placed, p: Array) -> tuple[Array, Array]:
    """Distances (…) [m] of points (…, 3) [m] to a shape, negative inside; gradients (…, 3)."""
    shape, T = placed
    x = (p - T.translation) @ T.rotation
    if isinstance(shape, Box):
        out = np.abs(x) - np.array(shape.size_m) / 2
        deepest, beyond = out.max(axis=-1), np.maximum(out, 0.0)
        length = np.linalg.norm(beyond, axis=-1)
        inside = deepest <= 0.0
        d = np.where(inside, deepest, length)
        face = np.eye(3)[out.argmax(axis=-1)]
        away = np.where(inside[..., None], face, beyond / np.where(inside, 1.0, length)[..., None])
        return d, (np.copysign(1.0, x) * away) @ T.rotation.T
    assert isinstance(shape, Capsule | Sphere), "the oracle knows boxes, capsules and spheres"
    half = shape.length_m / 2 if isinstance(shape, Capsule) else 0.0
    axis = x.copy()
    axis[..., :2], axis[..., 2] = 0.0, np.clip(x[..., 2], -half, half)
    far = np.linalg.norm(x - axis, axis=-1)
    return far - shape.radius_m, ((x - axis) / far[..., None]) @ T.rotation.T


class Body:
    """A body of one or several convex shapes, moved by one joint."""

    def __init__(self, model: RobotModel, name: str) -> None:
        self.name, self.joint = name, model.body_joints[name]
        objects = [model.geometry.geometryObjects[i] for i in model.shape_ids[name]]
        shapes = model.description.body(name).shapes
        self._shapes = [(s, o.placement) for s, o in zip(shapes, objects, strict=True)]
        self.geometries = [each.geometry for each in objects]

    def shapes(self, T: pin.SE3) -> list[Placed]:
        """Its shapes, with the joint at T."""
        return [(shape, T * placement) for shape, placement in self._shapes]

    def placed(self, T: pin.SE3) -> list[tuple[coal.CollisionGeometry, Placed]]:
        """Its shapes with the joint at T, each with coal's geometry."""
        return list(zip(self.geometries, self.shapes(T), strict=True))

    def core(self, T: pin.SE3) -> tuple[Array, Array]:
        """Core points (K, 3) [m] with the joint at T, and radii (K,) [m]; see docs/method.md."""
        nodes, radii = [], []
        for shape, placement in self.shapes(T):
            if isinstance(shape, Box):
                corners = np.array(list(product((-0.5, 0.5), repeat=3))) * shape.size_m
                radius = 0.0
            else:
                assert isinstance(shape, Capsule | Sphere)
                half = shape.length_m / 2 if isinstance(shape, Capsule) else 0.0
                corners = np.linspace(-half, half, 7 if half else 1)[:, None] * [0.0, 0.0, 1.0]
                radius = shape.radius_m
            nodes += [placement.act(corner) for corner in corners]
            radii += [radius] * len(corners)
        return np.array(nodes), np.array(radii)


def closest_points(
    a: list[Placed], corners: Array, b: list[Placed], core: tuple[Array, Array], blend: float
) -> Array:
    """p_a, p_b, n and the point of the core (4, 3) between the shapes a and b.

    The point of the core is the mean over all core points of b with weights exp(−d/τ). Here d is
    the distance of a core point to a, minus the radius of the core point, and τ is `blend` [m]. The
    normal is a mean over the shapes of a, with such weights for the distances of these shapes to
    the point of the core. The points of a box of b that are nearest to `corners`, the core points
    of a, are core points of b too.
    """
    nodes, radii = core
    for face in (each for each in b if isinstance(each[0], Box)):
        d, n = signed_distance(face, corners)
        nodes = np.vstack([nodes, corners - d[:, None] * n])
        radii = np.append(radii, np.zeros(len(d)))
    weight = softmin(np.min([signed_distance(each, nodes)[0] for each in a], axis=0) - radii, blend)
    at, radius = weight @ nodes, weight @ radii
    sides = [signed_distance(each, at) for each in a]
    d, n = np.array([side[0] for side in sides]), np.array([side[1] for side in sides])
    share = softmin(d, blend)
    normal = share @ n
    return np.array([at - (share * d) @ n, at - radius * normal, normal, at])


def softmin(d: Array, blend: float) -> Array:
    """Weights exp(−d/τ) with the sum 1."""
    weight = np.exp((d.min() - d) / blend)
    return weight / weight.sum()


RAYS = 360
STEP = 0.01  # [m] between two heights, and along the arc over an edge
CORNER = 0.01  # [m] largest gap between the ends of two rings that meet


class Ring(NamedTuple):
    """The outlines of one shape's offset at all heights; points and tangents are x + iy."""

    heights: Array
    vertices: Array
    tangents: Array
    outside: Array
    """[m] signed distance of each vertex from the nearest offset of another shape, negative inside
    of this offset; at most 1 m."""


class Border:
    """{p : distance to l_m = d_b} as polygons at each height, traced along rays by bisection."""

    def __init__(self, model: RobotModel, d_b: float) -> None:
        shapes = Body(model, model.description.mobile_body.name).shapes(pin.SE3.Identity())
        key = tuple((s, tuple(T.rotation.ravel()), tuple(T.translation)) for s, T in shapes)
        self._rings = trace(key, d_b)

    def nearest(self, p: Array) -> tuple[Array, Array]:
        """The border point nearest to p (3,) [m] at p's height, and the unit tangent there."""
        z = self._level(p[2])
        at, found = complex(p[0], p[1]), []
        ends: list[tuple[complex, complex, bool]] = []
        for ring in self._rings:
            if ring.heights[0] <= z <= ring.heights[-1]:
                feet(at, *slice_at(ring, z), found, ends)
        corner_feet(at, found, ends)
        _, foot, t = min(found, key=lambda each: each[0])
        t /= abs(t)
        return np.array([foot.real, foot.imag, p[2]]), np.array([t.real, t.imag, 0.0])

    def _level(self, z: float) -> float:
        """[m] the height nearest to z at which a ring exists."""
        levels = [float(np.clip(z, ring.heights[0], ring.heights[-1])) for ring in self._rings]
        return min(levels, key=lambda each: abs(each - z))


@lru_cache
def trace(key: tuple, d_b: float) -> tuple[Ring, ...]:
    """The outlines of each shape's offset at the distance d_b [m]; `key` has the placed shapes."""
    shapes = [(s, pin.SE3(np.reshape(R, (3, 3)), np.array(p))) for s, R, p in key]
    traced = [(shape, *trace_shape(shape, d_b)) for shape in shapes]
    rings = []
    for shape, heights, points in traced:
        others = [signed_distance(each, points)[0] for each in shapes if each is not shape]
        outside = np.min([*others, np.full(points.shape[:2], d_b + 1.0)], axis=0) - d_b + 2e-6
        vertices = points[..., 0] + 1j * points[..., 1]
        edges = np.diff(vertices, axis=1)
        edges /= np.abs(edges)
        turns = edges + np.roll(edges, 1, axis=1)
        tangents = turns / np.abs(turns)
        rings.append(Ring(heights, vertices, np.hstack([tangents, tangents[:, :1]]), outside))
    return tuple(rings)


def trace_shape(placed: Placed, d_b: float) -> tuple[Array, Array]:
    """(H,) [m] heights and (H, RAYS + 1, 3) [m] points at the distance d_b of a shape."""
    shape, T = placed
    assert isinstance(shape, Box), "the oracle traces boxes"
    half = np.abs(T.rotation) @ np.array(shape.size_m) / 2
    heights = levels(T.translation[2] - half[2], T.translation[2] + half[2], d_b)
    angles = np.linspace(0.0, 2 * np.pi, RAYS, endpoint=False)
    rays = np.column_stack([np.cos(angles), np.sin(angles), np.zeros(RAYS)])
    origins = np.array([[[T.translation[0], T.translation[1], z]] for z in heights])
    near, far = np.zeros((len(heights), RAYS)), np.full((len(heights), RAYS), 4 * half.max() + 1.0)
    for _ in range(60):
        middle = (near + far) / 2
        inside = signed_distance(placed, origins + middle[..., None] * rays)[0] < d_b
        near, far = np.where(inside, middle, near), np.where(inside, far, middle)
    points = origins + near[..., None] * rays
    return heights, np.concatenate([points, points[:, :1]], axis=1)


def levels(bottom: float, top: float, d_b: float) -> Array:
    """[m] heights of an offset above the floor: even beside the shape, by arc above and below."""
    arc = np.linspace(0.0, np.pi / 2, int(np.ceil(d_b * np.pi / 2 / STEP)) + 1)[1:]
    arc[-1] -= 1e-3  # short of the flat top
    low = bottom if bottom > 0.8 * d_b else min(0.0, top)
    beside = np.linspace(low, top, max(2, int(np.ceil((top - low) / STEP)) + 1))
    under = low - d_b * np.sin(arc[::-1]) if low > 0.0 else []
    found = np.concatenate([under, beside, top + d_b * np.sin(arc)])
    return found if found[0] >= 0.0 else np.append(0.0, found[found > 0.0])


def slice_at(ring: Ring, z: float) -> tuple[Array, Array, Array]:
    """Vertices, tangents and `outside` of a ring at z [m], linear between two of its heights."""
    k = min(int(np.searchsorted(ring.heights, z, side="right")) - 1, len(ring.heights) - 2)
    share = (z - ring.heights[k]) / (ring.heights[k + 1] - ring.heights[k])
    vertices, tangents, outside = (
        rows[k] + share * (rows[k + 1] - rows[k])
        for rows in (ring.vertices, ring.tangents, ring.outside)
    )
    return vertices, tangents, outside


def feet(p: complex, corners: Array, tangents: Array, outside: Array, found: list, ends: list):
    """Add to `found` the feet of p on the edges by their tangents, and to `ends` the cut ends."""
    ahead, turns = ((p - corners) * tangents.conj()).real, np.diff(tangents)
    foot_there, cut = (ahead[:-1] >= 0.0) & (ahead[1:] < 0.0), outside < 0.0
    shown = ~(cut[:-1] & cut[1:])
    for i in np.flatnonzero(shown & (foot_there | cut[:-1] | cut[1:])):
        edge, turn, (a, b) = corners[i + 1] - corners[i], turns[i], outside[i : i + 2]
        first, last = max(a / (a - b) if a < 0 else 0.0, 0.0), a / (a - b) if b < 0 else 1.0
        if ahead[i] >= 0.0 > ahead[i + 1]:
            s = right_angle(p - corners[i], edge, tangents[i], turn)
            if first <= s <= last:
                foot = corners[i] + s * edge
                found.append((abs(p - foot), foot, tangents[i] + s * turn))
        for s, begins in ((first, True), (last, False)):
            if s != (0.0 if begins else 1.0):
                t = tangents[i] + s * turn
                ends.append((corners[i] + s * edge, t / abs(t), begins))


def right_angle(to_p: complex, edge: complex, t: complex, turn: complex) -> float:
    """The s within [0, 1] at which (to_p − s edge) · (t + s turn) = 0; 0 without one."""
    a, b, c = -dot(edge, turn), dot(to_p, turn) - dot(edge, t), dot(to_p, t)
    roots = [s.real for s in np.roots([a, b, c]) if abs(s.imag) < 1e-9]
    inside = [s for s in roots if -1e-9 <= s <= 1 + 1e-9]
    return float(np.clip(inside[0], 0.0, 1.0)) if inside else 0.0


def corner_feet(p: complex, found: list, ends: list) -> None:
    """Add to `found` the points nearest to p on the ends of rings, joined where two rings meet."""
    begins, met = [end for end in ends if end[2]], set()
    for at, t, is_begin in ends:
        if is_begin:
            continue
        near = [k for k, other in enumerate(begins) if abs(other[0] - at) < CORNER]
        if near:
            k = min(near, key=lambda k: abs(begins[k][0] - at))
            met.add(k)
            way, t = begins[k][0] - at, t + begins[k][1]
            if abs(way) > 0.0:
                at += np.clip(dot(p - at, way) / abs(way) ** 2, 0.0, 1.0) * way
        found.append((abs(p - at), at, square(p - at, t)))
    for k, (at, t, _) in enumerate(begins):
        if k not in met:
            found.append((abs(p - at), at, square(p - at, t)))


def square(way: complex, along: complex) -> complex:
    """The perpendicular of `way` on the side of `along`, with its length; `along` if way ≈ 0."""
    if abs(way) < 1e-9:
        return along
    return 1j * way if dot(1j * way, along) >= 0.0 else -1j * way


def dot(a: complex, b: complex) -> float:
    """Scalar product of two vectors x + iy."""
    return float((a * b.conjugate()).real)
