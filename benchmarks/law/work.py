"""Runs the cases of a measurement in several processes; the results have the order of the cases."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import TypeVar

from app.jobs.pool import Workers
from app.jobs.progress import progress_bar

Case = TypeVar("Case")
Row = TypeVar("Row")


def played(play: Callable[[Case], Row], cases: Sequence[Case], jobs: int, text: str) -> list[Row]:
    """The row of each case.

    Args:
        play: Computes the row of a case; a function of a module with picklable arguments and
            result.
        cases: The cases.
        jobs: Number of processes; 1 is this process.
        text: The text of the progress bar.
    """
    with progress_bar(text, 1.0) as on_progress, Workers(tuple, max(jobs, 1)) as workers:
        return list(workers.map(partial(_row, play), cases, on_progress))


def _row(play: Callable[[Case], Row], _: object, case: Case) -> Row:
    return play(case)
