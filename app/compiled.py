"""Numerical kernels, compiled to machine code once for a machine and kept beside their source.

What a control step computes on vectors of nine is nothing but overhead in an interpreter: kernels
make the whole step twice to three times as fast. A kernel is a plain function of floats and arrays,
which does the same, slowly, with `NUMBA_DISABLE_JIT=1`.
"""

import sys
from collections.abc import Callable
from functools import lru_cache, partial
from typing import TypeVar, cast

import numba
from numba import types
from numba.core import config, sigutils
from numba.core.typing.templates import Signature

Function = TypeVar("Function", bound=Callable[..., object])


def compiled(*signatures: str) -> Callable[[Function], Function]:
    """Compile a function for the given types, when its module is imported for the first time.

    So a control loop never waits for a compiler, and an array of another dtype is refused. A kernel
    may call kernels of its own module only: what numba keeps for it is compiled anew when its own
    file changes, not when another one does (so still with numba 0.68). Where nothing can be kept,
    neither beside the source nor in the user's cache, each process compiles what it imports.

    Args:
        signatures: As numba writes them, such as ``f8[:](f8[:,:], i8)``. Without any it is a part
            of the kernels of its module that call it, and not to be called from elsewhere.
    """

    def compile_(function: Function) -> Function:
        known = [_any_array(signature) for signature in signatures]
        compile_now = partial(numba.njit, known or None, error_model="numpy")
        try:
            kernel = compile_now(cache=bool(known))(function)
        except RuntimeError:  # numba has found no folder that it can write to
            _tell_once("each time: set NUMBA_CACHE_DIR to a folder that can be written")
            return cast("Function", compile_now()(function))
        if signatures and not config.DISABLE_JIT and kernel.stats.cache_misses:
            _tell_once("once on this machine")
        return cast("Function", kernel)

    return compile_


def _any_array(signature: str) -> Signature:
    """The same with arrays as they come: of any strides, and read-only if need be.

    What gives nothing back writes to its arguments: they stay as they are.
    """
    given, returned = sigutils.normalize_signature(signature)
    if returned == types.void:
        return Signature(returned, given, None)
    as_they_come = tuple(
        types.Array(each.dtype, each.ndim, "A", readonly=True)
        if isinstance(each, types.Array)
        else each
        for each in given
    )
    return Signature(returned, as_they_come, None)


@lru_cache(maxsize=1)
def _tell_once(how_often: str) -> None:
    """Say why nothing happens for a while: another kernel was not kept yet."""
    print(f"dbb: compiling kernels, {how_often}: half a minute", file=sys.stderr)
