"""Convex shapes of the simplified collision bodies (Figure 2b), as records of `robot.toml`.

A superquadric (hyper-ellipsoid) is the set of points p with f(p) ≤ 1, where
f(p) = (|x/a|^(2/e₂) + |y/b|^(2/e₂))^(e₂/e₁) + |z/c|^(2/e₁). The exponent e₁ determines the vertical
profile, e₂ the plan view: an ellipse for an exponent of 1, almost a rectangle for one near 0.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache, partial
from typing import TYPE_CHECKING, Annotated, Literal

import coal
import numpy as np
import pinocchio as pin
from pydantic import Field

from app.errors import AssetError, extras_named
from app.jobs.bounded import BudgetError, within_budget
from app.robot.assets import resolve_package_uri
from app.strict import Array, Positive, Strict, Vector3

if TYPE_CHECKING:
    import trimesh

INTERVALS = 24  # [-] intervals along each edge of the cube that is projected onto a superquadric
Exponent = Annotated[float, Field(ge=0.1, le=2.0)]


class _Placed(Strict):
    """A shape placed in the frame of its body."""

    xyz_m: Vector3 = (0.0, 0.0, 0.0)  # [m] origin of the shape's frame in the body's frame
    rpy_rad: Vector3 = (0.0, 0.0, 0.0)  # [rad] fixed-axis roll, pitch and yaw of the shape's frame

    def placement(self) -> pin.SE3:
        """T_body_shape, the pose of the shape in the body's frame."""
        return pin.SE3(pin.rpy.rpyToMatrix(*self.rpy_rad), np.array(self.xyz_m))


class Box(_Placed):
    """A box with its centre at `xyz_m`."""

    type: Literal["box"]
    size_m: tuple[Positive, Positive, Positive]  # [m] full side lengths along x, y and z

    def coal_geometry(self) -> coal.CollisionGeometry:
        return coal.Box(*self.size_m)


class Sphere(_Placed):
    """A sphere with its centre at `xyz_m`."""

    type: Literal["sphere"]
    radius_m: Positive  # [m]

    def coal_geometry(self) -> coal.CollisionGeometry:
        return coal.Sphere(self.radius_m)


class Cylinder(_Placed):
    """A cylinder along z with its centre at `xyz_m`."""

    type: Literal["cylinder"]
    radius_m: Positive  # [m]
    length_m: Positive  # [m] full length along z

    def coal_geometry(self) -> coal.CollisionGeometry:
        return coal.Cylinder(self.radius_m, self.length_m)


class Capsule(Strict):
    """All points within `radius_m` of the segment from `start_m` to `end_m`."""

    type: Literal["capsule"]
    start_m: Vector3  # [m] one end of the segment in the body's frame
    end_m: Vector3  # [m] the other end of the segment in the body's frame
    radius_m: Positive  # [m]

    @property
    def length_m(self) -> float:
        """[m] length of the segment, without the two half spheres."""
        return float(np.linalg.norm(np.subtract(self.end_m, self.start_m)))

    def coal_geometry(self) -> coal.CollisionGeometry:
        return coal.Capsule(self.radius_m, self.length_m)

    def placement(self) -> pin.SE3:
        """T_body_shape: z is along the segment, and the origin is its middle."""
        start, end = np.array(self.start_m), np.array(self.end_m)
        along = end - start
        if not along.any():
            return pin.SE3(np.eye(3), start)
        turn = pin.Quaternion.FromTwoVectors(np.array([0.0, 0.0, 1.0]), along)
        return pin.SE3(turn.matrix(), (start + end) / 2)


