"""Files of a robot's offline results: its link pairs, and P_i of Algorithm 1 (the clouds).

A file is an `.npz` without pickles. Its name and header have its key, a hash of all inputs that is
equal on all machines.
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
from typing import Any, Literal
from xml.etree import ElementTree
from zipfile import BadZipFile

import numpy as np
from numpy.lib.npyio import NpzFile
from pydantic import TypeAdapter
from pydantic_core import to_json

from app.border.dbb import Cloud, make_cloud
from app.border.sampling import SamplingConfig, sample_clouds
from app.errors import OutputError
from app.robot import assets
from app.robot.assets import read_urdf, resolve_package_uri
from app.robot.description import RobotDescription
from app.robot.link_pairs import LinkPairs, find_link_pairs
from app.robot.model import RobotModel
from app.robot.shapes import ConvexMesh
from app.strict import Array
from app.system import write_whole

FORMAT = 2  # version of layout and sampling; a new version invalidates all files
_BLOCK = np.array([80, 80, 50])  # [0.1 mm] block size; points are stored as block and offset
_LARGEST = 256_000_000  # [bytes] largest expanded file; the paper's robot needs 30 MB
_PARTS = ("blocks", "places", "distances")
_HEADER = TypeAdapter(dict[str, Any])  # key, format, and the fields of `LinkPairs`
_PAIRS = TypeAdapter(LinkPairs)

_log = logging.getLogger(__name__)
_FAULTS = OSError, ValueError, KeyError, EOFError, BadZipFile, zlib.error, RuntimeError, MemoryError


class DamagedFileError(Exception):
    """A file cannot be read, its content is invalid, or its key is not the expected one."""


@dataclass(frozen=True)
class BorderData:
    """The link pairs of one robot, and the sampled points of its borders."""

    pairs: LinkPairs
    clouds: dict[str, Cloud]
    """P_i of Algorithm 1, the sampled points for each pair of arm and base, by the pair's name."""
    origin: Literal["cache", "shipped", "sampled"]
    """A file of `cache_folder`, a file of `SHIPPED_CACHE` if that is another folder, or a new
    sampling."""


def load_border_data(
    model: RobotModel,
    *,
    sampling: SamplingConfig | None = None,
    progress: bool = True,
    processes: int | None = None,
    on_progress: Callable[[float], None] = lambda _: None,
) -> BorderData:
    """Load the pairs and clouds of a robot, or sample and store them.

    Without `sampling`, the parameters are those of the delivered files. The other arguments are
    those of `sample_clouds`. Errors: those of `border_key` and `sample_clouds`.
    """
    sampling = sampling or SamplingConfig()
    if (found := kept_border_data(model, sampling)) is not None:
        return found
    pairs = find_link_pairs(model, samples=sampling.pair_samples, seed=sampling.seed)
    sample = partial(sample_clouds, progress=progress, processes=processes, on_progress=on_progress)
    data = BorderData(pairs, sample(model, pairs.mobile, sampling), "sampled")
    key = border_key(model.description, sampling)
    path = _path(assets.cache_folder(), model, key)
    try:
        write(path, data, key)
    except (OSError, OutputError) as error:
        _log.warning("%s cannot be stored (%s); it will be computed again", path, error)
    return data


def kept_border_data(
    model: RobotModel, sampling: SamplingConfig | None = None
) -> BorderData | None:
    """Load the pairs and clouds of a robot, or return None if no valid file has them.

    `cache_folder` has precedence over the delivered files. A file of another robot with the same
    key is valid too. A warning names each invalid file. Errors: those of `border_key`.
    """
    key = border_key(model.description, sampling or SamplingConfig())
    folders: dict[Path, Literal["cache", "shipped"]] = {assets.cache_folder(): "cache"}
    folders.setdefault(assets.SHIPPED_CACHE, "shipped")
    for folder, origin in folders.items():
        others = sorted(folder.glob(f"*-{key}.npz"))
        for path in dict.fromkeys((_path(folder, model, key), *others)):
            try:
                return replace(read(path, key), origin=origin)
            except FileNotFoundError:
                continue
            except DamagedFileError as error:
                _log.warning("%s is not used: %s", path, error)
    return None


def _path(folder: Path, model: RobotModel, key: str) -> Path:
    return folder / f"{model.description.name}-{key}.npz"


