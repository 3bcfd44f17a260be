"""Faults at random instants: `python -m benchmarks.faults --tries 30 [--seed 1] [--json]`.

Each try starts a command in a separate folder. Then one of its processes is killed, terminated,
interrupted, suspended for a second, or suspended while the command is terminated; or all its
processes get the signal of a terminal. Two other faults are a full disk and a folder without write
access; in tries with these, a process is killed too. When all processes have ended, or after twelve
seconds, the program counts the remains: processes, open ports, incomplete results and, except after
the fault "kill", unfinished or temporary files. It also counts wrong statuses. If the command is a
study, it is then continued, and its results must be identical to those of a study without a fault.
One of the commands, `hang`, hangs in a library that does not release Python's lock.
"""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
import tempfile
import time
from collections import Counter
from contextlib import suppress
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import psutil
import tyro

from app.cli.common import print_json
from app.cli.options import Json
from app.jobs.progress import progress_bar
from app.robot.assets import ASSETS
from app.system import _BEGUN, ENDING

_MARK = "DBB_FAULTS"  # environment variable of all processes that a try starts
_TEMPORARY = "temporary"  # folder of a try for the temporary files of libraries
_PATIENCE = 12.0  # [s] after which no remains may exist
_STOPPED = 1.0  # [s] time for which a process is suspended
_FAULTS = {
    "kill": signal.SIGKILL,
    "terminate": signal.SIGTERM,
    "interrupt": signal.SIGINT,
    "stop": signal.SIGSTOP,
    "hold": signal.SIGSTOP,
    "ctrl-c": signal.SIGINT,
    "hang up": signal.SIGHUP,
    "impatient": signal.SIGINT,
    "full": signal.SIGKILL,
    "read-only": signal.SIGKILL,
}
"""The first signal of each fault.

"stop" suspends a process for a second; then the command is terminated. "hold" suspends a process
and terminates the command; only the command itself is resumed. "ctrl-c", "hang up" and "impatient"
(Ctrl-C three times) send the signal to the whole group, as a terminal does. With "full" and
"read-only" the command cannot write, and a child process, or else the command, is killed."""
_FROM_TERMINAL = ("ctrl-c", "hang up", "impatient")
_OF_DISK = ("full", "read-only")
_COMMAND = "the command"
_ROOM = 20_000  # [bytes] largest size of a file on a full disk
_STUDY = ("study", "--cases", "4", "--physics", "kinematic", "--processes", "2", "--out", "out")
_SWEEP = ("sweep", "--step", "90", "--hold", "0.5", "--physics", "kinematic", "--processes", "2")
_FILM = (
    *("film", "guiding-front", "--physics", "kinematic", "--width", "320", "--height", "240"),
    *("--out", "a.webm"),
)
_ROBOT = (
    "new-robot",
    *(str(ASSETS / "bases" / "racecar.urdf"), "--base", "base_link", "--kind", "car-like"),
    *("--steering-limit", "0.5", "--arm-urdf", str(ASSETS / "bases" / "panda.urdf")),
    *("--mount-xyz", "0.40", "0", "0.35", "--tip", "panda_hand", "--out", "mine"),
)
_COMMANDS: dict[str, tuple[tuple[str, ...], float]] = {
    "serve": (("serve", "--physics", "kinematic", "--port", "{port}"), 15.0),
    "sweep": ((*_SWEEP, "--out", "out"), 20.0),
    "study": (_STUDY, 20.0),
    "reproduce": (("reproduce", "fig3", "--processes", "2", "--out", "out"), 20.0),
    "new-robot": (_ROBOT, 20.0),
    "film": (_FILM, 20.0),
    "hang": ((), 3.0),
}
"""Arguments of each command, and the time [s] within which the fault occurs."""


class Left(NamedTuple):
    """The remains of a try.

    Attributes:
        orphans: Command lines of remaining processes.
        port: Whether a process still listens.
        half: Names of incomplete files.
        begun: Names of unfinished or temporary files and folders.
    """

    orphans: list[str]
    port: bool
    half: list[str]
    begun: list[str]


