"""Signals that end a command by way of its `finally`s, though compiled code may swallow them."""

from __future__ import annotations

import os
import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType

from app.errors import DbbError
from app.system import ENDING

_LONGEST = 2.0  # [s] for a command to end after SIGTERM or SIGHUP; its children take 2.5 s more
_received: list[int] = []


@contextmanager
def ending_signals_raised() -> Iterator[None]:
    """SIGINT raises `KeyboardInterrupt`; SIGTERM and SIGHUP raise `SystemExit` of 128 + the signal.

    Whatever error compiled code makes of that is the same exception again at the end. After SIGTERM
    or SIGHUP the process ends within 2 s whatever it does.

    Raises:
        KeyboardInterrupt: Ctrl-C was pressed, and something ended by it.
        SystemExit: Another of the signals came.
    """
    _received.clear()
    before = {}
    if threading.current_thread() is threading.main_thread():
        for number in ENDING:
            handler = signal.getsignal(number)
            # A signal that is ignored stays so; a handler of others, such as a test's, too.
            if handler in (signal.default_int_handler, signal.SIG_DFL):
                before[number] = signal.signal(number, _end)
    try:
        yield
    except Exception as error:
        if _received and not isinstance(error, DbbError):  # ours says what it is
            raise _exception() from error
        raise
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def check_signals() -> None:
    """To be called now and then in long work; in other threads than the main one it does nothing.

    Raises:
        KeyboardInterrupt: Ctrl-C was pressed, and nothing came of it.
        SystemExit: The same of another signal.
    """
    if _received and threading.current_thread() is threading.main_thread():
        raise _exception()


def _end(number: int, _: FrameType | None) -> None:
    _received.append(number)
    if number != signal.SIGINT:
        timer = threading.Timer(_LONGEST, os._exit, (128 + number,))
        timer.daemon = True
        timer.start()
    raise _exception()


def _exception() -> BaseException:
    last = _received[-1]
    return KeyboardInterrupt() if last == signal.SIGINT else SystemExit(128 + last)
