"""Differences between operating systems are in `app.system`, with fallbacks."""

from __future__ import annotations

import ast
import ctypes
import os
import resource
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path
from types import SimpleNamespace

import psutil
import pytest

from app import system
from app.cli.options import make_folder
from app.errors import OutputError
from benchmarks.memory import peak_memory
from tests.browser import wait_for

PROJECT = Path(__file__).resolve().parent.parent
THE_PLACE = PROJECT / "app" / "system.py"
OTHERS = sorted(path for path in (PROJECT / "app").rglob("*.py") if path != THE_PLACE)

MODULES = {
    "ctypes",
    "fcntl",
    "grp",
    "mmap",
    "multiprocessing.shared_memory",
    "posix",
    "pty",
    "pwd",
    "resource",
    "select",
    "syslog",
    "termios",
}
"""Modules that are missing or differ on some systems, and `ctypes`, which calls C."""
NAMES = {
    "os": {
        "epoll",
        "eventfd",
        "fork",
        "forkpty",
        "getpgid",
        "kill",
        "killpg",
        "memfd_create",
        "mkfifo",
        "nice",
        "pipe2",
        "pidfd_open",
        "setpgid",
        "setpriority",
        "setsid",
        "uname",
        "wait4",
        "waitid",
        "WNOHANG",
    },
    "signal": {
        "SIGALRM",
        "SIGCHLD",
        "SIGHUP",
        "SIGKILL",
        "SIGUSR1",
        "SIGUSR2",
        "alarm",
        "pthread_kill",
        "pthread_sigmask",
        "setitimer",
        "sigwait",
    },
    "mp": {"get_context", "set_start_method", "Pipe", "Pool", "Process", "Queue", "Value"},
}
"""Functions of a module that exist only on some systems, or differ there. Names of `os` that start
with `sched_` or `SCHED_` count too.
"""
GUARD = {
    "ctypes",
    "select",
    "os.getpgid",
    "os.kill",
    "os.killpg",
    "signal.SIGHUP",
    "signal.SIGKILL",
}
FOR_A_REASON = {
    ("app/dashboard/export/browser.py", "sys.platform"): "where a Mac keeps its browsers",
    **{("app/jobs/guard.py", name): "it runs without this package" for name in GUARD},
}
"""Exceptions outside `app.system`, with their reasons."""


@pytest.mark.parametrize("path", OTHERS, ids=lambda path: str(path.relative_to(PROJECT)))
def test_system_dependent_names_are_used_in_one_module(path: Path) -> None:
    name = path.relative_to(PROJECT).as_posix()
    found = set(peculiar(path.read_text(encoding="utf-8")))
    assert {one for one in found if (name, one) not in FOR_A_REASON} == set()


@pytest.mark.parametrize(
    ("source", "culprit"),
    [
        ("import fcntl", "fcntl"),
        ("from ctypes import CDLL", "ctypes"),
        ("from multiprocessing import shared_memory", "multiprocessing.shared_memory"),
        ("from multiprocessing import get_context", "mp.get_context"),
        ("import multiprocessing as m\nm.Pool(2)", "mp.Pool"),
        ("import os\nos.sched_setaffinity(0, {1})", "os.sched_setaffinity"),
        ("from os import setsid as s", "os.setsid"),
        ("import signal as s\ns.SIGKILL", "signal.SIGKILL"),
        ("import sys\nif sys.platform == 'linux': pass", "sys.platform"),
        ("import platform\nplatform.system()", "platform"),
        ("open('/proc/self/stat')", "/proc"),
        ("f'/proc/{1}/stat'", "/proc"),
    ],
)
def test_rule_detects_every_form_of_use(source: str, culprit: str) -> None:
    assert culprit in set(peculiar(source))


def test_rule_detects_the_names_in_app_system() -> None:
    found = set(peculiar(THE_PLACE.read_text(encoding="utf-8")))
    assert {"fcntl", "ctypes", "os.killpg", "os.sched_setscheduler", "sys.platform"} <= found


