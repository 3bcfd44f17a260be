"""A robot as an untrusted zip: it is unpacked within bounds, and nothing in it is executed."""

import os
import re
import shutil
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
from typing import NamedTuple
from xml.etree import ElementTree

from app.errors import RobotFileError, did_you_mean, named_part
from app.onboarding.read.source import FORMATS, mesh_places, read_source, spellings
from app.onboarding.read.tree import make_tree
from app.robot.assets import refuse_entities
from app.strict import placeholder
from app.system import temporary_folder

FOLDER = "package"  # name of the folder in a robot's own folder into which a zip is unpacked
LARGEST_ARCHIVE = 100_000_000  # [bytes] largest zip
LARGEST_CONTENT = 500_000_000  # [bytes] largest expanded size of all files
MOST_FILES = 2000  # [-] largest number of files
KEPT = (".urdf", ".xml", *FORMATS[:-1], ".bin")  # .bin: numbers of a .gltf
"""Endings of the unpacked files, besides licences; other files, such as programs, are left out."""
_HIDDEN = re.compile(r"(.*/)?(\.[^/]*|__MACOSX/.*)")  # also the files that macOS adds
_NOTES = re.compile(r"(licen[cs]e|copying|notice)(\.[a-z]+)?", re.IGNORECASE)
_LARGEST_DIRECTORY = 500 * MOST_FILES  # [bytes] largest list; an entry has 46 bytes and a name
_LONGEST_NAME = 200  # [characters]
_MAX_URDFS = 20  # [-] largest number of URDFs that are read
_MAX_NAMES = 500  # [-] largest number of links, and of joints, that a list on the page can show
_UTF8 = 0x800  # flag of a name in UTF-8
_BOUNDED = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)
# These methods expand one chunk at a time; bzip2 and LZMA expand everything that they read.
_UNREADABLE = zipfile.BadZipFile, zlib.error, EOFError, NotImplementedError, OSError, ValueError
"""Errors of a damaged zip; a ValueError is a name that is not UTF-8."""


def unpack(archive: Path, folder: Path) -> list[str]:
    """Write the `KEPT` files and licences of a zip to a folder; return the sorted paths of URDFs.

    Hidden files and those in `__MACOSX` are not among these paths. A RobotFileError is raised if
    the zip cannot be read, is too large or has no URDF; or if an entry is a link, has a password or
    a compression other than deflate, or has a path that is invalid or occurs twice.
    """
    _check_size(archive)
    try:
        with zipfile.ZipFile(archive) as opened:
            files = _checked(opened.infolist())
            for path, info in files.items():
                if path.suffix.lower() in KEPT or _NOTES.fullmatch(path.name):
                    target = folder / path
                    target.parent.mkdir(parents=True, exist_ok=True)
                    with opened.open(info) as source, target.open("xb") as sink:
                        shutil.copyfileobj(source, sink)  # at most the size that was checked
    except _UNREADABLE as error:
        raise RobotFileError(f"not a zip that can be read: {error}") from None
    visible = [path for path in map(str, files) if not _HIDDEN.fullmatch(path)]
    if found := sorted(path for path in visible if path.lower().endswith(".urdf")):
        return found
    if xacro := next((path for path in map(str, files) if path.endswith(".xacro")), ""):
        why = f"only {xacro}: a xacro can contain Python, and nothing in a zip is executed"
        helps = "expand it (xacro FILE -o robot.urdf) and put the URDF into the zip"
        raise RobotFileError(f"no .urdf in it, {why}; {helps}")
    raise RobotFileError("no .urdf in it; zip the URDF together with its meshes")


