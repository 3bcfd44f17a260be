"""Numerical kernels, compiled to machine code once for a machine and kept beside their source.

What a control step computes on vectors of nine is nothing but overhead in an interpreter: kernels
make the whole step twice to three times as fast. A kernel is a plain function of floats and arrays,
which does the same, slowly, with `NUMBA_DISABLE_JIT=1`.
"""

import sys
from collections.abc import Callable
from functools import lru_cache
from pathlib import Path
from types import FunctionType
from typing import Any, TypeVar, cast

import numba
from numba import types
from numba.core import config, sigutils
from numba.core.compiler import CompilerBase, DefaultPassBuilder
from numba.core.compiler_machinery import AnalysisPass, PassManager, register_pass
from numba.core.dispatcher import Dispatcher
from numba.core.typed_passes import NativeLowering
from numba.core.typing.templates import Signature


@register_pass(mutates_CFG=False, analysis_only=True)
class _NoInline(AnalysisPass):
    """Keeps a function apart from its callers: LLVM needs far longer for one large function."""

    _name = "no_inline"

    def __init__(self) -> None:
        AnalysisPass.__init__(self)

    def run_pass(self, state: Any) -> bool:
        name = state.cr.fndesc.llvm_func_name
        state.library._final_module.get_function(name).add_function_attribute("noinline")
        return False


class _Apart(CompilerBase):
    """numba's pipeline with `_NoInline` at its end."""

    def define_pipelines(self) -> list[PassManager]:
        passes = DefaultPassBuilder.define_nopython_pipeline(self.state)
        passes.add_pass_after(_NoInline, NativeLowering)
        passes.finalize()
        return [passes]


Function = TypeVar("Function", bound=Callable[..., object])


def compiled(*signatures: str | Signature) -> Callable[[Function], Function]:
    """Compile a function for the given types, when its module is imported for the first time.

    So a control loop never waits for a compiler, and an array of another dtype is refused. Where
    nothing can be kept, neither beside the source nor in the user's cache, each process compiles
    what it imports.

    Args:
        signatures: As numba writes them, such as ``f8[:](f8[:,:], i8)``, or numba's own objects,
            which are taken as they are. Without any the function is a part of the kernels that call
            it, and nothing of its own is stored.
    """

    def compile_(function: Function) -> Function:
        kernel = numba.njit(error_model="numpy", pipeline_class=_Apart)(function)
        if config.DISABLE_JIT or not signatures:
            return cast("Function", kernel)
        try:
            kernel.enable_caching()
        except RuntimeError:  # numba has found no folder that it can write to
            how_often = "each time: set NUMBA_CACHE_DIR to a folder that can be written"
        else:  # for numba (so still 0.68) a kernel is its own file only
            kernel._cache._cache_file._source_stamp = _stamp(kernel)
            how_often = "once on this machine"
        for signature in signatures:
            kernel.compile(_any_array(signature) if isinstance(signature, str) else signature)
        kernel.disable_compile()
        if kernel.stats.cache_misses:
            _tell_once(how_often)
        return cast("Function", kernel)

    return compile_


def _stamp(kernel: Dispatcher) -> tuple[tuple[str, float, int], ...]:
    """What a kernel is made of: name, time and size of its file, and of each that it calls into.

    Others are those that it has by their own names; constants are to be its own file's.
    """
    files, known, called = set[Path](), set[FunctionType](), [kernel.py_func]
    while called:
        function = called.pop()
        files.add(Path(function.__code__.co_filename))
        known.add(function)
        named = (function.__globals__.get(name) for name in function.__code__.co_names)
        parts = {each.py_func for each in named if isinstance(each, Dispatcher)}
        called += parts - known
    kept = sorted((file, file.stat()) for file in files)
    return tuple((file.name, stat.st_mtime, stat.st_size) for file, stat in kept)


def _any_array(signature: str) -> Signature:
    """The same with arrays as they come: of any strides, and read-only if need be.

    Arrays that are written as contiguous, and all arguments of a function that returns nothing and
    so writes to them, stay as they are.
    """
    given, returned = sigutils.normalize_signature(signature)
    if returned == types.void:
        return Signature(returned, given, None)
    as_they_come = tuple(
        types.Array(each.dtype, each.ndim, "A", readonly=True)
        if isinstance(each, types.Array) and each.layout == "A"
        else each
        for each in given
    )
    return Signature(returned, as_they_come, None)


@lru_cache(maxsize=1)
def _tell_once(how_often: str) -> None:
    """Say why nothing happens for a while: another kernel was not kept yet."""
    print(f"dbb: compiling kernels, {how_often}: half a minute", file=sys.stderr)
