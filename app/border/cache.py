"""Files of a robot's offline results: its link pairs, and the clouds of their borders.

A file is found by its key and verified before use; otherwise its content is computed once and
stored. It is one `.npz` without pickles, written as a whole. Its key is a hash of all inputs,
equal on all machines, and is part of its name and of its header.
content depends on, equal on all machines, and stands in its name and in its header.
"""

import hashlib
import io
import json
import logging
import zlib
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, Literal, TypeVar
from xml.etree import ElementTree
from zipfile import BadZipFile

import numpy as np
from numpy.lib.npyio import NpzFile

from app.border.config import SamplingConfig
from app.border.dbb import Cloud, make_cloud
from app.errors import OutputError
from app.robot import assets
from app.robot.assets import read_urdf, resolve_package_uri
from app.robot.description import RobotDescription
from app.robot.link_pairs import LinkPairs, Pair, find_link_pairs
from app.robot.model import RobotModel
from app.robot.shapes import ConvexMesh
from app.strict import Array, Finite, NonNegative, Strict
from app.system import write_whole

Arrays = dict[str, Array]
Read = TypeVar("Read")

FORMAT = 2  # version of layout and sampling; a new version invalidates all files
_BLOCK = np.array([80, 80, 50])  # [0.1 mm] block size; points are stored as block and offset
_LARGEST = 256_000_000  # [bytes] largest expanded file; the paper's robot needs 30 MB
_PARTS = ("blocks", "places", "distances")

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
    """A file whose content does not match its name; the message has the reason."""


class _Header(Strict):
    """The description of a file, beside its arrays."""

    key: str
    format: int
    mobile: tuple[tuple[str, str], ...]
    manipulator: tuple[tuple[str, str], ...]
    never: tuple[tuple[str, str], ...]
    rates: dict[str, NonNegative]
    least_distance_m: dict[str, Finite]
    samples: int
    seed: int


def write(path: Path, header: _Header, arrays: Arrays) -> None:
    """Write a file completely or not at all; a zip has a checksum of each array.

    Raises:
        OSError: The folder cannot be made.
        OutputError: The file cannot be written.
    """
    told = np.frombuffer(header.model_dump_json().encode(), dtype=np.uint8)
    content: dict[str, Any] = {"header": told, **arrays}
    packed = io.BytesIO()
    np.savez_compressed(packed, **content)
    path.parent.mkdir(parents=True, exist_ok=True)
    write_whole(path, packed.getvalue())


def read(path: Path, unpack: Callable[[Arrays], Read]) -> Read:
    """The content of a file with valid checksums, which are zip's own.

    Raises:
        FileNotFoundError: The file does not exist.
        DamagedFileError: The file cannot be read, or has another content.
    """
    try:
        # Opened here: `np.load` leaves an unreadable file open, and accepts a plain array.
        with path.open("rb") as stream, NpzFile(stream, allow_pickle=False) as file:
            expanded = sum(each.file_size for each in file.zip.infolist())
            if expanded > _LARGEST:
                raise DamagedFileError(f"it expands to {expanded / 1e6:.0f} MB, too large")
            return unpack({name: file[name] for name in file.files})
    except FileNotFoundError:
        raise
    except _UNREADABLE as error:
        raise DamagedFileError(f"it cannot be read ({type(error).__name__})") from error


def robot_content(description: RobotDescription) -> dict[str, object]:
    """All data of a robot that determine the places of its bodies.

    From the description these are the bodies' shapes, the arm's joints and limits and the base's
    link; from the URDF its joints; from a mesh its bytes. Sources, colours, masses, gains and the
    paths of installed packages do not count.

    Raises:
        AssetError: The URDF or a mesh is missing.
    """
    arm = description.arm
    urdf = read_urdf(description)
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
        "kinematics": [  # in canonical XML, without comments and white space
            ElementTree.canonicalize(ElementTree.tostring(joint, "unicode"), strip_text=True)
            for joint in urdf.iterfind("joint")
        ],
    }


@dataclass(frozen=True)
class BorderData:
    """All offline results for one robot."""

    pairs: LinkPairs
    """§2.1, the pairs of (1)."""
    clouds: dict[str, Cloud]
    """P_i of Algorithm 1, by the name of the pair of L_m."""
    origin: Literal["cache", "shipped", "sampled"]
    """Its origin: the cache, a delivered file, or sampled now."""


def load_border_data(
    model: RobotModel,
    *,
    sampling: SamplingConfig | None = None,
    progress: bool = True,
    processes: int | None = None,
    on_progress: Callable[[float], None] = lambda _: None,
) -> BorderData:
    """Pairs and clouds of a robot, stored or sampled now, by `processes` or on all cores.

    The default sampling is that of the delivered file. `progress` draws a bar on stderr;
    `on_progress` takes the share that is sampled, 0 to 1.

    Raises:
        AssetError: The URDF or a mesh is missing.
        DescriptionError: The mobile robot is too large for the file format.
    """
    sampling = sampling or SamplingConfig()
    if (found := kept_border_data(model, sampling)) is not None:
        return found
    # Imported here: a robot with a stored border needs no sampling.
    from app.border.sampling import sample_clouds

    pairs = find_link_pairs(model, samples=sampling.pair_samples, seed=sampling.seed)
    clouds = sample_clouds(
        model,
        pairs.mobile,
        sampling,
        progress=progress,
        processes=processes,
        on_progress=on_progress,
    )
    data = BorderData(pairs, clouds, "sampled")
    key = border_key(model.description, sampling)
    path = _path(assets.cache_folder(), model, key)
    try:
        write(path, *pack(data, key))
    except (OSError, OutputError) as error:
        _log.warning("%s cannot be stored (%s); it will be computed again", path, error)
    return data