class ConvexMesh(_Placed):
    """The convex hull of a mesh file."""

    type: Literal["convex_mesh"]
    file: str  # `package://…` address of the mesh
    scale: tuple[Positive, Positive, Positive] = (1.0, 1.0, 1.0)
    """[-] factors of the mesh's coordinates, which are metres after the scaling."""

    def hull(self) -> trimesh.Trimesh:
        """The convex hull of the file's scaled vertices, in the shape's frame.

        Raises an AssetError if the file is missing or reading exceeds the budget of
        `app.jobs.bounded`, and a MissingExtraError if trimesh is not installed.
        """
        with extras_named():
            import trimesh  # slow, and possibly not installed

        path = resolve_package_uri(self.file)
        read = partial(trimesh.load, force="mesh")
        try:
            loaded = within_budget(read, path, size=path.stat().st_size)
        except BudgetError as error:
            raise AssetError(f"{self.file}: {error}") from None
        assert isinstance(loaded, trimesh.Trimesh)
        return hull_mesh(loaded.vertices * self.scale)

    def coal_geometry(self) -> coal.CollisionGeometry:
        return convex_hull(self.hull().vertices)


class Hull(_Placed):
    """The convex hull of some points."""

    type: Literal["hull"]
    vertices_m: Annotated[tuple[Vector3, ...], Field(min_length=4)]
    """[m] points in the shape's own frame; points inside the hull of the others have no effect."""

    def coal_geometry(self) -> coal.CollisionGeometry:
        return convex_hull(np.array(self.vertices_m))


class Superquadric(_Placed):
    """A hyper-ellipsoid with its centre at `xyz_m`: an ellipsoid, a pillow, or almost a box.

    Its distances are those of a convex polytope of 3,458 vertices on its surface: too large by less
    than 0.5 % of the longest semi-axis for exponents from 0.1 to 1, by less than 1 % up to 2.
    """

    type: Literal["superquadric"]
    semi_axes_m: tuple[Positive, Positive, Positive]  # [m] half lengths along x, y and z
    e1: Exponent  # [-] roundness from top to bottom: 1 is an ellipsoid, 0 would be a box
    e2: Exponent  # [-] roundness in plan

    def vertices(self) -> Array:
        """(N, 3) [m] corners of the polytope in the shape's own frame; read-only."""
        return polytope_vertices(self.semi_axes_m, self.e1, self.e2)

    def coal_geometry(self) -> coal.CollisionGeometry:
        return convex_hull(self.vertices())


def hull_mesh(points: Array) -> trimesh.Trimesh:
    """The convex hull of points (N, 3) [m], facing outwards and at least 0.1 mm thick."""
    import trimesh  # see ConvexMesh.hull

    hull = trimesh.convex.convex_hull(_thick(points), repair=False)  # a repair would need networkx
    inwards = np.vecdot(hull.face_normals, hull.triangles_center - hull.vertices.mean(axis=0)) < 0
    hull.faces = np.where(inwards[:, None], hull.faces[:, ::-1], hull.faces)
    return hull


THIN = 1e-4  # [m] smallest thickness of a hull


def _thick(points: Array) -> Array:
    """Points (N, 3) [m], doubled along each principal axis thinner than 0.1 mm, to 0.1 mm."""
    around = points - points.mean(axis=0)
    for axis in np.linalg.eigh(around.T @ around)[1].T:
        if (missing := THIN - np.ptp(points @ axis)) > 0.0:
            points = np.concatenate([points + s * missing / 2 * axis for s in (-1.0, 1.0)])
    return points


def convex_hull(points: Array, grid: float = THIN) -> coal.CollisionGeometry:
    """The convex hull of points (N, 3) [m], at least 0.1 mm thick.

    coal refuses corners with 255 or more neighbours, such as those of a finely drawn disc. Then
    the points are rounded to `grid` [m], which is doubled until coal accepts them.
    """
    points = _thick(np.asarray(points, dtype=float))  # without a volume, coal ends the process
    vertices = coal.StdVec_Vec3s()
    for vertex in points:
        vertices.append(vertex)
    try:
        return coal.Convex.convexHull(vertices, True, "Qt")
    except RuntimeError as error:
        if "Too many neighbors" not in str(error):
            raise
    return convex_hull(np.unique(np.round(points / grid), axis=0) * grid, 2.0 * grid)


