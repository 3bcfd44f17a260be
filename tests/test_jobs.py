"""However a process ends, its child processes end; pools of processes, their jobs and progress."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from itertools import product
from pathlib import Path

import psutil
import pytest

from app.errors import LoopError
from app.jobs.pool import Workers
from app.jobs.process import run_in_process
from tests.jobs import (
    add,
    add_slowly,
    add_twice_over,
    killed_at_first,
    nap,
    refuse_context,
    touch,
    unpicklable,
)

PROJECT = Path(__file__).resolve().parent.parent

PARENT = """
import sys, tempfile, threading
from app.jobs import process, progress
from app.jobs.pool import Workers
from app.jobs.process import run_in_process
from app.jobs.progress import ending_signals_raised
from tests.jobs import say_and_wait, wait_with_workers

process._PATIENCE = progress._LONGEST = 60.0  # [s] on a busy machine, too, nothing is killed
work = threading.Thread(
    target=run_in_process,
    args=(wait_with_workers, sys.argv[1]),
    kwargs={"report": print, "cancelled": threading.Event()},
    daemon=True,
)
with ending_signals_raised(), tempfile.TemporaryDirectory(dir=sys.argv[1], prefix="its-own-"):
    work.start()
    with Workers(int, processes=2) as workers:
        list(workers.map(say_and_wait, range(2)))
"""


def start(script: Path, folder: Path, *args: str) -> subprocess.Popen[str]:
    return subprocess.Popen(
        [sys.executable, str(script), *args],
        cwd=folder,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env={**os.environ, "PYTHONPATH": str(PROJECT)},
        start_new_session=True,
    )


@pytest.fixture(scope="module")
def long_job() -> Iterator[Future[float]]:
    """A job that takes longer than the patience of its guard, beside the first tests."""
    with ThreadPoolExecutor(1) as thread:
        yield thread.submit(
            run_in_process, nap, 4.0, report=print, cancelled=threading.Event(), niceness=0
        )


@pytest.mark.slow
@pytest.mark.parametrize(
    ("suspended", "number"),
    [
        *product([False], [signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGKILL]),
        *product([True], [signal.SIGTERM, signal.SIGKILL]),
    ],
)
def test_child_processes_end_with_their_parent(
    tmp_path: Path, number: int, suspended: bool, long_job: Future[float]
) -> None:
    script, files = tmp_path / "script.py", tmp_path / "files"
    script.write_text(PARENT)
    files.mkdir()
    process = start(script, tmp_path, str(files))
    assert process.stdout is not None
    for _ in range(4):
        assert process.stdout.readline() == "started\n"
    children = psutil.Process(process.pid).children(recursive=True)
    assert len(children) == 7  # four workers, a job, and the guards of both
    assert len(list(files.iterdir())) == 2
    for child in children:
        if suspended and "guard.py" in " ".join(child.cmdline()):
            child.suspend()
    os.kill(process.pid, number)
    process.wait(timeout=30)
    _, alive = psutil.wait_procs(children, timeout=30)
    assert alive == []
    left = [path.name.rpartition("-")[0] for path in files.iterdir()]
    assert left == ["its-own"] * (number == signal.SIGKILL), (
        "only a killed process leaves its folder"
    )


SLOW = r"""
import os, time
os.write(1, b"importing\n")
time.sleep(60)
def work(receiver, sender): pass
"""
HANGING = r"""
import ctypes, os
lock, library = ctypes.create_string_buffer(256), ctypes.PyDLL(None)
library.pthread_mutex_init(lock, None)
library.pthread_mutex_lock(lock)
os.write(1, b"importing\n")
library.pthread_mutex_lock(lock)  # for ever, with Python's lock
def work(receiver, sender): pass
"""
STARTING = """
import sys, time, types
from app.jobs.process import Child
slow = types.ModuleType("slow")  # only the child has to import it
exec("def work(receiver, sender): pass", vars(slow))
sys.modules["slow"] = slow
child = Child(slow.work, leads_group=len(sys.argv) > 1)
time.sleep(60)
"""


LEADS = ("leads a group",)


def test_child_ends_with_its_killed_parent_in_any_state(tmp_path: Path) -> None:
    """The children end at the same time, because each end takes seconds."""
    on_linux, begun = sys.platform == "linux", []
    for stopped, code, leads in (
        (False, SLOW, ()),
        (False, HANGING, LEADS),
        (True, SLOW, LEADS),
        *([(True, HANGING, ())] if on_linux else []),  # only Linux ends such a child itself
    ):
        folder = tmp_path / str(len(begun))
        folder.mkdir()
        (script := folder / "script.py").write_text(STARTING)
        (folder / "slow.py").write_text(code)
        process = start(script, folder, *leads)
        assert process.stdout is not None
        assert process.stdout.readline() == "importing\n"
        begun.append((process, psutil.Process(process.pid).children(recursive=True)))
        if stopped and on_linux:  # no other process wakes it
            begun[-1][1][0].suspend()
    for process, _ in begun:
        process.kill()
        process.wait()
    for case, (_, children) in enumerate(begun):
        _, alive = psutil.wait_procs(children, timeout=30)
        assert alive == [], case


DRIVER = """
import subprocess, sys, time
from app.jobs.progress import ending_signals_raised
with ending_signals_raised():
    command = [sys.executable, "-c", "import sys; sys.stdin.read()"]  # ends when its parent does
    process = subprocess.Popen(command, stdin=subprocess.PIPE, start_new_session=True)
    print("started", flush=True)
    time.sleep(60)
