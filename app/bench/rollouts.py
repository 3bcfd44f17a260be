"""Whole runs with physics, as fast as they go: in multiples of real time."""

from __future__ import annotations

from functools import partial
from time import perf_counter
from typing import NamedTuple

from app.border.cache import BorderData, load_border_data
from app.border.pool import Workers
from app.config import Config
from app.robot.assets import load_robot
from app.robot.model import RobotModel
from app.simulation.run import run_scenario
from app.simulation.scenario import LINES

_RUNS = ("guiding-lateral", "guiding-front")


class Robot(NamedTuple):
    """What a process loads once."""

    model: RobotModel
    data: BorderData


def load(robot: str) -> Robot:
    """A robot and its border, which has been sampled already."""
    model = RobotModel(load_robot(robot))
    return Robot(model, load_border_data(model, progress=False))


def realtime_factor(robot: str, processes: int) -> float:
    """Simulated time over real time of some guided runs, shared among processes.

    The time to start the processes is not counted: each first takes a short run.
    """
    simulated = sum(LINES[name].duration for name in _RUNS) * processes
    with Workers(partial(load, robot), processes) as workers:
        list(workers.map(_run, [("guiding-front", 0.5)] * (4 * processes)))
        begin = perf_counter()
        jobs = [(name, LINES[name].duration) for name in _RUNS for _ in range(processes)]
        list(workers.map(_run, jobs))
        return simulated / (perf_counter() - begin)


def _run(robot: Robot, job: tuple[str, float]) -> None:
    name, duration = job
    run_scenario(robot.model, robot.data, LINES[name].changed(duration=duration), Config())
