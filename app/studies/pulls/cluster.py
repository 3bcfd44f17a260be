"""A study on the workers of a running dask scheduler; without one a pool of processes does it."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from functools import partial
from typing import Any, TypeVar, cast

from distributed import Client, as_completed
from distributed.scheduler import KilledWorker

from app.errors import StudyError
from app.studies.pulls.parameters import code_digest

Job = TypeVar("Job")
Result = TypeVar("Result")

_PATIENCE = 10.0  # [s] for a scheduler to answer
_WORKERS_PATIENCE = 30.0  # [s] for one of its workers to be there


class Cluster:
    """Runs jobs as `app.jobs.pool.Workers` does, on a dask scheduler; use it in a `with`.

    The scheduler is not ours to end. `tls://` addresses take their certificates from dask's own
    configuration.
    """

    def __init__(self, scheduler: str, make_context: Callable[[], Any]) -> None:
        """Connect.

        Args:
            scheduler: Address, as in `tls://10.0.0.7:8786`.
            make_context: Gives what the jobs share; called for each, so it has to keep it.

        Raises:
            StudyError: Nobody answers there, it has no workers, or they have another code.
        """
        for name in ("distributed", "tornado"):  # their errors reach us anyway
            logging.getLogger(name).setLevel(logging.CRITICAL)
        self._make_context = make_context
        self._client = _connected(scheduler)
        try:
            _check_workers(self._client, scheduler)
        except BaseException:
            self._client.close()
            raise

    def __enter__(self) -> Cluster:
        return self

    def __exit__(self, *_: object) -> None:
        self._client.close()

    def map(self, function: Callable[[Any, Job], Result], jobs: Sequence[Job]) -> Iterator[Result]:
        """The results of all jobs, in the order in which they end.

        Raises:
            StudyError: A job takes its worker's process down again and again.
        """
        run = partial(_run, function, self._make_context)
        futures = self._client.map(run, jobs, pure=False)
        names = {future.key: job for future, job in zip(futures, jobs, strict=True)}
        for future in as_completed(futures):
            try:
                result = future.result()
            except KilledWorker:
                name = names[future.key]
                raise StudyError(f"case {name} ended its worker's process") from None
            yield result


def _run(
    function: Callable[[Any, Job], Result], make_context: Callable[[], Any], job: Job
) -> Result:
    return function(make_context(), job)


def _connected(scheduler: str) -> Client:
    try:
        return Client(scheduler, timeout=_PATIENCE)
    except (OSError, TimeoutError, TypeError, ValueError) as error:  # TypeError: no certificates
        reason = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise StudyError(
            f"--scheduler: no dask scheduler answers at {scheduler} ({reason}); start one by "
            "`dask scheduler`, and workers by `dask worker ADDRESS` with this project installed"
        ) from None


def _check_workers(client: Client, scheduler: str) -> None:
    """Refuse a cluster without workers, and one whose workers run other code than this process."""
    with suppress(TimeoutError):
        client.wait_for_workers(1, timeout=_WORKERS_PATIENCE)
    try:
        digests = cast(dict[str, str], client.run(code_digest)) if client.nthreads() else {}
    except ImportError as error:
        raise StudyError(f"--scheduler: a worker of {scheduler} lacks {error.name}") from None
    if not digests:
        raise StudyError(
            f"--scheduler: {scheduler} has no workers; start some by `dask worker {scheduler}`"
        )
    strange = [worker for worker, digest in digests.items() if digest != code_digest()]
    if strange:
        raise StudyError(
            f"--scheduler: {', '.join(strange)} of {scheduler} runs another version of the code"
        )
