"""Files of what is made offline for a robot: found by their key, checked before they are believed.

A file is one `.npz` without pickles, written as a whole. Its key is a hash of all that its content
depends on, equal on all machines, and stands in its name and in its header.
"""

from __future__ import annotations

import hashlib
import io
import json
import logging
import zlib
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, Literal, TypeVar
from xml.etree import ElementTree
from zipfile import BadZipFile

import numpy as np
from numpy.lib.npyio import NpzFile

from app.errors import OutputError
from app.robot import assets
from app.robot.assets import urdf_path
from app.robot.description import RobotDescription
from app.robot.packages import resolve_package_uri
from app.robot.shapes import ConvexMesh
from app.strict import Strict
from app.system import write_whole

Array = np.ndarray
Content = TypeVar("Content")
Arrays = dict[str, Array]
Origin = Literal["cache", "shipped"]

_log = logging.getLogger(__name__)
_UNREADABLE = (
    OSError,
    ValueError,
    KeyError,
    EOFError,
    BadZipFile,
    zlib.error,
    NotImplementedError,
    RuntimeError,
    MemoryError,
)


class DamagedFileError(Exception):
    """A file that is not what its name says; the reason is its message."""


class Header(Strict):
    """What a file says of itself, beside its arrays."""

    key: str


def find_kept(
    name: str, key: str, unpack: Callable[[Arrays], Content]
) -> tuple[Content, Origin] | None:
    """What the user's cache, or the project itself, has of a name and a key; None if neither.

    A file that is damaged or of another robot is never believed, with a warning.

    Args:
        name: Of the file, without the key.
        key: As of `digest`.
        unpack: Makes the content of a file's arrays.
    """
    folders: dict[Path, Origin] = {assets.cache_folder(): "cache"}
    folders.setdefault(assets.SHIPPED_CACHE, "shipped")
    for folder, origin in folders.items():
        path = _path(folder, name, key)
        try:
            return read(path, unpack), origin
        except FileNotFoundError:
            continue
        except DamagedFileError as error:
            _log.warning("%s is not used: %s", path, error)
    return None


def keep(name: str, header: Header, arrays: Arrays) -> None:
    """Write to the user's cache; one that cannot be written costs only a warning."""
    path = _path(assets.cache_folder(), name, header.key)
    try:
        write(path, header, arrays)
    except (OSError, OutputError) as error:
        _log.warning("%s cannot be kept (%s); it will be made again", path, error)


def _path(folder: Path, name: str, key: str) -> Path:
    return folder / f"{name}-{key}.npz"


def write(path: Path, header: Header, arrays: Arrays) -> None:
    """Write a file as a whole or not at all, with a checksum.

    Raises:
        OSError: The folder cannot be made.
        OutputError: It cannot be written.
    """
    told = np.frombuffer(header.model_dump_json().encode(), dtype=np.uint8)
    content: dict[str, Any] = {"header": told, **arrays}
    content["checksum"] = _checksum(content)
    packed = io.BytesIO()
    np.savez_compressed(packed, **content)
    path.parent.mkdir(parents=True, exist_ok=True)
    write_whole(path, packed.getvalue())


def read(path: Path, unpack: Callable[[Arrays], Content]) -> Content:
    """The content of a file whose checksum holds.

    Raises:
        FileNotFoundError: There is no file.
        DamagedFileError: It cannot be read, or not as what it should be.
    """
    try:
        # Opened here: `np.load` leaves a file open that it cannot read, and takes a plain array.
        with path.open("rb") as stream, NpzFile(stream, allow_pickle=False) as file:
            arrays = {name: file[name] for name in file.files}
        checksum = arrays.pop("checksum")
        if not np.array_equal(checksum, _checksum(arrays)):
            raise DamagedFileError("its checksum does not hold")
        return unpack(arrays)
    except FileNotFoundError:
        raise
    except _UNREADABLE as error:
        raise DamagedFileError(f"it cannot be read ({type(error).__name__})") from error


Kind = TypeVar("Kind", bound=Header)


def header_of(arrays: Arrays, kind: type[Kind], **expected: object) -> Kind:
    """The header of a file.

    Raises:
        DamagedFileError: A field of it is not what is expected.
    """
    header = kind.model_validate_json(arrays["header"].tobytes())
    if any(getattr(header, field) != value for field, value in expected.items()):
        raise DamagedFileError("it belongs to another robot, sampling or version")
    return header


def _checksum(arrays: Mapping[str, Array]) -> Array:
    """(32,) uint8 over names, types, shapes and bytes."""
    total = hashlib.blake2b(digest_size=32)
    for name in sorted(arrays):
        array = np.ascontiguousarray(arrays[name])
        total.update(f"{name} {array.dtype.str} {array.shape};".encode())
        total.update(array.data)
    return np.frombuffer(total.digest(), dtype=np.uint8)


def digest(content: dict[str, object]) -> str:
    """32 hexadecimal digits of what can be written as JSON."""
    text = json.dumps(content, sort_keys=True, separators=(",", ":"), allow_nan=False)
    return hashlib.blake2b(text.encode(), digest_size=16).hexdigest()


def robot_content(description: RobotDescription) -> dict[str, object]:
    """All of a robot that the places of its bodies depend on.

    Of the description count the bodies' shapes, the arm's joints and limits and the base's link; of
    the URDF its joints; of a mesh its bytes. Sources, colours, masses, gains and the place where
    packages are installed do not.

    Raises:
        AssetError: The URDF or a mesh is not there.
    """
    arm = description.arm
    urdf = ElementTree.fromstring(urdf_path(description).read_text(encoding="utf-8"))
    return {
        "base": description.base.link,
        "mount": arm.mount_link,
        "joints": [arm.joints, arm.position_lower, arm.position_upper],
        "bodies": [
            [body.name, body.frame, [shape.model_dump() for shape in body.shapes]]
            for body in description.bodies
        ],
        "meshes": [
            hashlib.blake2b(resolve_package_uri(shape.file).read_bytes()).hexdigest()
            for body in description.bodies
            for shape in body.shapes
            if isinstance(shape, ConvexMesh)
        ],
        **({"unwatched": sorted(description.unwatched)} if description.unwatched else {}),
        "kinematics": [  # in canonical XML, without comments and layout
            ElementTree.canonicalize(ElementTree.tostring(joint, "unicode"), strip_text=True)
            for joint in urdf.iterfind("joint")
        ],
    }
