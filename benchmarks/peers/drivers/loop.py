"""The loop of the libraries' drivers: read the plan, follow each path, write the motion and times.

`python drive_NAME.py PLAN OUT` reads `PLAN/plan.json` and writes into the folder OUT, for each run,
`RUN.npz` with q (N + 1, 3 + n_m) [m and rad], step_s (N,) and d_start (pairs,) [m], or
`RUN.error`, a text. `about.json` has the versions of the libraries.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Sequence
from importlib.metadata import version
from pathlib import Path
from time import perf_counter
from typing import Any, Protocol

import numpy as np

Array = np.ndarray
Plan = dict[str, Any]


class Follower(Protocol):
    """A library that follows one path."""

    def distances(self) -> Sequence[float]:
        """[m] distances of the plan's pairs; empty if the library reports none."""
        ...

    def step(self, target: Array) -> Array:
        """Compute a step towards the pose T_world_ee (4, 4), and return q (3 + n_m,)."""
        ...


def main(make: Callable[[Plan, Array, float], Follower], *packages: str) -> None:
    """Follow all runs of a plan.

    Args:
        make: Makes a follower from the plan, the initial q (3 + n_m,) and the cost of base motion.
        packages: Packages whose versions are recorded.
    """
    source, out = Path(sys.argv[1]), Path(sys.argv[2])
    plan: Plan = json.loads((source / "plan.json").read_text(encoding="utf-8"))
    for key in ("planar_urdf", "unicycle_urdf"):
        plan[key] = str(source / plan[key])
    paths = np.load(source / plan["paths"])
    about = {name: version(name) for name in packages}
    (out / "about.json").write_text(json.dumps(about), encoding="utf-8")
    for run in plan["runs"]:
        p, R = paths[run["path"] + "_p"], paths[run["path"] + "_R"]
        q = np.concatenate([np.zeros(3), plan["lines"][run["path"]]["q_m_rad"]])
        done = 0
        try:
            follower = make(plan, q, plan["arm_cost"] * run["base_weight"])
            found = {"d_start": np.array(follower.distances(), dtype=float)}
            qs, times = np.empty((len(p), len(q))), np.empty(len(p) - 1)
            qs[0] = q
            target = np.eye(4)
            target[:3, :3] = R
            for done in range(len(p) - 1):
                target[:3, 3] = p[done + 1]
                begin = perf_counter()
                q = follower.step(target)
                times[done] = perf_counter() - begin
                qs[done + 1] = q
        except Exception as error:  # the row reports any exception of a library
            text = f"at {done * plan['dt_s']:.2f} s: {type(error).__name__}: {error}"
            (out / f"{run['name']}.error").write_text(" ".join(text.split()), encoding="utf-8")
            continue
        np.savez(out / f"{run['name']}.npz", q=qs, step_s=times, **found)
