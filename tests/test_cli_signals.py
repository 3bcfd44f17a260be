"""A signal ends a command with the conventional status, also in compiled code."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import suppress
from itertools import product

import psutil
import pytest

from app.cli import main
from app.errors import BrowserError, LoopError
from app.jobs.progress import progress_bar

ENTRY = sys.modules["app.cli.main"]
"""The module; the package exports a function of the same name."""


def interrupted() -> None:
    """Raise SIGINT, like Ctrl-C."""
    signal.raise_signal(signal.SIGINT)


@pytest.fixture(autouse=True)
def default_handler(monkeypatch) -> Iterator[None]:
    """Set Python's own SIGINT handler, and postpone the end of the process after a signal.

    Otherwise a test that fails could end the test run.
    """
    monkeypatch.setattr("app.jobs.progress._LONGEST", 3600.0)
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


def turned_into_another_error() -> None:
    """Interrupt like a compiled kernel that is about to return, which raises another error."""
    try:
        interrupted()
    except KeyboardInterrupt as error:
        raise SystemError("returned a result with an exception set") from error


def swallowed() -> None:
    """Lose the interrupt, like a callback from compiled code; the work continues."""
    with progress_bar("work", 10.0) as on_progress:
        for done in range(10):
            try:
                if done == 3:
                    interrupted()
            except KeyboardInterrupt:
                pass
            on_progress(done)
            if done > 3:
                pytest.fail("the interrupt was lost")


def swallowed_by_an_import() -> None:
    """Lose the interrupt, like an import that ignores missing modules; then the work starts."""
    with suppress(BaseException):
        interrupted()
    with progress_bar("work", 10.0):
        pytest.fail("the interrupt was lost")


@pytest.mark.parametrize(
    "command", [interrupted, turned_into_another_error, swallowed, swallowed_by_an_import]
)
def test_an_interrupted_command_prints_one_line(command, monkeypatch, capsys):
    monkeypatch.setattr(ENTRY, "_run", lambda _: command())
    with pytest.raises(SystemExit) as end:
        main(["run"])
    assert end.value.code == 130
    assert capsys.readouterr().err == "dbb: interrupted\n"
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGHUP])
def test_sigterm_and_sighup_unwind_the_command(number, monkeypatch):
    tidied = []

    def command(_: object) -> None:
        try:
            signal.raise_signal(number)
        except SystemExit:
            tidied.append(True)
            raise ValueError("raised by compiled code instead") from None

    monkeypatch.setattr(ENTRY, "_run", command)
    with pytest.raises(SystemExit) as end:
        main(["run"])
    assert end.value.code == 128 + number
    assert tidied == [True]
    assert signal.getsignal(number) is signal.SIG_DFL


def test_a_second_signal_does_not_interrupt_the_clean_up(monkeypatch, capsys):
    tidied = []

    def command(_: object) -> None:
        try:
            interrupted()
        finally:
            signal.raise_signal(signal.SIGTERM)
            interrupted()
            tidied.append(True)

    monkeypatch.setattr(ENTRY, "_run", command)
    with pytest.raises(SystemExit) as end:
        main(["run"])
    assert end.value.code == 130
    assert tidied == [True]
    assert capsys.readouterr().err == "dbb: interrupted\n"


DEAF = r"""
import ctypes, os, tempfile
from pathlib import Path
from app.jobs import progress
from app.system import whole_folder
progress._LONGEST = 0.5
kept = tempfile.TemporaryDirectory()
robot = whole_folder(Path(tempfile.gettempdir()) / "robot")
robot.__enter__()
lock = ctypes.create_string_buffer(256)
ctypes.CDLL(None).pthread_mutex_init(lock, None)
with progress.ending_signals_raised():
    while True:
        try:
            os.write(1, b"started\n")  # the second pass blocks for ever in compiled code
            ctypes.CDLL(None).pthread_mutex_lock(lock)
        except BaseException:
            pass  # lost
