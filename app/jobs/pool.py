"""Process pool: executes the same function for many jobs in several processes."""

from __future__ import annotations

import logging
import pickle
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import AbstractContextManager, suppress
from functools import partial
from multiprocessing.connection import Connection
from queue import Empty, SimpleQueue
from threading import Lock
from typing import Any, TypeVar

from typing_extensions import Self

from app.errors import LoopError
from app.jobs.process import Child, Outcome
from app.jobs.progress import OnProgress
from app.system import usable_cores

Result = TypeVar("Result")
_TRIES = 3  # [-] largest number of attempts at a job that ends its process
_LOOK_EVERY = 0.1  # [s] longest wait for a message; signals to other threads do not end this wait
_log = logging.getLogger(__name__)


class Workers(AbstractContextManager["Workers"]):
    """Runs `function(context, job)` for many jobs; each process makes its context once.

    The processes start when the `with` begins, and make their contexts while this process continues
    its own work.
    """

    def __init__(self, make_context: Callable[[], Any], processes: int | None = None) -> None:
        """Prepare a number of processes; default: one for each usable core.

        If the number is one, or if a process cannot start, this process executes the jobs.
        `make_context` must be picklable; it makes the data that all jobs of a process share.
        """
        self._make_context = make_context
        self._processes = processes or usable_cores()
        self._threads = ThreadPoolExecutor(self._processes)  # one thread waits for each process
        self._children: list[Child] = []
        self._idle: SimpleQueue[Child] = SimpleQueue()
        self._lock = Lock()  # protects the list of processes
        self._own: Any = None  # the context of this process, made at the first use

    def __enter__(self) -> Self:
        try:
            while len(self._children) < self._processes > 1:
                self._children.append(Child(_work, self._make_context))
                self._idle.put(self._children[-1])
        except OSError:
            _log.warning("worker processes cannot run here; continuing in one process")
            self._processes = 1
            self._end()
        return self

    def __exit__(self, kind: object, *_: object) -> None:
        if kind is not None:
            self._end()
        self._threads.shutdown(cancel_futures=True)
        self._end()

    def map(
        self,
        function: Callable[..., Result],
        jobs: Sequence[Any],
        on_progress: OnProgress = lambda _: None,
        *,
        tells: bool = False,
        lost: Callable[[Any], Result] | None = None,
    ) -> Iterator[Result]:
        """Execute the jobs, and yield their results in the order of the jobs.

        `function`, jobs and results must be picklable. Other processes begin at once; without them,
        a job runs when its result is read. `on_progress` gets the finished share of all jobs in the
        thread that reads the results. With `tells`, `function` has a third argument, of the type
        `OnProgress`, that it calls with the finished share of its job. If the process of a job has
        ended in each of three attempts, `lost` makes the job's result. Without `lost`, a LoopError
        is raised when the result is read, as are exceptions of `function` and `make_context`.
        """
        work = function if tells else partial(_without_reports, function)
        sent: SimpleQueue[tuple[int, float]] = SimpleQueue()  # number and finished share of a job
        futures: list[Future[Result]] = []
        shares = [0.0] * len(jobs)

        def send(number: int, share: float) -> None:
            sent.put((number, share))

        def take(number: int, share: float) -> None:
            shares[number] = max(shares[number], min(share, 1.0))
            on_progress(sum(shares) / len(shares))

        def results() -> Iterator[Result]:
            try:
                for number, future in enumerate(futures):
                    while shares[number] < 1.0:
                        with suppress(Empty):
                            take(*sent.get(timeout=_LOOK_EVERY))
                    yield future.result()
            finally:
                for future in futures:
                    future.cancel()
            for number, job in enumerate(jobs[len(futures) :]):  # without processes
                if self._own is None:
                    self._own = self._make_context()
                result = work(self._own, job, partial(take, number))
                take(number, 1.0)
                yield result

        if self._processes > 1:
            for number, job in enumerate(jobs):
                tell = partial(send, number)
                futures.append(self._threads.submit(self._ask, work, job, tell, lost))
                futures[-1].add_done_callback(lambda _, tell=tell: tell(1.0))
        return results()

    def _ask(
        self,
        work: Callable[..., Result],
        job: Any,
        tell: OnProgress,
        lost: Callable[[Any], Result] | None,
    ) -> Result:
        """Run a job in an idle process; there are as many threads as processes."""
        child = self._idle.get()
        try:
            for _ in range(_TRIES):
                try:
                    child.sender.send((work, job))
                    while not isinstance(received := child.receiver.recv(), Outcome):
                        tell(received)
                except (EOFError, OSError):  # the process has ended
                    child = self._replaced(child)
                else:
                    return received.value()
            if lost is None:
                raise LoopError(f"a worker process was killed at the same job {_TRIES} times")
            return lost(job)
        finally:
            self._idle.put(child)

    def _replaced(self, gone: Child) -> Child:
        """A new process in place of the ended process `gone`; `gone` if the pool is ending."""
        with self._lock:
            if gone not in self._children:
                return gone
            gone.end(at_once=True)
            self._children.remove(gone)
            self._children.append(Child(_work, self._make_context))
            return self._children[-1]

    def _end(self) -> None:
        with self._lock:
            ended, self._children = self._children, []
        for child in ended:
            child.end(at_once=True)


ALONE = Workers(tuple, 1)  # runs jobs in this process; their context is an empty tuple


def _without_reports(function: Callable[..., Result], context: Any, job: Any, _: object) -> Result:
    return function(context, job)


def _work(receiver: Connection, sender: Connection, make_context: Callable[[], Any]) -> None:
    """Main function of a worker process, until its parent closes the connection."""
    made = Outcome.of(make_context)
    with suppress(EOFError):
        while True:
            Outcome.of(_do, receiver.recv_bytes(), made, sender.send).send(sender)


def _do(message: bytes, made: Outcome, tell: OnProgress) -> Any:
    context, (work, job) = made.value(), pickle.loads(message)
    return work(context, job, tell)