@pytest.fixture
def mac(monkeypatch: pytest.MonkeyPatch) -> None:
    """A system without Linux's own functions, and with macOS units."""
    for name in [name for name in vars(os) if name.lower().startswith("sched_")]:
        monkeypatch.delattr(os, name)
    monkeypatch.setattr(sys, "platform", "darwin")
    monkeypatch.setattr(ctypes, "CDLL", lambda _: SimpleNamespace(fflush=lambda _: 0))


@pytest.mark.usefixtures("mac")
def test_without_cpu_affinity_all_cores_are_usable() -> None:
    assert system.usable_cores() == os.cpu_count()


@pytest.mark.usefixtures("mac")
def test_without_real_time_policy_only_the_niceness_is_set(
    monkeypatch,
) -> None:
    wished = []
    monkeypatch.setattr(os, "setpriority", lambda *wish: wished.append(wish))
    system.raise_priority(-10)
    assert wished == [(os.PRIO_PROCESS, 0, -10)]


@pytest.mark.parametrize(("cores", "claimed"), [(1, False), (2, False), (3, True)])
def test_real_time_policy_is_used_only_with_a_spare_core(cores, claimed, monkeypatch) -> None:
    wished = []
    monkeypatch.setattr(system, "usable_cores", lambda: cores)
    monkeypatch.setattr(system.resource, "setrlimit", lambda *_: None)
    monkeypatch.setattr(signal, "signal", lambda *_: None)
    monkeypatch.setattr(os, "setpriority", lambda *_: None)
    monkeypatch.setattr(os, "sched_setscheduler", lambda *wish: wished.append(wish), raising=False)
    system.raise_priority(-10)
    assert bool(wished) is claimed


@pytest.mark.skipif(not hasattr(os, "sched_setscheduler"), reason="no real-time policy here")
def test_process_that_never_pauses_loses_the_real_time_policy() -> None:
    code = (
        "import os, threading, time\nfrom app import system\nsystem.usable_cores = lambda: 4\n"
        "begun = threading.Event()\n"
        "def work(): begun.wait(); time.sleep(0.1); print(os.sched_getscheduler(0))\n"
        "system.raise_priority(-10)\nprint(os.sched_getscheduler(0), flush=True)\n"
        "other = threading.Thread(target=work)\nother.start()\n"
        "end = time.process_time() + 3.0\n"
        "while os.sched_getscheduler(0) == os.SCHED_RR and time.process_time() < end: pass\n"
        "print(os.sched_getscheduler(0), flush=True)\nbegun.set()\nother.join()"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=PROJECT, capture_output=True, text=True, timeout=120
    )
    first, *later = done.stdout.split()
    if first != str(os.SCHED_RR):
        pytest.skip("this user may not use the real-time policy")
    assert later == [str(os.SCHED_OTHER)] * 2, done.stderr


@pytest.mark.usefixtures("mac")
def test_memory_release_and_flush_work_without_mallopt() -> None:
    system.return_freed_memory_early()
    system.return_freed_memory()
    system.flush_c_output()


def test_peak_memory_considers_the_unit_of_the_system(monkeypatch) -> None:
    monkeypatch.setattr(resource, "getrusage", lambda _: SimpleNamespace(ru_maxrss=3 * 2**20))
    assert peak_memory() == pytest.approx(3 * 2**30 / 1e6)
    monkeypatch.setattr(sys, "platform", "darwin")
    assert peak_memory() == pytest.approx(3 * 2**20 / 1e6)


def test_missing_permission_for_priorities_is_no_error(monkeypatch) -> None:
    def refuse(*_: object) -> None:
        raise PermissionError

    for name in ("setpriority", "sched_setscheduler", "setsid", "killpg", "nice"):
        monkeypatch.setattr(os, name, refuse, raising=False)
    system.raise_priority(-10)
    system.lower_priority(5)
    system.lead_group()
    system.end_group(0, at_once=False)


