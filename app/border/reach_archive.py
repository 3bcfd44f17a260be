"""The file of a reachability map: one `.npz` without pickles, checked before it is believed."""

from __future__ import annotations

import hashlib
import os
import tempfile
import zlib
from pathlib import Path
from typing import NamedTuple
from zipfile import BadZipFile

import numpy as np
from pydantic import Field

from app.border.archive import DamagedFileError
from app.strict import Positive, Strict, Vector3

Array = np.ndarray

_UNREADABLE = (
    OSError, ValueError, KeyError, EOFError, BadZipFile, zlib.error, NotImplementedError,
    RuntimeError, MemoryError,
)  # fmt: skip


class Header(Strict):
    """What a file says of itself."""

    key: str
    body: str
    p_base: Vector3
    """[m]"""
    seed: int
    spacing_m: Positive
    samples: int = Field(ge=1)
    """[-] poses at each position."""
    method: str
    free_joints: tuple[str, ...]


class Counts(NamedTuple):
    """What a file holds: positions (N, 3) int16 in steps of the lattice, solutions (N,) uint16."""

    header: Header
    steps: Array
    found: Array


def write(path: Path, content: Counts) -> None:
    """Write a file as a whole or not at all.

    Raises:
        OSError: The folder cannot be written.
    """
    header = np.frombuffer(content.header.model_dump_json().encode(), dtype=np.uint8)
    arrays = {"header": header, "steps": content.steps.T, "found": content.found}
    path.parent.mkdir(parents=True, exist_ok=True)
    handle, name = tempfile.mkstemp(dir=path.parent, prefix=path.stem, suffix=".tmp")
    try:
        with os.fdopen(handle, "wb") as file:
            np.savez_compressed(file, checksum=_checksum(arrays), **arrays)
            file.flush()
            os.fsync(file.fileno())
        os.chmod(name, 0o644)  # a temporary file is private, a cache need not be
        os.replace(name, path)
    except BaseException:
        os.unlink(name)
        raise


def read(path: Path, key: str) -> Counts:
    """Read a file and check it.

    Raises:
        FileNotFoundError: There is none.
        DamagedFileError: It is not a file of this key, or not as it was written.
    """
    try:
        with np.load(path, allow_pickle=False) as file:
            arrays = {name: file[name] for name in ("header", "steps", "found")}
            if not np.array_equal(file["checksum"], _checksum(arrays)):
                raise DamagedFileError("its checksum does not hold")
        header = Header.model_validate_json(arrays["header"].tobytes())
        if header.key != key:
            raise DamagedFileError("it belongs to another robot, sampling or version")
        return Counts(header, arrays["steps"].T, arrays["found"])
    except FileNotFoundError:
        raise
    except _UNREADABLE as error:
        raise DamagedFileError(f"it cannot be read ({type(error).__name__})") from error


def _checksum(arrays: dict[str, Array]) -> Array:
    """(32,) uint8 over names, types, shapes and bytes."""
    total = hashlib.blake2b(digest_size=32)
    for name in sorted(arrays):
        array = np.ascontiguousarray(arrays[name])
        total.update(f"{name} {array.dtype.str} {array.shape};".encode())
        total.update(array.tobytes())
    return np.frombuffer(total.digest(), dtype=np.uint8)
