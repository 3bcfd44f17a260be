"""Jobs for separate processes, in a module that such a process imports quickly."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Callable

    from app.jobs.process import Report
    from app.onboarding.request import Request


def count_up(report: Report, most: int) -> int:
    for k in range(most):
        report("counting", k / most)
    return os.getpid()


def add(context: int, job: int) -> int:
    return context + job


def killed_at_first(context: int, file: str) -> str:
    """Kills its own process in its first attempts, as many as the last digit of the file's name."""
    path = Path(file)
    path.open("a").write(f"{os.getpid()}\n")
    if len(path.read_text().splitlines()) <= int(path.name[-1]):
        os.kill(os.getpid(), signal.SIGKILL)
    return path.name


def add_slowly(context: int, job: int, on_progress: Callable[[float], None]) -> int:
    for share in (0.25, 0.5, 0.25, 0.75):  # progress may decrease
        on_progress(share)
    return context + job


def add_twice_over(context: int, job: int, on_progress: Callable[[float], None]) -> int:
    on_progress(2.0)
    return context + job


def refuse_context() -> int:
    raise ValueError("no context")


def unpicklable(context: int, job: int) -> object:
    return lambda: job


def touch(context: int, file: str) -> None:
    Path(file).touch()


def fail_with(report: Report, error: Exception) -> None:
    raise error


def vanish(report: Report) -> None:
    os._exit(7)


def nap(report: Report, seconds: float) -> float:
    time.sleep(seconds)
    return seconds


def wait_for_ever(report: Report, file: str) -> None:
    """Starts a child process, writes the child's id to a file, and does not end by itself."""
    child = subprocess.Popen([sys.executable, "-c", "import time; time.sleep(600)"])
    Path(file).write_text(str(child.pid))
    report("waiting", 0.5)
    time.sleep(600)


def say_and_wait(context: object, job: int) -> None:
    os.write(1, b"started\n")
    time.sleep(60)


def wait_with_workers(report: Report, folder: str) -> None:
    """Waits with two workers and a temporary folder; only the guard kills it, after 3.5 s."""
    from app.jobs import process
    from app.jobs.pool import Workers

    process._PATIENCE = 60.0
    own = tempfile.TemporaryDirectory(dir=folder, prefix="of-the-job-")
    with own, Workers(int, processes=2) as workers:
        list(workers.map(say_and_wait, range(2)))


def wait_in_a_folder(report: Report, out: str) -> None:
    from app.system import whole_folder

    with whole_folder(Path(out)):
        report("waiting", 0.5)
        time.sleep(600)


def wait_for_ever_for_a_request(report: Report, request: Request) -> None:
    """Begins a folder and does not end by itself; if killed, it leaves the unfinished folder."""
    from app.system import whole_folder

    begun = whole_folder(request.out)
    begun.__enter__()
    report("waiting", -1.0)
    time.sleep(600)


def nothing_for_a_request(report: Report, request: Request) -> None:
    report(request.name, 1.0)
