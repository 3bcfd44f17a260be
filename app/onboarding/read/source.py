"""A URDF or xacro file as XML, its meshes found; from a path or an installed package."""

from __future__ import annotations

import os
import re
import unicodedata
from collections.abc import Iterator, Mapping
from importlib.util import find_spec
from itertools import chain
from os.path import isdir, isfile  # False also for a name that is too long for a file
from pathlib import Path
from urllib.parse import unquote
from xml.etree import ElementTree
from xml.etree.ElementTree import Element

from app.errors import RobotFileError, closest
from app.jobs.bounded import within_budget
from app.robot.assets import (
    floats,
    followed,
    package_roots,
    refuse_entities,
    refuse_placeholder,
    resolve_package_uri,
    share_folders,
    xml_text,
)
from app.strict import LARGEST_TEXT

MESHES = (".stl", ".dae", ".obj")
"""Endings of mesh files that pybullet reads."""
FORMATS = (*MESHES, ".glb", ".gltf", ".ply", ".off", ".3mf", "")
"""Endings of readable meshes; for the others `new-robot` writes an STL. Some files have none."""
_SCHEMES = ("package", "model", "file", "")
_ABOVE = 2  # [-] folders above the URDF's for relative paths


def locate(source: str) -> Path:
    """The file of a path or a `package://…` address.

    Raises:
        RobotFileError: The file does not exist.
        AssetError: The package is not installed.
    """
    scheme, rest = split_address(source)
    path = Path(os.path.expanduser(rest if scheme == "file" else source))
    path = resolve_package_uri(source) if scheme == "package" else path
    if not isfile(path):
        raise RobotFileError(
            f"{source}: no such file; give a URDF, a xacro, a zip or package://PACKAGE/…"
        )
    return followed(path)


def read_robot(
    path: Path, packages: Mapping[str, Path] | None = None, /, **arguments: str
) -> tuple[Element, list[str]]:
    """The `<robot>` of `read_source`, with an address for `mesh_path` in place of each mesh.

    The second value has sentences on left-out shapes.

    Raises:
        RobotFileError: As for `read_source`, or a mesh is not found.
    """
    robot = read_source(path, packages, **arguments)
    said = []
    for link in robot.findall("link"):
        for tag in ("visual", "collision"):
            for element in link.findall(tag):
                if why := _needless(element, link, path.parent, packages):
                    link.remove(element)
                    said.append(f"a {tag} of {link.get('name')} is left out: {why}")
    return robot, said


def _needless(
    element: Element, link: Element, folder: Path, packages: Mapping[str, Path] | None
) -> str:
    """Why a visual or collision is left out, or empty; a mesh that stays gets its address.

    A placeholder of size 0 is left out, and a visual whose mesh cannot be had, if the link also
    has a collision shape.
    """
    if (shape := element.find("geometry/*")) is None:
        return ""
    sizes = [shape.get(key) for key in ("size", "radius", "length", "scale")]
    stated = [floats(size, n) for size in sizes if size is not None for n in (1, 3)]
    if not all(all(each or (1.0,)) for each in stated):
        return f"its {shape.tag} has the size 0"
    if shape.tag != "mesh":
        return ""
    try:
        if not (file := shape.get("filename", "")):
            raise RobotFileError(
                f"link {link.get('name')!r}: a mesh has no filename; name its file, or take "
                "the shape out"
            )
        shape.set("filename", mesh_address(file, folder, packages))
    except RobotFileError as error:
        if element.tag == "collision" or link.find("collision") is None:
            raise
        return str(error)
    return ""


def read_source(
    path: Path, packages: Mapping[str, Path] | None = None, /, **arguments: str
) -> Element:
    """The `<robot>` of a URDF, or of a xacro with its arguments by name.

    Named folders of ROS packages have precedence over all others.

    Raises:
        RobotFileError: It is not well-formed XML, declares entities, is not a robot, or its macros
            cannot be expanded.
    """
    text = (
        _expanded(path, packages or {}, arguments)
        if path.suffix.lower() == ".xacro"
        else xml_text(path)
    )
    refuse_entities(text, path)
    robot = _without_namespace(ElementTree.fromstring(text))
    for each in robot.iter():
        each.attrib = {key: value.strip() for key, value in each.items()}  # blanks are no names
    if robot.tag != "robot":
        raise RobotFileError(f"{path}: its root is <{robot.tag}>, a URDF's is <robot>")
    if left := _unexpanded(robot):
        raise RobotFileError(
            f"{path}: {left} is unexpanded xacro; rename it to .xacro, or: xacro FILE -o robot.urdf"
        )
    return robot


