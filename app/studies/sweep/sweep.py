"""A sweep: paths of the end-effector towards the base from all directions, with each controller."""

import math
from collections import Counter
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import replace
from functools import lru_cache, partial
from itertools import groupby, islice, product, tee
from operator import attrgetter
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np

from app.avoidance.closest_points import ClosestPoints, DistanceMonitor
from app.border.cache import BorderData, load_border_data
from app.border.mobile import MobileBody
from app.errors import UnreachableError
from app.jobs.pool import Workers
from app.jobs.progress import OnProgress, part_of
from app.robot.description import load_robot
from app.robot.model import RobotModel
from app.robot.state import RobotState, at_rest
from app.simulation.run import run_from_spec
from app.simulation.scenarios.start import OUT_OF_REACH, StartSolver
from app.simulation.session import check_avoidance
from app.strict import Array
from app.studies.runs import Row, rounded, thinned, write_json, write_rows
from app.studies.sweep.plan import (
    CLEARANCE_LIMIT,
    ERROR_LIMIT,
    Approach,
    Kind,
    Start,
    SweepPlan,
    exit_distance,
    point_of,
)
from app.system import write_whole

_START_SHARE = 0.25  # [-] estimated share of the search for starts in the whole work
LISTS: dict[Kind, str] = {"side": "paths", "wheel_axis": "wheel_axis", "above": "above"}
"""The key in `sweep.json` for the paths of each kind."""
_RESULTS = (
    *("ee_error_final_m", "ee_error_max_m", "min_clearance_m", "arm_min_clearance_m"),
    *("contacts", "arm_contacts", "floor_contacts"),
    *("base_displacement_m", "base_yaw_rad", "activation_max", "solver_failures"),
)
"""Results of a run that are in `sweep.json`."""
_FIRST = (
    *("kind", "controller", "height_m", "speed_mps", "direction_deg"),
    *("offset_m", "place_x_m", "place_y_m", "passed"),
)
"""First columns of `sweep.csv`."""
_GAPS = (0.30, 0.24, 0.36, 0.20, 0.42)
"""[m] distances of the end-effector's origin from the base's outline or top, preferred first."""
_SEARCHES = ((0, 0), (0, 1), (40, 0), (-40, 0), (80, 0), (-80, 0))
"""[deg] horizontal angle of the end-effector from outwards, addition to the seed; in this order."""