"""


@pytest.mark.skipif(sys.platform != "linux", reason="only there are a process's children listed")
def test_stopped_foreign_process_ends_with_the_command_that_started_it(tmp_path) -> None:
    script = tmp_path / "script.py"
    script.write_text(DRIVER)
    process = start(script, tmp_path)
    assert process.stdout is not None
    assert process.stdout.readline() == "started\n"
    children = psutil.Process(process.pid).children()  # the process and the command's guard
    for each in children:
        each.suspend()
    process.terminate()
    process.wait(timeout=30)
    _, alive = psutil.wait_procs(children, timeout=10)
    for each in alive:
        each.kill()
    assert alive == []


FOREIGN = "raise SystemExit('a foreign module was imported')"
CHILD = """
import threading
from app.jobs.pool import Workers
from app.jobs.process import run_in_process
from tests.jobs import add, count_up
run_in_process(count_up, 1, report=lambda *_: None, cancelled=threading.Event())
with Workers(int, processes=2) as workers:
    print(list(workers.map(add, range(3))))
"""


def test_child_imports_nothing_from_the_working_directory(tmp_path: Path) -> None:
    """The child also does not import its parent's main module, which has no `__main__` guard."""
    script, folder = tmp_path / "script.py", tmp_path / "foreign"
    script.write_text(CHILD)
    for name in ("app", "tests", "multiprocessing", "numpy"):
        (folder / name).mkdir(parents=True)
        for file in ("__init__.py", "__main__.py"):
            (folder / name / file).write_text(FOREIGN)
    for name in ("pickle.py", "sitecustomize.py", "signal.py"):
        (folder / name).write_text(FOREIGN)
    out, errors = start(script, folder).communicate(timeout=60)
    assert (out, errors) == ("[0, 1, 2]\n", "")


def test_job_may_take_longer_than_the_patience_of_its_guard(long_job: Future[float]) -> None:
    """The patience counts only from the end of the parent."""
    assert long_job.result(timeout=60.0) == 4.0


OWN_HANDLER = """
import os, signal, time
from app.jobs import progress

progress._PATIENCE = progress._LONGEST = 0.3
signal.signal(signal.SIGTERM, lambda *_: print("handled", flush=True))
with progress.ending_signals_raised():
    os.kill(os.getpid(), signal.SIGTERM)
    time.sleep(1.0)
print("continues", flush=True)
"""


def test_a_signal_that_other_code_handles_does_not_end_the_process(tmp_path: Path) -> None:
    script = tmp_path / "script.py"
    script.write_text(OWN_HANDLER)
    out, err = start(script, tmp_path).communicate(timeout=60.0)
    assert (out.split(), err) == (["handled", "continues"], "")


def test_pool_has_as_many_processes_as_available_cores(monkeypatch) -> None:
    """`taskset` or a container may allow fewer cores than the machine has."""
    begun = psutil.Process().children()
    for cores in (1, 3):
        monkeypatch.setattr(os, "sched_getaffinity", lambda _, n=cores: set(range(n)), False)
        with Workers(int) as workers:
            assert len(psutil.Process().children()) - len(begun) == (cores if cores > 1 else 0)
            assert [*workers.map(add, [1, 2])] == [1, 2]


@pytest.mark.parametrize("processes", [1, 2])
def test_pool_reports_the_share_of_all_jobs_during_the_work(processes: int) -> None:
    told: list[tuple[float, threading.Thread]] = []

    def on_progress(share: float) -> None:
        told.append((share, threading.current_thread()))

    with Workers(int, processes) as workers:
        results = workers.map(add_slowly, [1, 2, 3, 4], on_progress, tells=True)
        assert [*results] == [1, 2, 3, 4]
    shares = [share for share, _ in told]
    assert shares == sorted(shares)
    assert {*shares} >= {k / 16 for k in range(13, 17)}  # reports during the last job, and its end
    assert len({*shares}) == 16
    assert {thread for _, thread in told} == {threading.current_thread()}  # which gets Ctrl-C