@pytest.mark.parametrize("at_once", [False, True])
def test_end_group_ends_the_leader_and_its_children(at_once: bool) -> None:
    code = (
        "import subprocess, sys, time\nfrom app.system import lead_group\nlead_group()\n"
        "child = subprocess.Popen([sys.executable, '-c', 'import time; time.sleep(60)'],"
        " stdout=sys.stdout)\n"
        "print(child.pid, flush=True)\ntime.sleep(60)"
    )
    leader = subprocess.Popen(
        [sys.executable, "-c", code], cwd=PROJECT, stdout=subprocess.PIPE, text=True
    )
    assert leader.stdout is not None
    assert int(leader.stdout.readline()) != leader.pid
    begin = time.monotonic()
    system.end_group(leader.pid, at_once=at_once)
    assert leader.stdout.read() == ""  # ends when the last process has closed it
    assert time.monotonic() - begin < 50  # they did not end by themselves
    assert leader.wait() == -(signal.SIGKILL if at_once else signal.SIGTERM)
    system.end_group(leader.pid, at_once=at_once)  # the group no longer exists


@pytest.mark.skipif(sys.platform != "linux", reason="the system lists no children")
def test_stopped_grandchild_is_resumed() -> None:
    """A stopped browser process would block its driver for ever."""
    with subprocess.Popen(
        ["sh", "-c", "sleep 60 & echo $!; wait"], stdout=subprocess.PIPE, text=True
    ) as shell:
        assert shell.stdout is not None
        grandchild = int(shell.stdout.readline())
        try:
            os.kill(grandchild, signal.SIGSTOP)
            wait_for(lambda: psutil.Process(grandchild).status() == psutil.STATUS_STOPPED)
            system.wake_children()
            wait_for(lambda: psutil.Process(grandchild).status() == psutil.STATUS_SLEEPING)
        finally:
            os.kill(grandchild, signal.SIGKILL)


def test_write_through_a_link_keeps_it_and_a_device_is_not_replaced(tmp_path: Path) -> None:
    (tmp_path / "data").mkdir()
    link, pipe = tmp_path / "newest.csv", tmp_path / "pipe.csv"
    link.symlink_to("data/today.csv")
    for text in ("one", "two"):  # first without a file, then with one
        system.write_whole(link, text)
        assert link.is_symlink()
        assert (tmp_path / "data" / "today.csv").read_text() == text
    os.mkfifo(pipe)
    with pytest.raises(OutputError, match=r"pipe\.csv: it is a folder, a device, a pipe"):
        system.write_whole(pipe, "three")
    assert pipe.is_fifo()
    left = {path.name for path in tmp_path.rglob("*")}
    assert left == {"data", "newest.csv", "pipe.csv", "today.csv"}


