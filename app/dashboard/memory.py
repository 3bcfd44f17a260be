"""Memory of what is not used any more goes back to the system when it is known to be much."""

from __future__ import annotations

import gc

from app.system import give_freed_memory_back


def give_back() -> None:
    """Collect what only cycles hold, and give the freed memory back.

    Python looks for old cycles only once they are a quarter of all objects, and few objects may
    hold much: a model, a border, an open pipe.
    """
    gc.collect()
    give_freed_memory_back()
