"""Process pool: the same function for many jobs on all cores, in the order of the jobs."""

import logging
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import AbstractContextManager, suppress
from functools import partial
from multiprocessing.connection import Connection
from queue import SimpleQueue
from typing import Any, TypeVar

from typing_extensions import Self

from app.errors import LoopError
from app.jobs.process import Child, Outcome
from app.system import usable_cores

Job = TypeVar("Job")
Result = TypeVar("Result")
_log = logging.getLogger(__name__)


class Workers(AbstractContextManager["Workers"]):
    """Runs `function(context, job)` for many jobs, with a context that each process makes once.

    Processes begin, and make it, when a `with` is entered: what is done before the first job does
    not wait for them. Results come in the order of the jobs, so they do not depend on the number of
    processes.
    """

    def __init__(self, make_context: Callable[[], Any], processes: int | None = None) -> None:
        """Prepare so many processes, one a usable core if not given; one means within this process.

        `make_context` makes what the jobs share; it must be picklable.
        """
        self._make_context = make_context
        self._processes = processes or usable_cores()
        self._threads = ThreadPoolExecutor(self._processes)  # one waits for each process
        self._children: list[Child] = []
        self._idle: SimpleQueue[Child] = SimpleQueue()
        self._own: Any = None  # the context within this process, once it is needed

    def __enter__(self) -> Self:
        try:
            while len(self._children) < self._processes > 1:
                self._children.append(Child(_work, self._make_context))
                self._idle.put(self._children[-1])
        except OSError:
            self._go_on_alone()
        return self

    def __exit__(self, kind: object, *_: object) -> None:
        if kind is not None:
            self._end()
        self._threads.shutdown(cancel_futures=True)
        self._end()

    def map(self, function: Callable[[Any, Job], Result], jobs: Sequence[Job]) -> Iterator[Result]:
        """The results of all jobs, in their order, each as soon as it is there."""
        done = 0
        if self._processes > 1:
            try:
                for result in self._threads.map(partial(self._ask, function), jobs):
                    done += 1
                    yield result
            except _GoneError:
                self._go_on_alone()
        if done < len(jobs):
            if self._own is None:
                self._own = self._make_context()
            for job in jobs[done:]:
                yield function(self._own, job)

    def _go_on_alone(self) -> None:
        _log.warning("worker processes cannot run here; going on in one process")
        self._processes = 1
        self._end()

    def _ask(self, function: Callable[[Any, Job], Result], job: Job) -> Result:
        """Have an idle process do a job; there is one for each thread that waits here."""
        child = self._idle.get()
        try:
            child.sender.send((function, job))
            outcome = child.receiver.recv()
        except (EOFError, OSError):
            raise _GoneError from None
        finally:
            self._idle.put(child)
        return outcome.value()

    def _end(self) -> None:
        for child in self._children:
            child.end(at_once=True)


ALONE = Workers(tuple, 1)
"""Does the jobs of others within this process."""


class _GoneError(LoopError):
    """A process has ended."""


def _work(receiver: Connection, sender: Connection, make_context: Callable[[], Any]) -> None:
    """What each process does, until its parent wants no more."""
    context = make_context()
    with suppress(EOFError):
        while True:
            function, job = receiver.recv()
            sender.send(Outcome.of(function, context, job))
