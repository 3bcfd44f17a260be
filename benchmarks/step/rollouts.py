"""Speed of complete runs with a plant, in multiples of real time."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from time import perf_counter
from typing import NamedTuple

import numpy as np

from app.border.cache import BorderData
from app.cli.common import load_robot_and_border
from app.config import Config
from app.jobs.pool import Workers
from app.robot.model import RobotModel
from app.simulation.run import run_scenario
from app.simulation.scenarios import LINES

_RUNS = ("guiding-lateral", "guiding-front")
_ROUNDS = 3


class Rollouts(NamedTuple):
    """Ratios of simulated to real time of guided runs in worker processes; medians over rounds.

    Attributes:
        factors: [-] ratio for all processes together, by the number of processes.
        scaling: [-] ratio for the last number of processes, divided by that for the first number.
    """

    factors: dict[int, float]
    scaling: float


def time_rollouts(
    robot: str, processes: Sequence[int], *, rounds: int = _ROUNDS, seconds: float | None = None
) -> Rollouts:
    """Measure runs with each number of processes in turn, because the machine's speed varies.

    The start of the processes is not measured, because each process first executes short runs.

    Args:
        robot: Name of the robot.
        processes: Numbers of parallel processes; each process executes all runs.
        rounds: Number of measurements for each number of processes.
        seconds: [s] duration of each run; None means the duration of the scenario.
    """
    jobs = [(name, seconds or LINES[name].duration) for name in _RUNS]
    simulated = sum(duration for _, duration in jobs)
    # At least two, because a single worker would be this process with its many other objects.
    with Workers(partial(load_robot_and_border, robot), max(2, *processes)) as workers:
        list(workers.map(_run, [[("guiding-front", 0.5)]] * (4 * max(processes))))
        found = []
        for _ in range(rounds):
            times = [_time(workers, [jobs] * n) for n in processes]
            found.append([n * simulated / t for n, t in zip(processes, times, strict=True)])
    medians = np.median(found, axis=0).tolist()
    scaling = float(np.median([factors[-1] / factors[0] for factors in found]))
    return Rollouts(dict(zip(processes, medians, strict=True)), scaling)


def _time(workers: Workers, jobs: Sequence[Sequence[tuple[str, float]]]) -> float:
    begin = perf_counter()
    list(workers.map(_run, jobs))
    return perf_counter() - begin


def _run(robot: tuple[RobotModel, BorderData], jobs: Sequence[tuple[str, float]]) -> None:
    for name, duration in jobs:
        run_scenario(*robot, LINES[name].changed(duration=duration), Config())
