"""An untrusted robot package as a zip: unpacked within bounds, and read.

Nothing in it is executed: a xacro, whose expressions are Python, is refused.
"""

from __future__ import annotations

import os
import re
import stat
import struct
import zipfile
import zlib
from collections.abc import Iterator
from contextlib import suppress
from encodings.aliases import aliases
from functools import lru_cache
from os.path import isfile  # False also for a name that is too long for a file
from pathlib import Path, PurePosixPath
from typing import IO, NamedTuple
from xml.etree import ElementTree
from xml.etree.ElementTree import Element

from app.errors import RobotFileError, did_you_mean
from app.onboarding.read.source import FORMATS, read_source, spellings, split_address
from app.onboarding.read.tree import make_tree
from app.robot.assets import refuse_entities, refuse_placeholder
from app.system import temporary_folder

FOLDER = "package"
"""Folder of a package within the robot's own folder."""
LARGEST_URDF = 10_000_000
"""[bytes] largest URDF in a package."""
LARGEST_ARCHIVE = 100_000_000
"""[bytes] largest zip."""
LARGEST_CONTENT = 500_000_000
"""[bytes] largest expanded size of all files."""
MOST_FILES = 2000
"""[-] most files."""
KEPT = (".urdf", ".xml", *FORMATS[:-1])
"""Endings of the files that are written; others, such as programs, stay in the zip."""
_NOTES = re.compile(r"(licen[cs]e|copying|notice)(\.[a-z]+)?", re.IGNORECASE)
_LARGEST_DIRECTORY = 500 * MOST_FILES  # [bytes] largest directory; an entry takes 46 and a name
_LONGEST_NAME = 200  # [characters]
_CHUNK = 1 << 20  # [bytes]
_UTF8 = 0x800  # flag of a name in UTF-8
_BOUNDED = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)
# These formats expand one chunk at a time; bzip2 and LZMA expand everything that they read.
_UNREADABLE = (
    zipfile.BadZipFile,
    zlib.error,
    EOFError,
    NotImplementedError,
    OSError,
    ValueError,  # a name that is not UTF-8
)


def unpack(archive: Path, folder: Path) -> list[str]:
    """Write the URDFs, meshes and licences of a zip into a folder; returns the names of all files.

    Raises:
        RobotFileError: It is not a plain zip, is too large, or has a path that leads out of it, a
            link, a password, a file with another compression than deflate, or a duplicate name;
            names it.
    """
    where = archive.name
    _check_size(archive)
    try:
        with zipfile.ZipFile(archive) as opened:
            infos = _checked(opened.infolist(), where)
            left = LARGEST_CONTENT
            for info, path in infos:
                if _wanted(path):
                    target = folder / path
                    target.parent.mkdir(parents=True, exist_ok=True)
                    with opened.open(info) as source, target.open("xb") as sink:
                        left -= _copy(source, sink, left, where)
    except _UNREADABLE as error:
        raise RobotFileError(f"{where}: not a zip that can be read: {error}") from None
    return [str(path) for _, path in infos]


def _check_size(archive: Path) -> None:
    """Check the file itself and its directory before reading its content."""
    size = archive.stat().st_size
    if size > LARGEST_ARCHIVE:
        raise RobotFileError(
            f"{archive.name}: {size / 1e6:.0f} MB; a zip may have {LARGEST_ARCHIVE / 1e6:.0f} MB"
        )
    with archive.open("rb") as file:
        file.seek(max(0, size - (1 << 16) - 22 - 20))
        tail = file.read()
    at = tail.rfind(b"PK\x05\x06")
    if at < 0 or len(tail) < at + 22:
        if not tail.startswith(b"PK"):
            refuse_placeholder(tail[:1024], archive.name)
        raise RobotFileError(f"{archive.name}: not a zip; zip the URDF together with its meshes")
    if tail[:at][-20:].startswith(b"PK\x06\x07"):  # it would replace the record that is read
        raise RobotFileError(
            f"{archive.name}: a ZIP64, the form for archives of over 4 GB; zip it as a plain zip"
        )
    count, directory = struct.unpack_from("<HI", tail, at + 10)
    if count > MOST_FILES or directory > _LARGEST_DIRECTORY:
        raise RobotFileError(
            f"{archive.name}: a list of {count} files; a zip may hold {MOST_FILES:,}: "
            "leave out all but the URDF and its meshes"
        )