def _without_namespace(robot: Element) -> Element:
    """Remove the root's own namespace from the names of elements, as other readers do."""
    own = robot.tag.rpartition("}")[0] + "}"
    for each in robot.iter() if len(own) > 1 else ():
        if isinstance(each.tag, str):
            each.tag = each.tag.removeprefix(own)
    return robot


def _unexpanded(robot: Element) -> str:
    """The first macro or expression of a xacro in a robot, or empty."""
    for each in robot:
        namespace, _, tag = str(each.tag).rpartition("}")
        if namespace.endswith("xacro"):
            return f"<xacro:{tag}>"
        if tag in ("link", "joint"):
            values = (value for part in each.iter() for value in part.attrib.values())
            if left := next((value for value in values if "${" in value or "$(" in value), ""):
                return left
    return ""


def mesh_address(reference: str, folder: Path, packages: Mapping[str, Path] | None = None) -> str:
    """The address of a mesh: `package://…` if its package is installed, otherwise its path.

    Escapes such as `%20`, backslashes and accents are read in the sense of other programs.

    Raises:
        RobotFileError: The file does not exist, has an unreadable format, or a placeholder is in
            its place.
    """
    for spelling in spellings(reference):
        found = next((p for p in _places(spelling, folder, packages or {}) if isfile(p)), None)
        if found is not None:
            if found.suffix.lower() not in FORMATS:
                known = ", ".join(FORMATS[:-1])
                raise RobotFileError(f"mesh {reference}: {known} are read; convert it to one")
            if found.suffix.lower() != ".3mf":  # an archive
                with found.open("rb") as file:
                    refuse_placeholder(file.read(1024), f"mesh {found}")
            return _installed_address(found) or str(followed(found))
    why = _missing(spellings(reference)[-1], folder, packages or {})
    raise RobotFileError(f"mesh {reference}: {why}")


def spellings(reference: str) -> list[str]:
    """An address, without escapes and backslashes, and in Unicode's normal forms."""
    plain = reference.strip()
    slashed = plain.replace("\\", "/")
    meant = (plain, unquote(plain), slashed, unquote(slashed))
    normal = (unicodedata.normalize(form, each) for form in ("NFD", "NFC") for each in meant)
    return [*dict.fromkeys((*meant, *normal))]


def split_address(reference: str) -> tuple[str, str]:
    """Scheme and path of an address; a Windows drive is no scheme, two slashes are one."""
    scheme, mark, rest = reference.partition(":")
    if not mark or len(scheme) == 1:
        return "", reference
    path = re.sub("//+", "/", rest.removeprefix("//"))
    return scheme.lower(), path.removeprefix("localhost") if scheme == "file" else path


def _places(reference: str, folder: Path, packages: Mapping[str, Path]) -> Iterator[Path]:
    """Possible places of a mesh: its package, beside the URDF, or beside a folder above it."""
    scheme, path = split_address(reference)
    if scheme in ("package", "model"):
        package, _, inner = path.lstrip("/").partition("/")
        yield from (root / inner for root in _package_folders(package, folder, packages))
    elif scheme in _SCHEMES:
        yield from (each / path for each in (folder, *list(folder.parents)[:_ABOVE]))


def _missing(reference: str, folder: Path, packages: Mapping[str, Path]) -> str:
    """Why no file is found for an address, with a correction."""
    scheme, path = split_address(reference)
    if scheme in ("package", "model"):
        package, _, inner = path.lstrip("/").partition("/")
        roots = [*dict.fromkeys(_package_folders(package, folder, packages))]
        if not roots:
            return _nowhere(package, inner, folder)
        where = f"no such file in the package {package!r}: {', '.join(map(str, roots))}"
        near = next(filter(None, (_near(root, inner) for root in roots)), "")
        return f"{where}{near}; if another folder is meant, give --package {package}=FOLDER"
    if scheme not in _SCHEMES:
        return "an address of the web or of another tool; name a file, relative to the URDF"
    if re.match("/?[A-Za-z]:", path):
        return "a path of another machine, of Windows; name the file relative to the URDF"
    return f"there is no file {folder / path}{_near(folder, path)}"


def _near(root: Path, path: str) -> str:
    """` (did you mean 'x'?)` for the closest path below a folder, or an empty string."""
    found = Path()
    for part in Path(path).parts:
        names = [part] if part == ".." else [each.name for each in (root / found).glob("*")]
        if not (name := closest(part, names)):
            return ""
        found /= name
    return "" if found == Path(path) else f" (did you mean {found.as_posix()!r}?)"


