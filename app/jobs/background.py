"""Long work in a process of its own, that tells how far it is and can be stopped at any time."""

from __future__ import annotations

import multiprocessing as mp
import os
import signal
import threading
from collections.abc import Callable
from multiprocessing.connection import Connection
from typing import Any, NamedTuple

from app.errors import DbbError, LoopError
from app.system import SPAWN, end_group, lead_group, step_back

Tell = Callable[[str, float], None]
"""Takes what is being done, and which share of it, 0 to 1, is done; below 0 if nobody knows."""

_NICENESS = 10  # [-] of 19: the simulation beside it comes first
_LOOK_EVERY = 0.1  # [s] whether to stop
_PATIENCE = 3.0  # [s] for a process to end


class Stopped(DbbError):  # noqa: N818 - the wish of a person, not an error
    """The work was stopped by a person."""


class _News(NamedTuple):
    text: str
    share: float


class _End(NamedTuple):
    result: Any
    error: BaseException | None


def cores() -> int:
    """How many processes such work may use: one core is the simulation's."""
    return max(1, (os.cpu_count() or 1) - 1)


def run_apart(work: Callable[..., Any], *args: Any, tell: Tell, stopping: threading.Event) -> Any:
    """Run `work(tell, *args)` in a process of low priority, and wait for it.

    The process leads a group of its own, which ends with it, and when this process is gone.

    Args:
        work: A function of a module; it and the rest must survive pickling.
        args: For it, after `tell`.
        tell: Called here with what it tells there.
        stopping: Set by who wants it to end.

    Returns:
        What `work` returns.

    Raises:
        Stopped: `stopping` was set.
        LoopError: The process ended by itself.
        DbbError: What `work` raised.
    """
    news, sender = SPAWN.Pipe(duplex=False)
    process = SPAWN.Process(target=_work, args=(sender, work, args), name="dbb work")
    process.start()
    sender.close()
    try:
        end = _listen(news, tell, stopping)
        if end is None:
            process.join(_PATIENCE)
            raise LoopError(f"the process for this ended with status {process.exitcode}")
        if end.error is not None:
            raise end.error
        return end.result
    finally:
        news.close()
        _end(process)


def _listen(news: Connection, tell: Tell, stopping: threading.Event) -> _End | None:
    while not stopping.is_set():
        if not news.poll(_LOOK_EVERY):
            continue
        try:
            received = news.recv()
        except (EOFError, OSError):
            return None
        if isinstance(received, _End):
            return received
        tell(received.text, received.share)
    raise Stopped("stopped")


def _end(process: Any) -> None:
    """End the process and all that it has started."""
    for at_once, end in ((False, process.terminate), (True, process.kill)):
        if not process.is_alive():
            break
        end_group(process.pid, at_once=at_once)
        end()  # it leads no group yet, or no more
        process.join(_PATIENCE)
    process.join()
    end_group(process.pid, at_once=True)  # what it may have left behind
    process.close()


def _work(sender: Connection, work: Callable[..., Any], args: tuple[Any, ...]) -> None:
    """What the process does."""
    lead_group()
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is answered by who started it
    signal.signal(signal.SIGTERM, _leave)
    step_back(_NICENESS)
    threading.Thread(target=_end_with_parent, daemon=True).start()
    try:
        end = _End(work(lambda text, share: sender.send(_News(text, share)), *args), None)
    except DbbError as error:
        end = _End(None, error)
    except Exception as error:  # told to the person who waits
        end = _End(None, LoopError(f"{type(error).__name__}: {error}"))
    sender.send(end)
    sender.close()


def _leave(*_: object) -> None:
    """End by way of every `finally`, which a second signal does not interrupt."""
    signal.signal(signal.SIGTERM, signal.SIG_IGN)
    raise SystemExit(128 + signal.SIGTERM)


def _end_with_parent() -> None:
    parent = mp.parent_process()
    if parent is not None:
        parent.join()
        end_group(0, at_once=True)
        os._exit(1)  # where there are no groups
