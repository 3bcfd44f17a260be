"""The shapes of a link with their convex hulls, and its inertia, in the frame of the link."""

import codecs
import re
from collections.abc import Mapping, Sequence
from functools import lru_cache
from pathlib import Path
from typing import NamedTuple
from xml.etree.ElementTree import Element, iterparse

import numpy as np
import pinocchio as pin
import trimesh

from app.errors import RobotFileError
from app.onboarding.fit.convex import convex_pieces
from app.onboarding.read.source import MESHES
from app.onboarding.read.tree import Arm, Tree
from app.robot.assets import floats, kind_of, refuse_placeholder, stated_stl
from app.robot.shapes import THIN, hull_mesh
from app.robot.urdf import numbers, origin, unit_of, urdf_mesh
from app.strict import Array

_LARGEST = 10.0  # [m] largest size of a shape
_SMALLEST = 1e-3  # [m] smallest size of a mesh
_DENSEST = 30_000.0  # [kg/m³] largest density of a link; gold has 19,300
_LIGHTEST = 2.0  # [kg/m³] smallest density of all links of a base or an arm; real ones have 200
_HEAVIEST = 100.0  # [kg] largest mass with any density: a shape may represent a part of its link
MOST_FACES = 40_000  # [-] triangles above which a mesh is simplified, but keeps its extent
_CELL = 3e-4  # [m] edge of the cells in which vertices of a larger mesh are merged
_MANY = 10_000  # [-] number of points above which a hull uses only the outermost ones
_HEAVY = 4_000_000  # [bytes] larger mesh files are converted to STL without merging equal vertices
_SPACING = 0.03  # [m] distance between points on the surface of a hull
_MAX_POINTS = 1500  # [-] largest number of corners, and of other points, on a hull
ARM_DENSITY = 1200.0  # [kg/m³] of the hulls of an arm's links; a Panda's have 1,000 to 1,500
BASE_DENSITY = 450.0  # [kg/m³] of the hulls of a base's links; a Husky has 400, an LD-60 480
_GUESS = 1.0  # [kg m²] largest moment of inertia that is a rough guess, for any mass
_GYRATION = 5.0, 10.0  # [m], [-] largest radius of gyration; the second is relative to the shapes
_OUTSIDE = 0.5, 2.0  # [m], [-] largest distance of a centre of mass; second relative to shapes
_ROUNDING = 1e-5  # [-] smallest excess of the sum of two moments over the third, relative to it
_TINY = 1e-9  # [kg] or [kg m²] largest value that counts as zero
_BEGIN = 1 << 16  # [bytes] length of the beginning of a file that is searched for damage
_MARK = codecs.BOM_UTF8  # which many readers take for a part of the first word
_COMMA = re.compile(rb"^[^#\n]*\d,\d", re.MULTILINE)  # not in a comment


class LinkShape(NamedTuple):
    """One shape of a link."""

    mesh: trimesh.Trimesh  # in the link's frame [m]; each part has up to about `MOST_FACES` faces
    hull: trimesh.Trimesh  # convex hull of the shape, in the link's frame [m]
    kind: str  # tag of the geometry; "piece" for a mesh after `in_pieces`
    radius: float | None  # [m] radius of a cylinder, sphere or capsule; None for other shapes

    @property
    def volume(self) -> float:
        """[m³] volume of the hull, or 0 if it is not thicker than `hull_mesh` makes flat hulls."""
        return float(self.hull.volume) if self.hull.volume > 0.51 * THIN * self.hull.area else 0.0


