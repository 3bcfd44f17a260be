"""Joint speeds relative to their limits, and how often joints exceed these limits."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import Any

from benchmarks.law import paths, pulls
from benchmarks.law.options import Options
from benchmarks.law.report import Report, largest
from benchmarks.law.work import played

_FORCES = 30.0, 50.0, 80.0, 100.0  # [N] bounds of the groups of pulls
_HELD = 1.5  # [s] time at the end of a pull


def speeds(options: Options, count: int = 24) -> Report:
    """Run the cases of `paths` and of `pulls`, and evaluate the joint speeds.

    Args:
        options: See `Options`.
        count: Number of paths, and number of pulls.
    """
    tasks = [paths.Tracking(options, k) for k in range(count)]
    pulled = played(pulls.play, pulls.cases(options, count, _HELD), options.jobs, "pulls")
    tracked = played(paths.play, tasks, options.jobs, "paths")
    groups: dict[str, list[dict[str, Any]]] = {"tracking": tracked}
    for low, high in pairwise(_FORCES):
        groups[f"pulls of {low:g} to {high:g} N"] = [
            row for row in pulled if low < row["f_max_n"] <= high
        ]
    rows = [_row(name, group) for name, group in groups.items() if group]
    return Report("speeds", rows, _row("all", [*tracked, *pulled]))


def _row(name: str, group: Sequence[dict[str, Any]]) -> dict[str, Any]:
    return {
        "group": name,
        "runs": len(group),
        "share_max": largest(group, "joint_speed_share"),
        "runs_over_1.01": sum(row["steps_over_1.01"] > 0 for row in group),
        "steps": sum(row["steps"] for row in group),
        "steps_over_1": sum(row["steps_over_1"] for row in group),
        "steps_over_1.01": sum(row["steps_over_1.01"] for row in group),
    }
