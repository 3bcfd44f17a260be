"""Convex shapes that enclose points: capsule, box or polytope."""

from collections.abc import Iterable
from functools import cache
from typing import NamedTuple

import numpy as np
import pinocchio as pin
import trimesh
from scipy.optimize import minimize
from scipy.spatial import ConvexHull, HalfspaceIntersection, QhullError
from trimesh.intersections import slice_faces_plane

from app.robot.shapes import Box, Capsule, Hull, Shape, shape_mesh
from app.strict import Array

_UNIT = 1e-4  # [m] resolution of sizes, which are rounded up
_THINNEST = 0.002  # [m] smallest side of a box


class PointHull(NamedTuple):
    """The convex hull of points."""

    corners: Array
    """(M, 3) [m] corners; of flat points all, rounded to 1 µm, without duplicates; of fewer
    than five points all, unchanged."""
    volume: float  # [m³], 0 for flat points and for fewer than five points


def hull(points: Array) -> PointHull:
    """The convex hull of points (N, 3) [m]."""
    points = np.asarray(points, dtype=float)
    if len(points) < 5:
        return PointHull(points, 0.0)
    try:
        found = ConvexHull(points)
    except QhullError:
        return PointHull(np.unique(np.round(points, 6), axis=0), 0.0)
    return PointHull(points[found.vertices], float(found.volume))


class Fit(NamedTuple):
    """A convex shape around points."""

    shape: Shape  # the shape, in the points' frame
    volume: float  # [m³] volume of the shape
    over_cover: float
    """[-] ratio of the shape's volume to that of the points' hull; infinite for flat points."""
    protrusion: float  # [m] largest extent beyond the points' hull, along one of 162 directions


def fit_best(around: PointHull, weights: dict[str, float]) -> Fit:
    """Of the kinds in `weights`, the shape around a hull with the least volume times weight [-]."""
    corners, inner = around
    kinds = {"capsule": fit_capsule, "box": fit_box, "hull": fit_hull}
    shapes = {kind: kinds[kind](corners) for kind in weights}
    shape = shapes[min(shapes, key=lambda kind: weights[kind] * volume_of(shapes[kind]))]
    volume, D = volume_of(shape), directions(2)
    protrusion = float((support(shape, D) - (D @ corners.T).max(axis=1)).max())
    return Fit(shape, volume, volume / inner if inner > 0 else np.inf, protrusion)


def lean_corners(points: Array) -> Array:
    """Corners (M, 3) of the convex hull; if there are many, corners of a polytope around the hull.

    The polytope has faces in 642 directions, evenly spread after scaling the points to equal widths
    along principal axes. It exceeds a round hull by about 0.2 % of its size, and edges by more.
    """
    corners, D = hull(points).corners, directions(3)
    if len(corners) <= 2 * len(D):  # the polytope may have as many
        return corners
    middle = corners.mean(axis=0)
    _, spread, axes = np.linalg.svd(corners - middle, full_matrices=False)
    D = D / np.maximum(spread / np.sqrt(len(corners)), _THINNEST) @ axes
    D /= np.linalg.norm(D, axis=1)[:, None]
    return _polytope(D, ((corners - middle) @ D.T).max(axis=0) + _UNIT) + middle


def _polytope(D: Array, reach: Array) -> Array:
    """Corners (M, 3) [m] of the polytope of all x with D x ≤ `reach`, for D (K, 3); 0 is inside."""
    return HalfspaceIntersection(np.column_stack([D, -reach]), np.zeros(3)).intersections


