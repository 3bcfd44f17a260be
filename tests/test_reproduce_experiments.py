"""Experiments run once, agree with `run_scenario`, and do not depend on the number of processes."""

from __future__ import annotations

import pickle
from dataclasses import replace

import numpy as np
import pytest

from app.border.cache import BorderData
from app.config import Config
from app.robot.model import RobotModel
from app.simulation.run import run_scenario
from app.studies.paper import experiments, report
from app.studies.paper.experiments import LATERAL, Experiment, run_experiments
from app.studies.paper.report import FIGURES, chosen

TIMES = {"step_p50_us", "step_p99_us", "realtime_factor"}


def short(experiment: Experiment) -> Experiment:
    """The experiment with a duration of 0.05 s."""
    return experiment._replace(scenario=replace(experiment.scenario, duration=0.05))


def test_experiment_gives_the_figures_of_run_scenario(robot: RobotModel, border_data: BorderData):
    lateral = short(LATERAL)
    run = run_experiments([lateral], seed=3)[lateral]
    result = run_scenario(robot, border_data, lateral.scenario, Config(), seed=3)
    assert {k: v for k, v in run.figures.items() if k not in TIMES} == {
        k: v for k, v in result.figures.items() if k not in TIMES
    }
    for key in ("t_s", "base_x_m", "q_panda_joint4_rad", "d_lm-lEE_m", "beta_lm-l3"):
        assert run.trace[key].tolist() == result.trace[key][::10].tolist()
    assert run.trace.of("q_m").shape == (5, 7)
    assert run.trace.of("base_pose").shape == (5, 3)


@pytest.mark.slow
def test_repeated_experiments_run_once_and_progress_reaches_the_total():
    seen: list[float] = []
    others = [*map(short, (LATERAL, Experiment.of("guiding-front", "none"), LATERAL))]
    runs = run_experiments(others, on_progress=seen.append)
    assert set(runs) == set(others)
    assert seen == sorted(seen)
    assert seen[-1] == pytest.approx(experiments.duration(others)) == pytest.approx(0.1)


def test_no_experiments_give_no_runs():
    assert run_experiments([]) == {}


def test_run_result_survives_pickling():
    run = experiments.RunResult({"a": 1.0}, {"t_s": np.arange(3.0)})
    again = pickle.loads(pickle.dumps(run))
    assert again.figures == run.figures
    np.testing.assert_array_equal(again.trace["t_s"], run.trace["t_s"])


def test_experiment_sets_border_kind_and_start():
    plain = Experiment.of("tracking", "dbb")
    other = Experiment.of("tracking", "dbb", start=(0.0, 0.68, 0.3))
    assert plain.config == other.config == Config()
    points = experiments.GUIDING["points"]["front"]
    assert points.config.changes(Config()) == {"border.kind": "points"}
    assert points.name != experiments.FRONT.name
    np.testing.assert_allclose(other.aim(), [(0.0, 0.68, 0.3), (0.0, 0.48, 0.3)])
    assert len({plain.name, other.name}) == 2


def test_figures_request_exactly_the_experiments_that_they_need():
    assert report.experiments_for(["fig10"]) == []
    twelve = report.experiments_for(["fig12"])
    assert {e.controller for e in twelve} == {"dbb", "repulsive"}
    assert {e.scenario.name for e in twelve} == {"tracking"}
    everything = report.experiments_for(list(FIGURES))
    assert len(everything) == len(set(everything))
    assert {e for name in FIGURES for e in report.experiments_for([name])} == set(everything)


def test_all_experiments_fit_into_a_quarter_of_an_hour():
    """If each core simulates at half of real time, two cores need 500 s for 500 s of simulation."""
    assert experiments.duration(report.experiments_for(list(FIGURES))) < 500.0


def test_chosen_figures_are_unique_and_in_the_papers_order():
    assert chosen(["fig12", "fig3", "fig12"]) == ["fig3", "fig12"]
    assert chosen([]) == list(FIGURES)