def kept_border_data(
    model: RobotModel, sampling: SamplingConfig | None = None
) -> BorderData | None:
    """Pairs and clouds of a robot if they are stored, otherwise None.

    The user's cache has precedence over the project's files. A damaged file, or one of another
    robot, is ignored with a warning.

    Raises:
        AssetError: The URDF or a mesh is missing.
    """
    key = border_key(model.description, sampling or SamplingConfig())
    folders: dict[Path, Literal["cache", "shipped"]] = {assets.cache_folder(): "cache"}
    folders.setdefault(assets.SHIPPED_CACHE, "shipped")
    for folder, origin in folders.items():
        path = _path(folder, model, key)
        try:
            return replace(read(path, partial(unpack, key=key)), origin=origin)
        except FileNotFoundError:
            continue
        except DamagedFileError as error:
            _log.warning("%s is not used: %s", path, error)
    return None


def _path(folder: Path, model: RobotModel, key: str) -> Path:
    return folder / f"{model.description.name}-{key}.npz"


def border_key(description: RobotDescription, sampling: SamplingConfig) -> str:
    """32 hexadecimal digits that depend on all inputs of the border.

    Raises:
        AssetError: The URDF or a mesh is missing.
    """
    content = {"format": FORMAT, **robot_content(description), "sampling": sampling.model_dump()}
    text = json.dumps(content, sort_keys=True, separators=(",", ":"), allow_nan=False)
    return hashlib.blake2b(text.encode(), digest_size=16).hexdigest()


def pack(data: BorderData, key: str) -> tuple[_Header, Arrays]:
    """Header and arrays of a file."""
    arrays = {}
    for i, pair in enumerate(data.pairs.mobile):
        for part, array in _pack(data.clouds[pair.name]).items():
            arrays[f"cloud{i}_{part}"] = array
    return _Header(format=FORMAT, key=key, **vars(data.pairs)), arrays


def unpack(arrays: Arrays, key: str) -> BorderData:
    """The inverse of `pack`.

    Raises:
        DamagedFileError: The file has another key or format, or a changed content.
    """
    header = _Header.model_validate_json(arrays["header"].tobytes())
    if (header.key, header.format) != (key, FORMAT):
        raise DamagedFileError("it belongs to another robot, sampling or version")
    mobile, manipulator, never = (
        tuple(Pair(*names) for names in group)
        for group in (header.mobile, header.manipulator, header.never)
    )
    rates, least = header.rates, header.least_distance_m
    pairs = LinkPairs(mobile, manipulator, never, rates, least, header.samples, header.seed)
    clouds = {
        pair.name: _unpack(pair.name, *(arrays[f"cloud{i}_{part}"] for part in _PARTS))
        for i, pair in enumerate(mobile)
    }
    return BorderData(pairs, clouds, "cache")


def _pack(cloud: Cloud) -> dict[str, Array]:
    """Compressible bytes: differences of consecutive blocks, offsets in a block, distances."""
    blocks = cloud.points // _BLOCK
    order = np.lexsort((blocks[:, 0], blocks[:, 1], blocks[:, 2]))
    blocks, points = blocks[order], cloud.points[order]
    steps = np.diff(blocks, axis=0, prepend=np.zeros((1, 3), dtype=int)).astype(np.int16)
    places = (points - blocks * _BLOCK).astype(np.uint8)
    distances = cloud.distances[order]
    parts = (_bytes(steps), np.ascontiguousarray(places.T), _bytes(distances[:, None]))
    return dict(zip(_PARTS, parts, strict=True))


def _unpack(pair: str, blocks: Array, places: Array, distances: Array) -> Cloud:
    """The inverse of `_pack`.

    Raises:
        DamagedFileError: An array has a wrong type or shape.
    """
    n = places.shape[-1]
    shapes = [(blocks, (3, 2, n)), (places, (3, n)), (distances, (1, 2, n))]
    if any(array.dtype != np.uint8 or array.shape != shape for array, shape in shapes):
        raise DamagedFileError("an array of it has the wrong type or shape")
    steps = _numbers(blocks, np.dtype("<i2"))
    points = np.cumsum(steps.T, axis=1, dtype=np.int16) * _BLOCK.astype(np.int16)[:, None] + places
    return make_cloud(pair, points.T, _numbers(distances, np.dtype("<u2"))[:, 0].astype(np.uint16))


def _bytes(array: Array) -> Array:
    """(k, 2, N) uint8: low and high bytes of each column of (N, k) 16-bit numbers, separately."""
    little = np.ascontiguousarray(array.T).astype(array.dtype.newbyteorder("<"))
    return np.ascontiguousarray(little.view(np.uint8).reshape(*little.shape, 2).transpose(0, 2, 1))


def _numbers(planes: Array, dtype: np.dtype) -> Array:
    """(N, k) 16-bit numbers, the inverse of `_bytes`."""
    return np.ascontiguousarray(planes.transpose(0, 2, 1)).view(dtype)[..., 0].T
