"""A robot's package as a zip: its URDF, with every mesh by a path inside of the package.

Nothing of a package is executed: a xacro, whose expressions are Python, is refused.
"""

from __future__ import annotations

import os
from pathlib import Path, PurePosixPath
from xml.etree import ElementTree

from app.errors import RobotFileError
from app.onboarding.read.source import read_source, refuse_entities
from app.onboarding.read.unpack import unpack

FOLDER = "package"
"""Where a package lies in the robot's own folder."""
LARGEST_URDF = 10_000_000
"""[bytes] of a URDF in a package."""


def is_package(source: str) -> bool:
    """Whether a robot is given as a zip."""
    return source.lower().endswith(".zip")


def open_package(archive: Path, folder: Path, file: str | None = None) -> Path:
    """Unpack a zip; its URDF's meshes are then named by paths that stay inside.

    Args:
        archive: The zip.
        folder: The robot's own; the package goes below it.
        file: The URDF's path in the zip; may be left out where there is one only.

    Returns:
        The URDF, ready to be read.

    Raises:
        RobotFileError: The zip cannot be trusted (`unpack`), has no such URDF, or it refers to
            files outside of the package.
    """
    root = (folder / FOLDER).resolve()
    if not archive.is_file():
        raise RobotFileError(
            f"{archive}: no such file; give a URDF, a xacro, a zip or package://PACKAGE/…"
        )
    names = unpack(archive, root)
    path = root / chosen_urdf(names, archive.name, file)
    tie_meshes(path, root)
    return path


def chosen_urdf(names: list[str], where: str, file: str | None) -> str:
    """The path of the one URDF that is meant.

    Args:
        names: Of all files.
        where: The zip, for messages.
        file: What was asked for, or None.

    Raises:
        RobotFileError: There is none, or there are several and none was named.
    """
    found = urdfs(names)
    if file is not None:
        if file not in found:
            raise RobotFileError(
                f"{where}: no URDF {file!r} in it; there are: {', '.join(found) or '(none)'}"
            )
        return file
    if len(found) > 1:
        raise RobotFileError(
            f"{where}: it holds {len(found)} URDFs; name one by --file: {', '.join(found[:20])}"
        )
    if found:
        return found[0]
    xacro = next((name for name in names if name.endswith(".xacro")), None)
    if xacro is not None:
        raise RobotFileError(
            f"{where}: no .urdf in it, only {xacro}: a xacro can hold Python, and nothing of a zip "
            "is executed; expand it (xacro FILE -o robot.urdf) and put the URDF into the zip"
        )
    raise RobotFileError(f"{where}: no .urdf in it; zip the URDF together with its meshes")


def urdfs(names: list[str]) -> list[str]:
    """Those of some files that are URDFs; hidden files and what macOS adds to a zip are none."""
    return sorted(name for name in names if name.lower().endswith(".urdf") and not _hidden(name))


def _hidden(name: str) -> bool:
    path = PurePosixPath(name)
    return path.name.startswith(".") or "__MACOSX" in path.parts[:-1]


def tie_meshes(path: Path, root: Path) -> None:
    """Write a URDF again with each mesh by its path relative to it.

    Args:
        path: The URDF.
        root: The package's folder.

    Raises:
        RobotFileError: It is no URDF, or a mesh is missing or outside of the package.
    """
    if path.stat().st_size > LARGEST_URDF:
        raise RobotFileError(f"{path.name}: a URDF may have {LARGEST_URDF / 1e6:.0f} MB")
    robot = read_source(path)
    for mesh in robot.iter("mesh"):
        reference = str(mesh.get("filename"))
        found = _inside(reference, path.parent, root)
        if found.suffix.lower() == ".dae":
            refuse_entities(found.read_bytes(), found)
        mesh.set("filename", _relative(found, path.parent))
    path.write_text(ElementTree.tostring(robot, encoding="unicode"), encoding="utf-8")


def _inside(reference: str, folder: Path, root: Path) -> Path:
    scheme, _, rest = reference.partition("://")
    if scheme in ("package", "model") and rest:
        places = _in_packages(rest, root)
    elif "://" in reference or reference.startswith("/"):
        places = []
    else:
        places = [folder / reference]
    kept = [place.resolve() for place in places if place.resolve().is_relative_to(root)]
    if not kept:
        raise RobotFileError(
            f"mesh {reference}: outside of the package; refer to a file in the zip by "
            "package://PACKAGE/PATH or by a path relative to the URDF"
        )
    found = next((place for place in kept if place.is_file()), None)
    if found is None:
        raise RobotFileError(
            f"mesh {reference}: there is no such file in the zip (STL, COLLADA, OBJ or PLY)"
        )
    return found


def _in_packages(rest: str, root: Path) -> list[Path]:
    """Where `package://PACKAGE/PATH` may be: in a folder of that name, or in the zip's top."""
    package, _, inner = rest.partition("/")
    named = sorted(each for each in root.rglob("*") if each.is_dir() and each.name == package)
    tops = [each.parent for each in sorted(root.rglob("package.xml"))]
    return [place / inner for place in (*named, *tops, root)]


def _relative(path: Path, folder: Path) -> str:
    """A path from a folder on, by `..` where it has to."""
    return Path(os.path.relpath(path, folder)).as_posix()