def main(
    tries: int = 20,
    seconds: float = float("inf"),
    seed: int = 0,
    only: tuple[str, ...] = (),
    json: Json = False,
) -> None:
    """Cause faults in commands, and count the remains.

    The status is 1 if a process, an open port, or an incomplete or temporary file remains, if a
    result is lost, or if a command ends with a wrong status. A signal ends the program early, with
    status 1; the program then prints the counts up to this time.

    Args:
        tries: Largest number of tries.
        seconds: [s] time after which no further try begins.
        seed: Seed of commands, faults, processes and instants.
        only: Names among serve, sweep, study, reproduce, new-robot, film and hang; default: all.
        json: Print one JSON object.
    """
    rng = np.random.default_rng(seed)
    # A background process ignores two of these signals, and its child processes would, too.
    for number in ENDING:
        signal.signal(number, signal.default_int_handler)
    names, end = only or tuple(_COMMANDS), time.monotonic() + seconds
    tally: dict[str, Counter[str]] = {name: Counter() for name in names}
    result: dict[str, Any] = {"seed": seed, "tally": tally, "findings": [], "interrupted": False}
    with tempfile.TemporaryDirectory(prefix="dbb-faults-") as folder:
        try:
            whole = _studied(Path(folder) / "whole") if "study" in names else {}
            with progress_bar("faults", tries) as on_progress:
                for k in range(tries):
                    if time.monotonic() > end:
                        break
                    name = names[k % len(names)]
                    row = _try(name, Path(folder) / str(k), rng, whole)
                    tally[name].update(tries=1, **{key: len(row[key]) for key in _COUNTED})
                    if any(row[key] for key in _COUNTED):
                        result["findings"].append(row)
                    on_progress(k + 1)
        except KeyboardInterrupt:
            result["interrupted"] = True
            for each in _alive(Path(folder)):
                with suppress(psutil.NoSuchProcess):
                    each.kill()
    if json:
        print_json(result)
    else:
        for name, counts in tally.items():
            print(f"{name:10} " + ", ".join(f"{key} {n}" for key, n in counts.items()))
    findings = [*map(str, result["findings"]), *["interrupted"] * result["interrupted"]]
    if findings:
        sys.exit("\n".join(findings))


_HANGING = """
import ctypes
from app.cli import main
from app.jobs.progress import ending_signals_raised
lock, library = ctypes.create_string_buffer(256), ctypes.PyDLL(None)
library.pthread_mutex_init(lock, None)
library.pthread_mutex_lock(lock)
with ending_signals_raised():
    library.pthread_mutex_lock(lock)
"""
"""The program of the command "hang"; after a signal only its guard can end it."""
_COUNTED = ("orphans", "ports", "half", "begun", "lost", "status")


def _try(
    name: str, folder: Path, rng: np.random.Generator, whole: dict[str, bytes]
) -> dict[str, Any]:
    """Run one command with one random fault, and list the remains under the keys of `_COUNTED`."""
    (folder / _TEMPORARY).mkdir(parents=True)
    port = _free_port()
    words, span = _COMMANDS[name]
    words = tuple(word.format(port=port) for word in words)
    delay = float(rng.uniform(0.3, span))
    fault, in_child = list(_FAULTS)[int(rng.integers(len(_FAULTS)))], rng.random() < 0.4
    # The only child process of "hang" is the guard.
    in_child = in_child and fault not in _FROM_TERMINAL and name != "hang"
    command = _started(words, folder, _ROOM if fault == "full" else None)
    time.sleep(delay)
    in_child = in_child or (fault in _OF_DISK and name != "hang")
    if fault == "read-only" and (folder / "out").is_dir():
        (folder / "out").chmod(0o500)
    struck = _strike(command, fault, in_child, rng)
    if in_child or fault == "stop":  # it may continue, or end by itself
        with suppress(subprocess.TimeoutExpired):
            command.wait(2.0)
        command.terminate()
    left = _left_after(command, folder, port)
    if (folder / "out").is_dir():
        (folder / "out").chmod(0o700)
    usual = {0, *(each for n in ENDING for each in (-n, 128 + n))}  # it may have ended before
    # The guard kills a command that hangs; a fault of the disk kills a command without workers.
    killed = name == "hang" or (fault in _OF_DISK and struck == _COMMAND)
    usual |= {-signal.SIGKILL} if killed else set()
    usual |= {2} if fault in _OF_DISK else set()  # it cannot write
    wrong = fault not in ("kill", "stop") and command.returncode not in usual
    lost: list[str] = []
    if name == "study":
        lost = [each for each, content in _studied(folder).items() if whole[each] != content]
    return {
        "command": name,
        "fault": fault,
        "struck": struck,
        "after_s": delay,
        "orphans": left.orphans,
        "ports": [port] if left.port else [],
        "half": left.half,
        "begun": [] if fault == "kill" else left.begun,
        "lost": lost,
        "status": [command.returncode] if wrong and (not in_child or fault in _OF_DISK) else [],
    }