def _checked(
    infos: list[zipfile.ZipInfo], where: str
) -> list[tuple[zipfile.ZipInfo, PurePosixPath]]:
    """The files, each with its path inside of the folder."""
    total = sum(info.file_size for info in infos)
    if total > LARGEST_CONTENT:
        raise RobotFileError(
            f"{where}: it expands to {total / 1e6:,.0f} MB; "
            f"at most {LARGEST_CONTENT / 1e6:.0f} MB are taken"
        )
    if len(infos) > MOST_FILES:
        raise RobotFileError(f"{where}: {len(infos):,} files; a zip may hold {MOST_FILES:,}")
    found: dict[PurePosixPath, zipfile.ZipInfo] = {}
    for info in infos:
        path = _path(info, where)
        if info.orig_filename.endswith(("/", "\\")):  # a folder
            continue
        if path in found:
            raise RobotFileError(f"{where}: the file {str(path)!r} stands twice in it")
        found[path] = info
    return [(info, path) for path, info in found.items()]


def _path(info: zipfile.ZipInfo, where: str) -> PurePosixPath:
    """The target of an entry; only plain files and folders below the top."""
    name = info.orig_filename
    if not info.flag_bits & _UTF8 and not name.isascii():
        name = _as_stored(name.encode("cp437"))
    name = name.replace("\\", "/")  # as Windows PowerShell writes them
    problem = None
    if name.startswith("/"):
        problem = "is an absolute path"
    elif re.match(r"[A-Za-z]:", name):
        problem = "is a path of Windows, with a drive"
    elif ".." in PurePosixPath(name).parts:
        problem = "leads out of the zip by '..'"
    elif not name.isprintable() or not name.strip("/. ") or len(name) > _LONGEST_NAME:
        problem = "is no name of a file"
    elif stat.S_IFMT(info.external_attr >> 16) not in (0, stat.S_IFREG, stat.S_IFDIR):
        problem = "is a link or a device, not a file"
    elif info.flag_bits & 1:
        problem = "is locked by a password"
    elif info.compress_type not in _BOUNDED:
        problem = "is packed by another method than deflate"
    if problem is not None:
        raise RobotFileError(
            f"{where}: {name[:_LONGEST_NAME]!r} {problem}; "
            "zip the package's folder itself, with plain files below it"
        )
    return PurePosixPath(name)


def _wanted(path: PurePosixPath) -> bool:
    return path.suffix.lower() in KEPT or _NOTES.fullmatch(path.name) is not None


def _copy(source: IO[bytes], sink: IO[bytes], most: int, where: str) -> int:
    """Copy the real content, independent of the size in the zip's directory; [bytes]."""
    written = 0
    while chunk := source.read(_CHUNK):
        written += len(chunk)
        if written > most:
            raise RobotFileError(f"{where}: it expands to more than {LARGEST_CONTENT / 1e6:.0f} MB")
        sink.write(chunk)
    return written


def open_package(archive: Path, folder: Path, file: str | None = None) -> Path:
    """Unpack a zip; returns its URDF, whose meshes then have paths inside of the package.

    It is unpacked below the robot's own folder. `file`, the path in the zip, is optional if
    there is one URDF only.

    Raises:
        RobotFileError: The zip is not safe (`unpack`), lacks that URDF, or the URDF refers to
            files outside of the package.
    """
    root = (folder / FOLDER).resolve()
    if not archive.is_file():
        raise RobotFileError(
            f"{archive}: no such file; give a URDF, a xacro, a zip or package://PACKAGE/…"
        )
    names = unpack(archive, root)
    path = root / _chosen_urdf(names, archive.name, file)
    _tie_meshes(path, root)
    return path


def _chosen_urdf(names: list[str], where: str, file: str | None) -> str:
    """The path of the selected URDF of a zip."""
    found = _urdfs(names)
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


def _urdfs(names: list[str]) -> list[str]:
    """The URDFs among some files, without hidden files and macOS's additions."""
    paths = [PurePosixPath(name) for name in names if name.lower().endswith(".urdf")]
    return sorted(
        str(path)
        for path in paths
        if not path.name.startswith(".") and "__MACOSX" not in path.parts[:-1]
    )


def _read_bounded(path: Path) -> Element:
    if path.stat().st_size > LARGEST_URDF:
        raise RobotFileError(f"{path.name}: a URDF may have {LARGEST_URDF / 1e6:.0f} MB")
    return read_source(path)


def _tie_meshes(path: Path, root: Path) -> None:
    """Write a URDF again with the relative path of each mesh inside of the root."""
    robot = _read_bounded(path)
    for mesh in robot.iter("mesh"):
        reference = str(mesh.get("filename"))
        if Path(reference).suffix.lower() not in FORMATS:
            continue  # checked when the robot is read
        found = _inside(reference, path.parent, root)
        if found.suffix.lower() == ".dae":
            refuse_entities(found.read_bytes(), found)
        mesh.set("filename", Path(os.path.relpath(found, path.parent)).as_posix())
    path.write_text(ElementTree.tostring(robot, encoding="unicode"), encoding="utf-8")


