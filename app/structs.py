"""Structs of arrays and numbers that Python and compiled code share.

A compiled function takes a struct as one pointer, in 0.2 µs for any number of fields; a tuple of
arrays costs 0.1 µs for each of them. Both sides share the memory: Python reads the values that
compiled code writes into an array without a copy. Numbers, and the arrays that the fields refer
to, are fixed when a struct is made. With ``NUMBA_DISABLE_JIT=1`` the struct is the named tuple
that it is made from.
"""

from collections.abc import Callable
from hashlib import sha256
from typing import Any, NamedTuple, cast

import numpy as np
from numba import types
from numba.core import cgutils
from numba.core.typing.templates import Signature
from numba.experimental import structref
from numba.extending import intrinsic, overload

from app.compiled import compiled


@structref.register
class _Struct(types.StructRef):
    """The type of a struct: names and types of its fields.

    Its name is short because numba writes it into the name of every function that takes the struct.
    """

    def __init__(self, name: str, fields: dict[str, types.Type]) -> None:
        super().__init__(list(fields.items()))
        self.name = f"{name}_{sha256(repr(self._fields).encode()).hexdigest()[:16]}"
        self._payload = types.StructRefPayload("struct", ())
        self._payload._fields, self._payload.name = self._fields, f"{self.name}_payload"

    def preprocess_fields(self, fields: Any) -> Any:
        return tuple((name, types.unliteral(kind)) for name, kind in fields)

    def get_data_type(self) -> types.StructRefPayload:
        return self._payload


class _Handle(structref.StructRefProxy):
    """A struct on the Python side."""

    values: Any
    """The owner of the memory of its arrays."""


structref.define_boxing(_Struct, _Handle)


class StructType(NamedTuple):
    """A kind of struct."""

    type: types.StructRef
    """Its name in the signature of a compiled function."""
    made_from: Signature
    """The signature of the compiled function that makes it from a named tuple, by `assemble`."""


_TYPES: dict[type, types.StructRef] = {}


def struct_type(values: type[Any], fields: dict[str, types.Type]) -> StructType:
    """The kind of struct with the fields of a named tuple, each of a numba type."""
    struct = _TYPES[values] = _Struct(values.__name__, fields)
    given = types.NamedTuple(tuple(fields.values()), values)
    return StructType(struct, Signature(struct, (given,), None))


def make_struct(make: Callable[[Any], Any], values: Any) -> Any:
    """The struct of a named tuple, by a compiled function that calls `assemble`.

    The struct owns the tuple. Its arrays are borrowed, so that compiled code does not count the
    references to them: that would take a fifth of a control step.
    """
    struct = make(values)
    if struct is not values:
        struct.values = values
    return struct


def assemble(values: Any) -> Any:
    """A struct from a named tuple, in compiled code; in Python the named tuple itself."""
    return values


@intrinsic
def _borrowed(_: Any, value: Any) -> Any:
    """An array that does not own its memory, or the number itself."""

    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        if not isinstance(value, types.Array):
            return args[0]
        array = context.make_array(value)(context, builder, args[0])
        for field in ("meminfo", "parent"):
            setattr(array, field, cgutils.get_null_value(getattr(array, field).type))
        return array._getvalue()

    return value(value), codegen


@overload(assemble, strict=False)
def _assemble(values: Any) -> Callable[..., Any]:
    body = "".join(f"    struct.{name} = borrowed(values.{name})\n" for name in values.fields)
    known = {
        "new": structref.new,
        "struct_type": _TYPES[values.instance_class],
        "borrowed": _borrowed,
    }
    exec(f"def assemble(values):\n    struct = new(struct_type)\n{body}    return struct\n", known)
    return cast("Callable[..., Any]", known["assemble"])


@compiled()
def put(into: np.ndarray, values: np.ndarray) -> None:
    """Copy values into an array; ``into[:] = values`` compiles to fifty times as much code."""
    for i in range(len(into)):
        into[i] = values[i]


@compiled()
def put_rows(into: np.ndarray, values: np.ndarray) -> None:
    """Copy rows of values (k, n) into the first k rows of an array."""
    for i in range(len(values)):
        for j in range(values.shape[1]):
            into[i, j] = values[i, j]


@compiled()
def fill(into: np.ndarray, value: float) -> None:
    """Set all entries of an array to a value."""
    for i in range(len(into)):
        into[i] = value
