"""Convex shapes of the simplified collision bodies (Figure 2b), as a description states them.

Each shape gives itself to coal for exact distances with a signed normal; `meshes.py` draws it.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Literal

import coal
import numpy as np
import pinocchio as pin
from pydantic import Field

from app.errors import extras_named
from app.robot.packages import resolve_package_uri
from app.robot.superquadric import polytope_vertices
from app.strict import Positive, Strict, Vector3

if TYPE_CHECKING:
    import trimesh

Exponent = Annotated[float, Field(ge=0.1, le=2.0)]


class _Placed(Strict):
    """A shape placed in the frame of its body."""

    xyz_m: Vector3 = (0.0, 0.0, 0.0)
    """[m] centre of the shape in the body's frame."""
    rpy_rad: Vector3 = (0.0, 0.0, 0.0)
    """[rad] fixed-axis roll, pitch and yaw of the shape in the body's frame."""

    def placement(self) -> pin.SE3:
        """T_body_shape."""
        return pin.SE3(pin.rpy.rpyToMatrix(*self.rpy_rad), np.array(self.xyz_m))


class Box(_Placed):
    """A box with its centre at `xyz_m`."""

    type: Literal["box"]
    size_m: tuple[Positive, Positive, Positive]
    """[m] full side lengths along x, y and z."""

    def coal_geometry(self) -> coal.CollisionGeometry:
        return coal.Box(*self.size_m)


class Sphere(_Placed):
    """A sphere with its centre at `xyz_m`."""

    type: Literal["sphere"]
    radius_m: Positive
    """[m]"""

    def coal_geometry(self) -> coal.CollisionGeometry:
        return coal.Sphere(self.radius_m)


class Cylinder(_Placed):
    """A cylinder along z with its centre at `xyz_m`."""

    type: Literal["cylinder"]
    radius_m: Positive
    """[m]"""
    length_m: Positive
    """[m] full length along z."""

    def coal_geometry(self) -> coal.CollisionGeometry:
        return coal.Cylinder(self.radius_m, self.length_m)


class Capsule(Strict):
    """All points within `radius_m` of the segment from `start_m` to `end_m`."""

    type: Literal["capsule"]
    start_m: Vector3
    """[m] one end of the segment in the body's frame."""
    end_m: Vector3
    """[m] the other end of the segment in the body's frame."""
    radius_m: Positive
    """[m]"""

    @property
    def length_m(self) -> float:
        """[m] length of the segment, without the two half spheres."""
        return float(np.linalg.norm(np.subtract(self.end_m, self.start_m)))

    def coal_geometry(self) -> coal.CollisionGeometry:
        return coal.Capsule(self.radius_m, self.length_m)

    def placement(self) -> pin.SE3:
        """T_body_shape, with z along the segment."""
        start, end = np.array(self.start_m), np.array(self.end_m)
        along = end - start
        if not along.any():
            return pin.SE3(np.eye(3), start)
        turn = pin.Quaternion.FromTwoVectors(np.array([0.0, 0.0, 1.0]), along)
        return pin.SE3(turn.matrix(), (start + end) / 2)


class ConvexMesh(_Placed):
    """The convex hull of a mesh file."""

    type: Literal["convex_mesh"]
    file: str
    """`package://…` address of the mesh."""
    scale: tuple[Positive, Positive, Positive] = (1.0, 1.0, 1.0)

    def hull(self) -> trimesh.Trimesh:
        """The hull, in the shape's own frame.

        Raises:
            AssetError: The file is not there.
        """
        # Imported here: only this shape needs trimesh, which takes longer to import than all else.
        with extras_named():
            import trimesh

        loaded = trimesh.load(resolve_package_uri(self.file), force="mesh")
        assert isinstance(loaded, trimesh.Trimesh)
        return loaded.apply_scale(self.scale).convex_hull

    def coal_geometry(self) -> coal.CollisionGeometry:
        return _convex_hull(self.hull().vertices)


class Hull(_Placed):
    """The convex hull of some points around `xyz_m`."""

    type: Literal["hull"]
    vertices_m: Annotated[tuple[Vector3, ...], Field(min_length=4)]
    """[m] points in the shape's own frame; those inside of the others' hull do nothing."""

    def coal_geometry(self) -> coal.CollisionGeometry:
        return _convex_hull(np.array(self.vertices_m))


class Superquadric(_Placed):
    """A hyper-ellipsoid with its centre at `xyz_m`: an ellipsoid, a pillow, almost a box.

    Its distances are those of a convex polytope of 3,458 vertices on its surface, and so at most
    what the polytope lies inside of the surface too large: less than 0.5 % of the longest semi-axis
    for exponents from 0.1 to 1, 1 % up to 2.
    """

    type: Literal["superquadric"]
    semi_axes_m: tuple[Positive, Positive, Positive]
    """[m] half of the lengths along x, y and z."""
    e1: Exponent
    """[-] roundness from top to bottom: 1 as an ellipsoid, towards 0 as a box."""
    e2: Exponent
    """[-] roundness in plan."""

    def vertices(self) -> np.ndarray:
        """(N, 3) [m] the polytope's corners, in the shape's own frame; read-only."""
        return polytope_vertices(self.semi_axes_m, self.e1, self.e2)

    def coal_geometry(self) -> coal.CollisionGeometry:
        return _convex_hull(self.vertices())


def _convex_hull(points: np.ndarray) -> coal.CollisionGeometry:
    vertices = coal.StdVec_Vec3s()
    for vertex in points:
        vertices.append(np.asarray(vertex, dtype=float))
    return coal.Convex.convexHull(vertices, True, "Qt")


Shape = Annotated[
    Box | Sphere | Cylinder | Capsule | ConvexMesh | Hull | Superquadric,
    Field(discriminator="type"),
]