"""


@pytest.mark.parametrize(
    ("number", "guarded"),
    [*product([signal.SIGINT, signal.SIGTERM, signal.SIGHUP], [True]), (signal.SIGTERM, False)],
)
def test_a_signal_ends_a_command_with_a_blocked_main_thread(number, guarded, tmp_path):
    environment = os.environ | {"TMPDIR": str(tmp_path)}
    process = subprocess.Popen(
        [sys.executable, "-c", DEAF], stdout=subprocess.PIPE, env=environment
    )
    assert process.stdout is not None
    assert process.stdout.readline() == b"started\n"
    if not guarded:
        (guard,) = psutil.Process(process.pid).children()
        guard.kill()
    process.send_signal(number)
    assert process.wait(timeout=30) == 128 + number
    assert list(tmp_path.iterdir()) == [], "temporary folders remain"


HANGING = DEAF.replace("ctypes.CDLL", "ctypes.PyDLL").replace(
    "kept =", "progress._PATIENCE = 1.0\nkept ="
)
"""This program holds Python's global lock, so that no thread of its process can run."""


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_a_command_that_hangs_with_pythons_global_lock_is_killed(number, tmp_path):
    process = subprocess.Popen(
        [sys.executable, "-c", HANGING],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        env=os.environ | {"TMPDIR": str(tmp_path)},
    )
    assert process.stdout is not None
    assert process.stdout.readline() == b"started\n"
    process.send_signal(number)
    _, said = process.communicate(timeout=30)
    assert process.returncode == -signal.SIGKILL
    assert said == b"dbb: killed: still running 1 s after the signal\n"


LATE = r"""
import atexit, os, sys
from app.cli import console
class Slow:
    def __del__(self):  # like the release of much memory
        os.write(1, b"tidies up")
kept = Slow()
sys.argv[1:] = ["--version"]
atexit.register(os.write, 1, b"ends")
console()
"""


def test_a_finished_command_exits_without_freeing_objects():
    done = subprocess.run([sys.executable, "-c", LATE], capture_output=True, timeout=60)
    assert done.returncode == 0
    assert done.stdout.startswith(b"dbb ")
    assert done.stdout.endswith(b"ends")


def test_an_error_after_an_interrupt_is_reported(monkeypatch, capsys):
    def ended_by_ctrl_c(_: object) -> None:
        with suppress(KeyboardInterrupt):
            interrupted()
        raise LoopError("the simulation had ended")

    monkeypatch.setattr(ENTRY, "_run", ended_by_ctrl_c)
    with pytest.raises(SystemExit) as end:
        main(["serve"])
    assert end.value.code == 2
    assert "the simulation had ended" in capsys.readouterr().err


def test_a_browser_ended_by_the_same_signal_does_not_change_the_status(monkeypatch):
    def hung_up(_: object) -> None:
        with suppress(SystemExit):
            signal.raise_signal(signal.SIGHUP)
        raise BrowserError("the browser has failed: connection closed")

    monkeypatch.setattr(ENTRY, "_run", hung_up)
    with pytest.raises(SystemExit) as end:
        main(["film"])
    assert end.value.code == 128 + signal.SIGHUP


def test_an_error_without_an_interrupt_is_unchanged(monkeypatch):
    def fails(_: object) -> None:
        raise SystemError("of another kind")

    monkeypatch.setattr(ENTRY, "_run", fails)
    with pytest.raises(SystemError, match="of another kind"):
        main(["run"])


def test_an_ignored_ctrl_c_does_not_interrupt_the_command(monkeypatch):
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    monkeypatch.setattr(ENTRY, "_run", lambda _: interrupted())
    main(["run"])
    assert signal.getsignal(signal.SIGINT) is signal.SIG_IGN


def test_an_interrupted_study_reports_stored_cases_and_how_to_continue(
    monkeypatch, capsys, tmp_path
):
    def ended_after_three(*_: object, on_progress: Callable[[float], None], **__: object) -> None:
        on_progress(3)
        interrupted()

    monkeypatch.setattr("app.studies.pulls.study.study", ended_after_three)
    with pytest.raises(SystemExit) as end:
        main(["study", "--cases", "9", "--out", str(tmp_path)])
    assert end.value.code == 130
    report, last = capsys.readouterr().err.splitlines()
    assert report.startswith(f"3 of 9 cases are stored in {tmp_path}; the same command continues")
    assert last == "dbb: interrupted"


def test_progress_without_a_terminal_prints_occasional_plain_lines(monkeypatch, capsys):
    clock = iter([0.0, 1.0, 30.0, 31.0, 60.0])
    monkeypatch.setattr("app.jobs.progress.monotonic", lambda: next(clock))
    with progress_bar("work", 4.0) as on_progress:
        for done in range(1, 5):
            on_progress(done)
    assert capsys.readouterr().err == "work: 50% after 30 s\nwork: 100% after 60 s\n"
    with progress_bar("work", 4.0, shown=False) as on_progress:
        on_progress(1.0)
    assert capsys.readouterr().err == ""
