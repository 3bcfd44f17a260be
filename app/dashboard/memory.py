"""Memory of what is not used any more goes back to the system when it is known to be much."""

from __future__ import annotations

import ctypes
import gc


def give_back() -> None:
    """Collect what only cycles hold, and give the freed memory back.

    Python looks for old cycles only once they are a quarter of all objects, and few objects may
    hold much: a model, a border, an open pipe. glibc keeps what was freed, for each thread apart.
    """
    gc.collect()
    trim = getattr(ctypes.CDLL(None), "malloc_trim", None)  # of glibc alone
    if trim is not None:
        trim(0)