class StartFinder:
    """Finds the starts of a robot's paths; the base is at the origin and faces +x."""

    def __init__(self, model: RobotModel, data: BorderData, d_b: float) -> None:
        """Prepare the search for buffers of d_b [m]; raises the error of `check_avoidance`."""
        check_avoidance(model, data)
        self.model, self.data = model, data
        self._solver = StartSolver(model, data.pairs, d_b)
        self._state = RobotState(model)
        self._monitor = DistanceMonitor(self._state, data.pairs.mobile)
        self._body = MobileBody(model)
        self._searched: tuple[Approach, int] | None = None  # arguments of the last search
        self._found: Iterator[tuple[Array, Array]] = iter(())  # its results
        self._flaws: Counter[str] = Counter()  # its failed tries, by the reason

    def find(self, approach: Approach, distance: float, *, seed: int = 0) -> Start:
        """Find the start of a path; without one, `reason` has the three most frequent reasons.

        If the arm cannot reach the desired `distance` [m] from the base on the path's line, the
        start has the distance at which the search ended. At most six postures are tried.
        """
        search = replace(approach, offset=0.0), seed
        if search != self._searched:  # paths that differ only in `offset` share the postures
            self._searched, self._found = search, self._search(*search)
        self._found, postures = tee(self._found)  # stores the found postures for the next path
        refused: Counter[str] = Counter()
        for posture in islice(postures, 6):
            try:
                p_ee, q_m = self._slide_to_distance(approach, *posture, distance)
                if approach.kind == "wheel_axis":
                    q_m = self._slide_to_offset(p_ee, q_m, approach.offset)
            except UnreachableError as error:
                refused[str(error)] += 1
                continue
            closest = self._closest(q_m)
            p_ee, p_b = point_of(self._state.T_world_ee.translation), point_of(closest.p_b)
            return Start(approach, tuple(q_m.tolist()), p_ee, p_b, float(closest.d))
        flaws = sorted((refused or self._flaws).items(), key=lambda item: (-item[1], item[0]))
        reasons = (f"{flaw} ({count} tries)" for flaw, count in flaws[:3])
        return Start(approach, reason="; ".join(reasons))

    def _search(self, approach: Approach, seed: int) -> Iterator[tuple[Array, Array]]:
        """Yield the end-effector's positions (3,) [m] and postures (n_m,) outside all buffers."""
        places = [self._place(approach, gap) for gap in _GAPS]
        reached = [p for p in places if self._solver.reaches(point_of(p), seed=seed)]
        missed = len(places) - len(reached)
        self._flaws = Counter({OUT_OF_REACH: missed} if missed else {})
        for (turn, k), p_ee in product(_SEARCHES, reached):
            try:
                how = {"turn": math.radians(turn), "tries": 4}
                yield p_ee, self._solver.solve(point_of(p_ee), seed=seed + k, **how)
            except UnreachableError as error:
                self._flaws.update(error.flaws)

    def _place(self, approach: Approach, gap: float) -> Array:
        """(3,) [m] position of the end-effector at a gap [m] from the base's outline or top."""
        lower, upper = self._body.lower, self._body.upper
        if approach.kind == "above":
            return np.array([*approach.place, upper[2] + gap])
        centre, outwards = (lower + upper)[:2] / 2, -approach.inwards[:2]
        x, y = centre + (exit_distance(centre, outwards, lower[:2], upper[:2]) + gap) * outwards
        return np.array([x, y, approach.height])

    def _slide_to_distance(
        self, approach: Approach, p_ee: Array, q_m: Array, distance: float
    ) -> tuple[Array, Array]:
        """Slide p_ee (3,) [m] and q_m (n_m,) towards a `distance` [m], by at most about 0.25 m."""
        excess = self._closest(q_m).d - distance
        step, moved, small = np.sign(excess) * 0.02, 0.0, 1e-4  # [m]; `small` is the tolerance
        while abs(excess) > small and abs(step) > small / 8 and moved <= 0.25:  # [m]
            p_new = p_ee + step * approach.inwards
            with suppress(UnreachableError):
                q_new = self._solver.slide(point_of(p_new), q_m)
                new_excess = self._closest(q_new).d - distance
                if new_excess * excess >= 0:
                    p_ee, q_m, excess, moved = p_new, q_new, new_excess, moved + abs(step)
                    continue
            step /= 2  # out of reach, or beyond the distance
        return p_ee, q_m

    def _slide_to_offset(self, p_ee: Array, q_m: Array, x: float) -> Array:
        """Joint positions (n_m,) at which p_b, the arm's point nearest to the base, has this x [m].

        The search starts at `q_m`, with the end-effector at `p_ee` (3,) [m]. If it fails, it raises
        an UnreachableError.
        """
        smallest = np.inf
        for _ in range(40):
            closest = self._closest(q_m)
            error = float(closest.p_b[0]) - x
            if abs(error) < 1e-7:
                return q_m
            smallest = min(smallest, abs(error))
            if abs(error) > 1e-4:  # shift the end-effector along the base's x axis
                p_ee = p_ee - [error, 0.0, 0.0]
                q_m = self._solver.slide(point_of(p_ee), q_m)
            else:  # the smallest joint step, which is finer than the search for postures
                joint = self._state.model.body_joints[closest.pair.b]
                row = self._state.point_jacobian(joint, closest.p_b)[0, self._state.model.n_b :]
                q_m = q_m - row * error / (row @ row)
        raise UnreachableError(f"x of the arm's closest point differs by {smallest:.1e} m or more")

    def _closest(self, q_m: Array) -> ClosestPoints:
        """Closest points of the nearest pair with the base; the state then has the posture q_m."""
        self._state.update(at_rest(self._state.model, q_m))
        return min(self._monitor.find_closest_points(), key=lambda closest: closest.d)


@lru_cache(maxsize=1)
def load(robot: str, d_b: float) -> StartFinder:
    """The `StartFinder` of a robot for a buffer distance `d_b` [m], cached in each process."""
    model = RobotModel(load_robot(robot))
    return StartFinder(model, load_border_data(model, progress=False), d_b)


