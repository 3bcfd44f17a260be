"""Keeping what C libraries print away from the program's own output."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager

from app.system import flush_c_output


@contextmanager
def silence(*descriptors: int) -> Iterator[None]:
    """Drop what is printed to the process's file descriptors meanwhile, by C code too.

    It acts on the whole process: keep it short. C's buffers are flushed at both ends, or what was
    printed inside would come out after it.

    Args:
        descriptors: 1 for standard output, 2 for standard error.
    """
    _flush()
    kept = {fd: os.dup(fd) for fd in descriptors}
    nowhere = os.open(os.devnull, os.O_WRONLY)
    try:
        for fd in descriptors:
            os.dup2(nowhere, fd)
        yield
    finally:
        _flush()
        for fd, original in kept.items():
            os.dup2(original, fd)
            os.close(original)
        os.close(nowhere)


def _flush() -> None:
    for stream in (sys.stdout, sys.stderr):
        if stream is not None:
            stream.flush()
    flush_c_output()
