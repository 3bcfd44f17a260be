"""Functions that read elements of a URDF: numbers, poses, triangles and colours."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING
from xml.etree.ElementTree import Element

import numpy as np
import pinocchio as pin

from app.errors import RobotFileError, did_you_mean, named_part
from app.jobs.bounded import SMALL
from app.robot.assets import floats, resolve_package_uri
from app.strict import Array

if TYPE_CHECKING:
    import trimesh

_ATTRIBUTES = {  # of elements in which a missing attribute means a default
    "origin": ("xyz", "rpy", "quat_xyzw"),
    "axis": ("xyz",),
    "limit": ("lower", "upper", "effort", "velocity", "acceleration", "deceleration", "jerk"),
    "mimic": ("joint", "multiplier", "offset"),
    "mass": ("value",),
    "inertia": ("ixx", "ixy", "ixz", "iyy", "iyz", "izz"),
}


def unit_of(length: float) -> str:
    """Probable unit of a length too large in m: `millimetres` or `inches or centimetres`."""
    return "millimetres" if length >= 60.0 else "inches or centimetres"


def only_rpy(robot: Element) -> None:
    """Replace `quat_xyzw`, which few libraries read, by `rpy` in each `<origin>`. A RobotFileError
    is raised if a `quat_xyzw` is not four numbers, is zero or is beside an `rpy`.
    """
    for part in (*robot.findall("link"), *robot.findall("joint")):
        for at in (each for each in part.iter("origin") if "quat_xyzw" in each.attrib):
            where = f"{part.tag} {part.get('name')!r}"
            x = numbers(at, "quat_xyzw", (0.0, 0.0, 0.0, 1.0), where)
            if "rpy" in at.attrib or not 0.0 < (length := float(np.linalg.norm(x))) < np.inf:
                raise RobotFileError(f"{where}: quat_xyzw is zero, or beside rpy: write only one")
            del at.attrib["quat_xyzw"]
            rpy = pin.rpy.matrixToRpy(pin.Quaternion(x / length).matrix())
            at.set("rpy", " ".join(map(str, rpy.tolist())))


def origin(element: Element, where: str) -> pin.SE3:
    """The `<origin>` [m] of an element, or the identity; `where` begins the message of an error.

    Raises a RobotFileError if an attribute is not three numbers, an angle exceeds 4π rad or a
    coordinate 10 m.
    """
    at = element.find("origin")
    rpy = numbers(at, "rpy", (0.0, 0.0, 0.0), where)
    if np.abs(rpy).max() > 4 * np.pi:
        why = f'{where}: rpy="{" ".join(f"{angle:g}" for angle in rpy)}" looks like degrees'
        raise RobotFileError(f"{why}; angles of a URDF are in radians: 90 degrees are 1.5708")
    xyz = numbers(at, "xyz", (0.0, 0.0, 0.0), where)
    if (far := float(np.abs(xyz).max())) > 10.0:
        why = f"{where}: its origin is {far:g} m away: lengths of a URDF are in metres"
        raise RobotFileError(f"{why}, these look like {unit_of(far)}")
    return pin.SE3(pin.rpy.rpyToMatrix(*rpy), xyz)


def numbers(element: Element | None, key: str, default: tuple[float, ...], where: str) -> Array:
    """The numbers of an attribute `key`, or the default if element or attribute is missing.

    Raises the RobotFileError of `stated`; also one, which begins with `where`, if the attribute
    does not have as many finite numbers as the default.
    """
    if (words := stated(element, key, where)) is None:
        return np.array(default)
    if (values := floats(words, len(default))) is None:
        wanted = "a number" if len(default) == 1 else f"{len(default)} numbers"
        raise RobotFileError(f"{where}: {key}={words!r} should be {wanted}{without_commas(words)}")
    return np.array(values)


def stated(element: Element | None, key: str, where: str) -> str | None:
    """The text of an attribute, or None if it is missing. If an element of `_ATTRIBUTES` then has
    an unknown attribute, maybe a misspelling, a RobotFileError that begins with `where` is raised.
    """
    if element is None or key in element.attrib:
        return None if element is None else element.get(key)
    known = _ATTRIBUTES.get(element.tag, element.attrib)
    if odd := next((name for name in element.attrib if name not in known and name[0] != "{"), ""):
        why = f"{where}: a URDF has no attribute {odd!r} of <{element.tag}>"
        raise RobotFileError(f"{why}{did_you_mean(odd, known)}; it has {', '.join(known)}")
    return None


def without_commas(words: str) -> str:
    """Advice for an error message if a text of numbers has a comma, otherwise an empty text."""
    return "; write points in numbers and blanks between them, no commas" * ("," in words)


def colour(visual: Element, materials: Mapping[str | None, Element]) -> list[float] | None:
    """`rgba` of a visual's material, or else of its namesake in `materials`; None without any."""
    if (material := visual.find("material")) is None:
        return None
    return rgba(material) or rgba(materials.get(material.get("name"), material))


