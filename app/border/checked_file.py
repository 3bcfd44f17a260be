"""Arrays in one `.npz` without pickles, written as a whole, checked before they are believed."""

from __future__ import annotations

import hashlib
import os
import tempfile
import zlib
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any
from zipfile import BadZipFile

import numpy as np

Array = np.ndarray

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


def write_arrays(path: Path, arrays: Mapping[str, Array]) -> None:
    """Write a file as a whole or not at all, with a checksum.

    Raises:
        OSError: The folder cannot be written.
    """
    content: dict[str, Any] = {**arrays, "checksum": _checksum(arrays)}
    path.parent.mkdir(parents=True, exist_ok=True)
    handle, name = tempfile.mkstemp(dir=path.parent, prefix=path.stem, suffix=".tmp")
    try:
        with os.fdopen(handle, "wb") as file:
            np.savez_compressed(file, **content)
            file.flush()
            os.fsync(file.fileno())
        os.chmod(name, 0o644)  # a temporary file is private, a cache need not be
        os.replace(name, path)
    except BaseException:
        os.unlink(name)
        raise


def read_arrays(path: Path) -> dict[str, Array]:
    """The arrays of a file whose checksum holds; read within `damage_told`.

    Raises:
        DamagedFileError: The checksum does not hold.
    """
    with np.load(path, allow_pickle=False) as file:
        arrays = {name: file[name] for name in file.files}
    checksum = arrays.pop("checksum")
    if not np.array_equal(checksum, _checksum(arrays)):
        raise DamagedFileError("its checksum does not hold")
    return arrays


@contextmanager
def damage_told() -> Iterator[None]:
    """Whatever goes wrong with a file that exists becomes a `DamagedFileError`.

    Raises:
        FileNotFoundError: There is no file.
        DamagedFileError: It cannot be read, or not as what it should be.
    """
    try:
        yield
    except FileNotFoundError:
        raise
    except _UNREADABLE as error:
        raise DamagedFileError(f"it cannot be read ({type(error).__name__})") from error


def _checksum(arrays: Mapping[str, Array]) -> Array:
    """(32,) uint8 over names, types, shapes and bytes."""
    total = hashlib.blake2b(digest_size=32)
    for name in sorted(arrays):
        array = np.ascontiguousarray(arrays[name])
        total.update(f"{name} {array.dtype.str} {array.shape};".encode())
        total.update(array.data)
    return np.frombuffer(total.digest(), dtype=np.uint8)
