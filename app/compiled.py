"""Numerical kernels, compiled to machine code once for a machine and kept beside their source.

What a control step computes on vectors of nine is nothing but overhead in an interpreter: kernels
make the whole step twice to three times as fast. A kernel is a plain function of floats and arrays,
which does the same, slowly, with `NUMBA_DISABLE_JIT=1`.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar, cast

import numba

Function = TypeVar("Function", bound=Callable[..., object])


def compiled(*signatures: str) -> Callable[[Function], Function]:
    """Compile a function for the given types, when its module is imported for the first time.

    So a control loop never waits for a compiler, and an array of another type is refused. A kernel
    may call kernels of its own module only: what is kept knows nothing of changes elsewhere.

    Args:
        signatures: As numba writes them, such as ``f8[:](f8[:,:], i8)``.
    """
    return cast(
        "Callable[[Function], Function]",
        numba.njit(list(signatures), cache=True, error_model="numpy"),
    )