@pytest.mark.parametrize("made", ["log.csv", "robot"])
def test_mount_point_is_rejected_before_the_work(
    made: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As in a container; the system does not replace mount points."""
    out = tmp_path / made
    out.touch() if out.suffix else out.mkdir()
    monkeypatch.setattr(os.path, "ismount", lambda path: Path(path) == out)
    write = system.whole_file if out.suffix else system.whole_folder
    with pytest.raises(OutputError, match="mount point"), write(out):
        pytest.fail("the work began")


def test_folder_that_fills_during_the_work_is_named(tmp_path: Path) -> None:
    out = tmp_path / "robot"
    with pytest.raises(OutputError, match=f"cannot write to {out}"), system.whole_folder(out):
        (out / "first").mkdir(parents=True)


def test_in_a_removed_folder_only_absolute_paths_are_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "removed").mkdir()
    monkeypatch.chdir(tmp_path / "removed")
    (tmp_path / "removed").rmdir()
    system.write_whole(tmp_path / "log.csv", "whole")
    with pytest.raises(OutputError, match=r"log\.csv: the working folder has been removed"):
        system.write_whole(Path("log.csv"), "lost")


def test_concurrent_writers_of_one_file_do_not_mix_their_contents(tmp_path: Path) -> None:
    """Like two containers with a shared cache: in each, the first thread has the number 1."""
    with system.whole_file(tmp_path / "a") as one, system.whole_file(tmp_path / "a") as other:
        one.write_text("whole")
        other.write_text("hal")
    assert (tmp_path / "a").read_text() == "whole"
    assert [path.name for path in tmp_path.iterdir()] == ["a"]


def test_invalid_temporary_folder_is_ignored(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for folder, kept in ((tmp_path, True), (tmp_path / "nothing", False)):
        monkeypatch.setenv("TMPDIR", str(folder))
        system.set_missing_folders()
        assert ("TMPDIR" in os.environ) is kept


def test_file_is_claimed_by_one_process_at_a_time(tmp_path: Path) -> None:
    path = tmp_path / "journal"
    with path.open("a+b") as first:
        assert system.claim(first)
        with path.open("a+b") as second:
            assert not system.claim(second)
    with path.open("a+b") as third:
        assert system.claim(third)


def test_new_folder_waits_while_its_lock_is_checked_elsewhere(tmp_path: Path) -> None:
    folder = tmp_path / f"{system._BEGUN}robot"
    folder.mkdir()
    looks = os.open(folder, os.O_RDONLY)
    assert system.claim(looks)
    release = threading.Timer(0.2, os.close, [looks])
    release.start()
    with system.unfinished_folder(tmp_path, "robot") as begun:
        assert begun == folder
    release.join()


def test_folder_that_replaced_an_abandoned_one_is_not_removed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder, claim = tmp_path / f"{system._BEGUN}robot", system.claim
    folder.mkdir()

    def replaced(lock: int) -> bool | None:
        folder.rename(tmp_path / "elsewhere")
        folder.mkdir()
        return claim(lock)

    monkeypatch.setattr(system, "claim", replaced)
    system.remove_abandoned(tmp_path)
    assert folder.is_dir()


KILLED = """
import os, sys
from pathlib import Path
from app.system import whole_file, whole_folder
begun = whole_file(Path("a.txt")), whole_folder(Path("robot"))
for each in begun:
    each.__enter__().joinpath("half") if each is begun[1] else each.__enter__().write_text("half")
print("begun", flush=True)
sys.stdin.read()
"""


def test_files_of_a_killed_process_are_removed_and_others_stay(tmp_path: Path) -> None:
    def begin() -> subprocess.Popen[str]:
        process = subprocess.Popen(
            [sys.executable, "-c", KILLED],
            cwd=tmp_path,
            env={**os.environ, "PYTHONPATH": str(PROJECT)},
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )
        assert process.stdout is not None
        assert process.stdout.readline() == "begun\n"
        return process

    own = tmp_path / ".robot-of-mine"
    own.mkdir()
    with begin() as process:
        system.remove_abandoned(tmp_path)
        assert len([*tmp_path.glob(f"{system._BEGUN}*")]) == 2
        with (
            pytest.raises(OutputError, match="another process is writing the same"),
            system.whole_folder(tmp_path / "robot"),
        ):
            pytest.fail("before any work")
        process.kill()
    with system.whole_folder(tmp_path / "robot") as folder:
        (folder / "robot.toml").touch()
    system.remove_abandoned(tmp_path)
    assert {path.name for path in tmp_path.iterdir()} == {"robot", own.name}


@pytest.mark.skipif(os.geteuid() != 0, reason="only root makes links of other users")
@pytest.mark.parametrize("link", ["a.txt", "folder"])
@pytest.mark.parametrize("write", [system.write_whole, lambda path, _: make_folder(path.parent)])
def test_links_of_other_users_in_a_shared_folder_are_not_followed(link, write, tmp_path) -> None:
    shared, target = tmp_path / "shared", tmp_path / "target"
    for folder in (shared, target):
        folder.mkdir()
    shared.chmod(0o1777)
    (shared / link).symlink_to(target if link == "folder" else target / "a.txt")
    os.lchown(shared / link, 12345, 12345)
    wanted = shared / "folder" / "a.txt" if link == "folder" else shared / "a.txt"
    if link == "a.txt" and write is not system.write_whole:
        wanted /= "below"
    with pytest.raises(OutputError, match="link of another user"):
        write(wanted, "text")
    assert [*target.iterdir()] == []
    os.lchown(shared / link, os.geteuid(), -1)
    if write is system.write_whole:
        write(wanted, "text")
        assert (target / "a.txt").read_text() == "text"


def test_file_with_the_longest_name_is_written(tmp_path: Path) -> None:
    system.write_whole(tmp_path / ("a" * 251 + ".txt"), "text")
    assert [len(path.name) for path in tmp_path.iterdir()] == [255]


def test_check_of_a_folder_keeps_all_its_files(tmp_path: Path) -> None:
    (tmp_path / ".writable").write_text("a user's own")
    make_folder(tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == [".writable"]


@pytest.mark.slow
def test_loop_process_works_without_linux_functions(
    tmp_path: Path,
) -> None:
    """Every process starts with an `os` module without the `sched_` names."""
    (tmp_path / "sitecustomize.py").write_text(
        "import os\n"
        "for name in [name for name in vars(os) if name.lower().startswith('sched_')]:\n"
        "    delattr(os, name)\n",
        encoding="utf-8",
    )
    code = """
import os
import time
from functools import partial
import numpy as np
from app.border.cache import load_border_data
from app.config import Config
from app.robot.description import load_robot
from app.robot.model import RobotModel
from app.simulation.loop.process_loop import ProcessLoop
from app.simulation.session import Session

if __name__ == "__main__":
    assert not hasattr(os, "sched_getaffinity")
    model = RobotModel(load_robot("husky_panda"))
    data = load_border_data(model, progress=False)
    make = partial(Session, model, data, Config(), physics="kinematic")
    loop = ProcessLoop(make, np.array(model.description.arm.ready_position))
    loop.start()
    while loop.latest().t < 0.1:
        assert loop.error is None
        time.sleep(0.02)
    loop.stop()
    print("ran")
"""
    (tmp_path / "loop.py").write_text(code, encoding="utf-8")
    path = os.pathsep.join([str(tmp_path), str(PROJECT)])
    done = subprocess.run(
        [sys.executable, str(tmp_path / "loop.py")],
        env={**os.environ, "PYTHONPATH": path},
        capture_output=True,
        text=True,
        timeout=300,
    )
    assert done.stdout.strip() == "ran", done.stderr[-2000:]


def peculiar(source: str) -> list[str]:
    """System-dependent functions that a module uses, such as `os.setsid`, under any name."""
    tree = ast.parse(source)
    aliases = {"os": "os", "signal": "signal", "sys": "sys"}
    found = []
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            for alias in node.names:
                top = "mp" if alias.name == "multiprocessing" else alias.name
                aliases[alias.asname or alias.name] = top
                found += [alias.name] if alias.name in {*MODULES, "platform"} else []
        elif isinstance(node, ast.ImportFrom) and node.module:
            top = "mp" if node.module == "multiprocessing" else node.module
            found += [top] if top in MODULES else []
            for alias in node.names:
                full = f"{node.module}.{alias.name}"
                found += [full] if full in MODULES else []
                found += [f"{top}.{alias.name}"] if is_peculiar(top, alias.name) else []
    for node in ast.walk(tree):
        if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name):
            top = aliases.get(node.value.id, "")
            found += [f"{top}.{node.attr}"] if is_peculiar(top, node.attr) else []
        elif isinstance(node, ast.Constant) and isinstance(node.value, str):
            found += ["/proc"] if node.value.startswith(("/proc", "/dev/shm", "/sys/")) else []
    return found


def is_peculiar(module: str, name: str) -> bool:
    """Whether a name of a module is system-dependent."""
    if module == "os" and name.lower().startswith("sched_"):
        return True
    return name in NAMES.get(module, ()) or (module, name) == ("sys", "platform")


def test_user_without_a_home_gets_a_separate_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("HOME", "~")  # the home of a user that the system does not know
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    system.set_missing_folders()
    assert Path(os.environ["HOME"]).parent == tmp_path
