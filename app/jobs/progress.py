"""Long commands: progress on standard error, and signals that end a command with a clean-up."""

import atexit
import os
import signal
import sys
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, nullcontext
from time import monotonic, sleep
from types import FrameType

from app.errors import BrowserError, DbbError
from app.jobs.guard import guarded
from app.system import ENDING, wake_children

OnProgress = Callable[[float], None]  # takes the share of the work that is done, 0 to 1

_EVERY = 20.0  # [s] time between two lines of plain text; shorter work prints no line
_LONGEST = 2.0  # [s] time in which a command can end by itself after a signal
_PATIENCE = 8.0  # [s] time after which the guard kills a process in which no thread can run
_TIDYING = 1.0  # [s] timeout of the exit functions of a process that is ended by `_end_late`
_received: list[int] = []


@contextmanager
def progress_bar(
    text: str, total: float, *, shown: bool = True
) -> Iterator[Callable[[float], None]]:
    """Display the progress of the work `text`, whose amount is `total`; nothing if not `shown`.

    This yields a function that takes the amount of finished work. If a library has discarded the
    exception of an ending signal such as Ctrl-C, the start of the `with` and each call of this
    function raise the exception again, in the main thread only.
    """
    _raise_lost_signal()
    show = _bar if sys.stderr.isatty() else _lines
    with show(text, total) if shown else nullcontext(lambda _: None) as update:

        def on_progress(done: float) -> None:
            _raise_lost_signal()
            update(done)

        yield on_progress


def part_of(on_progress: OnProgress, begin: float, end: float) -> OnProgress:
    """A function that takes the finished share of a part of some work, 0 to 1.

    It calls `on_progress` with the finished share of the whole work: `begin` at the start of the
    part, `end` at its end.
    """
    return lambda share: on_progress(begin + (end - begin) * share)


def _raise_lost_signal() -> None:
    """Raise a signal's exception again if compiled code or an import has discarded it."""
    if _received and threading.current_thread() is threading.main_thread():
        raise _exception()


@contextmanager
def _bar(text: str, total: float) -> Iterator[Callable[[float], None]]:
    # Imported here: it would delay the start of every command.
    from rich import progress
    from rich.console import Console

    *usual, remaining = progress.Progress.get_default_columns()
    columns = *usual, progress.TimeElapsedColumn(), remaining
    with progress.Progress(*columns, console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task(text, total=total)
        yield lambda done: bar.update(task, completed=done)


@contextmanager
def _lines(text: str, total: float) -> Iterator[Callable[[float], None]]:
    begin = last = monotonic()

    def update(done: float) -> None:
        nonlocal last
        if (now := monotonic()) - last >= _EVERY:
            last = now
            line = f"{text}: {done / total:.0%} after {now - begin:.0f} s"
            print(line, file=sys.stderr, flush=True)

    yield update


@contextmanager
def ending_signals_raised() -> Iterator[None]:
    """Raise exceptions for ending signals with default handlers, in the main thread only.

    SIGINT (Ctrl-C) raises a KeyboardInterrupt; SIGTERM and SIGHUP raise a SystemExit with the
    status 128 + the signal's number. If the work then ends with a `BrowserError` instead, or with
    an error that is not a `DbbError`, the exception of the signal replaces this error. If the work
    does not end, `_deadline` ends the process.
    """
    _received.clear()
    before = {}
    if threading.current_thread() is threading.main_thread():
        for number in ENDING:
            handler = signal.getsignal(number)
            # Ignored signals stay ignored, and handlers of other code stay installed.
            if handler in (signal.default_int_handler, signal.SIG_DFL):
                before[number] = signal.signal(number, _raise)
    try:
        with _deadline(tuple(before)):
            yield
    except Exception as error:
        # `_exception` names the signal; a browser's error only states that the browser has ended.
        if _received and (isinstance(error, BrowserError) or not isinstance(error, DbbError)):
            raise _exception() from error
        raise
    finally:
        if _received:
            wake_children()
        _received.clear()
        for number, handler in before.items():
            signal.signal(number, handler)


def _raise(number: int, _: FrameType | None) -> None:
    _received.append(number)
    if len(_received) == 1:  # later signals do not interrupt the clean-up
        raise _exception()


@contextmanager
def _deadline(numbers: Sequence[int]) -> Iterator[None]:
    """End the process 2 to 3 s after a signal of `numbers` in the `with`; 8 s if no thread runs."""
    # Python's own handlers wait until compiled code of the main thread has returned, and their
    # exceptions can be lost there. Therefore the system writes the number of each signal to a pipe.
    # The guard passes these numbers on to a thread, which ends this process; if the guard is
    # killed, the thread reads the pipe itself. If compiled code holds Python's lock, the thread
    # cannot run; the guard then kills this process after 8 s.
    if not numbers:
        yield
        return
    heard, written = os.pipe()  # `heard` stays open for signals until the end
    os.set_blocking(written, False)
    before = signal.set_wakeup_fd(written, warn_on_full_buffer=False)
    try:
        with guarded(heard, _PATIENCE, numbers) as passed_on:
            ending = ((os.dup(passed_on), os.dup(heard)), numbers, _LONGEST)
            threading.Thread(target=_end_late, args=ending, daemon=True).start()
            yield
    finally:
        signal.set_wakeup_fd(before)
        os.close(written)
        os.close(heard)


def _end_late(sources: Sequence[int], numbers: Sequence[int], longest: float) -> None:
    for source in sources:
        with os.fdopen(source, "rb", buffering=0) as signals:
            while number := signals.read(1):
                if number[0] in numbers:
                    wake_children()
                    sleep(longest)
                    # The exit functions remove temporary folders; a removal may hang.
                    tidying = threading.Thread(target=atexit._run_exitfuncs, daemon=True)
                    tidying.start()
                    tidying.join(_TIDYING)
                    os._exit(128 + number[0])


def _exception() -> BaseException:
    first = _received[0]
    return KeyboardInterrupt() if first == signal.SIGINT else SystemExit(128 + first)
