"""Garbage collection during a run: objects of before the run are left out."""

from __future__ import annotations

import gc
from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def settled() -> Iterator[None]:
    """Leave alone what is there already; a run's own objects are few, a robot's border is not.

    Looking through it again takes milliseconds. Within another one it changes nothing. At the end
    all is looked at again: else solvers held in cycles would be reported as leaks.
    """
    outermost = gc.get_freeze_count() == 0
    if outermost:
        gc.freeze()
    try:
        yield
    finally:
        if outermost:
            gc.unfreeze()