@pytest.mark.parametrize("processes", [1, 2])
def test_progress_of_a_job_is_limited_to_its_share(processes: int) -> None:
    shares: list[float] = []
    with Workers(int, processes) as workers:
        results = workers.map(add_twice_over, [1, 2], shares.append, tells=True)
        assert [*results] == [1, 2]
    assert {*shares} == {0.5, 1.0}


@pytest.mark.parametrize("processes", [1, 2])
def test_pool_reports_finished_jobs_if_jobs_report_nothing(processes: int) -> None:
    shares: list[float] = []
    with Workers(int, processes) as workers:
        assert [*workers.map(add, [1, 2, 3, 4], shares.append)] == [1, 2, 3, 4]
        assert [*workers.map(add, [], shares.append)] == []
    assert shares == [0.25, 0.5, 0.75, 1.0]


def test_pool_starts_jobs_before_a_result_is_requested(tmp_path: Path) -> None:
    file, last = tmp_path / "touched", time.monotonic() + 30
    with Workers(int, processes=2) as workers:
        results = workers.map(touch, [str(file)])
        while not file.exists() and time.monotonic() < last:
            time.sleep(0.01)
        assert file.exists()
        assert [*results] == [None]


def test_killed_worker_is_replaced_and_its_job_repeated_twice(tmp_path: Path) -> None:
    """After the third kill the job counts as lost; the other jobs are not affected."""
    jobs = [str(tmp_path / f"killed-{times}") for times in (0, 2, 3, 1)]
    with Workers(int, processes=2) as workers:
        done = [*workers.map(killed_at_first, jobs, lost=lambda job: f"lost {Path(job).name}")]
        assert done == ["killed-0", "killed-2", "lost killed-3", "killed-1"]
        with pytest.raises(LoopError, match="killed at the same job 3 times"):
            list(workers.map(killed_at_first, [str(tmp_path / "always-9")]))
        assert len({*(tmp_path / "killed-3").read_text().splitlines()}) == 3
        assert [*workers.map(add, [1, 2])] == [1, 2]


@pytest.mark.parametrize("processes", [1, 2])
def test_error_of_the_context_is_raised_when_a_result_is_read(processes: int) -> None:
    no_context = pytest.raises(ValueError, match="no context")
    with Workers(refuse_context, processes) as workers, no_context:
        list(workers.map(add, [1, 2]))


class Unreadable:
    """A job that another process cannot read, like a function of a program's main module."""

    def __reduce__(self) -> tuple[object, tuple[()]]:
        return refuse, ()


def refuse() -> None:
    raise AttributeError("no such function here")


def test_error_of_a_job_that_a_process_cannot_read_is_raised() -> None:
    with Workers(int, processes=2) as workers:
        with pytest.raises(AttributeError, match="no such function here"):
            list(workers.map(add, [Unreadable()]))
        assert [*workers.map(add, [1, 2])] == [1, 2]


def test_result_that_cannot_be_pickled_is_named() -> None:
    with Workers(int, processes=2) as workers:
        with pytest.raises(LoopError, match=r"cannot be sent: .*lambda"):
            list(workers.map(unpicklable, [1]))
        assert [*workers.map(add, [1, 2])] == [1, 2]


NEW_ROBOT = """
import sys
from pathlib import Path
from app.cli import robots
from app.errors import DbbError

robots.helpers = lambda: sys.exit("workers start")
try:
    robots.new_robot({"urdf": "robot.urdf", "base": "base", "tip": "hand", "out": Path("made")})
except DbbError as error:
    print(error)
print("imported" if "app.onboarding.new_robot" in sys.modules else "not imported")
"""


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (None, "robot.urdf: no such file"),
        ("", "robot.urdf"),
        ("<robot name='r'><link name='other'/></robot>", "'base'"),
    ],
)
def test_invalid_urdf_is_rejected_before_slow_imports_and_workers(
    tmp_path: Path, content: str | None, message: str
) -> None:
    script = tmp_path / "script.py"
    script.write_text(NEW_ROBOT)
    if content is not None:
        (tmp_path / "robot.urdf").write_text(content)
    out, errors = (process := start(script, tmp_path)).communicate(timeout=60)
    assert process.returncode == 0, errors
    refusal, imported = out.splitlines()
    assert message in refusal
    assert imported == "not imported"
