"""Short real runs for the tests of `app.studies.paper`, and runs with replaced figures."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from app.border.cache import BorderData
from app.config import Config
from app.robot.model import RobotModel
from app.simulation.run import RunResult, run_from_spec
from app.studies.paper.experiments import Experiment, Sources
from app.studies.runs import thinned


def short_run(
    robot: RobotModel,
    data: BorderData,
    experiment: Experiment,
    duration: float,
    physics: str = "kinematic",
) -> RunResult:
    """Run an experiment with a shorter duration."""
    scenario = experiment.scenario.changed(duration=duration)
    return thinned(
        run_from_spec(experiment._replace(scenario=scenario, physics=physics), robot, data)
    )


def sources_of(robot: RobotModel, data: BorderData, runs: dict[Experiment, RunResult]) -> Sources:
    """Sources that contain these runs."""
    return Sources(robot, data, Config(), runs)


def with_figures(run: RunResult, **figures: Any) -> RunResult:
    """The run with some of its figures replaced."""
    return run._replace(figures={**run.figures, **figures})


def every(experiments: Iterable[Experiment], run: RunResult) -> dict[Experiment, RunResult]:
    """The same run for each of the experiments."""
    return dict.fromkeys(experiments, run)