def _started(
    words: tuple[str, ...], folder: Path, room: int | None = None
) -> subprocess.Popen[bytes]:
    environment = {**os.environ, _MARK: str(folder), "DBB_ROBOTS": str(folder / "robots")}
    environment["TMPDIR"] = str(folder / _TEMPORARY)
    root = str(Path(__file__).resolve().parent.parent)
    environment["PYTHONPATH"] = os.pathsep.join([root, environment.get("PYTHONPATH", "")])
    run = ["-m", "app", *words] if words else ["-c", _HANGING]
    limit = [] if room is None else ["prlimit", f"--fsize={room}"]
    with (folder / "said").open("ab") as said:
        return subprocess.Popen(
            [*limit, sys.executable, *run],
            cwd=folder,
            env=environment,
            stdout=said,
            stderr=said,
            start_new_session=True,
        )


def _strike(
    command: subprocess.Popen[bytes], fault: str, in_child: bool, rng: np.random.Generator
) -> str:
    """Send the signals of a fault to the command, a random child process, or the whole group.

    Returns:
        `_COMMAND` or the command line of the chosen process; "no process" if it has ended.
    """
    with suppress(psutil.NoSuchProcess, ProcessLookupError):
        struck = psutil.Process(command.pid)
        children = struck.children(recursive=True)
        if in_child and children:
            struck = children[int(rng.integers(len(children)))]
        name = _COMMAND if struck.pid == command.pid else _command_line(struck)
        if fault in _FROM_TERMINAL:
            for pause in (0.0, 0.1, 0.4)[: 3 if fault == "impatient" else 1]:
                time.sleep(pause)
                os.killpg(command.pid, _FAULTS[fault])
        else:
            struck.send_signal(_FAULTS[fault])
        if fault == "hold":
            command.terminate()
        if fault in ("stop", "hold"):
            time.sleep(_STOPPED)
            if fault == "stop" or struck.pid == command.pid:
                struck.resume()
        return name
    return "no process"


def _left_after(command: subprocess.Popen[bytes], folder: Path, port: int) -> Left:
    """Wait up to `_PATIENCE` until all processes end; kill the others, and return all remains."""
    end = time.monotonic() + _PATIENCE
    while (alive := _alive(folder)) and time.monotonic() < end:
        time.sleep(0.1)
    orphans = [_command_line(each) for each in alive]
    listening = _answers(port)
    for each in alive:
        with suppress(psutil.NoSuchProcess):
            each.kill()
    command.wait()
    files = [path for path in folder.rglob("*") if path.is_file() and path.name != "said"]
    begun = {*folder.rglob(f"{_BEGUN}*"), *(folder / _TEMPORARY).iterdir()}
    own = [path for path in files if not any(path.is_relative_to(each) for each in begun)]
    if (folder / "mine").exists() and not (folder / "mine" / "report.html").exists():
        own.append(folder / "mine")
    return Left(
        orphans,
        listening,
        [path.name for path in own if not _is_whole(path)],
        [path.name for path in begun],
    )


def _alive(folder: Path) -> list[psutil.Process]:
    """The running processes of the tries in a folder."""
    found = []
    for process in psutil.process_iter():
        with suppress(psutil.Error):
            mine = Path(process.environ().get(_MARK, "")).is_relative_to(folder)
            if mine and process.status() != psutil.STATUS_ZOMBIE:
                found.append(process)
    return found


def _command_line(process: psutil.Process) -> str:
    with suppress(psutil.Error):
        return " ".join(process.cmdline())[-120:]
    return "one that has ended"


_ENDS = {
    ".json": b"}",
    ".html": b"</html>",
    ".png": b"IEND\xaeB`\x82",
    ".parquet": b"PAR1",
    ".csv": b"\n",
    ".toml": b"\n",
}
"""Last bytes of a complete file, by the file's ending; the last line of a journal may be cut
off."""


def _is_whole(path: Path) -> bool:
    if path.is_dir():
        return False
    content = path.read_bytes()
    end = _ENDS.get(path.suffix, b"")
    return content.endswith(end) or content.rstrip().endswith(end)


def _studied(folder: Path) -> dict[str, bytes]:
    """Run or continue the study in a folder to its end, and return the bytes of its table.

    If the study fails, its output replaces the table.
    """
    (folder / _TEMPORARY).mkdir(parents=True, exist_ok=True)
    command = _started(_STUDY, folder)
    if command.wait() != 0:
        return {"results.parquet": (folder / "said").read_bytes()}
    return {"results.parquet": (folder / "out" / "results.parquet").read_bytes()}


def _free_port() -> int:
    with socket.socket() as found:
        found.bind(("127.0.0.1", 0))
        return found.getsockname()[1]


def _answers(port: int) -> bool:
    with socket.socket() as tried:
        tried.settimeout(1.0)
        return tried.connect_ex(("127.0.0.1", port)) == 0


if __name__ == "__main__":
    tyro.cli(main)
