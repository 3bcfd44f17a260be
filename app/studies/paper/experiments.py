"""The runs behind the figures: each is done once, all side by side, and shared."""

from __future__ import annotations

import os
import threading
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from app.border.cache import BorderData, load_border_data
from app.config import Config
from app.jobs.pool import Workers
from app.robot.assets import load_robot
from app.robot.model import RobotModel
from app.simulation.run import RunResult, run_scenario
from app.simulation.scenarios.leading import Scenario
from app.simulation.scenarios.line import LineScenario, Point
from app.simulation.scenarios.names import scenario_by_name
from app.system import SPAWN

Array = np.ndarray

ROBOT = "husky_panda"
"""The paper's robot."""
MOST_PROCESSES = 2
"""More than two is possible, but each needs 0.5 GB."""
_LOOK = 0.2  # [s] between two looks at how far the workers are


class Experiment(NamedTuple):
    """A scenario with a controller, as `dbb run` takes them.

    Attributes:
        scenario: Name of the scenario.
        controller: Name of the controller.
        start: [m] where the hand starts, if not where the scenario says.
        move: [m] how far it is led, likewise.
        points: Whether the border is the paper's cloud of points and not the surface through it.
    """

    scenario: str
    controller: str
    start: Point | None = None
    points: bool = False
    move: Point | None = None

    @property
    def name(self) -> str:
        """As in `tracking, dbb`."""
        start = "" if self.start is None else " from ({:g}, {:g}, {:g}) m".format(*self.start)
        border = ", border of points" if self.points else ""
        return f"{self.scenario}{start}, {self.controller}{border}"

    def full(self) -> Scenario:
        """The scenario with its start and its way."""
        return scenario_by_name(self.scenario).changed(start=self.start, move=self.move)

    def config(self) -> Config:
        """The parameters: the defaults, but for the kind of border."""
        return Config().replace("border.kind", "points") if self.points else Config()

    def aim(self) -> Array:
        """(2, 3) [m] where the hand is led from and to, in the world."""
        scenario = self.full()
        assert isinstance(scenario, LineScenario), f"{self.scenario} leads along no line"
        return np.array([scenario.start, np.add(scenario.start, scenario.move)])


class Run(NamedTuple):
    """What an experiment gave.

    Attributes:
        figures: As `dbb run --json` prints them.
        log: Columns of its `log.csv`, each (N,).
    """

    figures: dict[str, Any]
    log: dict[str, Array]

    @property
    def base_poses(self) -> Array:
        """(N, 3) x, y [m] and heading [rad] of the base."""
        return np.column_stack([self.log[k] for k in ("base_x_m", "base_y_m", "base_yaw_rad")])

    @property
    def q_m(self) -> Array:
        """(N, n_m) [rad or m] the arm's joints."""
        n_m = sum(f"q{i}_rad" in self.log for i in range(1, len(self.log)))
        return np.column_stack([self.log[f"q{i}_rad"] for i in range(1, n_m + 1)])


Runs = dict[Experiment, Run]


@dataclass(frozen=True, eq=False)
class Sources:
    """What figures and claims are made from.

    Attributes:
        model: The robot.
        data: Its pairs and clouds.
        config: Parameters of the runs, unless an experiment says otherwise.
        runs: The runs that were asked for.
    """

    model: RobotModel
    data: BorderData
    config: Config
    runs: Runs


def load_sources() -> Sources:
    """The paper's robot with the default parameters, no run done yet."""
    model = RobotModel(load_robot(ROBOT))
    return Sources(model, load_border_data(model), Config(), {})


def default_processes() -> int:
    """Two, or as many as there are cores."""
    return min(MOST_PROCESSES, os.cpu_count() or 1)


def run_experiments(
    experiments: Iterable[Experiment],
    *,
    seed: int = 0,
    processes: int = 1,
    on_progress: Callable[[float], None] = lambda _: None,
) -> Runs:
    """Do each experiment once.

    Args:
        experiments: What to run; repeated ones are run once.
        seed: Of everything random in the runs.
        processes: How many to run side by side.
        on_progress: Called now and then with the simulated time of all of them together [s].

    Raises:
        UnreachableError: No start of the arm for one of them.
    """
    # The longest ones first: so the processes end together.
    todo = sorted(set(experiments), key=lambda e: (-e.full().duration, e.name))
    clock = SPAWN.Value("d", 0.0)
    with (
        _watched(clock, on_progress),
        Workers(partial(_Context, seed, clock), min(processes, max(len(todo), 1))) as workers,
    ):
        return dict(zip(todo, workers.map(_run, todo), strict=True))


def duration(experiments: Iterable[Experiment]) -> float:
    """[s] simulated time of all of them together."""
    return sum(e.full().duration for e in set(experiments))


class _Context:
    """What the runs of one process share."""

    def __init__(self, seed: int, clock: Any) -> None:
        self.sources = load_sources()
        self.seed = seed
        self.clock = clock


def _run(context: _Context, experiment: Experiment) -> Run:
    sources = context.sources
    before = 0.0

    def tick(t: float) -> None:
        nonlocal before
        with context.clock.get_lock():
            context.clock.value += t - before
        before = t

    scenario = experiment.full()
    result = run_scenario(
        sources.model,
        sources.data,
        scenario,
        experiment.config(),
        controller=experiment.controller,
        seed=context.seed,
        on_progress=tick,
    )
    tick(scenario.duration)
    return run_of(result)


def run_of(result: RunResult) -> Run:
    """A run's figures and log, as other processes and the figures take them."""
    rows = result.recorder.rows
    return Run(result.figures, {key: np.array([row[key] for row in rows]) for key in rows[0]})


@contextmanager
def _watched(clock: Any, on_progress: Callable[[float], None]) -> Iterator[None]:
    """Reports the workers' clock while they work; they cannot call back by themselves."""
    ended = threading.Event()

    def watch() -> None:
        while not ended.wait(_LOOK):
            on_progress(clock.value)

    watcher = threading.Thread(target=watch, daemon=True)
    watcher.start()
    try:
        yield
    finally:
        ended.set()
        watcher.join()
        on_progress(clock.value)
