"""Takes a zip apart that a stranger may have made: within bounds, and nowhere but in its folder."""

from __future__ import annotations

import re
import stat
import struct
import zipfile
import zlib
from pathlib import Path, PurePosixPath
from typing import IO

from app.errors import RobotFileError

LARGEST_ARCHIVE = 100_000_000
"""[bytes] of the zip."""
LARGEST_CONTENT = 500_000_000
"""[bytes] of all its files, expanded."""
MOST_FILES = 2000
"""[-] in it."""
KEPT = (".urdf", ".xml", ".stl", ".dae", ".obj", ".ply")
"""Ends of the names of files that are written; others, such as programs, stay in the zip."""
_NOTES = re.compile(r"(licen[cs]e|copying|notice)(\.[a-z]+)?", re.IGNORECASE)
_LARGEST_DIRECTORY = 500 * MOST_FILES  # [bytes] of a zip's list of files; each takes 46 and a name
_LONGEST_NAME = 200  # [characters]
_CHUNK = 1 << 20  # [bytes]
_BOUNDED = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)
# Of these a chunk is expanded at a time; bzip2 and LZMA expand all that they read.
_UNREADABLE = (
    zipfile.BadZipFile,
    zlib.error,
    EOFError,
    NotImplementedError,
    OSError,
    ValueError,  # a name that is not UTF-8
)


def unpack(archive: Path, folder: Path) -> list[str]:
    """Write the URDFs, meshes and licences of a zip into a folder.

    Args:
        archive: The zip.
        folder: Made here.

    Returns:
        Names of all files in the zip, also of those that were not written.

    Raises:
        RobotFileError: It is no plain zip, too large, or holds a path that leads elsewhere, a link,
            a password, a file packed by another method than deflate, or a name twice; says which.
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
    """Before anything of it is believed: the file itself, and its list of files."""
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
        raise RobotFileError(f"{archive.name}: not a zip: it has no list of files at its end")
    if tail[:at][-20:].startswith(b"PK\x06\x07"):  # it would stand in for the record that is read
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
        if info.is_dir():
            continue
        if path in found:
            raise RobotFileError(f"{where}: the file {str(path)!r} stands twice in it")
        found[path] = info
    return [(info, path) for path, info in found.items()]


def _path(info: zipfile.ZipInfo, where: str) -> PurePosixPath:
    """Where an entry may go; only plain files and folders below the top."""
    name = info.orig_filename
    problem = None
    if name.startswith("/"):
        problem = "is an absolute path"
    elif "\\" in name or re.match(r"[A-Za-z]:", name):
        problem = "is a path of Windows, with a drive or backslashes"
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
    """Copy what is really there, whatever the zip's list says of its size; [bytes]."""
    written = 0
    while chunk := source.read(_CHUNK):
        written += len(chunk)
        if written > most:
            raise RobotFileError(f"{where}: it expands to more than {LARGEST_CONTENT / 1e6:.0f} MB")
        sink.write(chunk)
    return written