def rgba(material: Element) -> list[float] | None:
    """Red, green, blue and opacity [0, 1] of a material; None without three or four numbers.

    Colours up to 255, commas and a missing opacity are accepted, because these mistakes are common.
    """
    found = material.find("color")
    stated = "" if found is None else found.get("rgba", "").replace(",", " ")
    if (values := floats(stated, 4) or floats(stated, 3)) is None:
        return None
    scale = 1.0 if max(values[:3]) <= 1.0 else 255.0
    opacity = min(1.0, values[3]) if len(values) == 4 else 1.0
    return [min(1.0, max(0.0, value / scale)) for value in values[:3]] + [max(0.0, opacity)]


def mesh_path(address: str) -> Path:
    """The file of a mesh's address, `package://…` or a path; errors of `resolve_package_uri`."""
    return resolve_package_uri(address) if address.startswith("package://") else Path(address)


def mesh_bytes(links: Iterable[Element]) -> int:
    """[bytes] size of the links' mesh files, with `.bin` files beside a `.gltf`; 0 without a file,
    else at least `SMALL` + 1: few bytes can encode many triangles. Errors: as `mesh_path`.
    """
    named = {mesh.get("filename", "") for link in links for mesh in link.iter("mesh")} - {""}
    files = {path for path in map(mesh_path, named) if path.is_file()}
    folders = {path.parent for path in files if path.suffix.lower() == ".gltf"}
    files.update(*(folder.glob("*.bin") for folder in folders))
    sizes = [path.stat().st_size for path in files]
    return max(SMALL + 1, sum(sizes)) if sizes else 0


def urdf_mesh(
    shape: Element, where: str, load: Callable[[Path], trimesh.Trimesh]
) -> tuple[trimesh.Trimesh, float | None]:
    """Triangles and radius [m] of an element such as `<box>`; the radius of a box or mesh is None.

    `load` reads the triangles of a mesh file. Raises the errors of `load` and
    `resolve_package_uri`, and a RobotFileError, which begins with `where`, if element or attributes
    are invalid.
    """
    if shape.tag != "mesh":
        return primitive(shape, where)
    if not (address := shape.get("filename")):
        raise RobotFileError(f"{where}: a mesh has no filename")
    scale = numbers(shape, "scale", (1.0, 1.0, 1.0), where)
    with named_part(where):
        return load(mesh_path(address)).copy().apply_scale(scale), None


def primitive(shape: Element, where: str) -> tuple[trimesh.Trimesh, float | None]:
    """As `urdf_mesh`, for a box, sphere, cylinder or capsule; any other element is an error."""
    from trimesh import creation  # a slow import

    def sizes(key: str, count: int = 1) -> Array:
        if key not in shape.attrib:
            raise RobotFileError(f"{where}: its {shape.tag} has no {key}")
        found = numbers(shape, key, (0.0,) * count, where)
        if not (found > 0).all():
            raise RobotFileError(f"{where}: the {key} of its {shape.tag} is not above zero")
        return found

    if shape.tag == "box":
        return creation.box(extents=sizes("size", 3)), None
    if shape.tag not in ("sphere", "cylinder", "capsule"):
        raise RobotFileError(f"{where}: a <{shape.tag}> is not a shape of a URDF")
    radius = float(sizes("radius")[0])
    if shape.tag == "sphere":
        return creation.icosphere(subdivisions=3, radius=radius), radius
    mesh = getattr(creation, shape.tag)(height=float(sizes("length")[0]), radius=radius)
    mesh.apply_translation(-mesh.bounds.mean(axis=0))
    return mesh, radius
