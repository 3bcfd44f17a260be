"""Progress of long work on standard error: a bar on a terminal, else a line now and then."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from time import monotonic

from app.jobs.signals import check_signals

_EVERY = 20.0  # [s] between two plain lines; shorter work says nothing


@contextmanager
def progress_bar(
    text: str, total: float, *, shown: bool = True
) -> Iterator[Callable[[float], None]]:
    """Show how far some work is.

    Args:
        text: What is being done.
        total: How much there is to do, in any unit.
        shown: Whether to show it at all.

    Yields:
        The function to be told how much is done, where Ctrl-C is heard again if it was lost.
    """
    show = (_bar if sys.stderr.isatty() else _lines) if shown else _nothing
    with show(text, total) as update:

        def on_progress(done: float) -> None:
            check_signals()
            update(done)

        yield on_progress


@contextmanager
def _bar(text: str, total: float) -> Iterator[Callable[[float], None]]:
    # Imported here: it would make every command start later.
    from rich import progress
    from rich.console import Console

    columns = (
        progress.TextColumn("{task.description}"),
        progress.BarColumn(),
        progress.TaskProgressColumn(),
        progress.TimeRemainingColumn(),
    )
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
def _nothing(text: str, total: float) -> Iterator[Callable[[float], None]]:
    del text, total
    yield lambda _: None
