"""A URDF or xacro file as XML, its meshes found; from a path or an installed package."""

from __future__ import annotations

import os
import re
from collections.abc import Iterator, Mapping
from os.path import isdir, isfile  # False also for a name that is too long for a file
from pathlib import Path
from xml.etree import ElementTree
from xml.etree.ElementTree import Element

from app.errors import RobotFileError, did_you_mean
from app.robot.assets import package_roots, refuse_entities, resolve_package_uri, share_folders

MESHES = (".stl", ".dae", ".obj")
"""Ends of the names of meshes that pybullet reads."""


def locate(source: str) -> Path:
    """The file of a path or a `package://…` address.

    Raises:
        RobotFileError: There is no such file.
        AssetError: The package is not installed.
    """
    path = resolve_package_uri(source) if source.startswith("package://") else Path(source)
    if not isfile(path):
        raise RobotFileError(
            f"{source}: no such file; give a URDF, a xacro, a zip or package://PACKAGE/…"
        )
    return path.resolve()


def read_robot(
    path: Path, packages: Mapping[str, Path] | None = None, /, **arguments: str
) -> Element:
    """The `<robot>` of `read_source`, each mesh by an address that `mesh_path` takes.

    Raises:
        RobotFileError: As `read_source`, or a mesh is not found.
    """
    robot = read_source(path, packages, **arguments)
    for mesh in robot.iterfind("link//mesh"):
        mesh.set("filename", mesh_address(mesh.get("filename", ""), path.parent, packages))
    return robot


def read_source(
    path: Path, packages: Mapping[str, Path] | None = None, /, **arguments: str
) -> Element:
    """The `<robot>` of a URDF, or of a xacro with its arguments by name.

    Folders of ROS packages that are given by name come before all others.

    Raises:
        RobotFileError: It is not well-formed XML, declares entities, is not a robot, or its macros
            cannot be expanded.
    """
    try:
        text = (
            _expanded(path, packages or {}, arguments)
            if path.suffix == ".xacro"
            else path.read_text(encoding="utf-8")
        )
    except UnicodeDecodeError as error:
        raise RobotFileError(f"{path}: {error}; save it as UTF-8") from None
    refuse_entities(text, path)
    robot = ElementTree.fromstring(text)
    if robot.tag != "robot":
        raise RobotFileError(f"{path}: its root is <{robot.tag}>, a URDF's is <robot>")
    if left := _unexpanded(robot):
        raise RobotFileError(
            f"{path}: {left} is xacro that nobody expanded; rename it to .xacro, or: "
            "xacro FILE -o robot.urdf"
        )
    return robot


def _unexpanded(robot: Element) -> str:
    """The first of a xacro's macros or expressions among what a robot is made of, or nothing."""
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
    """A mesh that a URDF in a folder names: by `package://…` if it is installed, else by its path.

    Raises:
        RobotFileError: There is no such file.
    """
    if reference.startswith(("package://", "model://")):
        package, _, inner = reference.partition("://")[2].partition("/")
        path = _in_package(package, inner, folder, packages or {}, reference)
    else:
        path = Path(reference.removeprefix("file://"))
        path = path if path.is_absolute() else folder / path
    if path.suffix.lower() not in (*MESHES, ""):
        raise RobotFileError(
            f"mesh {reference}: simulators read {', '.join(MESHES)}; convert it to one of them"
        )
    if not isfile(path):
        near = [each.name for each in path.parent.glob("*") if isfile(each)]
        why = f"there is no file {path}{did_you_mean(path.name, near)}"
        raise RobotFileError(f"mesh {reference}: {why}" if reference else "a mesh has no filename")
    return _installed_address(path) or str(path.resolve())


def mesh_path(address: str) -> Path:
    """The file behind what `mesh_address` gave."""
    return resolve_package_uri(address) if address.startswith("package://") else Path(address)


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


