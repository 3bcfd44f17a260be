"""Short real runs for the tests of `app.reproduce`, and figures of runs as a test wants them."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from app.border.cache import BorderData
from app.config import Config
from app.robot.model import RobotModel
from app.simulation.run import run_scenario
from app.studies.paper.experiments import Experiment, Run, Sources, run_of


def short_run(
    robot: RobotModel,
    data: BorderData,
    experiment: Experiment,
    duration: float,
    physics: str = "kinematic",
) -> Run:
    """An experiment, cut short."""
    scenario = experiment.full().changed(duration=duration)
    return run_of(
        run_scenario(
            robot,
            data,
            scenario,
            experiment.config(),
            controller=experiment.controller,
            physics=physics,
        )
    )


def sources_of(robot: RobotModel, data: BorderData, runs: dict[Experiment, Run]) -> Sources:
    """Sources with these runs."""
    return Sources(robot, data, Config(), runs)


def with_figures(run: Run, **figures: Any) -> Run:
    """The run with some of its figures replaced."""
    return run._replace(figures={**run.figures, **figures})


def every(experiments: Iterable[Experiment], run: Run) -> dict[Experiment, Run]:
    """The same run for each of the experiments."""
    return dict.fromkeys(experiments, run)