def fit_capsule(points: Array) -> Capsule:
    """A small capsule around points (N, 3) [m], by a local search from the best principal axis."""
    some = points[np.unique((points @ directions(1).T).argmax(axis=0))]  # sufficient for the pose
    centre = some.mean(axis=0)
    axes = np.linalg.svd(some - centre, full_matrices=False)[2]

    def volume(x: Array) -> float:
        a, b = x[:3], x[3:]
        r, length = _radius(some, a, b), float(np.linalg.norm(b - a))
        return np.pi * r**2 * (length + 4 / 3 * r)

    starts = []
    for axis in axes:
        along = (some - centre) @ axis
        r = _radius(some, centre - axis, centre + axis)
        low, high = along.min() + 0.7 * r, along.max() - 0.7 * r
        if low > high:
            low = high = (low + high) / 2
        starts.append(np.concatenate([centre + (low - 1e-3) * axis, centre + (high + 1e-3) * axis]))
    start = min(starts, key=volume)
    options = {"maxiter": 400, "xatol": 2e-4, "fatol": 1e-7, "adaptive": True}
    options["initial_simplex"] = np.vstack([start, start + 0.03 * np.eye(6)])
    best = minimize(volume, start, method="Nelder-Mead", options=options)
    found = _capsule(points, np.round(best.x.reshape(2, 3), 4))
    # A coordinate that is small at both ends becomes zero if this adds little volume: distances
    # have simple formulas if the axis of the capsule meets that of a joint.
    ends = np.array([found.start_m, found.end_m])
    snapped = _capsule(points, np.where((np.abs(ends) < 0.005).all(axis=0), 0.0, ends))
    return snapped if volume_of(snapped) < 1.05 * volume_of(found) else found


def fit_box(points: Array) -> Box:
    """A small box around points (N, 3) [m], aligned with an axis of the frame or a principal axis.

    A rotated box replaces the best box so far only if its volume is smaller by more than a tenth.
    """
    best = _box(points, np.zeros(3))
    main = np.linalg.svd(points - points.mean(axis=0), full_matrices=False)[2]
    for axis in np.vstack([np.eye(3), main]):
        turned = _box(points, np.round(pin.rpy.matrixToRpy(_tight_frame(points, axis)), 4))
        if np.prod(turned.size_m) < 0.9 * np.prod(best.size_m):
            best = turned
    return best


def fit_hull(points: Array) -> Hull | Box:
    """A polytope around points (N, 3) [m] with a face for each of 42 directions, or a box if qhull
    finds none. Its frame is at the centre of their bounding box, z along the first principal axis.
    """
    middle = np.round((points.max(axis=0) + points.min(axis=0)) / 2, 4)
    axes = np.linalg.svd(points - points.mean(axis=0), full_matrices=False)[2]
    R = pin.Quaternion.FromTwoVectors(np.array([0.0, 0.0, 1.0]), axes[0]).matrix()
    rpy = np.round(pin.rpy.matrixToRpy(R), 4)
    own = (points - middle) @ pin.rpy.rpyToMatrix(*rpy)
    D = directions(1)
    reach = np.maximum((own @ D.T).max(axis=0), _THINNEST / 2) + _UNIT
    try:
        corners = _polytope(D, reach)
    except QhullError:
        return fit_box(points)
    corners = np.unique(np.round(corners, 4), axis=0)  # of equal corners only one remains
    vertices = tuple(map(three, corners[ConvexHull(corners).vertices]))
    return Hull(type="hull", vertices_m=vertices, xyz_m=three(middle), rpy_rad=three(rpy))


def support(shape: Shape, D: Array) -> Array:
    """(K,) [m] largest coordinate of a shape along each unit vector of D (K, 3)."""
    if isinstance(shape, Capsule):  # its mesh is not exact
        return (D @ np.array([shape.start_m, shape.end_m]).T).max(axis=1) + shape.radius_m
    T = shape.placement()
    return D @ T.translation + (D @ T.rotation @ shape_mesh(shape).vertices.T).max(axis=1)


def volume_of(shape: Shape) -> float:
    """[m³] volume of a shape."""
    return float(shape.coal_geometry().computeVolume())