def _check_size(archive: Path) -> None:
    """Refuse a file that is not a zip, or is too large, before its list of files is read."""
    if (size := archive.stat().st_size) > LARGEST_ARCHIVE:
        raise RobotFileError(f"{size / 1e6:.0f} MB; the limit is {LARGEST_ARCHIVE / 1e6:.0f} MB")
    with archive.open("rb") as file:
        file.seek(max(0, size - (1 << 16) - 22 - 20))
        tail = file.read()
    at = tail.rfind(b"PK\x05\x06")
    if at < 0 or len(tail) < at + 22:
        if (name := placeholder(tail[:1024])) and not tail.startswith(b"PK"):
            raise RobotFileError(f"in the place of the file is {name}")
        raise RobotFileError("not a zip; zip the URDF together with its meshes")
    if tail[:at][-20:].startswith(b"PK\x06\x07"):  # it would replace the record that is read
        raise RobotFileError("a ZIP64, the form for archives of over 4 GB; zip it as a plain zip")
    count, directory = struct.unpack_from("<HI", tail, at + 10)
    if count > MOST_FILES or directory > _LARGEST_DIRECTORY:
        why = f"a list of {count} files; the limit is {MOST_FILES:,}"
        raise RobotFileError(f"{why}: leave out all files except the URDF and its meshes")


def _checked(infos: list[zipfile.ZipInfo]) -> dict[PurePosixPath, zipfile.ZipInfo]:
    """The files of a zip by path, without folders; refuses too many, too large or repeated ones."""
    total = sum(info.file_size for info in infos)
    if total > LARGEST_CONTENT:
        why = f"it expands to {total / 1e6:,.0f} MB"
        raise RobotFileError(f"{why}; the limit is {LARGEST_CONTENT / 1e6:.0f} MB")
    if len(infos) > MOST_FILES:  # its record can state a smaller number
        raise RobotFileError(f"{len(infos):,} files; the limit is {MOST_FILES:,}")
    found: dict[PurePosixPath, zipfile.ZipInfo] = {}
    for info in infos:
        path = _path(info)
        is_folder = info.orig_filename.endswith(("/", "\\"))
        if not is_folder and found.setdefault(path, info) is not info:
            raise RobotFileError(f"it contains the file {str(path)!r} twice")
    return found


def _path(info: zipfile.ZipInfo) -> PurePosixPath:
    """The path of an entry, which must be a plain file or folder inside of the zip."""
    name = info.orig_filename
    if not info.flag_bits & _UTF8 and not name.isascii():
        name = _as_stored(name.encode("cp437"))
    name = name.replace("\\", "/")  # as Windows PowerShell writes them
    unnamed = not name.isprintable() or not name.strip("/. ") or len(name) > _LONGEST_NAME
    kinds = (0, stat.S_IFREG, stat.S_IFDIR)
    problems = {
        "is an absolute path": name.startswith("/"),
        "is a path of Windows, with a drive": re.match(r"[A-Za-z]:", name),
        "leads out of the zip by '..'": ".." in PurePosixPath(name).parts,
        "is not a file name": unnamed,
        "is a link or a device, not a file": stat.S_IFMT(info.external_attr >> 16) not in kinds,
        "is locked by a password": info.flag_bits & 1,
        "is packed by another method than deflate": info.compress_type not in _BOUNDED,
    }
    if problem := next((text for text, holds in problems.items() if holds), ""):
        helps = "zip the package's folder itself, with plain files below it"
        raise RobotFileError(f"{name[:_LONGEST_NAME]!r} {problem}; {helps}")
    return PurePosixPath(name)


def open_package(archive: Path, folder: Path, file: str | None = None) -> Path:
    """Unpack a zip into a robot's folder; return the file of its URDF, with relative mesh paths.
    `file` is its path in the zip, or None for the only URDF. A RobotFileError is raised as for
    `unpack`, if the URDF or a mesh is not in the zip or cannot be read, or if the zip has several
    URDFs and `file` is None.
    """
    root = (folder / FOLDER).resolve()
    with named_part(archive.name):
        urdfs = unpack(archive, root)
        if file is None and len(urdfs) > 1:
            some = ", ".join(urdfs[:20])
            raise RobotFileError(f"it has {len(urdfs)} URDFs; name one by --file: {some}")
        if file not in (None, *urdfs):
            raise RobotFileError(f"no URDF {file!r} in it; there are: {', '.join(urdfs)}")
    robot = read_source(path := root / (file or urdfs[0]))[0]
    for mesh in robot.iter("mesh"):
        reference = str(mesh.get("filename"))
        if Path(reference).suffix.lower() not in FORMATS:
            continue  # checked when the robot is read
        found = _inside(reference, path.parent, root)
        if found.suffix.lower() == ".dae":
            refuse_entities(found.read_bytes(), found)
        mesh.set("filename", Path(os.path.relpath(found, path.parent)).as_posix())
    path.write_text(ElementTree.tostring(robot, encoding="unicode"), encoding="utf-8")
    return path


