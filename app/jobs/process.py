"""Child processes: start, progress, cancellation, and the end with the parent.

A child is a separate interpreter. It is not a fork, because a fork would copy locks that another
thread holds. The child's standard input is a pipe that the parent holds open: when the pipe closes,
the parent has ended.
"""

from __future__ import annotations

import atexit
import os
import pickle
import signal
import subprocess
import sys
import threading
import time
import traceback
from collections.abc import Callable
from contextlib import AbstractContextManager, ExitStack, suppress
from multiprocessing.connection import Connection, Pipe
from multiprocessing.pool import RemoteTraceback
from typing import Any, NamedTuple

from app.errors import DbbError, LoopError
from app.jobs.guard import guarded, wake_without_parent
from app.system import end_group, end_when_closed, interrupt_blocked, lead_group, lower_priority

Report = Callable[[str, float], None]
"""A function that takes the present activity and the share of the work that is done, 0 to 1, or a
negative number if the share is unknown."""

_CANCEL_EVERY = 0.1  # [s] time between two checks of the event that cancels
_PATIENCE = 2.5  # [s] time in which a process can clean up before it is killed
_BEGIN = "import sys; sys.path[:] = {}; from app.jobs.process import begin; begin({}, {}, {})"
"""Code of a child's interpreter: it copies the parent's `sys.path`, then imports this module."""


class Cancelled(DbbError):  # noqa: N818 - a person's choice, not an error
    """A person has cancelled the work."""


class EndedError(LoopError):
    """A process has ended without a result, although it was not cancelled."""


class Child(AbstractContextManager["Child"]):
    """A process that runs `work(receiver, sender, *args)` and ends when its parent has ended.

    The connection `receiver` of `work` is the other end of this object's `sender`, and vice versa.
    `work` must be a function of a module, and `args` must be picklable. The child never imports the
    parent's main module, and ignores SIGINT (Ctrl-C), which the parent handles.
    """

    def __init__(
        self, work: Callable[..., object], *args: object, leads_group: bool = False
    ) -> None:
        """Start the process, or raise an OSError; with `leads_group`, its children end with it."""
        task = pickle.dumps((work, args))
        theirs_in, self.sender = Pipe(duplex=False)
        self.receiver, theirs_out = Pipe(duplex=False)
        alive, self._alive = Pipe(duplex=False)
        self._leads_group = leads_group
        given = theirs_in.fileno(), theirs_out.fileno()
        path = [folder for folder in sys.path if folder]  # an empty one is the working directory
        code = _BEGIN.format(path, *given, leads_group)
        with theirs_in, theirs_out, alive, interrupt_blocked():
            self._process = subprocess.Popen(
                [sys.executable, "-c", code, f"dbb {getattr(work, '__name__', '')}"],
                stdin=alive.fileno(),
                pass_fds=given,
            )
        with suppress(BrokenPipeError):  # the process has ended; `receiver` reports that
            self.sender.send_bytes(task)

    def __exit__(self, *_: object) -> None:
        self.end(at_once=True)

    def ended(self, patience: float = 0.0) -> int | None:
        """The exit status (−N after signal N), or None if it still runs after `patience` [s]."""
        try:
            return self._process.wait(patience)
        except subprocess.TimeoutExpired:
            return None

    def end(self, *, at_once: bool = False) -> None:
        """End the process and, with `leads_group`, its children; `at_once` omits the clean-up."""
        for hard in (True,) if at_once else (False, True):
            if self.ended() is None:
                if self._leads_group:
                    end_group(self._process.pid, at_once=hard)
                # The process possibly does not lead its group yet.
                self._process.kill() if hard else self._process.terminate()
                self.ended(_PATIENCE)
        if self._leads_group:
            end_group(self._process.pid, at_once=True)  # the remaining children of the process