def _installed_address(path: Path) -> str | None:
    """`package://…` of a file that belongs to an installed package, or None."""
    full = path.resolve()
    for share in share_folders():
        if full.is_relative_to(share.resolve()):
            return f"package://{full.relative_to(share.resolve()).as_posix()}"
    for parent in full.parents:
        roots = [root.resolve() for root in package_roots(parent.name)] if parent.name else []
        if parent in roots:
            return f"package://{parent.name}/{full.relative_to(parent).as_posix()}"
    return None


def _nowhere(package: str, inner: str, folder: Path) -> str:
    """The places where a package was searched for a file's reference, with a correction."""
    holder = next((each for each in (folder, *folder.parents) if isfile(each / inner)), None)
    found = "FOLDER" if holder is None else f"{holder}, which holds a file of that path"
    return (
        f"the package {package!r} is no folder beside or above {folder}, is not in "
        "ROS_PACKAGE_PATH or AMENT_PREFIX_PATH, and is not installed; "
        f"give --package {package}={found}"
    )


def _package_folders(package: str, folder: Path, packages: Mapping[str, Path]) -> Iterator[Path]:
    """The named folder, then those upwards, of ROS's search paths, and installed ones."""
    if package in packages:
        yield packages[package]
        return
    for parent in (folder, *folder.parents):
        beside = (each.parent for each in parent.glob("*/package.xml"))
        for each in chain((parent, parent / package), beside):
            if isdir(each) and package in (each.name, _stated_name(each)):
                yield each
    for top in _ros_folders():
        yield from (each for each in (top / package, *top.glob(f"*/{package}")) if isdir(each))
        if top.name == package:
            yield top
    yield from package_roots(package)


def _stated_name(folder: Path) -> str:
    """A package's name in its `package.xml`, or empty; a download's folder may have another one."""
    try:
        with (folder / "package.xml").open("rb") as file:
            found = re.search(rb"<name>\s*([\w.-]+)", file.read(1 << 16))
    except OSError:
        return ""
    return found[1].decode() if found else ""


def _ros_folders() -> list[Path]:
    """Folders of packages in ROS_PACKAGE_PATH (ROS 1) and AMENT_PREFIX_PATH (ROS 2)."""
    first, second = (
        [Path(each) for each in os.environ.get(name, "").split(os.pathsep) if each]
        for name in ("ROS_PACKAGE_PATH", "AMENT_PREFIX_PATH")
    )
    return list(filter(Path.is_dir, [*first, *(prefix / "share" for prefix in second)]))


def _expanded(path: Path, packages: Mapping[str, Path], arguments: Mapping[str, str]) -> str:
    """A xacro file's URDF; packages are searched as for meshes."""
    if find_spec("xacrodoc") is None:
        raise RobotFileError(
            f"{path}: a xacro needs the package xacrodoc; try: pip install 'xacrodoc>=2,<3'"
        )
    refuse_entities(xml_text(path), path)
    known = _around(path) | {name: str(at) for name, at in packages.items()}
    try:
        return within_budget(_urdf_of, path, known, dict(arguments), size=LARGEST_TEXT)
    except Exception as error:  # xacro's errors have no common base class
        why = " ".join(str(error).split())
        if missing := re.search(r"Package not found: (\S+)", why):
            if missing[1] not in packages and (roots := package_roots(missing[1])):
                return _expanded(path, {**packages, missing[1]: roots[0]}, arguments)
            named = rf"\$\(find {re.escape(missing[1])}\)/([^\"']+)"
            inner = re.search(named, xml_text(path))
            where = _nowhere(missing[1], inner[1] if inner else "", path.parent)
            raise RobotFileError(f"{path}: {where}") from None
        lacking = "substitution arg" in why  # no option can correct a property or old syntax
        helps = "give it by --xacro NAME=VALUE" if lacking else "mend it until xacro FILE takes it"
        raise RobotFileError(f"{path}: xacro cannot expand it: {why}; {helps}") from None


def _urdf_of(path: Path, packages: Mapping[str, str], arguments: Mapping[str, str]) -> str:
    """A xacro's URDF by its library; macros can produce unlimited text, and compute for ever."""
    from xacrodoc import XacroDoc
    from xacrodoc import packages as known

    known.update_package_cache(packages)
    document = XacroDoc.from_file(str(path), subargs=arguments, resolve_packages=False)
    return document.to_urdf_string()


def _around(path: Path) -> dict[str, str]:
    """Folders that may be packages of a xacro: those beside the folders above it, nearest first."""
    found: dict[str, str] = {}
    for parent in [*list(path.parents)[1:5], *_ros_folders(), *share_folders()]:
        for folder in sorted(parent.glob("*")):  # of a folder that may not be read: none
            if isdir(folder) and not folder.name.startswith((".", "_")):
                for name in filter(None, (folder.name, _stated_name(folder))):
                    found.setdefault(name, str(folder))
    return found
