"""The file of a reachability map: one `.npz` without pickles, checked before it is believed."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import numpy as np
from pydantic import Field

from app.border.checked_file import DamagedFileError, damage_told, read_arrays, write_arrays
from app.strict import Positive, Strict, Vector3

Array = np.ndarray


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
    write_arrays(path, arrays)


def read(path: Path, key: str) -> Counts:
    """Read a file and check it.

    Raises:
        FileNotFoundError: There is none.
        DamagedFileError: It is not a file of this key, or not as it was written.
    """
    with damage_told():
        arrays = read_arrays(path)
        header = Header.model_validate_json(arrays["header"].tobytes())
        if header.key != key:
            raise DamagedFileError("it belongs to another robot, sampling or version")
        return Counts(header, arrays["steps"].T, arrays["found"])