def _inside(reference: str, folder: Path, root: Path) -> Path:
    """The mesh below `root` to which an address refers; `folder` is the folder of the URDF."""
    names = spellings(reference)
    names += [stored for name in names for stored in _stored(name)]
    printable = filter(str.isprintable, dict.fromkeys(names))  # like all names in a zip
    tops = (folder, *folder.parents)
    places = mesh_places(printable, folder, lambda name: (*_named_folders(name, root), *tops))
    resolved = map(Path.resolve, places)
    if not (below := [place for place in resolved if place.is_relative_to(root)]):
        why = f"mesh {reference}: outside of the package; refer to a file in the zip by"
        raise RobotFileError(f"{why} package://PACKAGE/PATH or by a path relative to the URDF")
    if (found := next(filter(isfile, below), None)) is not None:
        return found
    files = [each.relative_to(root) for each in root.rglob("*") if each.is_file()]
    name = PurePosixPath(reference).name
    near = did_you_mean(name, (each.name for each in files))
    if same := next((each.as_posix() for each in files if each.name == name), ""):
        near = f" (it has {same!r}, but the paths differ)"
    why = f"mesh {reference}: there is no such file in the zip{near}"
    raise RobotFileError(f"{why}; {', '.join(FORMATS[:-1])} are read")


def _stored(name: str) -> Iterator[str]:
    """The names `_as_stored` of a non-ASCII name, by each encoding that the zip may have used."""
    for code in () if name.isascii() else sorted({*aliases.values()}):
        with suppress(LookupError, ValueError):
            yield _as_stored(name.encode(code))


def _as_stored(name: bytes) -> str:
    """A name's bytes, read by code page 437 as `zipfile` does; 0x5C becomes %5C, and 0xFF %FF."""
    return name.decode("cp437").replace("\\", "%5C").replace("\xa0", "%FF")


@lru_cache(maxsize=1024)
def _named_folders(package: str, root: Path) -> list[Path]:
    """Folders below `root` with the name of a package, then all folders with a `package.xml`."""
    named = sorted(each for each in root.rglob("*") if each.is_dir() and each.name == package)
    return [*named, *(each.parent for each in sorted(root.rglob("package.xml")))]


class Contents(NamedTuple):
    """Names in a URDF."""

    links: tuple[str, ...]  # all links, in the order of the file
    endless: tuple[str, ...]  # joints of the type continuous
    root: str  # probably the base
    last: str  # probably the tip: the link with the largest number of joints to the root


def look_into(archive: Path) -> dict[str, Contents]:
    """The `Contents` of each readable URDF among the first 20 of a zip, by its path. A
    RobotFileError is raised as for `unpack`, or if none of these URDFs can be read.
    """
    with temporary_folder() as folder:
        with named_part(archive.name):
            found = unpack(archive, folder)
        contents, problem = {}, ""
        for name in found[:_MAX_URDFS]:
            try:
                contents[name] = _contents(read_source(folder / name)[0], Path(name).name)
            except RobotFileError as error:
                problem = str(error).replace(f"{folder}/", "")
        if not contents:
            raise RobotFileError(problem)
        return contents


def _contents(robot: ElementTree.Element, name: str) -> Contents:
    for tag, least in (("link", 1), ("joint", 0)):
        if not least <= (count := len(robot.findall(tag))) <= _MAX_NAMES:
            why = f"it has {count} {tag}s; {least} to {_MAX_NAMES} are valid"
            raise RobotFileError(f"{name}: {why}")
    tree = make_tree(robot)
    endless = tuple(joint.name for joint in tree.joints.values() if joint.kind == "continuous")
    last = max(tree.links, key=lambda link: len(tree.chain(tree.root, link)))
    return Contents(tuple(tree.links), endless, tree.root, last)