def sweep(plan: SweepPlan, *, processes: int = 1, on_progress: OnProgress = lambda _: None) -> Row:
    """Run all paths of a plan, and return the content of `sweep.json` except its key `files`."""
    begin = perf_counter()
    make_context = partial(load, plan.robot, plan.config.border.d_b)
    # Paths along the wheel axis that differ only in p_b share a search for postures.
    same = attrgetter("kind", "height", "direction_deg", "place")
    approaches = plan.approaches(make_context().model)
    groups = [tuple(group) for _, group in groupby(approaches, same)]
    rows: dict[Kind, list[Row]] = {kind: [] for kind in LISTS}
    with Workers(make_context, processes) as workers:
        on_share = part_of(on_progress, 0.0, _START_SHARE)
        found = workers.map(partial(_find_starts, plan), groups, on_share)
        starts = [start for each in found for start in each]
        trials, on_share = list(plan.trials(starts)), part_of(on_progress, _START_SHARE, 1.0)
        results = workers.map(partial(_row, plan), trials, on_share)
        for (start, *_), row in zip(trials, results, strict=True):
            rows[start.approach.kind].append(row)
    on_progress(1.0)
    return {
        **{name: getattr(plan, name) for name in ("robot", "seed", "mode", "physics")},
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
        **{LISTS[kind]: rows[kind] for kind in LISTS},
        "unreachable": [
            {"kind": start.approach.kind, **start.approach.where(), "reason": start.reason}
            for start in starts
            if start.reason
        ],
        "elapsed_s": perf_counter() - begin,
    }


def _find_starts(plan: SweepPlan, finder: StartFinder, group: tuple[Approach, ...]) -> list[Start]:
    return [finder.find(each, plan.distance, seed=plan.seed) for each in group]


def _row(plan: SweepPlan, finder: StartFinder, trial: tuple[Start, str, float]) -> Row:
    spec, (start, controller, speed) = plan.spec(*trial), trial
    run, scenario = thinned(run_from_spec(spec, finder.model, finder.data)), spec.scenario
    end = scenario.place(scenario.duration)
    errors = np.linalg.norm(run.trace.of("p_ee") - end, axis=1)
    row: Row = {
        "controller": controller,
        **start.approach.where(),
        "speed_mps": speed,
        **dict(zip(("start_x_m", "start_y_m", "start_z_m"), start.p_ee, strict=True)),
        "start_clearance_m": start.clearance,
        "start_p_b_x_m": start.p_b[0],
        **{key: run.figures[key] for key in _RESULTS},
        "time_s": arrival(run.trace.t, errors),
    }
    row["passed"] = passes(row)
    return {key: rounded(value) for key, value in row.items()}


def arrival(t: Array, errors: Array) -> float | None:
    """[s] first of the times t (N,) [s] from which on all errors (N,) [m] are ≤ 1 mm, or None."""
    arrived = np.append(0, np.flatnonzero(errors > ERROR_LIMIT) + 1)[-1]
    return float(t[arrived]) if arrived < len(t) else None


def passes(results: Row, error_limit: float = ERROR_LIMIT) -> bool:
    """Whether a path was successful: its final error is at most `error_limit` [m], arm and base
    were always at least 0.03 m apart, the arm never touched base or itself in the plant, and no
    step had the fallback command.
    """
    clearance = results["min_clearance_m"]
    flaws = (results[key] for key in ("contacts", "arm_contacts", "solver_failures"))
    arrived = results["ee_error_final_m"] <= error_limit
    return arrived and clearance is not None and clearance >= CLEARANCE_LIMIT and not any(flaws)


def _summaries(plan: SweepPlan, starts: list[Start], rows: dict[Kind, list[Row]]) -> Row:
    """Summaries by controller and by the key of `LISTS`, for the kinds of paths in the plan."""
    result: Row = {controller: {} for controller in plan.controllers}
    for controller, (kind, key) in product(result, LISTS.items()):
        if own := [start for start in starts if start.approach.kind == kind]:
            of_it = [row for row in rows[kind] if row["controller"] == controller]
            result[controller][key] = _summary(own, of_it)
    return result


def _summary(starts: list[Start], rows: list[Row]) -> Row:
    """Numbers of runs by their result, sums, and worst and median values; None without a value."""
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
    above = result["above"] or any(row["kind"] == "above" for row in result["unreachable"])
    with styled():
        for speed in result["speeds_mps"]:
            for height in result["heights_m"]:
                names.append(f"sweep_h{height:g}_v{speed:g}.png")
                write_whole(out / names[-1], png_of(polar_map(result, height, speed, model)))
            if above:
                names.append(f"sweep_above_v{speed:g}.png")
                write_whole(out / names[-1], png_of(above_map(result, speed, model)))
    rows = [{"kind": kind, **row} for kind, key in LISTS.items() for row in result[key]]
    write_rows(out / "sweep.csv", rows + result["unreachable"], _FIRST)
    write_json(out / "sweep.json", {**result, "files": names})
    return names
