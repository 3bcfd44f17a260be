"""Folders of compiled kernels: a kernel is read from any, and written to the first writable one."""

from __future__ import annotations

import hashlib
import inspect
from collections.abc import Iterator
from contextlib import suppress
from functools import cache
from pathlib import Path
from types import FunctionType
from typing import Any

from numba.core import caching, config
from numba.core.dispatcher import Dispatcher

from app.system import cache_folders

_COMPILING = "compiled.py", "kernel_memory.ll", "structs.py"


def _stamp(function: FunctionType) -> tuple[tuple[str, str], ...]:
    """Name and digest of each file on which a compiled kernel depends: the kernel's file, the files
    of the compiled functions that it calls by name, and those in `_COMPILING`. A kernel's constants
    must be in one of these files. An unreadable file raises an OSError.
    """
    files = {Path(__file__).with_name(name) for name in _COMPILING}
    known, called = set[FunctionType](), [function]
    while called:
        part = called.pop()
        files.add(Path(part.__code__.co_filename))
        known.add(part)
        named = (part.__globals__.get(name) for name in part.__code__.co_names)
        parts = {each.py_func for each in named if isinstance(each, Dispatcher)}
        called += parts - known
    return tuple(sorted((file.name, _digest(file)) for file in files))


@cache
def _digest(file: Path) -> str:
    return hashlib.sha256(file.read_bytes()).hexdigest()


def _folders(file: str, *, make: bool) -> Iterator[Path]:
    """The possible folders of a source file's kernels, in the order of search: one in
    NUMBA_CACHE_DIR (if set), `__pycache__` beside the file, one in each of `cache_folders`.
    """
    subfolder = caching._CacheLocator.get_suitable_cache_subpath(file)
    if config.CACHE_DIR:
        yield Path(config.CACHE_DIR) / subfolder
    yield Path(file).parent / "__pycache__"
    yield from (folder / "kernels" / subfolder for folder in cache_folders(make=make))


class _Locator(caching.InTreeCacheLocator):
    """A kernel's source, described for numba, whose own locators refuse read-only folders."""

    def ensure_cache_path(self) -> None:
        """Do nothing: the write itself shows whether the folder is writable."""


class _Described(caching.CompileResultCacheImpl):
    """Format and file name of a stored kernel as in numba, but with `_Locator`."""

    _locator_classes = [_Locator]  # noqa: RUF012 - numba's own form


class _Index(caching.IndexDataCacheFile):
    """The index of a folder's kernels; a damaged index counts as empty and is written again."""

    def _load_index(self) -> dict[Any, str]:
        try:
            return super()._load_index()
        except Exception:  # damaged bytes can raise any exception
            return {}


class KernelStore(caching.FunctionCache):
    """The stored kernels of a function: read from any of `_folders`, written to a writable one."""

    _impl_class = _Described
    saved = False  # whether this process has stored a compiled kernel of the function

    def __init__(self, function: FunctionType) -> None:
        super().__init__(function)
        self._stamp = _stamp(function)

    def _files(self, *, make: bool) -> Iterator[_Index]:
        for folder in _folders(inspect.getfile(self._py_func), make=make):
            yield _Index(str(folder), self._impl.filename_base, self._stamp)

    def _load_overload(self, sig: Any, target_context: Any) -> Any:
        for file in self._files(make=False):
            self._cache_file = file
            with suppress(Exception):  # the file cannot be read, or is damaged
                found = super()._load_overload(sig, target_context)
                if found is not None:
                    return found
        return None

    def _save_overload(self, sig: Any, data: Any) -> None:
        for file in self._files(make=True):
            self._cache_file = file
            with suppress(OSError):
                Path(file._cache_path).mkdir(parents=True, exist_ok=True)
                super()._save_overload(sig, data)
                self.saved = True
                return
