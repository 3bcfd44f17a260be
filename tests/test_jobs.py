"""However a process ends, all that it has started ends within 5 s, and temporary files go."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path

import psutil
import pytest

PROJECT = Path(__file__).resolve().parent.parent

PARENT = r"""
import os, sys, tempfile, threading, time
from pathlib import Path
from app.jobs import process, progress
from app.jobs.pool import Workers
from app.jobs.process import run_in_process
from app.jobs.progress import ending_signals_raised

process._PATIENCE = progress._LONGEST = 60.0  # [s] on a busy machine, too, nothing is killed

def wait(made, job):
    os.write(1, b"started\n")
    time.sleep(60)

def wait_in_a_folder(report, folder):
    with tempfile.TemporaryDirectory(dir=folder, prefix="of-the-job-"):
        with Workers(int, processes=2) as workers:
            list(workers.map(wait, range(2)))

if __name__ == "__main__":
    work = threading.Thread(
        target=run_in_process,
        args=(wait_in_a_folder, sys.argv[1]),
        kwargs={"report": print, "cancelled": threading.Event()},
        daemon=True,
    )
    with ending_signals_raised(), tempfile.TemporaryDirectory(dir=sys.argv[1], prefix="its-own-"):
        work.start()
        with Workers(int, processes=2) as workers:
            list(workers.map(wait, range(2)))
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


@pytest.mark.slow
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGKILL])
def test_all_that_a_process_has_started_ends_with_it(tmp_path: Path, number: int) -> None:
    script, files = tmp_path / "script.py", tmp_path / "files"
    script.write_text(PARENT)
    files.mkdir()
    process = start(script, tmp_path, str(files))
    assert process.stdout is not None
    for _ in range(4):
        assert process.stdout.readline() == "started\n"
    children = psutil.Process(process.pid).children(recursive=True)
    assert len(children) >= 5  # four workers, a job, and what keeps multiprocessing's accounts
    assert len(list(files.iterdir())) == 2
    os.kill(process.pid, number)
    process.wait(timeout=30)
    _, alive = psutil.wait_procs(children, timeout=30)
    assert alive == []
    left = [path.name.rpartition("-")[0] for path in files.iterdir()]
    assert left == ["its-own"] * (number == signal.SIGKILL), "only when it could do nothing"


FOREIGN = "raise SystemExit('a foreign module was imported')"
CHILD = """
import threading
from app.jobs.process import run_in_process
from tests.jobs import count_up
if __name__ == "__main__":
    run_in_process(count_up, 1, report=lambda *_: None, cancelled=threading.Event())
    print("done")
"""


@pytest.mark.skipif(sys.version_info < (3, 11), reason="Python 3.10 has no PYTHONSAFEPATH")
def test_a_child_imports_nothing_from_the_working_directory(tmp_path: Path) -> None:
    script, folder = tmp_path / "script.py", tmp_path / "foreign"
    script.write_text(CHILD)
    for name in ("app", "tests", "multiprocessing"):
        (folder / name).mkdir(parents=True)
        for file in ("__init__.py", "__main__.py"):
            (folder / name / file).write_text(FOREIGN)
    (folder / "pickle.py").write_text(FOREIGN)
    out, errors = start(script, folder).communicate(timeout=60)
    assert (out, errors) == ("done\n", "")
