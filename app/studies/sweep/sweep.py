"""A sweep: paths of the end-effector towards the base from all directions, with each controller.

The files are `sweep.json`, `sweep.csv`, a map for each height and speed, and, with paths from
above, a map of these for each speed.
"""

from functools import lru_cache, partial
from itertools import groupby
from operator import attrgetter
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np

from app.border.cache import load_border_data
from app.jobs.pool import Workers
from app.jobs.progress import OnProgress, part_of
from app.robot.description import load_robot
from app.robot.model import RobotModel
from app.simulation.run import run_from_spec
from app.strict import Array
from app.studies.runs import Row, rounded, thinned, write_json, write_rows
from app.studies.sweep.plan import (
    CLEARANCE_LIMIT,
    ERROR_LIMIT,
    KINDS,
    Approach,
    Kind,
    Start,
    SweepPlan,
    Trial,
)
from app.studies.sweep.starts import StartFinder
from app.system import write_whole

_START_SHARE = 0.25  # [-] estimated share of the search for starts in the whole work
LISTS: dict[Kind, str] = {"side": "paths", "wheel_axis": "wheel_axis", "above": "above"}
"""The key in `sweep.json` for the paths of each kind."""
_RESULTS = (
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
"""Results of a run that are in `sweep.json`."""
_FIRST = (
    "kind",
    "controller",
    "height_m",
    "speed_mps",
    "direction_deg",
    "offset_m",
    "place_x_m",
    "place_y_m",
    "passed",
)
"""First columns of `sweep.csv`."""


@lru_cache(maxsize=1)
def load(robot: str, d_b: float) -> StartFinder:
    """The `StartFinder` of a robot for a buffer distance `d_b` [m], cached in each process."""
    model = RobotModel(load_robot(robot))
    data = load_border_data(model, progress=False)
    return StartFinder(model, data, d_b)


def sweep(plan: SweepPlan, *, processes: int = 1, on_progress: OnProgress = lambda _: None) -> Row:
    """Run all paths of a plan.

    Each start is searched once for all controllers and speeds. The result, except for `elapsed_s`,
    does not depend on the number of processes.

    Args:
        plan: The paths.
        processes: Number of processes.
        on_progress: Called with the share of the work that is done, 0 to 1.

    Returns:
        The content of `sweep.json`; keys end in the unit.
    """
    begin = perf_counter()
    make_context = partial(load, plan.robot, plan.config.border.d_b)
    # Paths along the wheel axis that differ only in p_b share a search for postures.
    same = attrgetter("kind", "height", "direction_deg", "place")
    approaches = plan.approaches(make_context().model)
    groups = [tuple(group) for _, group in groupby(approaches, same)]
    starts: list[Start] = []
    rows: dict[Kind, list[Row]] = {kind: [] for kind in KINDS}
    with Workers(make_context, processes) as workers:
        on_share = part_of(on_progress, 0.0, _START_SHARE)
        for found in workers.map(partial(_find_starts, plan), groups, on_share):
            starts += found
        trials, on_share = list(plan.trials(starts)), part_of(on_progress, _START_SHARE, 1.0)
        results = workers.map(partial(_row, plan), trials, on_share)
        for trial, row in zip(trials, results, strict=True):
            rows[trial.start.approach.kind].append(row)
    on_progress(1.0)
    return {
        "robot": plan.robot,
        "seed": plan.seed,
        "mode": plan.mode,
        "physics": plan.physics,
        "controllers": list(plan.controllers),
        "heights_m": list(plan.heights),
        "speeds_mps": list(plan.speeds),
        "step_deg": plan.step,
        "length_m": plan.length,
        "hold_s": plan.hold,
        "start_distance_m": plan.distance,
        "base_weight": plan.config.task.base_weight,
        "parameters": plan.config.model_dump(),
        "summary": _summaries(plan, starts, rows),
        **{LISTS[kind]: rows[kind] for kind in KINDS},
        "unreachable": [
            {"kind": start.approach.kind, **start.approach.where(), "reason": start.reason}
            for start in starts
            if start.reason
        ],
        "elapsed_s": perf_counter() - begin,
    }


def _find_starts(plan: SweepPlan, finder: StartFinder, group: tuple[Approach, ...]) -> list[Start]:
    return [finder.find(each, plan.distance, seed=plan.seed) for each in group]


def _row(plan: SweepPlan, finder: StartFinder, trial: Trial) -> Row:
    spec, start = plan.spec(trial), trial.start
    run, scenario = thinned(run_from_spec(spec, finder.model, finder.data)), spec.scenario
    end = scenario.place(scenario.duration)
    errors = np.linalg.norm(run.trace.of("p_ee") - end, axis=1)
    row: Row = {
        "controller": trial.controller,
        **start.approach.where(),
        "speed_mps": trial.speed,
        **dict(zip(("start_x_m", "start_y_m", "start_z_m"), start.p_ee, strict=True)),
        "start_clearance_m": start.clearance,
        "start_p_b_x_m": start.p_b[0],
        **{key: run.figures[key] for key in _RESULTS},
        "time_s": arrival(run.trace.t, errors),
    }
    row["passed"] = passes(row)
    return {key: rounded(value) for key, value in row.items()}


def arrival(t: Array, errors: Array) -> float | None:
    """[s] time from which the end-effector stays within 1 mm of the path's end; None if never.

    Args:
        t: (N,) [s] times.
        errors: (N,) [m] distances of the end-effector from the path's end at these times.
    """
    arrived = np.append(0, np.flatnonzero(errors > ERROR_LIMIT) + 1)[-1]
    return float(t[arrived]) if arrived < len(t) else None


def passes(results: Row, error_limit: float = ERROR_LIMIT) -> bool:
    """Whether a path was successful.

    This means: a final error of at most `error_limit` [m], a smallest distance between arm and base
    of at least 0.03 m, no contact of the arm with the base or itself, and no step with the fallback
    command.
    """
    clearance = results["min_clearance_m"]
    flaws = (results[key] for key in ("contacts", "arm_contacts", "solver_failures"))
    arrived = results["ee_error_final_m"] <= error_limit
    return arrived and clearance is not None and clearance >= CLEARANCE_LIMIT and not any(flaws)


def _summaries(plan: SweepPlan, starts: list[Start], rows: dict[Kind, list[Row]]) -> Row:
    """Summaries by controller and by the key of `LISTS`, for the kinds of paths in the plan."""
    by_kind = {kind: [start for start in starts if start.approach.kind == kind] for kind in KINDS}
    return {
        controller: {
            LISTS[kind]: _summary(
                by_kind[kind], [row for row in rows[kind] if row["controller"] == controller]
            )
            for kind in KINDS
            if by_kind[kind]
        }
        for controller in plan.controllers
    }


def _summary(starts: list[Start], rows: list[Row]) -> Row:
    """Numbers of runs by their result, and the worst values; None without a value."""
    unreachable = sum(bool(start.reason) for start in starts)

    def extreme(choose: Any, key: str) -> float | None:
        values = [row[key] for row in rows if row[key] is not None]
        return float(choose(values)) if values else None

    return {
        "runs": len(rows),
        "passed": sum(row["passed"] for row in rows),
        "ee_error_final_max_m": extreme(max, "ee_error_final_m"),
        "ee_error_final_median_m": extreme(np.median, "ee_error_final_m"),
        "ee_error_max_m": extreme(max, "ee_error_max_m"),
        "min_clearance_m": extreme(min, "min_clearance_m"),
        "arm_min_clearance_m": extreme(min, "arm_min_clearance_m"),
        "runs_with_contact": sum(row["contacts"] > 0 for row in rows),
        "runs_with_arm_contact": sum(row["arm_contacts"] > 0 for row in rows),
        "contacts": sum(row["contacts"] for row in rows),
        "arm_contacts": sum(row["arm_contacts"] for row in rows),
        "never_arrived": sum(row["time_s"] is None for row in rows),
        "time_max_s": extreme(max, "time_s"),
        "base_displacement_max_m": extreme(max, "base_displacement_m"),
        "solver_failures": sum(row["solver_failures"] for row in rows),
        "unreachable": unreachable,
        "unreachable_share": unreachable / len(starts),
    }


def write_sweep(result: Row, out: Path) -> list[str]:
    """Write the result of a sweep into an existing folder, and return the names of the files."""
    from app.studies.style import png_of, styled
    from app.studies.sweep.maps import above_map, polar_map

    model = RobotModel(load_robot(result["robot"]))
    names = ["sweep.json", "sweep.csv"]
    with styled():
        for speed in result["speeds_mps"]:
            for height in result["heights_m"]:
                names.append(f"sweep_h{height:g}_v{speed:g}.png")
                write_whole(out / names[-1], png_of(polar_map(result, height, speed, model)))
            if result["above"] or any(row["kind"] == "above" for row in result["unreachable"]):
                names.append(f"sweep_above_v{speed:g}.png")
                write_whole(out / names[-1], png_of(above_map(result, speed, model)))
    rows = [{"kind": kind, **row} for kind, key in LISTS.items() for row in result[key]]
    write_rows(out / "sweep.csv", rows + result["unreachable"], _FIRST)
    write_json(out / "sweep.json", {**result, "files": names})
    return names
