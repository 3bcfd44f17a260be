"""Numerical kernels, compiled to machine code once and shared by all users who may read them.

In an interpreter a control step on vectors of nine entries is mostly overhead: kernels make the
whole step two to three times as fast. A kernel is a plain function of floats and arrays; with
`NUMBA_DISABLE_JIT=1` it does the same, slowly.
"""

import sys
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from functools import lru_cache, partial
from typing import Any, TypeVar, cast

import llvmlite.binding as llvm
import numba
from numba import types
from numba.core import config, sigutils
from numba.core.compiler import CompilerBase, DefaultPassBuilder
from numba.core.compiler_machinery import PassManager, register_pass
from numba.core.dispatcher import Dispatcher
from numba.core.typed_passes import NativeLowering
from numba.core.typing.templates import Signature

from app.kernel_store import KernelStore

_INLINED = 400  # bytes of bytecode of a function that may be inlined: LLVM needs far longer for
# one large function than for several
Function = TypeVar("Function", bound=Callable[..., object])


def compiled(*signatures: str | Signature) -> Callable[[Function], Function]:
    """Compile a function for the given types when its module is first imported.

    Thus a control loop never waits for a compiler, and an array of another dtype is refused. If no
    folder is writable, each process compiles the kernels that it imports.

    Args:
        signatures: In numba's notation, such as ``f8[:](f8[:,:], i8)``, or numba's own objects,
            which are used unchanged. Without signatures the function becomes a part of the kernels
            that call it; a call from Python then waits for the compiler the first time.
    """

    def compile_(function: Function) -> Function:
        kernel = numba.njit(error_model="numpy", pipeline_class=_Compiler)(function)
        if config.DISABLE_JIT:
            return cast("Function", kernel)
        _be_part_of_callers(kernel, numba.njit(error_model="numpy", pipeline_class=_PartCompiler))
        with suppress(OSError):  # a function without a file cannot be stored
            kernel._cache = KernelStore(kernel.py_func)
        if not signatures:
            return cast("Function", kernel)
        for signature in signatures:
            kernel.compile(_any_array(signature) if isinstance(signature, str) else signature)
        kernel.disable_compile()
        if kernel.stats.cache_misses or not isinstance(kernel._cache, KernelStore):
            _tell_once(getattr(kernel._cache, "saved", False))
        return cast("Function", kernel)

    return compile_


def _be_part_of_callers(kernel: Dispatcher, as_part: Callable[..., Dispatcher]) -> None:
    """Let compiled callers include the function instead of linking its machine code.

    numba optimises a function and makes machine code of it before it links it into a caller, where
    both happen again: ten times for a chain of ten calls.
    """
    part = as_part(kernel.py_func)

    def get_call_template(args: Sequence[types.Type], kws: Mapping[str, types.Type]) -> Any:
        # One version for all numbers, not one for each number that a caller writes.
        named = {name: types.unliteral(kind) for name, kind in kws.items()}
        return part.get_call_template(tuple(map(types.unliteral, args)), named)

    kernel.get_call_template, kernel.get_overload = get_call_template, part.get_overload


@register_pass(mutates_CFG=True, analysis_only=False)
class _PartLowering(NativeLowering):
    """Lowers a function to code that only callers link."""

    _name = "part_lowering"

    def run_pass(self, state: Any) -> bool:
        library = state.targetctx.codegen().create_library(state.func_id.func_qualname)
        library.enable_object_caching()
        library._optimize_final_module = lambda: None
        library._finalize_final_module = lambda: setattr(library, "_finalized", True)
        state.library = library
        for flag in ("no_compile", "no_cpython_wrapper", "no_cfunc_wrapper"):
            setattr(state.flags, flag, True)
        super().run_pass(state)
        function = library._final_module.get_function(state.cr.fndesc.llvm_func_name)
        if len(state.func_id.func.__code__.co_code) > _INLINED:
            function.add_function_attribute("noinline")

        entry_point = [].append  # never called: numba wants a built-in function of its own here
        state.targetctx.insert_user_function(entry_point, state.cr.fndesc, [library])
        state.cr = state.cr._replace(cfunc=entry_point)
        return True


@register_pass(mutates_CFG=True, analysis_only=False)
class _Lowering(NativeLowering):
    """Makes machine code without vector instructions and unrolled loops.

    For loops of nine rounds vectors are slower, and unrolling doubles the size of the code, which
    has to be read from memory in each control step.
    """

    _name = "compact_lowering"

    def run_pass(self, state: Any) -> bool:
        codegen, before = state.targetctx.codegen(), config.LOOP_VECTORIZE
        config.LOOP_VECTORIZE = codegen._loopvect = 0
        codegen._pass_builder = partial(_pass_builder, codegen)  # numba 0.61 has none
        try:
            return super().run_pass(state)
        finally:
            config.LOOP_VECTORIZE = codegen._loopvect = before
            del codegen._pass_builder


def _pass_builder(codegen: Any, opt: Any = None, **_: Any) -> Any:
    """numba's, with other options."""
    options = llvm.create_pipeline_tuning_options()
    options.speed_level = config.OPT if opt is None else opt
    options.slp_vectorization = options.loop_vectorization = options.loop_unrolling = False
    return llvm.create_pass_builder(codegen._tm, options)


class _Compiler(CompilerBase):
    """numba's pipeline with another last pass."""

    lowering: type[NativeLowering] = _Lowering

    def define_pipelines(self) -> list[PassManager]:
        passes = DefaultPassBuilder.define_nopython_pipeline(self.state)
        for k, (each, description) in enumerate(passes.passes):
            if each is NativeLowering:
                passes.passes[k] = (self.lowering, description)
        passes.finalize()
        return [passes]


class _PartCompiler(_Compiler):
    """numba's pipeline for a function that is a part of its callers."""

    lowering = _PartLowering


def direct(kernel: Function) -> Function:
    """The compiled code of a kernel with one signature, for callers with known types.

    It does not check the types of its arguments, because numba's check takes 2 to 3 µs per call: a
    wrong type is undefined behaviour.
    """
    if config.DISABLE_JIT:
        return kernel
    (compiled_code,) = cast("Dispatcher", kernel).overloads.values()
    return compiled_code.entry_point


def _any_array(signature: str) -> Signature:
    """The signature with arrays of any strides, also read-only ones.

    Arrays that are declared contiguous do not change. The arrays of a function that returns nothing
    do not change either, because the function writes to them.
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
def _tell_once(saved: bool) -> None:
    """Explain the delay once: a kernel is being compiled because it is not stored yet."""
    never = "each time: set NUMBA_CACHE_DIR to a folder that can be written"
    how_often = "once on this machine" if saved else never
    print(f"dbb: compiling kernels, {how_often}: half a minute", file=sys.stderr)
