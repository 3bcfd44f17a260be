"""The file of a robot's border: one `.npz` without pickles, checked before it is believed."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import numpy as np

from app.border.checked_file import DamagedFileError, damage_told, read_arrays, write_arrays
from app.border.cloud import Cloud, make_cloud
from app.robot.link_pairs import LinkPairs, Pair
from app.strict import Finite, NonNegative, Strict

Array = np.ndarray

_BLOCK = np.array([80, 80, 50])  # [0.1 mm] points are told by their block and their place in it


class Content(NamedTuple):
    """What a file holds."""

    pairs: LinkPairs
    clouds: dict[str, Cloud]


class _Header(Strict):
    format: int
    key: str
    mobile: tuple[tuple[str, str], ...]
    manipulator: tuple[tuple[str, str], ...]
    never: tuple[tuple[str, str], ...]
    rates: dict[str, NonNegative]
    least_distance_m: dict[str, Finite]
    samples: int
    seed: int


def write(path: Path, content: Content, *, key: str, layout: int) -> None:
    """Write a file as a whole or not at all.

    Args:
        path: The file.
        content: What to keep.
        key: The key of `border_key`.
        layout: Its format number.

    Raises:
        OSError: The folder cannot be written.
    """
    write_arrays(path, _arrays(content, key, layout))


def read(path: Path, *, key: str, layout: int) -> Content:
    """Read a file and check it.

    Raises:
        FileNotFoundError: There is none.
        DamagedFileError: It is not a file of this key and format, or not as it was written.
    """
    with damage_told():
        arrays = read_arrays(path)
        header = _Header.model_validate_json(arrays["header"].tobytes())
        if header.format != layout or header.key != key:
            raise DamagedFileError("it belongs to another robot, sampling or version")
        return _content(header, arrays)


def _arrays(content: Content, key: str, layout: int) -> dict[str, Array]:
    pairs = content.pairs
    header = _Header(
        format=layout,
        key=key,
        mobile=pairs.mobile,
        manipulator=pairs.manipulator,
        never=pairs.never,
        rates=pairs.rates,
        least_distance_m=pairs.least_distance_m,
        samples=pairs.samples,
        seed=pairs.seed,
    )
    arrays = {"header": np.frombuffer(header.model_dump_json().encode(), dtype=np.uint8)}
    for i, pair in enumerate(pairs.mobile):
        for part, array in _pack(content.clouds[pair.name]).items():
            arrays[f"cloud{i}_{part}"] = array
    return arrays


def _content(header: _Header, arrays: dict[str, Array]) -> Content:
    mobile, manipulator, never = (
        tuple(Pair(*names) for names in group)
        for group in (header.mobile, header.manipulator, header.never)
    )
    pairs = LinkPairs(
        mobile,
        manipulator,
        never,
        header.rates,
        header.least_distance_m,
        header.samples,
        header.seed,
    )
    clouds = {
        pair.name: _unpack(pair.name, *(arrays[f"cloud{i}_{part}"] for part in _PARTS))
        for i, pair in enumerate(mobile)
    }
    return Content(pairs, clouds)


_PARTS = ("blocks", "places", "distances")


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