def border_key(description: RobotDescription, sampling: SamplingConfig) -> str:
    """The key of a robot's border: 32 hexadecimal digits.

    The key depends on the sampling, and on all data of the robot that determine its pairs and
    clouds, but not on masses, colours, gains or absolute paths. Errors: those of `read_urdf`, and
    an AssetError if a mesh is missing.
    """
    arm = description.arm
    content = {
        "format": FORMAT,
        "sampling": sampling.model_dump(),
        "base": description.mobile_body.frame,  # also in `bodies`; existing keys have it twice
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
            for joint in read_urdf(description).iterfind("joint")
        ],
    }
    text = json.dumps(content, sort_keys=True, separators=(",", ":"), allow_nan=False)
    return hashlib.blake2b(text.encode(), digest_size=16).hexdigest()


def write(path: Path, data: BorderData, key: str) -> None:
    """Write a file completely, or write nothing and raise an OSError or an OutputError."""
    header = to_json({"key": key, "format": FORMAT, **vars(data.pairs)})
    content: dict[str, Any] = {"header": np.frombuffer(header, dtype=np.uint8)}
    for i, pair in enumerate(data.pairs.mobile):
        for part, array in zip(_PARTS, _pack(data.clouds[pair.name]), strict=True):
            content[f"cloud{i}_{part}"] = array
    packed = io.BytesIO()
    np.savez_compressed(packed, **content)
    path.parent.mkdir(parents=True, exist_ok=True)
    write_whole(path, packed.getvalue())


def read(path: Path, key: str) -> BorderData:
    """Read a file, and verify its checksums, its key and its content.

    Raises a FileNotFoundError if it does not exist, and a DamagedFileError if it cannot be read, is
    too large, or has another key or an invalid content.
    """
    try:
        # `np.load` would leave an unreadable file open, and would accept a plain array.
        with path.open("rb") as stream, NpzFile(stream, allow_pickle=False) as file:
            assert file.zip is not None  # it is None only after `close`
            expanded = sum(each.file_size for each in file.zip.infolist())
            if expanded > _LARGEST:
                raise DamagedFileError(f"it expands to {expanded / 1e6:.0f} MB, which is too large")
            header = _HEADER.validate_json(file["header"].tobytes())
            if (header.pop("key"), header.pop("format")) != (key, FORMAT):
                raise DamagedFileError("it belongs to another robot, sampling or version")
            pairs = _PAIRS.validate_python(header)
            clouds = {
                pair.name: _unpack(pair.name, *(file[f"cloud{i}_{part}"] for part in _PARTS))
                for i, pair in enumerate(pairs.mobile)
            }
            return BorderData(pairs, clouds, "cache")
    except FileNotFoundError:
        raise
    except _FAULTS as error:
        raise DamagedFileError(f"it cannot be read ({type(error).__name__})") from error


def _pack(cloud: Cloud) -> tuple[Array, Array, Array]:
    """The arrays of `_PARTS`, as bytes: steps from block to block, places in blocks, distances."""
    blocks = cloud.points // _BLOCK
    order = np.lexsort((blocks[:, 0], blocks[:, 1], blocks[:, 2]))
    blocks, points = blocks[order], cloud.points[order]
    steps = np.diff(blocks, axis=0, prepend=np.zeros((1, 3), dtype=int)).astype(np.int16)
    places = (points - blocks * _BLOCK).astype(np.uint8)
    return _bytes(steps), np.ascontiguousarray(places.T), _bytes(cloud.distances[order, None])


def _unpack(pair: str, blocks: Array, places: Array, distances: Array) -> Cloud:
    """The cloud of three arrays of bytes, the inverse of `_pack`."""
    n = places.shape[-1]
    shapes = [(blocks, (3, 2, n)), (places, (3, n)), (distances, (1, 2, n))]
    if any(array.dtype != np.uint8 or array.shape != shape for array, shape in shapes):
        raise DamagedFileError("it has an array of a wrong type or shape")
    steps = _numbers(blocks, np.dtype("<i2"))
    points = np.cumsum(steps.T, axis=1, dtype=np.int16) * _BLOCK.astype(np.int16)[:, None] + places
    return make_cloud(pair, points.T, _numbers(distances, np.dtype("<u2"))[:, 0].astype(np.uint16))


def _bytes(array: Array) -> Array:
    """(k, 2, N) uint8 low and high bytes of 16-bit numbers (N, k)."""
    little = np.ascontiguousarray(array.T).astype(array.dtype.newbyteorder("<"))
    return np.ascontiguousarray(little.view(np.uint8).reshape(*little.shape, 2).transpose(0, 2, 1))


def _numbers(planes: Array, dtype: np.dtype) -> Array:
    """(N, k) 16-bit numbers from their bytes (k, 2, N), the inverse of `_bytes`."""
    return np.ascontiguousarray(planes.transpose(0, 2, 1)).view(dtype)[..., 0].T