def _inside(reference: str, folder: Path, root: Path) -> Path:
    """The file of the zip for a mesh's name in a URDF of a folder."""
    scheme, path = split_address(reference)
    own = scheme == "" and not path.startswith("/")
    named = spellings(path.lstrip("/")) if own or scheme in ("package", "model") else []
    named += [_as_stored(each) for name in named for each in _encoded(name)]
    places = [
        place.resolve()
        for each in filter(str.isprintable, dict.fromkeys(named))  # like all names in a zip
        for place in ([folder / each] if own else _in_packages(each, folder, root))
    ]
    kept = [place for place in places if place.is_relative_to(root)]
    if not kept:
        raise RobotFileError(
            f"mesh {reference}: outside of the package; refer to a file in the zip by "
            "package://PACKAGE/PATH or by a path relative to the URDF"
        )
    if (found := next(filter(isfile, kept), None)) is not None:
        return found
    near = did_you_mean(Path(path).name, (each.name for each in root.rglob("*")))
    raise RobotFileError(
        f"mesh {reference}: there is no such file in the zip{near}; "
        f"{', '.join(FORMATS[:-1])} are read"
    )


def _encoded(name: str) -> Iterator[bytes]:
    """A name in each of Python's encodings that has its characters; a zip may lack its encoding."""
    for code in () if name.isascii() else sorted({*aliases.values()}):
        with suppress(LookupError, ValueError):
            yield name.encode(code)


def _as_stored(name: bytes) -> str:
    """The file name of an entry whose code page is unknown: its bytes in code page 437."""
    return name.decode("cp437").replace("\\", "%5C").replace("\xa0", "%FF")


def _in_packages(path: str, folder: Path, root: Path) -> list[Path]:
    """Candidates for `package://PACKAGE/PATH`: a folder of that name, or one above the URDF."""
    package, _, inner = path.partition("/")
    places = (*_package_folders(package, root), folder, *folder.parents)
    return [place / inner for place in places]


@lru_cache(maxsize=1024)
def _package_folders(package: str, root: Path) -> list[Path]:
    """Possible folders of a package in an unpacked zip; cached."""
    named = sorted(each for each in root.rglob("*") if each.is_dir() and each.name == package)
    tops = [each.parent for each in sorted(root.rglob("package.xml"))]
    return [*named, *tops]


_MAX_URDFS = 20  # [-] most URDFs that are read
_MAX_NAMES = 500  # [-] most links or joints in a list


class Contents(NamedTuple):
    """Names in a URDF."""

    links: tuple[str, ...]
    """All names, in the order of the file."""
    endless: tuple[str, ...]
    """Joints that turn without limits."""
    root: str
    """The first link that no joint moves: probably the base."""
    last: str
    """The link with the most joints from the root: probably the tip."""


def look_into(archive: Path) -> dict[str, Contents]:
    """The names of links and joints in the URDFs of a zip, by the URDF's path in the zip.

    Unreadable URDFs are left out. The unpacked files are deleted.

    Raises:
        RobotFileError: The zip is not safe, or no URDF in it can be read.
    """
    with temporary_folder() as folder:
        names = unpack(archive, folder)
        found = _urdfs(names)
        if not found:
            _chosen_urdf(names, archive.name, None)  # raises the error
        contents, problem = {}, ""
        for name in found[:_MAX_URDFS]:
            try:
                contents[name] = _contents(folder / name)
            except RobotFileError as error:
                problem = str(error).replace(f"{folder}/", "")
        if not contents:
            raise RobotFileError(problem)
        return contents


def _contents(path: Path) -> Contents:
    robot = _read_bounded(path)
    for tag, least in (("link", 1), ("joint", 0)):  # the most that a list in the page can show
        count = len(robot.findall(tag))
        if not least <= count <= _MAX_NAMES:
            raise RobotFileError(
                f"{path.name}: it has {count} {tag}s; {least} to {_MAX_NAMES} are taken"
            )
    tree = make_tree(robot)  # reports errors of the whole file first
    endless = tuple(joint.name for joint in tree.joints.values() if joint.kind == "continuous")
    last = max(tree.links, key=lambda link: len(tree.chain(tree.root, link)))
    return Contents(tuple(tree.links), endless, tree.root, last)
