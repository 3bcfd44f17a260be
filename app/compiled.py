"""Numerical kernels: numba compiles them to machine code, which `KernelStore` stores.

A kernel is a plain function of numbers, arrays and structs. With `NUMBA_DISABLE_JIT=1` Python
interprets it, slowly: vectors have about nine entries, so the overhead exceeds the computation.
"""

import gc
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from functools import lru_cache, partial
from pathlib import Path
from typing import Any, TypeVar, cast

import llvmlite.binding as llvm
import numba
from numba import types
from numba.core import config, sigutils
from numba.core.compiler import CompilerBase, DefaultPassBuilder
from numba.core.compiler_lock import global_compiler_lock
from numba.core.compiler_machinery import PassManager, register_pass
from numba.core.dispatcher import Dispatcher
from numba.core.typed_passes import NativeLowering
from numba.core.typing.templates import Signature

from app.kernel_store import KernelStore

# LLVM needs far longer for one large function than for several small functions.
_INLINED = 400  # [bytes] longest bytecode of an inlined function
_REPLACED = "NRT_incref", "NRT_decref", "NRT_MemInfo_alloc_aligned"
_MEMORY = Path(__file__).with_name("kernel_memory.ll").read_text(encoding="utf-8")
Function = TypeVar("Function", bound=Callable[..., object])


def compiled(*signatures: str | Signature) -> Callable[[Function], Function]:
    """A decorator: it compiles a function for the types in `signatures` at the module's import.

    The first import stores the compiled kernel, and later imports load it. Without a writable
    folder, each process compiles the kernel again. A call raises a TypeError if an argument, such
    as an array with a different dtype, fits no signature.

    A signature is a text in numba's notation, such as ``f8[:](f8[:,:], i8)`` (`_any_array` changes
    its array types), or a `Signature` of numba, which is used unchanged. A function without
    signatures is compiled as a part of the kernels that call it, and at its first call from Python.
    """

    def compile_(function: Function) -> Function:
        kernel = numba.njit(error_model="numpy", pipeline_class=_Compiler)(function)
        if config.DISABLE_JIT:
            return cast("Function", kernel)
        _be_part_of_callers(kernel, numba.njit(error_model="numpy", pipeline_class=_PartCompiler))
        with suppress(OSError, RuntimeError):  # a function without a file cannot be stored
            kernel._cache = KernelStore(kernel.py_func)
        if not signatures:
            return cast("Function", kernel)
        with _rare_collections():
            for signature in signatures:
                kernel.compile(_any_array(signature) if isinstance(signature, str) else signature)
        kernel.disable_compile()
        if kernel.stats.cache_misses or not isinstance(kernel._cache, KernelStore):
            _announce_once(getattr(kernel._cache, "saved", False))
        return cast("Function", kernel)

    return compile_


@contextmanager
def _rare_collections() -> Iterator[None]:
    """Collect garbage less often in the `with`: numba's many objects make a collection slow."""
    with global_compiler_lock:  # one thread at a time changes and restores the thresholds
        before = gc.get_threshold()
        gc.set_threshold(before[0] and max(before[0], 100_000), *before[1:])
        try:
            yield
        finally:
            gc.set_threshold(*before)


def _be_part_of_callers(kernel: Dispatcher, as_part: Callable[..., Dispatcher]) -> None:
    """Let compiled callers include the function as `_PartLowering` translates it: otherwise numba
    would compile the function again for each direct and indirect caller.
    """
    part = as_part(kernel.py_func)

    def get_call_template(args: Sequence[types.Type], kws: Mapping[str, types.Type]) -> Any:
        # One version for all numbers instead of a version for each literal number.
        named = {name: types.unliteral(kind) for name, kind in kws.items()}
        return part.get_call_template(tuple(map(types.unliteral, args)), named)

    kernel.get_call_template, kernel.get_overload = get_call_template, part.get_overload


@register_pass(mutates_CFG=True, analysis_only=False)
class _PartLowering(NativeLowering):
    """Translation of a function to LLVM code for its callers, without its own machine code."""

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
        entry_point = [].append  # never called: numba requires a separate built-in function here
        state.targetctx.insert_user_function(entry_point, state.cr.fndesc, [library])
        state.cr = state.cr._replace(cfunc=entry_point)
        return True


@register_pass(mutates_CFG=True, analysis_only=False)
class _Lowering(NativeLowering):
    """Translation to machine code without vector instructions, which are slower for loops of nine
    iterations, and without unrolled loops, which would double the size of the code.
    """

    _name = "compact_lowering"

    def run_pass(self, state: Any) -> bool:
        codegen, before = state.targetctx.codegen(), config.LOOP_VECTORIZE
        library = state.library = codegen.create_library(state.func_id.func_qualname)
        library.enable_object_caching()
        optimise = library._optimize_final_module
        library._optimize_final_module = lambda: _manage_memory(library, optimise)
        config.LOOP_VECTORIZE = codegen._loopvect = 0
        codegen._pass_builder = partial(_pass_builder, codegen)
        try:
            return super().run_pass(state)
        finally:
            config.LOOP_VECTORIZE = codegen._loopvect = before
            del codegen._pass_builder


def _manage_memory(library: Any, optimise: Callable[[], None]) -> None:
    """Optimise a kernel's LLVM code; `kernel_memory.ll` replaces numba's functions `_REPLACED`."""
    optimise()  # removes superfluous calls of these functions, which numba recognises by name
    library._final_module.link_in(llvm.parse_assembly(_MEMORY))
    for name in _REPLACED:  # no other module of the process finds these functions by their names
        library._final_module.get_function(name).linkage = "private"
    optimise()


def _pass_builder(codegen: Any, opt: Any = None, **_: Any) -> Any:
    """Make LLVM's pass builder as numba does, but without vector code and unrolled loops."""
    options = llvm.create_pipeline_tuning_options()
    options.speed_level = config.OPT if opt is None else opt
    options.slp_vectorization = options.loop_vectorization = options.loop_unrolling = False
    return llvm.create_pass_builder(codegen._tm, options)


class _Compiler(CompilerBase):
    """numba's pipeline with `lowering` in the place of numba's lowering pass."""

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
    """The compiled code of a kernel with one signature; with ``NUMBA_DISABLE_JIT=1`` the kernel.

    The code does not check the types of the arguments, because numba's check takes 2 to 3 µs per
    call. A call with a wrong type has undefined behaviour.
    """
    if config.DISABLE_JIT:
        return kernel
    (compiled_code,) = cast("Dispatcher", kernel).overloads.values()
    return compiled_code.entry_point


def _any_array(signature: str) -> Signature:
    """The signature in which arrays such as `f8[:]`, but not `f8[::1]`, can have any strides and be
    read-only. A function without a result keeps its signature, because it writes into arguments.
    """
    arguments, returned = sigutils.normalize_signature(signature)
    if returned != types.void:
        arguments = tuple(
            types.Array(each.dtype, each.ndim, "A", readonly=True)
            if isinstance(each, types.Array) and each.layout == "A"
            else each
            for each in arguments
        )
    return Signature(returned, arguments, None)


@lru_cache(maxsize=1)
def _announce_once(saved: bool) -> None:
    """Print that kernels are being compiled; `saved`: whether the first one has been stored."""
    never = "at each start; to store them, set NUMBA_CACHE_DIR to a writable folder"
    how_often = "once on this machine" if saved else never
    print(f"dbb: compiling kernels for about a minute, {how_often}", file=sys.stderr)
