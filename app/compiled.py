"""Numerical kernels, compiled to machine code once for a machine and kept beside their source.

What a control step computes on vectors of nine is nothing but overhead in an interpreter: kernels
make the whole step twice to three times as fast. A kernel is a plain function of floats and arrays,
which does the same, slowly, with `NUMBA_DISABLE_JIT=1`.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from functools import lru_cache
from typing import TypeVar, cast

import numba
from numba.core import config

Function = TypeVar("Function", bound=Callable[..., object])


def compiled(*signatures: str) -> Callable[[Function], Function]:
    """Compile a function for the given types, when its module is imported for the first time.

    So a control loop never waits for a compiler, and an array of another type is refused. A kernel
    may call kernels of its own module only: what is kept knows nothing of changes elsewhere.

    Args:
        signatures: As numba writes them, such as ``f8[:](f8[:,:], i8)``. Without any it is a part
            of the kernels of its module that call it, and not to be called from elsewhere.
    """

    def compile_(function: Function) -> Function:
        kernel = numba.njit(list(signatures) or None, cache=bool(signatures), error_model="numpy")(
            function
        )
        if signatures and not config.DISABLE_JIT and kernel.stats.cache_misses:
            _tell_once()
        return cast("Function", kernel)

    return compile_


@lru_cache(maxsize=1)
def _tell_once() -> None:
    """Say why nothing happens for a while: another kernel was not kept yet."""
    print("dbb: compiling kernels, once on this machine: half a minute", file=sys.stderr)
