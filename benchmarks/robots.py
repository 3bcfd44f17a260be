"""Delivered robots on the same paths: `python -m benchmarks.robots [--json]`.

A person pulls the end-effector of each robot towards the base from the side and from the front. In
two further cases the end-effector tracks a path of 0.2 m: towards a side of the base, or along the
wheel axis, where p_b, the arm's point nearest to the base, starts at x = 0. Each case runs without
and with avoidance. The program searches for a start 0.02 m outside of the buffer from which the
path leads into its inner half without avoidance. Without such a start, the row states the reason.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import Annotated, Any, NamedTuple

import tyro

from app.border.mobile import MobileBody
from app.cli import options
from app.cli.common import print_json, print_table
from app.config import Config
from app.errors import DbbError, check_name
from app.jobs.pool import Workers
from app.jobs.progress import progress_bar
from app.robot.assets import robot_names
from app.robot.model import RobotModel
from app.simulation.run import run_from_spec
from app.studies.runs import Row, rounded
from app.studies.sweep.plan import (
    CLEARANCE_LIMIT,
    ERROR_LIMIT,
    Approach,
    Mode,
    Start,
    SweepPlan,
)
from app.studies.sweep.sweep import StartFinder, load, passes

COMPARED = ("none", "dbb")
"""The controllers: without avoidance, then with avoidance."""
GUIDED_LIMIT = 0.02
"""[m] largest distance of a guided end-effector from the person's target at the end."""
_MAX_PATHS = 4  # [-] largest number of paths that are tested without avoidance
_TOUCHED = ("contacts", "arm_contacts", "floor_contacts")
_HEIGHTS = (0.8, 0.65, 0.5, 0.9, 1.0)  # [-] shares of the height of l_m, in the order of preference
_LEFT_RIGHT = (90.0, 270.0)  # [deg]
_SIDES = (60.0, 300.0, 75.0, 285.0, 45.0, 315.0, 90.0, 270.0, 105.0, 255.0, 120.0, 240.0)  # [deg]
_FRONTS = (10.0, 350.0, 0.0, 20.0, 340.0, 30.0, 330.0)  # [deg]


class Case(NamedTuple):
    """A case of the comparison; its numbers do not depend on the robot.

    Attributes:
        name: The displayed name.
        mode: Whether the arm tracks the path with constant orientation, or a person pulls the arm.
        directions: [deg] directions of the start, counter-clockwise from the front, in the order of
            preference.
        on_axis: Whether p_b starts on the wheel axis, x = 0, and moves along it.
        length: [m] length of the path, which starts 0.02 m outside of the buffer.
        speed: [m/s] mean speed of the end-effector.
    """

    name: str
    mode: Mode
    directions: tuple[float, ...]
    on_axis: bool = False
    length: float = 0.2
    speed: float = 0.025

    def approaches(self, model: RobotModel) -> Iterator[Approach]:
        """Possible paths in the order of preference: several heights from each direction."""
        top = float(MobileBody(model).upper[2])
        for direction in self.directions:
            for share in _HEIGHTS:
                height = round(share * top, 3)
                yield Approach("wheel_axis" if self.on_axis else "side", height, direction)


CASES = (
    Case("guiding-lateral", "guiding", _SIDES, length=0.3, speed=0.05),
    Case("guiding-front", "guiding", _FRONTS, length=0.3, speed=0.05),
    Case("tracking", "tracking", _SIDES),
    Case("wheel-axis", "tracking", _LEFT_RIGHT, on_axis=True),
)
"""The cases for each robot."""


def robot_table(
    robots: Sequence[str],
    *,
    cases: Sequence[Case] = CASES,
    seed: int = 0,
    processes: int = 1,
    on_progress: Callable[[float], None] = lambda _: None,
) -> Row:
    """Move each end-effector towards the base from the side, the front and along the wheel axis.

    Each path runs without and with avoidance. A path is the first one that starts outside all
    buffers and, without avoidance, leads to a distance below d_b / 2. If none of the tested paths
    does, or if the robot cannot be loaded, the row states the reason.

    Args:
        robots: Names of the robots.
        cases: The cases.
        seed: Seed of the search for starts.
        processes: Number of processes.
        on_progress: Called with the finished share of the work, 0 to 1.

    Returns:
        `rows`, `seed`, d_b and the acceptance limits of the rows; the name of a quantity with a
        unit ends in the unit. The `title` of a robot that cannot be loaded is its name.
    """
    jobs = [
        (SweepPlan(robot=robot, mode=case.mode, length=case.length, seed=seed), case)
        for robot in robots
        for case in cases
    ]
    with Workers(tuple, processes) as workers:  # the jobs share no data
        rows = [row for found in workers.map(_compared, jobs, on_progress) for row in found]
    limits = {
        "clearance_limit_m": CLEARANCE_LIMIT,
        "hand_error_limit_m": ERROR_LIMIT,
        "guided_hand_error_limit_m": GUIDED_LIMIT,
    }
    return {"seed": seed, "d_b_m": Config().border.d_b, **limits, "rows": rows}


