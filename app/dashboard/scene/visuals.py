"""Visual meshes of a URDF, decimated for a browser."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple
from xml.etree import ElementTree

import coal
import numpy as np
import pinocchio as pin
import trimesh

from app.dashboard.scene.colours import Rgb
from app.errors import AssetError, DescriptionError
from app.robot.description import RobotDescription
from app.robot.urdf import floats, resolved_urdf

Array = np.ndarray

MAX_FACES = 2500
"""Faces a mesh may have on the page; the Panda's links come with 12,000 to 22,000."""
MOST_FACES = 4 * MAX_FACES
"""Faces that are borne where fewer would show; what cannot be decimated at all keeps more."""
AGGRESSIONS = (3, 5, 7)
"""Of the decimation, the first that gets below `MOST_FACES`. More of it takes corners off meshes of
many parts, such as UR5's tubes; with less such meshes stay too heavy."""
CREASE = np.deg2rad(35.0)  # [rad] sharper edges are drawn as edges, not shaded over
GREY: Rgb = (150, 150, 155)
"""Colour of a visual for which the URDF states none."""


class Visual(NamedTuple):
    """One mesh in the frame of the joint that moves it."""

    name: str
    joint: int
    """Index of pinocchio's joint, 0 for what is fixed to the root."""
    placement: pin.SE3
    """T_joint_mesh."""
    mesh: trimesh.Trimesh
    colour: Rgb


def load_visuals(description: RobotDescription, model: pin.Model) -> list[Visual]:
    """All visual meshes of the URDF, decimated, in the URDF's colours.

    Args:
        description: The robot.
        model: pinocchio's model of the whole URDF, whose joints the visuals refer to.

    Raises:
        AssetError: The URDF or a mesh is not there.
        DescriptionError: A mesh of the URDF has no file, or a scale that is not three numbers.
    """
    urdf, files = _without_files(resolved_urdf(description))
    geometry = pin.buildGeomFromUrdfString(model, urdf, pin.GeometryType.VISUAL)
    ready: dict[_MeshFile, trimesh.Trimesh] = {}  # four wheels share one file
    visuals = []
    for item in geometry.geometryObjects:
        file = files.get(item.name)
        if file is None:
            mesh = for_display(mesh_of(item.geometry))
        else:
            if file not in ready:
                ready[file] = for_display(read_mesh(file.path).apply_scale(file.scale))
            mesh = ready[file]
        # A copy: the placement inside the item dies with `geometry`.
        placement = item.placement.copy()
        visuals.append(Visual(item.name, item.parentJoint, placement, mesh, _colour(item)))
    return visuals


class _MeshFile(NamedTuple):
    path: str
    scale: tuple[float, ...]


def _without_files(urdf: str) -> tuple[str, dict[str, _MeshFile]]:
    """A URDF with a sphere in place of each visual's mesh, and the meshes by pinocchio's names.

    pinocchio tells where they are; it would read each file too, which takes as long as all else.

    Raises:
        DescriptionError: A mesh has no file, or a scale that is not three numbers.
    """
    tree = ElementTree.fromstring(urdf)
    files = {}
    for link in tree.iterfind("link"):
        name = link.get("name", "")
        for i, visual in enumerate(link.iterfind("visual")):
            geometry = visual.find("geometry")
            if geometry is None or not len(geometry) or geometry[0].tag != "mesh":
                continue
            files[f"{name}_{i}"] = _mesh_file(name, geometry[0])
            geometry[0] = ElementTree.Element("sphere", radius="1")
    return ElementTree.tostring(tree, encoding="unicode"), files


def _mesh_file(link: str, mesh: ElementTree.Element) -> _MeshFile:
    path, scale = mesh.get("filename", ""), mesh.get("scale", "1 1 1")
    values = floats(scale, 3)
    if values is None:
        raise DescriptionError(f"link {link!r}: scale={scale!r} of a mesh is not three numbers")
    if not path:
        raise DescriptionError(f"link {link!r}: a mesh has no filename")
    return _MeshFile(path, tuple(values))


def read_mesh(path: str) -> trimesh.Trimesh:
    """The triangles of a mesh file, parts joined, equal vertices merged, textures left behind.

    Raises:
        AssetError: The file cannot be read, or its format needs a package that is not installed.
    """
    try:
        with open(path, "rb") as file:  # a file, not a path: then no texture beside it is read
            kind = Path(path).suffix[1:].lower()
            mesh = trimesh.load(file, file_type=kind, force="mesh", skip_materials=True)
    except (ImportError, NotImplementedError, ValueError, OSError) as error:
        raise AssetError(f"{path}: trimesh cannot read it: {error}") from None
    assert isinstance(mesh, trimesh.Trimesh)
    # A new mesh of positions only: textures would be copied with every part of it.
    return trimesh.Trimesh(mesh.vertices, mesh.faces, process=True)


def mesh_of(geometry: coal.CollisionGeometry) -> trimesh.Trimesh:
    """The triangles of a primitive shape.

    Raises:
        TypeError: A shape that a URDF cannot hold.
    """
    if isinstance(geometry, coal.Box):
        return trimesh.creation.box(extents=2.0 * np.asarray(geometry.halfSide))
    if isinstance(geometry, coal.Cylinder):
        return trimesh.creation.cylinder(geometry.radius, 2.0 * geometry.halfLength, sections=48)
    if isinstance(geometry, coal.Sphere):
        return trimesh.creation.icosphere(subdivisions=3, radius=geometry.radius)
    if isinstance(geometry, coal.Capsule):
        mesh = trimesh.creation.capsule(2.0 * geometry.halfLength, geometry.radius, count=[24, 24])
        return mesh.apply_translation(-mesh.bounds.mean(axis=0))
    raise TypeError(f"no mesh for {type(geometry).__name__}")


def for_display(mesh: trimesh.Trimesh) -> trimesh.Trimesh:
    """A mesh of about `MAX_FACES`, with the vertices of sharp edges doubled.

    The browser averages normals over shared vertices, so without the doubling every edge of a box
    would look like a pillow.
    """
    if len(mesh.faces) > MAX_FACES:
        mesh = _decimated(mesh)
    return trimesh.graph.smooth_shade(mesh, angle=CREASE)


def _decimated(mesh: trimesh.Trimesh) -> trimesh.Trimesh:
    for aggression in AGGRESSIONS:
        light = mesh.simplify_quadric_decimation(face_count=MAX_FACES, aggression=aggression)
        if len(light.faces) <= MOST_FACES:
            break
    return light


def _colour(item: pin.GeometryObject) -> Rgb:
    if not item.overrideMaterial:
        return GREY
    r, g, b = (round(255 * channel) for channel in item.meshColor[:3])
    return r, g, b
