"""The processes on which a study runs: some of this machine's, or any running dask scheduler's."""

from __future__ import annotations

import logging
import os
import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import cast

from dask import config as dask_config
from distributed import Client, LocalCluster

from app.errors import StudyError
from app.studies.pulls.parameters import code_digest

_PATIENCE = 10.0  # [s] for a scheduler to answer
_WORKERS_PATIENCE = 30.0  # [s] for one of its workers to be there
_MOST_PROCESSES = 2  # more are possible, but each needs 0.5 GB
_HOST = "127.0.0.1"
_CONNECT = "distributed.comm.timeouts.connect"
_SETTINGS = {
    "distributed.worker.daemon": True,
    "distributed.admin.tick.limit": "1h",  # a case holds its worker's thread for seconds
    "distributed.scheduler.allowed-failures": 3,
}


def default_processes() -> int:
    """Two, or as many as there are cores."""
    return min(_MOST_PROCESSES, os.cpu_count() or 1)


@contextmanager
def cluster(scheduler: str | None, processes: int) -> Iterator[Client]:
    """A client of the given scheduler, or of a cluster on this machine that ends with the `with`.

    The cluster listens on this machine only, each process has one thread, and numpy's libraries
    one each too.

    Args:
        scheduler: Address, as in `tcp://10.0.0.7:8786`, or None.
        processes: How many on this machine; of no meaning with a scheduler.

    Raises:
        StudyError: Nobody answers there, it has no workers, or they have another code.
    """
    with dask_config.set({**_SETTINGS, _CONNECT: f"{_PATIENCE}s"}), _quiet():
        if scheduler is None:
            with _local(processes) as local, Client(local) as client:
                yield client
            return
        client = _connected(scheduler)
        try:
            _check_workers(client, scheduler)
            yield client
        finally:
            client.close()


@contextmanager
def _local(processes: int) -> Iterator[LocalCluster]:
    with _interrupts_ignored():
        local = LocalCluster(
            n_workers=processes,
            threads_per_worker=1,
            processes=True,
            host=_HOST,
            dashboard_address=f"{_HOST}:0",
            worker_dashboard_address=f"{_HOST}:0",
            scheduler_kwargs={"dashboard": False},
            memory_limit=0,
            silence_logs=logging.CRITICAL,
        )
    try:
        yield local
    finally:
        local.close()


@contextmanager
def _interrupts_ignored() -> Iterator[None]:
    """Ctrl-C is ignored meanwhile, and for good by the processes that dask's threads start.

    Only the main thread can say so; in others nothing changes.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)


def workers_of(client: Client) -> int:
    """How many workers there are now."""
    return len(cast(dict[str, int], client.nthreads()))


def _connected(scheduler: str) -> Client:
    try:
        return Client(scheduler, timeout=_PATIENCE)
    except (OSError, TimeoutError, ValueError) as error:
        reason = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise StudyError(
            f"--scheduler: no dask scheduler answers at {scheduler} ({reason}); start one by "
            "`dask scheduler`, and workers by `dask worker ADDRESS` with this project installed"
        ) from None


def _check_workers(client: Client, scheduler: str) -> None:
    with suppress(TimeoutError):
        client.wait_for_workers(1, timeout=_WORKERS_PATIENCE)
    try:
        digests = cast(dict[str, str], client.run(code_digest)) if workers_of(client) else {}
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


@contextmanager
def _quiet() -> Iterator[None]:
    """Holds back what distributed logs of connections that end: its errors reach us anyway."""
    loggers = [logging.getLogger(name) for name in ("distributed", "tornado", "bokeh")]
    before = [logger.level for logger in loggers]
    for logger in loggers:
        logger.setLevel(logging.CRITICAL)
    try:
        yield
    finally:
        for logger, level in zip(loggers, before, strict=True):
            logger.setLevel(level)
