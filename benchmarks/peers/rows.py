"""A row for each library, path and cost of the base: its results, or the reason of a failure."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.peers.environments import PeerError, ensure_environment
from benchmarks.peers.evaluator import Evaluator
from benchmarks.peers.names import Peer
from benchmarks.peers.running import Done, Motion, own_python, run_driver

Array = np.ndarray
Row = dict[str, Any]

AGREES = 1e-5
"""[m] largest accepted difference between the initial distances of library and evaluator."""


def rows_of(
    name: str,
    peer: Peer,
    plan: Mapping[str, Any],
    folder: Path,
    environments: Path,
    judge: Evaluator,
) -> list[Row]:
    """Run a peer on all paths of a plan, and evaluate its motions.

    Args:
        name: Name of the peer.
        peer: The peer.
        plan: The content of the plan's JSON.
        folder: Its subfolder `plan` contains the plan; the driver writes into `runs/NAME`.
        environments: Folder of the Python environments, with one subfolder for each library.
        judge: The evaluator on the common model.

    Returns:
        One row for each run, also for failed runs.
    """
    load = os.getloadavg()[0]
    try:
        python = (
            own_python() if peer.own else ensure_environment(environments / name, peer.requirements)
        )
        done = run_driver(name, peer, python, folder / "plan", folder / "runs" / name)
    except PeerError as error:
        return [empty_row(name, peer, run, "missing", str(error)) for run in plan["runs"]]
    with np.load(folder / "plan" / plan["paths"], allow_pickle=False) as arrays:
        return [
            {**_judged(name, peer, run, done, plan, arrays, judge), "load_before": load}
            for run in plan["runs"]
        ]


def empty_row(
    name: str, peer: Peer, run: Mapping[str, Any], status: str, reason: str, version: str = ""
) -> Row:
    """The row of a run without a motion."""
    return {
        "peer": name,
        "version": version,
        "level": peer.level,
        "path": run["path"],
        "base_weight": run["base_weight"],
        "step_interval_s": peer.dt,
        "status": status,
        "reason": reason,
    }


def _judged(
    name: str,
    peer: Peer,
    run: Mapping[str, Any],
    done: Done,
    plan: Mapping[str, Any],
    arrays: Mapping[str, Array],
    judge: Evaluator,
) -> Row:
    version = next(iter(done.versions.values()), "")
    motion = done.motions.get(run["name"])
    if motion is None:
        reason = done.errors.get(run["name"]) or done.errors.get("") or "it wrote nothing"
        return empty_row(name, peer, run, "failed", reason, version)
    p, R = arrays[f"{run['path']}_p"], arrays[f"{run['path']}_R"]
    if reason := flaw(motion, len(p), judge):
        return empty_row(name, peer, run, "failed", reason, version)
    return {
        **empty_row(name, peer, run, "ok", "", version),
        **judge.figures(motion.q, p, R, plan["dt_s"]),
        "solver_failures": motion.failures,
        "step_p50_us": 1e6 * float(np.percentile(motion.step_s, 50)),
        "step_p99_us": 1e6 * float(np.percentile(motion.step_s, 99)),
        "step_max_us": 1e6 * float(motion.step_s.max()),
    }


def flaw(motion: Motion, count: int, judge: Evaluator) -> str:
    """Why a motion cannot be evaluated, or an empty string.

    Args:
        motion: The motion of the driver.
        count: Required number of configurations.
        judge: The evaluator on the common model.
    """
    shape = (count, judge.model.nq)
    if motion.q.shape != shape:
        return f"its motion has the shape {motion.q.shape}, not {shape}"
    if not np.isfinite(motion.q).all():
        return "its motion is not finite"
    if not len(motion.d_start):  # the library reports no distances
        return ""
    off = np.abs(motion.d_start - judge.distances(motion.q[0])).max()
    if not off <= AGREES:
        return f"it has another model: its initial distances differ by {off:.2e} m"
    return ""