class LinkGeometry(NamedTuple):
    """The shapes of a link: its collision shapes or its visual ones, see `link_geometry`."""

    shapes: tuple[LinkShape, ...]
    seen_only: bool  # whether the shapes are visual ones

    @property
    def corners(self) -> Array:
        """(N, 3) [m] corners of all hulls, in the link's frame."""
        return np.vstack([np.zeros((0, 3)), *(np.asarray(s.hull.vertices) for s in self.shapes)])

    @property
    def surface(self) -> Array:
        """(N, 3) [m] corners and random points, up to 1,500 each per hull, in the link's frame."""
        points = [np.zeros((0, 3))]
        for hull in (shape.hull for shape in self.shapes):
            count = int(np.clip(hull.area / _SPACING**2, 50, _MAX_POINTS))
            step = -(-len(hull.vertices) // _MAX_POINTS)
            spread = trimesh.sample.sample_surface(hull, count, seed=0)[0]
            points += [np.asarray(hull.vertices)[::step], spread]
        return np.vstack(points)

    @property
    def volume(self) -> float:
        """[m³] sum of the hulls' volumes; that of a flat hull counts as 0."""
        return sum(s.volume for s in self.shapes)


Geometry = Mapping[str, LinkGeometry]  # by the names of the links


def read_geometry(tree: Tree) -> Geometry:
    """The geometry of each link; raises the RobotFileError of `link_geometry`."""
    return {name: link_geometry(link) for name, link in tree.links.items()}


def link_geometry(link: Element, tags: tuple[str, ...] = ("collision", "visual")) -> LinkGeometry:
    """The geometry of one link, from its elements with the first tag in `tags` that occurs. An
    invalid shape, also one that is probably not in metres, raises a RobotFileError.
    """
    for tag in tags:
        if elements := link.findall(tag):
            shapes = [_shape(each, f"link {link.get('name')!r}") for each in elements]
            return LinkGeometry(tuple(shapes), tag == "visual")
    return LinkGeometry((), False)


def _shape(element: Element, where: str) -> LinkShape:
    T = origin(element, where).homogeneous
    if (shape := element.find("geometry/*")) is None:
        why = f"{where}: a {element.tag} has no geometry"
        raise RobotFileError(f"{why}; add a geometry, or remove the {element.tag}")
    mesh, radius = urdf_mesh(shape, where, load_mesh)
    hull = _hull(mesh).apply_transform(T)
    size = float(np.ptp(trimesh.transform_points(mesh.vertices, T), axis=0).max())
    if size > _LARGEST:
        scale = 0.001 if unit_of(size) == "millimetres" else 0.0254
        why = f"{where}: its {shape.tag} is {size:.4g} m long: lengths of a URDF are in metres"
        helps = f'set scale="{scale} {scale} {scale}" for a mesh, or write metres'
        raise RobotFileError(f"{why}, this looks like {unit_of(size)}; {helps}")
    if shape.tag == "mesh" and size < _SMALLEST:
        stated = f" with scale={shape.get('scale')!r}" if shape.get("scale") else ""
        helps = "remove the scale of a mesh that is in metres, or correct the unit in its file"
        raise RobotFileError(f"{where}: its mesh is {1e3 * size:.2g} mm long{stated}; {helps}")
    return LinkShape(mesh.apply_transform(T), hull, shape.tag, radius)


def _hull(mesh: trimesh.Trimesh) -> trimesh.Trimesh:
    return hull_mesh(_outermost(np.asarray(mesh.vertices), 4))


def in_pieces(shape: LinkShape) -> list[LinkShape]:
    """The shape alone or, for a mesh, its nearly convex pieces."""
    if shape.kind != "mesh":
        return [shape]
    whole, pieces = shape._replace(kind="piece"), convex_pieces(shape.mesh)
    if len(pieces) < 2:
        return [whole]
    return [whole._replace(mesh=mesh, hull=_hull(mesh)) for mesh in pieces]


def swept_shape(shape: LinkShape, motions: Sequence[pin.SE3]) -> LinkShape:
    """The union of a shape's copies after `motions` in the link's frame, and its convex hull."""
    corners = np.asarray(shape.hull.vertices)
    hull = hull_mesh(np.vstack([corners @ T.rotation.T + T.translation for T in motions]))
    meshes = [shape.mesh.copy().apply_transform(T.homogeneous) for T in motions]
    return shape._replace(mesh=trimesh.util.concatenate(meshes), hull=hull, radius=None)


def read_mesh(path: Path) -> trimesh.Trimesh:
    """The triangles [m] of all parts of a mesh file; a part with many triangles is simplified. A
    RobotFileError is raised if the content of the file is invalid, or has no triangles.
    """
    name, begin = f"mesh {path}", b""
    end, size = path.suffix[1:].lower() or "stl", path.stat().st_size
    try:
        with path.open("rb") as raw:  # a file, not a path, so that no texture is read
            begin = raw.read(_BEGIN)
            if end != "3mf":  # which is an archive
                refuse_placeholder(begin, name)
            if end == "dae":
                _states_unit(path)
            raw.seek(len(_MARK) if begin.startswith(_MARK) else 0)
            scene = trimesh.load(
                raw, file_type=end, force="scene", skip_materials=True, process=False
            )
        assert isinstance(scene, trimesh.Scene)
        scale = trimesh.units.unit_conversion(scene.units or "meters", "meters")
        for part, mesh in scene.geometry.items():
            if not np.isfinite(mesh.vertices).all():  # libraries read these in different ways
                raise ValueError("a coordinate is not a finite number")
            if isinstance(mesh, trimesh.Trimesh):
                merged = mesh.process() if size < _HEAVY else mesh
                scene.geometry[part] = _lightened(merged, _CELL / scale)
        joined = scene.to_mesh()
        if not len(joined.faces):
            raise ValueError("it has no triangles")
        return joined.apply_scale(scale)
    except (RobotFileError, MemoryError, PermissionError):
        raise
    except ImportError as error:
        raise RobotFileError(f"{name}: {error}; install it, or convert the mesh to .stl") from None
    except Exception as error:  # the readers' errors have no common base class
        raw = isinstance(error, (AttributeError, IndexError, KeyError, TypeError))
        why = "it is damaged or has no triangles" if raw else " ".join(str(error).split())
        why += _damage(error, begin, size, end) or "; export it again"
        raise RobotFileError(f"{name}: it cannot be read as .{end}: {why}") from None


load_mesh = lru_cache(maxsize=64)(read_mesh)


def _damage(error: Exception, begin: bytes, size: int, end: str) -> str:
    """Advice for an unreadable mesh file, or empty; `begin`: its first bytes, `end`: its suffix."""
    if (kind := kind_of(begin, size)) and f"(.{end})" not in kind:
        return f"; it is {kind}: {'rename it, or ' * ('mesh' in kind)}convert it to .stl"
    if end == "gltf":  # for a damaged file, trimesh looks for another .gltf
        if isinstance(error, FileNotFoundError) and not str(error).endswith(".gltf"):
            return " is missing beside it: add this file, or export the mesh as .glb"
        return "; it is damaged: export it again"
    if b"\0" not in begin and _COMMA.search(begin):
        return "; its numbers have decimal commas: export it with points"
    facets, stated = stated_stl(begin)
    if end == "stl" and b"\0" in begin and size != stated:
        expected = f"it states {facets:,} triangles, which are {stated:,} bytes"
        return f"; {expected}, but it has {size:,} bytes: copy or export it again"
    return ""


def _states_unit(path: Path) -> bool:
    """Whether a COLLADA file is damaged, not in metres, or states x or y upwards. A RobotFileError
    is raised if the file states a unit that is not a number above zero.
    """
    try:
        with path.open("rb") as file:  # the file's own <asset> is the first one
            asset = next((e for _, e in iterparse(file) if e.tag.endswith("asset")), Element(""))
    except (SyntaxError, ValueError, LookupError):  # XML that is not well-formed; an encoding
        return True
    unit, up = asset.find("{*}unit"), asset.findtext("{*}up_axis", "").strip()
    metres = floats("1" if unit is None else unit.get("meter", "1"), 1)
    if not metres or metres[0] <= 0.0:
        raise RobotFileError(f"mesh {path}: the meter of its <unit> should be a number above zero")
    return metres != [1.0] or up in ("X_UP", "Y_UP")


def is_foreign(path: Path) -> bool:
    """Whether a mesh has to become an STL file: other libraries misread it, or are very slow."""
    end, large = path.suffix.lower(), path.stat().st_size > _HEAVY
    with path.open("rb") as file:
        marked = file.read(len(_MARK)) == _MARK
    return marked or large or end not in MESHES or (end == ".dae" and _states_unit(path))


def _lightened(mesh: trimesh.Trimesh, cell: float) -> trimesh.Trimesh:
    """The mesh or, if it has more than `MOST_FACES` triangles, one of at most about that many, with
    nearly the same hull. In `mesh`, vertices in cubic cells with the edge `cell` or larger merge.
    """
    if len(mesh.faces) <= MOST_FACES:
        return mesh
    _merge(mesh, cell)
    outermost = _outermost(np.asarray(mesh.vertices), 3)
    while len(mesh.faces) > 10 * MOST_FACES:  # the simplification needs 300 bytes per triangle
        cell *= 2.0
        _merge(mesh, cell)
    if len(mesh.faces) > MOST_FACES:
        mesh = mesh.simplify_quadric_decimation(face_count=MOST_FACES, aggression=5)
    return trimesh.Trimesh(np.vstack([mesh.vertices, outermost]), mesh.faces, process=False)


def _merge(mesh: trimesh.Trimesh, cell: float) -> None:
    points = np.asarray(mesh.vertices)
    keys = ((points - points.min(axis=0)) / cell).astype(np.int64) @ [1 << 42, 1 << 21, 1]
    _, first, own = np.unique(keys, return_index=True, return_inverse=True)
    faces = own[np.asarray(mesh.faces)]
    faces = faces[np.all(faces != np.roll(faces, 1, axis=1), axis=1)]
    mesh.vertices, mesh.faces = points[first], faces  # frees the former arrays


def _outermost(points: Array, fineness: int) -> Array:
    """The farthest points in 642 (`fineness` 3) or 2,562 (4) directions; all of up to `_MANY`."""
    if len(points) <= _MANY:
        return points
    D = np.asarray(trimesh.creation.icosphere(subdivisions=fineness).vertices)
    return points[np.unique([int((points @ d).argmax()) for d in D])]


class LinkInertia(NamedTuple):
    """The inertia of a link."""

    inertia: pin.Inertia
    assumed: str  # how the inertia was estimated; empty if the URDF states it, or if it is zero


def read_inertias(
    tree: Tree, arm: Arm, geometry: Geometry, *, assume: bool
) -> dict[str, LinkInertia]:
    """The inertia of the base and of each link below it, by the name of the link. A link without an
    `<inertial>` gets a mass by its volume. So do the links from one joint of the arm to the next if
    their total mass is 0. A RobotFileError is raised if an inertia is impossible or probably in
    another unit, and, unless `assume` is true, if no link of the arm has a mass.
    """
    stated = {link: _stated(tree.links[link]) for link in tree.below(arm.base)}
    moving = [link for segment in arm.segments[1:] for link in segment]
    massive = {k: each for k, each in stated.items() if each and each.mass > _TINY}
    solid = {link: each for link, each in massive.items() if geometry[link].volume > 0.0}
    for link, each in solid.items():
        _check_inertia(f"link {link!r}", each, geometry[link])
    for part in (arm.base_links, moving):
        links = [link for link in part if link in solid]
        mass = sum(solid[link].mass for link in links)
        volume = sum(geometry[link].volume for link in links)
        if mass < _LIGHTEST * volume:
            why = f"{mass:.3g} kg in {1e3 * volume:.3g} l in total looks like tonnes"
            helps = "without an <inertial> of a link, its mass is assumed from its volume"
            why += f"; masses of a URDF are in kilograms; {helps}"
            raise RobotFileError(f"links {', '.join(links)}: {why}")
    if not assume and massive.keys().isdisjoint(moving):
        why = "no link of the arm has a mass: torques cannot be computed"
        helps = f"--assume-inertia to assume {ARM_DENSITY:g} kg/m³ in the hulls of its links"
        raise RobotFileError(f"{why}; add <inertial>, or set {helps}")
    dense = {link: BASE_DENSITY if link in arm.base_links else ARM_DENSITY for link in stated}
    found = {link: _chosen(each, geometry[link], dense[link]) for link, each in stated.items()}
    for links in arm.segments[1:]:  # each joint has to move a mass
        if sum(found[link].inertia.mass for link in links) <= _TINY:
            found |= {link: _chosen(None, geometry[link], ARM_DENSITY) for link in links}
    return found


def _check_inertia(where: str, stated: pin.Inertia, shapes: LinkGeometry) -> None:
    """Refuse an inertia that is impossible for its link's shapes; `where` names the link."""
    low, high = shapes.corners.min(axis=0), shapes.corners.max(axis=0)
    size, most = float(np.linalg.norm(high - low)), float(np.abs(stated.inertia).max())
    away = float(np.linalg.norm(stated.lever - stated.lever.clip(low, high)))
    if stated.mass > max(_HEAVIEST, _DENSEST * shapes.volume):
        why = f"a mass of {stated.mass:g} kg in {1e3 * shapes.volume:.3g} l looks like grams"
    elif away > max(_OUTSIDE[0], _OUTSIDE[1] * size):
        why = f"a centre of mass {away:.3g} m away from its shapes, which are {size:.2g} m long, "
        why += "looks like centimetres or millimetres"
    elif most > _GUESS and most > stated.mass * max(_GYRATION[0], _GYRATION[1] * size) ** 2:
        why = f"a moment of inertia of {most:.3g} kg m² of {stated.mass:g} kg in a shape of "
        why += f"{size:.2g} m looks like kg mm²"
    else:
        return
    units = "masses of a URDF are in kilograms, lengths in metres, moments of inertia in kg m²"
    raise RobotFileError(f"{where}: {why}; {units}")


def _chosen(stated: pin.Inertia | None, geometry: LinkGeometry, density: float) -> LinkInertia:
    """The stated inertia, with moments of the hull if only a mass is stated; if none is stated, an
    inertia by volume. A link without volume has the stated inertia, or zero.
    """
    if geometry.volume == 0.0:
        return LinkInertia(stated or pin.Inertia.Zero(), "")
    if stated is None:
        return LinkInertia(_of_volume(geometry, density), f"{density:g} kg/m³ in its hull")
    if stated.mass <= _TINY or np.abs(stated.inertia).max() > _TINY:
        return LinkInertia(stated, "")
    shape = _of_volume(geometry, 1.0)
    spread = pin.Inertia(stated.mass, stated.lever, shape.inertia * (stated.mass / shape.mass))
    return LinkInertia(spread, "its mass spread over its hull")


def _of_volume(geometry: LinkGeometry, density: float) -> pin.Inertia:
    """The inertia of solid hulls, or of one hull around all shapes if that has a smaller volume."""
    hulls = [shape.hull for shape in geometry.shapes if shape.volume > 0.0]
    around = hull_mesh(geometry.corners)
    if around.volume < sum(hull.volume for hull in hulls):
        hulls = [around]
    total = pin.Inertia.Zero()
    for hull in hulls:  # trimesh computes mass and moments with the density 1
        total += pin.Inertia(density * hull.mass, hull.center_mass, density * hull.moment_inertia)
    return total


def _stated(link: Element) -> pin.Inertia | None:
    """A link's stated inertia in its frame, with valid moments, or None; refuses a negative one."""
    element, where = link.find("inertial"), f"link {link.get('name')!r}"
    if element is None:
        return None
    mass = float(numbers(element.find("mass"), "value", (0.0,), where)[0])
    keys = ("ixx", "ixy", "iyy", "ixz", "iyz", "izz")  # in the order of pinocchio
    values = [numbers(element.find("inertia"), key, (0.0,), where)[0] for key in keys]
    I = pin.Symmetric3(np.array(values)).matrix()
    moments, axes = np.linalg.eigh(I)
    if mass < 0 or moments.min() < -1e-6 * max(1.0, np.abs(I).max()):
        listed = ", ".join(f"{value:.3g}" for value in moments)
        why = f"{where}: a mass of {mass:g} kg with moments of inertia of {listed} kg m²"
        raise RobotFileError(f"{why} is impossible: no value may be negative")
    moments = np.maximum(moments, 0.0)
    short = moments[2] * (1 + _ROUNDING) - moments[0] - moments[1]
    if short > 0:  # pybullet replaces moments that violate the triangle inequality by zero
        moments[:2] += short / 2
        I = axes @ np.diag(moments) @ axes.T
    return origin(element, where).act(pin.Inertia(mass, np.zeros(3), I))
