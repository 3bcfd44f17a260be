"""Triangle meshes of the convex shapes, for drawing and for bounds."""

from __future__ import annotations

from functools import singledispatch

import numpy as np
import trimesh

from app.robot.shapes import Box, Capsule, ConvexMesh, Cylinder, Hull, Sphere, Superquadric


@singledispatch
def shape_mesh(shape: object) -> trimesh.Trimesh:
    """The surface of a shape, in its own frame: that of its `placement()`.

    Raises:
        AssetError: The file of a convex mesh is not there.
    """
    raise TypeError(f"no mesh for a {type(shape).__name__}")


@shape_mesh.register
def _(shape: Box) -> trimesh.Trimesh:
    return trimesh.creation.box(extents=shape.size_m)


@shape_mesh.register
def _(shape: Sphere) -> trimesh.Trimesh:
    return trimesh.creation.icosphere(subdivisions=3, radius=shape.radius_m)


@shape_mesh.register
def _(shape: Cylinder) -> trimesh.Trimesh:
    return trimesh.creation.cylinder(radius=shape.radius_m, height=shape.length_m, sections=48)


@shape_mesh.register
def _(shape: Capsule) -> trimesh.Trimesh:
    mesh = trimesh.creation.capsule(height=shape.length_m, radius=shape.radius_m, count=[24, 24])
    mesh.apply_translation((0.0, 0.0, -mesh.bounds.mean(axis=0)[2]))
    return mesh


@shape_mesh.register
def _(shape: ConvexMesh) -> trimesh.Trimesh:
    return shape.hull()


@shape_mesh.register
def _(shape: Superquadric) -> trimesh.Trimesh:
    return trimesh.convex.convex_hull(shape.vertices())


@shape_mesh.register
def _(shape: Hull) -> trimesh.Trimesh:
    return trimesh.convex.convex_hull(np.array(shape.vertices_m))
