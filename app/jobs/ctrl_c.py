"""Ctrl-C that is not lost: compiled code may make another error of it, or none."""

from __future__ import annotations

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType

from app.errors import DbbError

_asked = threading.Event()


@contextmanager
def interrupts_kept() -> Iterator[None]:
    """Whatever error an interrupt has become is a `KeyboardInterrupt` again at the end.

    Raises:
        KeyboardInterrupt: Ctrl-C was pressed, and something ended by it.
    """
    _asked.clear()
    before = signal.getsignal(signal.SIGINT)
    # One who ignores Ctrl-C goes on to do so; a handler of others, such as a test's, stays.
    ours = before is signal.default_int_handler
    ours &= threading.current_thread() is threading.main_thread()
    if ours:
        signal.signal(signal.SIGINT, _interrupt)
    try:
        yield
    except Exception as error:
        if _asked.is_set() and not isinstance(error, DbbError):  # ours says what it is
            raise KeyboardInterrupt from error
        raise
    finally:
        _asked.clear()
        if ours:
            signal.signal(signal.SIGINT, before)


def check_interrupt() -> None:
    """To be called now and then in long work; in other threads than the main one it does nothing.

    Raises:
        KeyboardInterrupt: Ctrl-C was pressed, and nothing came of it.
    """
    if _asked.is_set() and threading.current_thread() is threading.main_thread():
        raise KeyboardInterrupt


def _interrupt(_: int, __: FrameType | None) -> None:
    _asked.set()
    raise KeyboardInterrupt
