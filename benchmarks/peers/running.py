"""Runs a driver in a separate process with one thread.

Only the drivers of our own controllers can import this project.
"""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path
from typing import NamedTuple

import numpy as np

from benchmarks.peers.environments import PeerError, last_line
from benchmarks.peers.names import Peer

Array = np.ndarray

_PROJECT = Path(__file__).resolve().parents[2]
_DRIVERS = Path(__file__).resolve().parent / "drivers"
_LONGEST = 900.0  # [s] timeout of a driver
_THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")


class Motion(NamedTuple):
    """The data that a driver has written for one run.

    Attributes:
        q: (N + 1, 3 + n_m) x, y [m], yaw [rad] and the arm's joints, every `plan.DT`.
        step_s: (M,) [s] computing time of each of the M control steps.
        d_start: (pairs,) [m] distances at the start, as the library computes them.
        failures: Number of steps without a solution.
    """

    q: Array
    step_s: Array
    d_start: Array
    failures: int = 0


class Done(NamedTuple):
    """The result of a driver.

    Attributes:
        motions: The motions by the name of the run.
        errors: Reasons of missing motions by the name of the run; the empty name has the reason why
            the driver ended early.
        versions: Versions of the libraries.
    """

    motions: dict[str, Motion]
    errors: dict[str, str]
    versions: dict[str, str]


def run_driver(name: str, peer: Peer, python: Path, plan: Path, out: Path) -> Done:
    """Run a driver on all paths of a plan.

    Args:
        name: Name of the peer.
        peer: The peer.
        python: Its interpreter.
        plan: Folder of the plan.
        out: Folder of the output; its content is deleted.

    Raises:
        PeerError: The driver could not start.
    """
    shutil.rmtree(out, ignore_errors=True)
    out.mkdir(parents=True)
    command = [str(python), str(_DRIVERS / f"drive_{peer.driver}.py"), str(plan), str(out)]
    variables = {k: v for k, v in os.environ.items() if k not in ("PYTHONPATH", "PYTHONHOME")}
    variables |= dict.fromkeys(_THREADS, "1")
    if peer.own:
        command.append(name)
        variables["PYTHONPATH"] = str(_PROJECT)
    errors: dict[str, str] = {}
    try:
        done = subprocess.run(
            command, env=variables, capture_output=True, text=True, timeout=_LONGEST
        )
        (out / "output.txt").write_text(done.stdout + done.stderr, encoding="utf-8")
        if done.returncode:
            errors[""] = f"ended with status {done.returncode}: {last_line(done.stderr)}"
    except subprocess.TimeoutExpired:
        errors[""] = f"not ready after {_LONGEST:g} s"
    except OSError as error:
        raise PeerError(f"cannot run {python}: {error.strerror}") from None
    return _read(out, errors)


def own_python() -> Path:
    """The interpreter of this process."""
    return Path(sys.executable)


def _read(out: Path, errors: dict[str, str]) -> Done:
    motions = {}
    for path in sorted(out.glob("*.npz")):
        with np.load(path, allow_pickle=False) as found:
            failures = int(found["failures"]) if "failures" in found else 0
            motions[path.stem] = Motion(found["q"], found["step_s"], found["d_start"], failures)
    for path in sorted(out.glob("*.error")):
        errors[path.stem] = path.read_text(encoding="utf-8")
    about = out / "about.json"
    versions = json.loads(about.read_text(encoding="utf-8")) if about.is_file() else {}
    return Done(motions, errors, versions)