def convex_pieces(mesh: trimesh.Trimesh) -> list[trimesh.Trimesh]:
    """The pieces of a mesh, which planes cut until no cut saves enough volume.

    A cut saves the volume of the piece's hull minus those of the hulls of both halves. It has to
    save more than 8 cm³, and more than 3 % of the volume of the hull of `mesh`.
    """
    whole = hull(mesh.vertices).volume
    least = max(0.03 * whole, 0.02**3)
    done, left = [], [(mesh, whole)]
    while left:
        piece, volume = left.pop()
        halves = _halves(piece) if volume > least else []
        volumes = [hull(half.vertices).volume for half in halves]
        if halves and volume - sum(volumes) > least:
            left += zip(halves, volumes, strict=True)
        else:
            done.append(piece)
    return done


def _halves(mesh: trimesh.Trimesh) -> list[trimesh.Trimesh]:
    """The halves of a mesh with the smallest sum of hull volumes; none if no plane cuts it."""
    some = mesh.faces[:: 1 + len(mesh.faces) // 2000]  # enough to choose a plane across an axis
    best, found = np.inf, None
    for normal, low, high in zip(np.eye(3), *mesh.bounds, strict=True):
        for at in np.outer(np.linspace(low, high, 9)[1:-1], normal):
            planes = [(normal, at), (-normal, at)]
            sides = [slice_faces_plane(mesh.vertices, some, *plane)[0] for plane in planes]
            volume = sum(hull(vertices).volume for vertices in sides)
            if all(map(len, sides)) and volume < best:
                best, found = volume, planes
    sides = [slice_faces_plane(mesh.vertices, mesh.faces, *plane) for plane in found or ()]
    return [trimesh.Trimesh(*side[:2], process=False) for side in sides]


@cache
def directions(subdivisions: int) -> Array:
    """(K, 3) evenly spread unit vectors, also ±x, ±y, ±z; K is 42, 162, 642 for 1, 2, 3."""
    spread = np.asarray(trimesh.creation.icosphere(subdivisions=subdivisions).vertices)
    D = np.vstack([spread, np.eye(3), -np.eye(3)])
    D = np.unique(np.round(D / np.linalg.norm(D, axis=1)[:, None], 9), axis=0)
    D.setflags(write=False)
    return D


def _tight_frame(points: Array, axis: Array) -> Array:
    """Rotation (3, 3): z along `axis`, x and y along the points' smallest rectangle normal to z."""
    R = pin.Quaternion.FromTwoVectors(np.array([0.0, 0.0, 1.0]), axis).matrix()
    try:
        T, _ = trimesh.bounds.oriented_bounds_2D(points @ R[:, :2])
    except (QhullError, ValueError, IndexError):
        return R
    turn = np.eye(3)
    turn[:2, :2] = np.asarray(T)[:2, :2].T
    return R @ turn


def _capsule(points: Array, ends: Array) -> Capsule:
    """The smallest capsule with the ends (2, 3) that encloses the points."""
    radius = round(float(np.ceil(_radius(points, *ends) / _UNIT + 1e-6) * _UNIT), 4)
    return Capsule(type="capsule", start_m=three(ends[0]), end_m=three(ends[1]), radius_m=radius)


def _radius(points: Array, a: Array, b: Array) -> float:
    """[m] largest distance of points to the segment from a to b (3,)."""
    along = b - a
    share = np.clip((points - a) @ along / max(float(along @ along), 1e-12), 0.0, 1.0)
    off = points - a - share[:, None] * along
    return float(np.sqrt(np.einsum("ij,ij->i", off, off).max()))


def _box(points: Array, rpy: Array) -> Box:
    R = pin.rpy.rpyToMatrix(*rpy)
    inside = points @ R
    low = np.floor(inside.min(axis=0) / _UNIT) * _UNIT
    high = np.ceil(inside.max(axis=0) / _UNIT) * _UNIT
    centre = np.round(R @ ((low + high) / 2), 5)  # for this, the size has a margin
    size = np.round(np.maximum(high - low, _THINNEST) + 2 * _UNIT, 4)
    return Box(type="box", size_m=three(size), xyz_m=three(centre), rpy_rad=three(rpy))


def three(v: Iterable[float]) -> tuple[float, float, float]:
    """Three numbers, rounded to 1e-5; no zero is negative."""
    x, y, z = (float(round(value, 5)) + 0.0 for value in v)
    return x, y, z
