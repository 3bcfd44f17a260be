"""What a sweep gives: figures of each path, and their summary for each controller."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np

from app.robot.model import RobotModel
from app.studies.paper.experiments import Run
from app.studies.paper.motion import hand_path
from app.studies.pulls.rounding import rounded
from app.studies.sweep.paths import KINDS, Kind
from app.studies.sweep.paths_start import Start
from app.studies.sweep.plan import SweepPlan, Trial

Array = np.ndarray
Row = dict[str, Any]

ERROR_LIMIT = 0.001
"""[m] final error up to which a path counts as done."""
CLEARANCE_LIMIT = 0.03
"""[m] distance between arm and base from which a path counts as safe."""
LISTS: dict[Kind, str] = {"side": "paths", "wheel_axis": "wheel_axis", "above": "above"}
"""Under which key of the JSON the paths of a kind stand."""
_KEPT = (
    "ee_error_final_m",
    "ee_error_max_m",
    "min_clearance_m",
    "arm_min_clearance_m",
    "contacts",
    "arm_contacts",
    "floor_contacts",
    "base_displacement_m",
    "base_yaw_rad",
    "activation_max",
    "solver_failures",
)


def row_of(trial: Trial, model: RobotModel, run: Run, target: Array) -> Row:
    """Figures of one path; keys end in their unit.

    They are rounded to nanometres and the like (`rounded`).

    Args:
        trial: What was run.
        model: The robot.
        run: What it gave.
        target: (3,) [m] where the hand was led to.
    """
    off = np.linalg.norm(hand_path(model, run) - target, axis=1)
    found: Row = {"controller": trial.controller, **trial.start.approach.where()}
    found |= {"speed_mps": trial.speed}
    found |= dict(zip(("start_x_m", "start_y_m", "start_z_m"), trial.start.p_ee, strict=True))
    found |= {"start_clearance_m": trial.start.clearance, "start_p_b_x_m": trial.start.p_b[0]}
    found |= {key: run.figures[key] for key in _KEPT}
    found["time_s"] = arrival(run.log["t_s"], off)
    found["passed"] = passes(found)
    return {key: rounded(value) for key, value in found.items()}


def arrival(t: Array, off: Array) -> float | None:
    """[s] from when on the hand stays within 1 mm of its target; None if it does not.

    Args:
        t: (N,) [s] times.
        off: (N,) [m] distances of the hand from its target.
    """
    outside = np.flatnonzero(off > ERROR_LIMIT)
    if not len(outside):
        return float(t[0])
    last = int(outside[-1])
    return None if last == len(t) - 1 else float(t[last + 1])


def passes(row: Row) -> bool:
    """Whether the hand arrived, and nothing came too near."""
    return (
        row["ee_error_final_m"] <= ERROR_LIMIT
        and row["min_clearance_m"] >= CLEARANCE_LIMIT
        and not row["contacts"]
        and not row["arm_contacts"]
        and not row["solver_failures"]
    )


def unreachable_of(start: Start) -> Row:
    """Why a path cannot begin."""
    return {"kind": start.approach.kind, **start.approach.where(), "reason": start.reason}


def summary(plan: SweepPlan, starts: list[Start], rows: dict[Kind, list[Row]]) -> Row:
    """For each controller and each kind of path, the worst of it and how many could not begin."""
    return {
        controller: {
            LISTS[kind]: _summary(
                [start for start in starts if start.approach.kind == kind],
                [row for row in rows[kind] if row["controller"] == controller],
            )
            for kind in KINDS
            if any(start.approach.kind == kind for start in starts)
        }
        for controller in plan.controllers
    }


def _summary(starts: list[Start], rows: list[Row]) -> Row:
    unreachable = sum(bool(start.reason) for start in starts)
    return {
        "runs": len(rows),
        "passed": sum(row["passed"] for row in rows),
        "ee_error_final_max_m": _extreme(max, rows, "ee_error_final_m"),
        "ee_error_final_median_m": _extreme(np.median, rows, "ee_error_final_m"),
        "ee_error_max_m": _extreme(max, rows, "ee_error_max_m"),
        "min_clearance_m": _extreme(min, rows, "min_clearance_m"),
        "arm_min_clearance_m": _extreme(min, rows, "arm_min_clearance_m"),
        "runs_with_contact": sum(row["contacts"] > 0 for row in rows),
        "runs_with_arm_contact": sum(row["arm_contacts"] > 0 for row in rows),
        "contacts": sum(row["contacts"] for row in rows),
        "arm_contacts": sum(row["arm_contacts"] for row in rows),
        "never_arrived": sum(row["time_s"] is None for row in rows),
        "time_max_s": _extreme(max, rows, "time_s"),
        "base_displacement_max_m": _extreme(max, rows, "base_displacement_m"),
        "solver_failures": sum(row["solver_failures"] for row in rows),
        "unreachable": unreachable,
        "unreachable_share": unreachable / len(starts),
    }


def _extreme(choose: Any, rows: Iterable[Row], key: str) -> float | None:
    values = [row[key] for row in rows if row[key] is not None]
    return float(choose(values)) if values else None
