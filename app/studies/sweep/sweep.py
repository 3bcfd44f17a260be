"""The sweep: hand paths towards the base from everywhere, each with each controller and speed."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from itertools import groupby
from time import perf_counter

from app.border.cache import load_border_data
from app.jobs.pool import Workers
from app.robot.assets import load_robot
from app.robot.model import RobotModel
from app.simulation.run import run_scenario
from app.studies.paper.experiments import run_of
from app.studies.sweep.paths import KINDS, Approach, Kind
from app.studies.sweep.paths_start import Start, StartFinder
from app.studies.sweep.plan import SweepPlan, Trial
from app.studies.sweep.result import LISTS, Row, row_of, summary, unreachable_of

START_SHARE = 0.25
"""[-] of the work that the search for starts is counted as."""


class _Context:
    """What the work of one process shares."""

    def __init__(self, plan: SweepPlan) -> None:
        self.plan = plan
        self.model = RobotModel(load_robot(plan.robot))
        self.data = load_border_data(self.model, progress=False)
        self.finder = StartFinder(self.model, self.data, plan.config.border.d_b)


def sweep(
    plan: SweepPlan, *, processes: int = 1, on_progress: Callable[[float], None] = lambda _: None
) -> Row:
    """Lead the hand along all paths of a plan.

    Starts are searched once for all controllers and speeds. The result does not depend on the
    number of processes, but for its times.

    Args:
        plan: What to do.
        processes: How many to work side by side.
        on_progress: Called now and then with the share of the work that is done, 0 to 1.

    Returns:
        What `sweep.json` holds; keys end in their unit.
    """
    begin = perf_counter()
    model = RobotModel(load_robot(plan.robot))
    load_border_data(model, progress=False)  # once, before the workers look for it in the cache
    groups = _groups(plan.approaches(model))
    starts: list[Start] = []
    rows: dict[Kind, list[Row]] = {kind: [] for kind in KINDS}
    with Workers(partial(_Context, plan), processes) as workers:
        for k, found in enumerate(workers.map(_find_starts, groups), start=1):
            starts += found
            on_progress(START_SHARE * k / len(groups))
        trials = list(plan.trials(starts))
        for k, (trial, row) in enumerate(
            zip(trials, workers.map(_run, trials), strict=True), start=1
        ):
            rows[trial.start.approach.kind].append(row)
            on_progress(START_SHARE + (1.0 - START_SHARE) * k / len(trials))
    on_progress(1.0)
    return {
        **_settings(plan),
        "summary": summary(plan, starts, rows),
        **{LISTS[kind]: rows[kind] for kind in KINDS},
        "unreachable": [unreachable_of(start) for start in starts if start.reason],
        "elapsed_s": perf_counter() - begin,
    }


def _groups(approaches: list[Approach]) -> list[tuple[Approach, ...]]:
    """Paths that begin with the same search for a posture: those along the wheel axis."""

    def key(approach: Approach) -> tuple[object, ...]:
        return approach.kind, approach.height, approach.direction_deg, approach.place

    return [tuple(group) for _, group in groupby(approaches, key)]


def _find_starts(context: _Context, group: tuple[Approach, ...]) -> list[Start]:
    plan = context.plan
    return [context.finder.find(each, plan.distance, seed=plan.seed) for each in group]


def _run(context: _Context, trial: Trial) -> Row:
    plan, scenario = context.plan, context.plan.scenario(trial)
    result = run_scenario(
        context.model,
        context.data,
        scenario,
        plan.config,
        controller=trial.controller,
        physics=plan.physics,
        seed=plan.seed,
    )
    target = scenario.position(scenario.duration)[0]
    return row_of(trial, context.model, run_of(result), target)


def _settings(plan: SweepPlan) -> Row:
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
    }
