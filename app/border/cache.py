"""The pairs and clouds of a robot, from a file if there is one, else sampled once and kept."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Literal, NamedTuple

import numpy as np

from app.border.config import SamplingConfig
from app.border.dbb import Cloud, make_cloud
from app.border.kept import (
    Arrays,
    DamagedFileError,
    Header,
    digest,
    find_kept,
    header_of,
    keep,
    robot_content,
)
from app.robot.description import RobotDescription
from app.robot.link_pairs import LinkPairs, Pair, find_link_pairs
from app.robot.model import RobotModel
from app.strict import Finite, NonNegative

Array = np.ndarray

FORMAT = 2
"""Number of the file's layout and of the way of sampling; a new one outdates all files."""
_BLOCK = np.array([80, 80, 50])  # [0.1 mm] points are told by their block and their place in it
_PARTS = ("blocks", "places", "distances")


@dataclass(frozen=True)
class BorderData:
    """All that is made offline for one robot.

    Attributes:
        pairs: §2.1, the pairs of (1).
        clouds: P_i of Algorithm 1, by the name of the pair of L_m.
        origin: Where it came from: the cache, a file shipped with the project, or sampled now.
    """

    pairs: LinkPairs
    clouds: dict[str, Cloud]
    origin: Literal["cache", "shipped", "sampled"]


def load_border_data(
    model: RobotModel,
    *,
    sampling: SamplingConfig | None = None,
    progress: bool = True,
    processes: int | None = None,
    on_progress: Callable[[float], None] | None = None,
) -> BorderData:
    """Pairs and clouds of a robot.

    Args:
        model: The robot.
        sampling: How to sample; the default is what the shipped file was made with.
        progress: Whether to draw a bar on stderr while sampling.
        processes: How many to sample with; all cores if not given.
        on_progress: Called with the share that is sampled, 0 to 1.

    Raises:
        AssetError: The URDF or a mesh is not there.
        DescriptionError: The mobile robot is too large to be kept.
    """
    sampling = sampling or SamplingConfig()
    if (found := kept_border_data(model, sampling)) is not None:
        return found
    # Imported here: a control step of a robot whose border is kept needs no sampling.
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
    key = border_key(model.description, sampling)
    keep(model.description.name, *pack(Content(pairs, clouds), key))
    return BorderData(pairs, clouds, "sampled")


def kept_border_data(
    model: RobotModel, sampling: SamplingConfig | None = None
) -> BorderData | None:
    """Pairs and clouds of a robot if they need not be sampled, else None.

    Raises:
        AssetError: The URDF or a mesh is not there.
    """
    key = border_key(model.description, sampling or SamplingConfig())
    found = find_kept(model.description.name, key, partial(unpack, key=key))
    return found and BorderData(*found[0], found[1])


def border_key(description: RobotDescription, sampling: SamplingConfig) -> str:
    """32 hexadecimal digits that change whenever the border could.

    Raises:
        AssetError: The URDF or a mesh is not there.
    """
    return digest(
        {"format": FORMAT, **robot_content(description), "sampling": sampling.model_dump()}
    )


class Content(NamedTuple):
    """What a file holds."""

    pairs: LinkPairs
    clouds: dict[str, Cloud]


class _Header(Header):
    format: int
    mobile: tuple[tuple[str, str], ...]
    manipulator: tuple[tuple[str, str], ...]
    never: tuple[tuple[str, str], ...]
    rates: dict[str, NonNegative]
    least_distance_m: dict[str, Finite]
    samples: int
    seed: int


def pack(content: Content, key: str) -> tuple[Header, Arrays]:
    """Header and arrays of a file."""
    arrays = {}
    for i, pair in enumerate(content.pairs.mobile):
        for part, array in _pack(content.clouds[pair.name]).items():
            arrays[f"cloud{i}_{part}"] = array
    return _Header(format=FORMAT, key=key, **vars(content.pairs)), arrays


def unpack(arrays: Arrays, key: str) -> Content:
    """The inverse of `pack`.

    Raises:
        DamagedFileError: The file is of another key or format, or not as it was written.
    """
    header = header_of(arrays, _Header, key=key, format=FORMAT)
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
    return Content(pairs, clouds)


def _pack(cloud: Cloud) -> dict[str, Array]:
    """Bytes that compress well: blocks in a row as differences, places in a block, distances."""
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
        DamagedFileError: The arrays are not of the right type or shape.
    """
    n = places.shape[-1]
    shapes = [(blocks, (3, 2, n)), (places, (3, n)), (distances, (1, 2, n))]
    if any(array.dtype != np.uint8 or array.shape != shape for array, shape in shapes):
        raise DamagedFileError("an array of it has the wrong type or shape")
    steps = _numbers(blocks, np.dtype("<i2"))
    points = np.cumsum(steps.T, axis=1, dtype=np.int16) * _BLOCK.astype(np.int16)[:, None] + places
    return make_cloud(pair, points.T, _numbers(distances, np.dtype("<u2"))[:, 0].astype(np.uint16))


def _bytes(array: Array) -> Array:
    """(k, 2, N) uint8: low and high bytes of each column of (N, k) 16-bit numbers, apart."""
    little = np.ascontiguousarray(array.T).astype(array.dtype.newbyteorder("<"))
    return np.ascontiguousarray(little.view(np.uint8).reshape(*little.shape, 2).transpose(0, 2, 1))


def _numbers(planes: Array, dtype: np.dtype) -> Array:
    """(N, k) 16-bit numbers, the inverse of `_bytes`."""
    return np.ascontiguousarray(planes.transpose(0, 2, 1)).view(dtype)[..., 0].T