def _compared(_: object, job: tuple[SweepPlan, Case]) -> list[Row]:
    plan, case = job
    told: Row = {"robot": plan.robot, "title": plan.robot, "case": case.name}
    try:
        finder = load(plan.robot, plan.config.border.d_b)
        told["title"] = finder.model.description.title
        rows = _shown(finder, plan, case)
    except DbbError as error:
        rows = [{"reason": str(error)}]
    return [told | row for row in rows]


def _shown(finder: StartFinder, plan: SweepPlan, case: Case) -> list[Row]:
    """A row for each controller on the first suitable path, or one row with a reason.

    A path is suitable if the arm enters the inner half of the buffer without avoidance.
    """
    half, gaps, start = plan.config.border.d_b / 2, [], None
    for approach in case.approaches(finder.model):
        start = finder.find(approach, plan.distance, seed=plan.seed)
        if start.reason:
            continue
        bare, *others = COMPARED
        row = _of_robot(finder, plan, case, start, bare)
        if row["clearance_m"] < half:
            return [row, *(_of_robot(finder, plan, case, start, name) for name in others)]
        gaps.append(row["clearance_m"])
        if len(gaps) == _MAX_PATHS:
            break
    assert start is not None, "a case has directions"
    if not gaps:
        return [{"reason": f"no start clear of the buffers: {start.reason}"}]
    return [
        {
            "reason": f"nothing to show: without avoidance the arm comes no nearer than "
            f"{min(gaps):.3f} m on {len(gaps)} paths"
        }
    ]


def _of_robot(
    finder: StartFinder, plan: SweepPlan, case: Case, start: Start, controller: str
) -> Row:
    spec = plan.spec(start, controller, case.speed)
    figures: Row = run_from_spec(spec, finder.model, finder.data).figures
    row: Row = {
        "controller": controller,
        **start.approach.where(),
        "clearance_m": figures["min_clearance_m"],
        "hand_error_m": figures["ee_error_final_m"],
        "base_path_m": figures["base_path_m"],
        "contacts": sum(figures[key] for key in _TOUCHED),
        "solver_failures": figures["solver_failures"],
    }
    limit = GUIDED_LIMIT if case.mode == "guiding" else ERROR_LIMIT
    row["passed"] = passes(figures, limit) and not row["contacts"]
    return {key: rounded(value) for key, value in row.items()}


def _print_robots(rows: list[dict[str, Any]]) -> None:
    head = "robot", "case", "from", "controller", "clearance", "error", "base drove", "contacts"
    shown = []
    for row in rows:
        if "reason" in row:
            shown.append([row["title"], row["case"], "", "", row["reason"]])
            continue
        shown.append(
            [
                row["title"],
                row["case"],
                f"{row['direction_deg']:g}°, {row['height_m']:.2f} m",
                row["controller"],
                f"{row['clearance_m']:.3f} m",
                f"{1000 * row['hand_error_m']:.3g} mm",
                f"{row['base_path_m']:.2f} m",
                str(row["contacts"]),
                "✓" if row["passed"] else "✗",
            ]
        )
    print_table((*head, ""), shown)


def main(
    robots: Annotated[tuple[str, ...], tyro.conf.arg(metavar="NAME …")] = (),
    case: Annotated[tuple[str, ...], tyro.conf.arg(metavar="NAME …")] = (),
    processes: options.Processes = None,
    seed: int = 0,
    json: options.Json = False,
) -> None:
    """Move each robot's end-effector towards its base, without and with avoidance.

    Args:
        robots: Names of the robots, which `dbb robots` lists; default: all robots.
        case: Names among guiding-lateral, guiding-front, tracking and wheel-axis; default: all.
        processes: Number of parallel processes.
        seed: Seed of the search for starts.
        json: Print one JSON object.
    """
    known = {each.name: each for each in CASES}
    for name in robots:
        check_name("robot", name, robot_names())
    for name in case:
        check_name("case", name, known)
    with progress_bar("robots", 1.0) as on_progress:
        result = robot_table(
            robots or robot_names(),
            cases=[known[name] for name in case] or CASES,
            seed=seed,
            processes=options.check_processes(processes),
            on_progress=on_progress,
        )
    if json:
        print_json(result)
    else:
        _print_robots(result["rows"])


if __name__ == "__main__":
    from benchmarks.robots import main as run  # worker processes find functions by their modules

    tyro.cli(run, prog="python -m benchmarks.robots")
