"""Child processes: how each one starts, reports progress, is cancelled, and ends with its parent.

Ctrl-C, which reaches a whole group of processes, is left to the parent. A child watches its parent
and ends with it, however the parent ends.
"""

from __future__ import annotations

import atexit
import multiprocessing as mp
import os
import pickle
import signal
import threading
import time
import traceback
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from multiprocessing import resource_tracker
from multiprocessing.connection import Connection
from multiprocessing.pool import RemoteTraceback
from typing import Any, NamedTuple

from app.errors import DbbError, LoopError
from app.system import SPAWN, end_group, interrupt_blocked, lead_group, step_back

Report = Callable[[str, float], None]
"""Takes the present activity, and the share of the work done, 0 to 1; below 0 if unknown."""

_CANCEL_EVERY = 0.1  # [s] between two looks at the wish to cancel
_PATIENCE = 2.5  # [s] for a process to leave by its `finally`s before it is killed
_SAFE_PATH = "PYTHONSAFEPATH"
_running: set[Any] = set()
"""Processes of `run_in_process`, whose threads this process does not wait for when it exits."""


class Cancelled(DbbError):  # noqa: N818 - a person's wish, not an error
    """A person has cancelled the work."""


class _Activity(NamedTuple):
    text: str
    share: float


class _Outcome(NamedTuple):
    result: Any
    error: BaseException | None
    traceback: str = ""


@contextmanager
def starting_children() -> Iterator[None]:
    """Processes started meanwhile never see Ctrl-C, and import nothing from the working directory.

    Ctrl-C is blocked, not ignored: one that comes meanwhile reaches this process afterwards.
    """
    before = os.environ.get(_SAFE_PATH)
    os.environ[_SAFE_PATH] = "1"
    resource_tracker.ensure_running()  # its own start would unblock Ctrl-C
    try:
        with interrupt_blocked():
            yield
    finally:
        if before is None:
            os.environ.pop(_SAFE_PATH, None)
        else:
            os.environ[_SAFE_PATH] = before


def follow_parent(*, leads_group: bool = False) -> None:
    """First act of a child process: ignore Ctrl-C, and end when the parent has ended.

    If it leads a group, all processes that this one starts end with it.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    if leads_group:
        lead_group()
    threading.Thread(target=_end_with_parent, args=(leads_group,), daemon=True).start()


def run_in_process(
    work: Callable[..., Any],
    *args: Any,
    report: Report,
    cancelled: threading.Event,
    niceness: int = 10,
) -> Any:
    """Run `work(report, *args)` in a process of low priority, and give what it returns.

    The process leads a group, which ends with it; `work` is a function of a module, and it and
    its arguments must survive pickling.

    Args:
        work: What is done.
        args: Its arguments after `report`.
        report: Called here with what `work` reports there.
        cancelled: Ends the process as soon as it is set.
        niceness: [-] of the process, 0 to 19.

    Raises:
        Cancelled: `cancelled` was set.
        LoopError: The process ended by itself.
        Exception: What `work` raised, its traceback the cause.
    """
    receiver, sender = SPAWN.Pipe(duplex=False)
    process = SPAWN.Process(target=_run, args=(sender, niceness, work, args), name="dbb job")
    _running.add(process)
    try:
        with starting_children():
            process.start()
        sender.close()
        outcome = _receive(receiver, report, cancelled)
        process.join(_PATIENCE)
        if outcome is None:
            raise LoopError(f"the process for this ended with status {process.exitcode}")
        if outcome.error is not None:
            raise outcome.error from RemoteTraceback(outcome.traceback)
        return outcome.result
    finally:
        _running.discard(process)
        receiver.close()
        _end(process)


def portable(error: BaseException) -> BaseException:
    """The error itself if it survives pickling, else one that says the same."""
    try:
        pickle.loads(pickle.dumps(error))
    except Exception:  # whatever the constructor of some error raises
        kind = "" if isinstance(error, DbbError) else f"{type(error).__name__}: "
        return LoopError(f"{kind}{error}")
    return error


def _receive(receiver: Connection, report: Report, cancelled: threading.Event) -> _Outcome | None:
    while not cancelled.is_set():
        if not receiver.poll(_CANCEL_EVERY):
            continue
        try:
            received = receiver.recv()
        except (EOFError, OSError):
            return None
        if isinstance(received, _Outcome):
            return received
        report(received.text, received.share)
    raise Cancelled("cancelled")


def _end(process: Any) -> None:
    """End a process and all that it has started."""
    if process.pid is None:  # it could not be started
        return
    for at_once, end in ((False, process.terminate), (True, process.kill)):
        if not process.is_alive():
            break
        end_group(process.pid, at_once=at_once)
        end()  # it may not lead its group yet
        process.join(_PATIENCE)
    process.join()
    end_group(process.pid, at_once=True)  # what it may have left behind
    process.close()


@atexit.register
def _end_all() -> None:
    for process in tuple(_running):
        with suppress(ValueError):  # its own thread has just closed it
            _end(process)


def _run(sender: Connection, niceness: int, work: Callable[..., Any], args: tuple) -> None:
    """Main function of the process of `run_in_process`."""
    signal.signal(signal.SIGTERM, _leave)
    follow_parent(leads_group=True)
    step_back(niceness)
    try:
        result = work(lambda text, share: sender.send(_Activity(text, share)), *args)
        outcome = _Outcome(result, None)
    except Exception as error:  # raised again in the process that waits
        outcome = _Outcome(None, portable(error), traceback.format_exc())
    sender.send(outcome)
    sender.close()
    signal.signal(signal.SIGTERM, signal.SIG_DFL)  # nothing is left that a `finally` would do


def _leave(*_: object) -> None:
    """End by way of every `finally`, which a second signal does not interrupt."""
    signal.signal(signal.SIGTERM, signal.SIG_IGN)
    raise SystemExit(128 + signal.SIGTERM)


def _end_with_parent(leads_group: bool) -> None:
    parent = mp.parent_process()
    if parent is None:
        return
    parent.join()
    if leads_group:
        end_group(0, at_once=False)  # itself too: temporary files go
        time.sleep(_PATIENCE)
        end_group(0, at_once=True)
    os._exit(1)