class Outcome(NamedTuple):
    """Outcome of work in another process: its result, or the exception that it raised."""

    result: Any  # None after an exception
    error: BaseException | None = None
    traceback: str = ""

    @classmethod
    def of(cls, work: Callable[..., Any], *args: Any) -> Outcome:
        try:
            return cls(work(*args))
        except Exception as error:  # raised again in the process that waits
            return cls(None, portable(error), traceback.format_exc())

    def send(self, sender: Connection) -> None:
        """Send this outcome; a result that cannot be pickled becomes a `LoopError`."""
        try:
            sender.send(self)
        except OSError:
            raise
        except Exception as error:  # pickling may raise any exception
            text = f"the result cannot be sent: {type(error).__name__}: {error}"
            sender.send(Outcome(None, LoopError(text)))

    def value(self) -> Any:
        """Return the result, or raise the exception of the work with its traceback as the cause."""
        if self.error is not None:
            raise self.error from RemoteTraceback(self.traceback)
        return self.result


def run_in_process(
    work: Callable[..., Any],
    *args: Any,
    report: Report,
    cancelled: threading.Event,
    niceness: int = 10,
) -> Any:
    """Run `work(report, *args)` in a `Child`, and return the result.

    This process calls `report` with the arguments of each call of `report` by `work`. `niceness`, 0
    to 19, is added to the child's niceness. If the event `cancelled` is set, this ends the child
    and all its children, and raises Cancelled. If the child ends without a result, this raises an
    EndedError. An exception of `work` is raised here, with its traceback as the cause.
    """
    child = Child(_run, niceness, work, args, leads_group=True)
    atexit.register(child.end)  # if this process exits in the meantime
    try:
        while not cancelled.is_set():
            if not child.receiver.poll(_CANCEL_EVERY):
                continue
            try:
                received = child.receiver.recv()
            except (EOFError, OSError):
                status = child.ended(_PATIENCE)
                raise EndedError(f"the process of this work ended with status {status}") from None
            if isinstance(received, Outcome):
                child.ended(_PATIENCE)
                return received.value()
            report(*received)
        raise Cancelled("cancelled")
    finally:
        atexit.unregister(child.end)
        child.end()


def portable(error: BaseException) -> BaseException:
    """The error itself if it is picklable, otherwise a `LoopError` that quotes the error."""
    try:
        pickle.loads(pickle.dumps(error))
    except Exception:  # the constructor of an error may raise any exception
        kind = "" if isinstance(error, DbbError) else f"{type(error).__name__}: "
        return LoopError(f"{kind}{error}")
    return error


def begin(receiver: int, sender: int, leads_group: bool) -> None:
    """Main function of a `Child`; `receiver` and `sender` are the connections' descriptors."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    wake_without_parent()
    with ExitStack() as stack:
        # Watch the parent before the import of the work's modules, which can take seconds.
        if leads_group:
            lead_group()
            stack.enter_context(guarded(0, _PATIENCE + 1.0, group=True))
        else:
            end_when_closed(0)
        threading.Thread(target=_end_with_parent, args=(leads_group,), daemon=True).start()
        given = stack.enter_context(Connection(receiver, writable=False))
        taken = stack.enter_context(Connection(sender, readable=False))
        work, args = pickle.loads(given.recv_bytes())
        work(given, taken, *args)


def _run(
    _: Connection, sender: Connection, niceness: int, work: Callable[..., Any], args: tuple
) -> None:
    signal.signal(signal.SIGTERM, _leave)
    lower_priority(niceness)
    Outcome.of(work, lambda text, share: sender.send((text, share)), *args).send(sender)
    sender.close()
    signal.signal(signal.SIGTERM, signal.SIG_DFL)  # every `finally` has run


def _leave(*_: object) -> None:
    """End this process after its clean-up, which a second signal does not interrupt."""
    signal.signal(signal.SIGTERM, signal.SIG_IGN)
    raise SystemExit(128 + signal.SIGTERM)


def _end_with_parent(leads_group: bool) -> None:
    """End this process, or the group that it leads, when the parent closes standard input."""
    os.read(0, 1)
    if leads_group:
        end_group(0, at_once=False)  # includes this process, which then removes temporary files
        time.sleep(_PATIENCE)
        end_group(0, at_once=True)
    os._exit(1)
