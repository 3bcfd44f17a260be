"""Structs: compiled code reads the values of Python and writes into the same memory."""

from __future__ import annotations

import copy
import ctypes
import gc
from typing import Any, NamedTuple

import numpy as np
import pytest
from numba import types
from numba.core.runtime import nrtdynmod
from numba.core.typing.templates import Signature

from app.compiled import compiled
from app.structs import StructType

FIELDS = {
    "number": types.f8,
    "flag": types.b1,
    "matrix": types.Array(types.f8, 2, "C"),
    "count": types.i8,
    "first": types.b1,
    "second": types.b1,
    "turned": types.Array(types.f8, 2, "F"),
    "complex": types.Array(types.c16, 1, "C"),
    "scalar": types.Array(types.f8, 0, "C"),
}
Values: Any = NamedTuple("Values", [(name, Any) for name in FIELDS])  # type: ignore[misc]
KIND = StructType("Values", FIELDS)


@compiled(Signature(types.void, (KIND.type, types.Array(types.f8, 1, "C")), None))
def read(w: Any, found: np.ndarray) -> None:
    w.matrix[1, 2] += 1.0
    w.scalar[()] = 7.0
    found[0], found[1] = w.number, w.count
    found[2], found[3], found[4] = w.flag, w.first, w.second
    found[5], found[6] = w.matrix[0, 1], w.turned[0, 1]
    found[7], found[8] = w.complex[1].imag, w.matrix.shape[1]


@pytest.mark.parametrize("flags", [(True, False, True), (False, True, False)])
def test_compiled_code_reads_every_field_and_shares_its_memory(flags: tuple[bool, ...]) -> None:
    flag, first, second = flags
    matrix, turned = np.arange(6.0).reshape(2, 3), np.arange(6.0).reshape(2, 3).T.copy(order="F")
    scalar = np.array(0.0)
    values = Values(1.5, flag, matrix, 4, first, second, turned, np.array([1j, 2j]), scalar)
    struct, found = KIND.made_of(values), np.empty(9)
    del values
    gc.collect()
    read(struct, found)
    assert found.tolist() == [1.5, 4, flag, first, second, 1.0, turned[0, 1], 2.0, 3.0]
    assert (matrix[1, 2], scalar[()]) == (6.0, 7.0)


def count(struct: Any) -> int:
    """The count of references in numba's record of a struct's memory."""
    return ctypes.c_int64.from_address(int(struct)).value


def test_compiled_code_never_releases_the_memory_of_a_struct() -> None:
    matrix, turned = np.ones((2, 3)), np.ones((3, 2), order="F")
    complex_, scalar = np.array([1j, 2j]), np.array(0.0)
    values = Values(1.5, True, matrix, 4, False, True, turned, complex_, scalar)
    struct = KIND.made_of(values)
    assert count(struct) == 1
    for _ in range(100):
        read(struct, np.empty(9))
        with pytest.raises(TypeError):
            read(struct, "not an array")
    assert count(struct) == 1


@pytest.mark.parametrize("copied", [copy.copy, copy.deepcopy])
def test_a_struct_is_not_copied_because_its_address_belongs_to_one_memory(copied: Any) -> None:
    kind = StructType("One", {"x": types.f8})
    struct = kind.made_of(NamedTuple("One", [("x", float)])(1.0))
    with pytest.raises(TypeError, match="address of its memory"):
        copied(struct)


def test_numba_has_the_record_of_memory_that_structs_and_kernels_assume() -> None:
    words = [str(each) for each in nrtdynmod._meminfo_struct_type.elements]
    assert words == ["i64", "i8*", "i8*", "i8*", "i64"]  # the allocator follows