def _in_package(
    package: str, inner: str, folder: Path, packages: Mapping[str, Path], reference: str
) -> Path:
    """The file of a ROS package, wherever the package is found first with it."""
    roots = list(dict.fromkeys(_package_folders(package, folder, packages)))
    for root in roots:
        if isfile(root / inner):
            return root / inner
    if roots:
        places, name = ", ".join(map(str, roots)), Path(inner).name
        near = [each.name for root in roots for each in (root / inner).parent.glob("*")]
        raise RobotFileError(
            f"mesh {reference}: no such file in the package {package!r}: {places}"
            f"{did_you_mean(name, near)}"
        )
    raise RobotFileError(f"mesh {reference}: {_nowhere(package, inner, folder)}")


def _nowhere(package: str, inner: str, folder: Path) -> str:
    """Where a package was looked for that a file in a folder names, and what helps."""
    holder = next((each for each in (folder, *folder.parents) if isfile(each / inner)), None)
    found = "FOLDER" if holder is None else f"{holder}, which holds a file of that path"
    return (
        f"the package {package!r} is no folder beside or above {folder}, is not in "
        "ROS_PACKAGE_PATH or AMENT_PREFIX_PATH, and is not installed; "
        f"give --package {package}={found}"
    )


def _package_folders(package: str, folder: Path, packages: Mapping[str, Path]) -> Iterator[Path]:
    """The folder given, or those upwards, of ROS's search paths and installed, as they count."""
    if package in packages:
        yield packages[package]
        return
    for parent in (folder, *folder.parents):
        if parent.name == package:
            yield parent
        if isdir(parent / package):
            yield parent / package
    for top in _ros_folders():
        yield from (each for each in (top / package, *top.glob(f"*/{package}")) if isdir(each))
        if top.name == package:
            yield top
    yield from package_roots(package)


def _ros_folders() -> list[Path]:
    """Folders of packages that ROS_PACKAGE_PATH (ROS 1) and AMENT_PREFIX_PATH (ROS 2) name."""
    first, second = (
        [Path(each) for each in os.environ.get(name, "").split(os.pathsep) if each]
        for name in ("ROS_PACKAGE_PATH", "AMENT_PREFIX_PATH")
    )
    return list(filter(Path.is_dir, [*first, *(prefix / "share" for prefix in second)]))


def _expanded(path: Path, packages: Mapping[str, Path], arguments: Mapping[str, str]) -> str:
    """A xacro file's URDF; packages are looked for as those of meshes are."""
    try:
        from xacrodoc import XacroDoc
        from xacrodoc import packages as known
    except ImportError:
        raise RobotFileError(
            f"{path}: a xacro needs the package xacrodoc; try: pip install 'xacrodoc>=2,<3'"
        ) from None
    refuse_entities(path.read_bytes(), path)
    known.update_package_cache(_around(path) | {name: str(at) for name, at in packages.items()})
    try:
        document = XacroDoc.from_file(str(path), subargs=dict(arguments), resolve_packages=False)
    except Exception as error:  # xacro has no common base of its errors
        why = " ".join(str(error).split())
        if missing := re.search(r"Package not found: (\S+)", why):
            if missing[1] not in packages and (roots := package_roots(missing[1])):
                return _expanded(path, {**packages, missing[1]: roots[0]}, arguments)
            named = rf"\$\(find {re.escape(missing[1])}\)/([^\"']+)"
            inner = re.search(named, path.read_text(encoding="utf-8"))
            where = _nowhere(missing[1], inner[1] if inner else "", path.parent)
            raise RobotFileError(f"{path}: {where}") from None
        lacking = "substitution arg" in why  # a property, or old syntax, no option can mend
        helps = "give it by --xacro NAME=VALUE" if lacking else "mend it until xacro FILE takes it"
        raise RobotFileError(f"{path}: xacro cannot expand it: {why}; {helps}") from None
    return document.to_urdf_string()


def _around(path: Path) -> dict[str, str]:
    """Folders that may be the packages a xacro names: those beside any folder above it first."""
    found: dict[str, str] = {}
    for parent in [*list(path.parents)[1:5], *_ros_folders(), *share_folders()]:
        for folder in sorted(parent.iterdir()):
            if folder.is_dir() and not folder.name.startswith((".", "_")):
                found.setdefault(folder.name, str(folder))
    return found
