"""Process pool: the same function for many jobs on all cores, in the order of the jobs."""

from __future__ import annotations

import logging
import multiprocessing as mp
import os
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from functools import partial
from types import TracebackType
from typing import Any, TypeVar

from app.jobs.process import follow_parent, starting_children
from app.system import SPAWN

Job = TypeVar("Job")
Result = TypeVar("Result")
_log = logging.getLogger(__name__)
_context: Any = None  # of a worker process, made once by its initialiser


class Workers:
    """Runs `function(context, job)` for many jobs, with a context that each process makes once.

    Results come in the order of the jobs, so they do not depend on the number of processes.
    """

    def __init__(self, make_context: Callable[[], Any], processes: int | None = None) -> None:
        """Prepare.

        Args:
            make_context: Makes what the jobs share; must be picklable.
            processes: All cores if not given. One means within this process.
        """
        self._make_context = make_context
        self._processes = processes or os.cpu_count() or 1
        self._executor: ProcessPoolExecutor | None = None
        self._own: Any = None  # the context within this process, once it is needed

    def __enter__(self) -> Workers:
        self._others = set(mp.active_children())
        if self._processes > 1:
            self._executor = ProcessPoolExecutor(
                self._processes, SPAWN, _start_worker, (self._make_context,)
            )
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        if self._executor is None:
            return
        if kind is not None:
            for child in set(mp.active_children()) - self._others:
                child.terminate()
        self._executor.shutdown(wait=True, cancel_futures=True)

    def map(self, function: Callable[[Any, Job], Result], jobs: Sequence[Job]) -> Iterator[Result]:
        """The results of all jobs, in their order, each as soon as it is there."""
        done = 0
        if self._executor is not None:
            try:
                with starting_children():  # the first submission starts all of them
                    results = self._executor.map(partial(_run, function), jobs)
                for result in results:
                    done += 1
                    yield result
            except BrokenProcessPool:
                _log.warning("worker processes cannot run here; going on in one process")
                self._executor.shutdown(wait=False, cancel_futures=True)
                self._executor = None
        if done < len(jobs):
            if self._own is None:
                self._own = self._make_context()
            for job in jobs[done:]:
                yield function(self._own, job)


def _start_worker(make_context: Callable[[], Any]) -> None:
    global _context
    follow_parent()
    _context = make_context()


def _run(function: Callable[[Any, Job], Result], job: Job) -> Result:
    return function(_context, job)
