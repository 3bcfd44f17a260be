"""What a link looks like: the convex hulls of its collision shapes, in the link's frame."""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path
from typing import NamedTuple
from xml.etree.ElementTree import Element

import numpy as np
import trimesh

from app.errors import RobotFileError
from app.onboarding.read.source import mesh_path
from app.onboarding.read.tree import Tree, numbers, origin

Array = np.ndarray

_LARGEST = 20.0  # [m] size of a shape; a link in millimetres has hundreds
_SPACING = 0.03  # [m] between points on a hull's surface
_MOST_POINTS = 1500  # [-] on the surface of one hull


class LinkShape(NamedTuple):
    """One collision shape of a link.

    Attributes:
        hull: Its convex hull, in the link's frame [m].
        surface: (N, 3) [m] points spread over the hull, its corners included.
        kind: box, cylinder, sphere or mesh.
        radius: [m] of a cylinder or sphere, else None.
    """

    hull: trimesh.Trimesh
    surface: Array
    kind: str
    radius: float | None


class LinkGeometry(NamedTuple):
    """All of a link.

    Attributes:
        shapes: Its collision shapes, or the visual ones where it has no collision.
        seen_only: Whether they are the visual ones.
    """

    shapes: tuple[LinkShape, ...]
    seen_only: bool

    @property
    def corners(self) -> Array:
        """(N, 3) [m] corners of all hulls, in the link's frame."""
        return np.vstack([np.zeros((0, 3)), *(np.asarray(s.hull.vertices) for s in self.shapes)])

    @property
    def surface(self) -> Array:
        """(N, 3) [m] points on the surface of all hulls, in the link's frame."""
        return np.vstack([np.zeros((0, 3)), *(s.surface for s in self.shapes)])

    @property
    def volume(self) -> float:
        """[m³] of all hulls."""
        return sum(abs(float(s.hull.volume)) for s in self.shapes)


def read_geometry(tree: Tree) -> dict[str, LinkGeometry]:
    """The geometry of every link, by its name; a link may have none.

    Raises:
        RobotFileError: A mesh is missing or cannot be read, or a size is no metre's.
    """
    return {name: _link_geometry(link) for name, link in tree.links.items()}


def read_shapes(tree: Tree, link: str) -> tuple[LinkShape, ...]:
    """A link's collision shapes, or the visual ones where it has no collision.

    Raises:
        RobotFileError: As `read_geometry`.
    """
    return _link_geometry(tree.links[link]).shapes


def looks(tree: Tree, link: str) -> LinkGeometry:
    """A link's visual shapes, or the collision ones where it has no visual.

    Raises:
        RobotFileError: As `read_geometry`.
    """
    return _link_geometry(tree.links[link], ("visual", "collision"))


def _link_geometry(link: Element, tags: tuple[str, ...] = ("collision", "visual")) -> LinkGeometry:
    for tag in tags:
        found = [_shape(element, f"link {link.get('name')!r}") for element in link.findall(tag)]
        if found:
            return LinkGeometry(tuple(found), tag == "visual")
    return LinkGeometry((), False)


def _shape(element: Element, where: str) -> LinkShape:
    T = origin(element, where).homogeneous
    holder = element.find("geometry")
    if holder is None or not len(holder):
        raise RobotFileError(f"{where}: a {element.tag} has no geometry")
    shape = holder[0]
    mesh, radius = _mesh_of(shape, where)
    hull = _hull(mesh, where).copy()
    hull.apply_transform(T)
    size = float(hull.extents.max())
    if size > _LARGEST:
        raise RobotFileError(
            f"{where}: its {shape.tag} is {size:.4g} m long: lengths of a URDF are in metres, this "
            'looks like millimetres; give the mesh scale="0.001 0.001 0.001"'
        )
    return LinkShape(hull, _surface(hull), shape.tag, radius)


def _mesh_of(shape: Element, where: str) -> tuple[trimesh.Trimesh, float | None]:
    def length(key: str) -> float:
        value = float(numbers(shape, key, (0.0,), where)[0])
        if not value > 0:
            raise RobotFileError(f"{where}: the {key} of its {shape.tag} is not above zero")
        return value

    if shape.tag == "box":
        size = numbers(shape, "size", (0.0, 0.0, 0.0), where)
        if not (size > 0).all():
            raise RobotFileError(f"{where}: the size of its box is not above zero")
        return trimesh.creation.box(extents=size), None
    if shape.tag == "sphere":
        return trimesh.creation.icosphere(subdivisions=3, radius=length("radius")), length("radius")
    if shape.tag in ("cylinder", "capsule"):
        make = getattr(trimesh.creation, shape.tag)
        mesh = make(height=length("length"), radius=length("radius"))
        mesh.apply_translation(-mesh.bounds.mean(axis=0))
        return mesh, length("radius")
    if shape.tag != "mesh":
        raise RobotFileError(f"{where}: a <{shape.tag}> is no shape of a URDF")
    mesh = _load(mesh_path(str(shape.get("filename"))), where).copy()
    mesh.apply_scale(numbers(shape, "scale", (1.0, 1.0, 1.0), where))
    return mesh, None


@lru_cache(maxsize=64)
def _load(path: Path, where: str) -> trimesh.Trimesh:
    try:
        with path.open("rb") as file:  # a file, not a path: then no texture beside it is read
            mesh = trimesh.load(
                file, file_type=path.suffix[1:].lower(), force="mesh", skip_materials=True
            )
    except Exception as error:  # the readers of the many formats have no common base of errors
        raise RobotFileError(f"{where}: mesh {path}: it cannot be read: {error}") from None
    if not isinstance(mesh, trimesh.Trimesh) or not len(mesh.vertices):
        raise RobotFileError(f"{where}: mesh {path}: it has no triangles")
    return mesh


def _hull(mesh: trimesh.Trimesh, where: str) -> trimesh.Trimesh:
    try:
        return mesh.convex_hull
    except Exception as error:  # qhull's own errors, for what is flat
        raise RobotFileError(f"{where}: a shape of it is flat: {str(error)[:80]}") from None


def _surface(hull: trimesh.Trimesh) -> Array:
    """Corners, then points spread evenly over the faces; always the same ones."""
    count = int(np.clip(hull.area / _SPACING**2, 50, _MOST_POINTS))
    spread = trimesh.sample.sample_surface(hull, count, seed=0)[0]
    corners = np.asarray(hull.vertices)
    if len(corners) > _MOST_POINTS:
        corners = corners[:: -(-len(corners) // _MOST_POINTS)]
    return np.vstack([corners, np.asarray(spread)])
