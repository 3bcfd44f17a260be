"""Process pool: the same function for many jobs on all cores, in the order of the jobs."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import AbstractContextManager, suppress
from functools import partial
from multiprocessing.connection import Connection
from queue import SimpleQueue
from threading import Lock
from typing import Any, NamedTuple, TypeVar

from typing_extensions import Self

from app.errors import LoopError
from app.jobs.process import Child, Outcome
from app.jobs.progress import OnProgress
from app.system import usable_cores

Result = TypeVar("Result")
_TRIES = 3  # [-] of a job whose process ends
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
        self._lock = Lock()  # of the list of processes
        self._own: Any = None  # the context within this process, once it is needed

    def __enter__(self) -> Self:
        try:
            while len(self._children) < self._processes > 1:
                self._children.append(Child(_work, self._make_context))
                self._idle.put(self._children[-1])
        except OSError:
            _log.warning("worker processes cannot run here; going on in one process")
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
        """The results of all jobs, in their order, each as soon as it is there.

        A process that ends is replaced, and its job begun again, `_TRIES` times in all; then the
        result is what `lost` makes of the job.

        Processes begin at once, so that other work can be done before the results are taken; within
        this one a job is done when its result is. `on_progress` is called, where they are taken,
        with the mean of the shares of the jobs that are done, 0 to 1, which never falls. A function
        that `tells` takes a third argument, to be called with the share of its job; of any other's
        only the end counts.

        Raises:
            LoopError: A job has ended its process each time, and there is no `lost`.
        """
        shares = _Shares(len(jobs), on_progress)
        tasks = [_Task(function, job, tells, lost) for job in jobs]
        asked: list[Future[Result]] = []
        if self._processes > 1:
            for number, task in enumerate(tasks):
                tell = partial(shares.send, number)
                asked.append(self._threads.submit(self._ask, task, tell))
                asked[-1].add_done_callback(lambda _, tell=tell: tell(1.0))
        return self._results(tasks, asked, shares)

    def _results(
        self, tasks: Sequence[_Task], asked: Sequence[Future[Result]], shares: _Shares
    ) -> Iterator[Result]:
        done = 0
        try:
            for future in asked:
                shares.wait_for(done)
                yield future.result()
                done += 1
        finally:
            for future in asked:
                future.cancel()
        if done < len(tasks) and self._own is None:
            self._own = self._make_context()
        for number, task in enumerate(tasks[done:], done):
            result = task.do(self._own, partial(shares.take, number))
            shares.take(number, 1.0)
            yield result

    def _ask(self, task: _Task, tell: OnProgress) -> Any:
        """Have an idle process do a job; there is one for each thread that waits here."""
        child = self._idle.get()
        try:
            for _ in range(_TRIES):
                outcome = _answer(child, task, tell)
                if outcome is not None:
                    return outcome.value()
                child = self._replaced(child)
            return task.given_up()
        finally:
            self._idle.put(child)

    def _replaced(self, gone: Child) -> Child:
        """Another process in the place of one that has ended, unless all are to end."""
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


ALONE = Workers(tuple, 1)
"""Does the jobs of others within this process."""


class _Shares:
    """How much of each job is done, as whoever does them tells it to the thread that waits."""

    def __init__(self, jobs: int, on_progress: OnProgress) -> None:
        self._of, self._on_progress = [0.0] * jobs, on_progress
        self._sent: SimpleQueue[tuple[int, float]] = SimpleQueue()

    def send(self, number: int, share: float) -> None:
        """Tell the share of a job; any thread may."""
        self._sent.put((number, share))

    def wait_for(self, number: int) -> None:
        """Take what is sent until a job is done."""
        while self._of[number] < 1.0:
            self.take(*self._sent.get())

    def take(self, number: int, share: float) -> None:
        """Take the share of a job, which may have begun again, and pass on that of all of them."""
        self._of[number] = max(self._of[number], min(share, 1.0))
        self._on_progress(sum(self._of) / len(self._of))


class _Task(NamedTuple):
    """A function with its job; `tells` and `lost` as in `Workers.map`."""

    function: Callable[..., Any]
    job: Any
    tells: bool
    lost: Callable[[Any], Any] | None

    def do(self, context: Any, tell: OnProgress) -> Any:
        """Its result."""
        return self.function(context, self.job, *([tell] if self.tells else []))

    def given_up(self) -> Any:
        """The result of a job that was given up."""
        if self.lost is None:
            raise LoopError(f"a worker process was killed at the same job {_TRIES} times")
        return self.lost(self.job)


def _answer(child: Child, task: _Task, tell: OnProgress) -> Outcome | None:
    """The outcome of a job in a process, or None if the process has ended."""
    with suppress(EOFError, OSError):
        child.sender.send(task._replace(lost=None))
        while not isinstance(received := child.receiver.recv(), Outcome):
            tell(received)
        return received
    return None


def _work(receiver: Connection, sender: Connection, make_context: Callable[[], Any]) -> None:
    """What each process does, until its parent wants no more."""
    context = make_context()
    with suppress(EOFError):
        while True:
            sender.send(Outcome.of(receiver.recv().do, context, sender.send))
