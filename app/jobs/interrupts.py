"""Starting processes that Ctrl-C does not reach: their parent answers it, and ends them."""

from __future__ import annotations

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def interrupts_ignored() -> Iterator[None]:
    """Ctrl-C is ignored meanwhile, and by every process that is started meanwhile.

    It reaches the whole group; a child that begins to ignore it never prints a traceback. Only the
    main thread can say so; in others nothing changes.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)
