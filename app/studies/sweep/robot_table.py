"""Every robot through the same cases, without avoidance and with it, as a table."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

from app.border.cache import BorderData, load_border_data
from app.border.mobile import MobileBody
from app.config import Config
from app.errors import DbbError
from app.jobs.pool import Workers
from app.robot.assets import load_robot
from app.robot.model import RobotModel
from app.simulation.run import run_scenario
from app.studies.pulls.rounding import rounded
from app.studies.sweep.paths_start import Start, StartFinder
from app.studies.sweep.plan import SweepPlan, Trial
from app.studies.sweep.result import CLEARANCE_LIMIT, ERROR_LIMIT, Row
from app.studies.sweep.robot_cases import CASES, Case

CONTROLLERS = ("none", "dbb")
"""Without avoidance and with it."""
GUIDED_LIMIT = 0.02
"""[m] farthest that a guided hand may be from the person's at the end."""
_TOUCHED = ("contacts", "arm_contacts", "floor_contacts")


class _Job(NamedTuple):
    robot: str
    case: Case
    seed: int


class _Loaded(NamedTuple):
    model: RobotModel
    data: BorderData
    finder: StartFinder


class _Context:
    """What a process keeps: the robot that it looked at last."""

    def __init__(self) -> None:
        self._name = ""
        self._loaded: _Loaded | None = None

    def robot(self, name: str) -> _Loaded:
        if self._loaded is None or self._name != name:
            model = RobotModel(load_robot(name))
            data = load_border_data(model, progress=False)
            self._loaded = _Loaded(model, data, StartFinder(model, data, Config().border.d_b))
            self._name = name
        return self._loaded


def robot_table(
    robots: Sequence[str],
    *,
    cases: Sequence[Case] = CASES,
    seed: int = 0,
    processes: int = 1,
    on_progress: Callable[[float], None] = lambda _: None,
) -> Row:
    """Lead each robot's hand towards its base from the side, the front and along the wheel axis.

    The start of each path is searched: the first height and direction from which the arm can begin
    clear of its buffers. A robot that cannot, or cannot be loaded, has a row that says why.

    Args:
        robots: Their names.
        cases: What to do with each.
        seed: Of everything random.
        processes: How many to work side by side.
        on_progress: Called now and then with the share of the work that is done, 0 to 1.

    Returns:
        `rows`, and the limits by which they passed; keys end in their unit. A robot that cannot be
        loaded has its name as `title`.
    """
    jobs = [_Job(robot, case, seed) for robot in robots for case in cases]
    rows: list[Row] = []
    with Workers(_Context, processes) as workers:
        for k, found in enumerate(workers.map(_rows, jobs), start=1):
            rows += found
            on_progress(k / len(jobs))
    limits = {
        "clearance_limit_m": CLEARANCE_LIMIT,
        "hand_error_limit_m": ERROR_LIMIT,
        "guided_hand_error_limit_m": GUIDED_LIMIT,
    }
    return {"seed": seed, "d_b_m": Config().border.d_b, **limits, "rows": rows}


def _rows(context: _Context, job: _Job) -> list[Row]:
    told: Row = {"robot": job.robot, "title": job.robot, "case": job.case.name}
    try:
        loaded = context.robot(job.robot)
        told["title"] = loaded.model.description.title
        start = _start(loaded, job)
        if start.reason:
            return [told | {"reason": start.reason}]
        return [told | _run(loaded, job, start, name) for name in CONTROLLERS]
    except DbbError as error:
        return [told | {"reason": str(error)}]


def _start(loaded: _Loaded, job: _Job) -> Start:
    """The first path that can begin, or the last one tried with why it cannot."""
    body = MobileBody(loaded.model)
    start: Start | None = None
    for approach in job.case.approaches(body):
        start = loaded.finder.find(approach, _plan(job).distance, seed=job.seed)
        if not start.reason:
            return start
    assert start is not None, "a case has directions"
    return start._replace(reason=f"no start clear of the buffers: {start.reason}")


def _run(loaded: _Loaded, job: _Job, start: Start, controller: str) -> Row:
    plan = _plan(job)
    scenario = plan.scenario(Trial(start, controller, job.case.speed))
    figures: Row = run_scenario(
        loaded.model, loaded.data, scenario, Config(), controller=controller, seed=job.seed
    ).figures
    row: Row = {
        "controller": controller,
        **start.approach.where(),
        "clearance_m": figures["min_clearance_m"],
        "hand_error_m": figures["ee_error_final_m"],
        "base_path_m": figures["base_path_m"],
        "contacts": sum(figures[key] for key in _TOUCHED),
        "solver_failures": figures["solver_failures"],
    }
    row["passed"] = _passes(row, job.case)
    return {key: rounded(value) for key, value in row.items()}


def _passes(row: Row, case: Case) -> bool:
    """Nothing touched or came too near, and the hand arrived."""
    clear = row["clearance_m"] is not None and row["clearance_m"] >= CLEARANCE_LIMIT
    arrived = row["hand_error_m"] <= (GUIDED_LIMIT if case.mode == "guiding" else ERROR_LIMIT)
    return clear and arrived and not row["contacts"] and not row["solver_failures"]


def _plan(job: _Job) -> SweepPlan:
    return SweepPlan(robot=job.robot, mode=job.case.mode, length=job.case.length, seed=job.seed)
