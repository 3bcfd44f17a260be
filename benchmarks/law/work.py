"""Cases of a measurement over some processes, in their order."""

from __future__ import annotations

import multiprocessing
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from typing import TypeVar

from app.jobs.progress import progress_bar

Case = TypeVar("Case")
Row = TypeVar("Row")


def played(play: Callable[[Case], Row], cases: Sequence[Case], jobs: int, text: str) -> list[Row]:
    """The row of each case.

    Args:
        play: Makes a row of a case; a function of a module, and what it takes and gives travels
            between processes.
        cases: What is played.
        jobs: Processes; with one it is this one.
        text: What the progress bar says.
    """
    rows: list[Row] = []
    with progress_bar(text, len(cases)) as on_progress:
        if jobs <= 1:
            for case in cases:
                rows.append(play(case))
                on_progress(len(rows))
            return rows
        fresh = multiprocessing.get_context("spawn")
        with ProcessPoolExecutor(jobs, mp_context=fresh) as pool:
            for row in pool.map(play, cases):
                rows.append(row)
                on_progress(len(rows))
    return rows