_Kinds = Box | Sphere | Cylinder | Capsule | ConvexMesh | Hull | Superquadric
Shape = Annotated[_Kinds, Field(discriminator="type")]


def shape_mesh(shape: Shape) -> trimesh.Trimesh:
    """The surface of a shape, in its own frame; raises the errors of `ConvexMesh.hull`."""
    with extras_named():
        from trimesh import convex, creation
    match shape:
        case Box():
            return creation.box(extents=shape.size_m)
        case Sphere():
            return creation.icosphere(subdivisions=3, radius=shape.radius_m)
        case Cylinder():
            return creation.cylinder(shape.radius_m, shape.length_m, sections=48)
        case Capsule():
            mesh = creation.capsule(shape.length_m, shape.radius_m, count=[24, 24])
            mesh.apply_translation((0.0, 0.0, -mesh.bounds.mean(axis=0)[2]))
            return mesh
        case ConvexMesh():
            return shape.hull()
        case Hull():
            return convex.convex_hull(np.array(shape.vertices_m))
        case Superquadric():
            return convex.convex_hull(shape.vertices())


def implicit(p: Array, semi_axes: Sequence[float], e1: float, e2: float) -> Array:
    """(…) [-] f of this module at p (…, 3) [m] in its frame; `semi_axes` are a, b and c [m]."""
    x, y, z = np.moveaxis(np.abs(p) / np.asarray(semi_axes), -1, 0)
    return _power_sum(_power_sum(x, y, e2 / 2), z, e1 / 2) ** (2 / e1)


def onto_surface(p: Array, semi_axes: Sequence[float], e1: float, e2: float) -> Array:
    """(…, 3) [m] points at which the rays from the centre through p (…, 3) meet the surface."""
    scaled = np.asarray(p) / np.abs(np.asarray(p) / np.asarray(semi_axes)).max(-1, keepdims=True)
    return scaled * implicit(scaled, semi_axes, e1, e2)[..., None] ** (-e1 / 2)


def around_box(size: Sequence[float], e1: float, e2: float) -> tuple[float, float, float]:
    """Semi-axes [m] of the superquadric through the corners of a box with the sides `size` [m]."""
    growth = (2.0 ** (e2 / e1) + 1.0) ** (e1 / 2)
    a, b, c = (0.5 * side * growth for side in size)
    return a, b, c


@lru_cache(maxsize=16)
def polytope_vertices(
    semi_axes: tuple[float, float, float], e1: float, e2: float, intervals: int = INTERVALS
) -> Array:
    """(6 intervals² + 2, 3) [m] points of a superquadric's surface, in its frame; read-only."""
    # The grid of the cube is denser towards its edges, where a small exponent bends the surface.
    s = np.sin(np.linspace(-0.5, 0.5, intervals + 1) * np.pi)
    u, v = (grid.ravel() for grid in np.meshgrid(s, s))
    ones = np.ones_like(u)
    ends = [np.column_stack([sign * ones, u, v]) for sign in (-1.0, 1.0)]
    faces = [np.roll(face, axis, axis=1) for axis in range(3) for face in ends]
    cube = np.unique(np.round(np.vstack(faces), 12), axis=0)
    vertices = onto_surface(cube * np.asarray(semi_axes), semi_axes, e1, e2)
    vertices.setflags(write=False)
    return vertices


def _power_sum(a: Array, b: Array, e: float) -> Array:
    """(a^(1/e) + b^(1/e))^e for a, b ≥ 0, by the ratio of both, because powers could overflow."""
    high, low = np.maximum(a, b), np.minimum(a, b)
    ratio = np.divide(low, high, out=np.zeros_like(high), where=high > 0)
    return high * (1.0 + ratio ** (1.0 / e)) ** e
