"""Claims hold with good figures and do not with bad ones; each has its threshold and its runs."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from app.border.cache import BorderData
from app.robot.model import RobotModel
from app.studies.paper import claims, guiding, refrigerator, thresholds, tracking
from app.studies.paper.claims import CLAIMS, DIRECTIONS, Claim, claims_of, judge
from app.studies.paper.experiments import Experiment, Run
from app.studies.paper.names import FIGURES
from tests.reproduction import sources_of, with_figures

MEASURED_APART = {"density"}  # figures whose claims are measured by real runs, not read off them
SMOOTH = {
    "avoidance_acceleration_jump_max": {"linear_mps2": 0.01, "angular_radps2": 0.01},
    "avoidance_acceleration_sign_changes": {"linear": 0, "angular": 1},
    "torque_jump_max_nm": 0.01,
    "torque_rate_sign_changes": 0,
}
GOOD: dict[str, Any] = {
    "min_clearance_m": 0.1,
    "ee_error_final_m": 1e-6,
    "base_displacement_m": 0.3,
    **SMOOTH,
    "door_met_base_s": None,
    "door_min_distance_m": 0.1,
    "door_opened_80deg_at_s": 38.0,
    "base_back_off_s": 20.0,
    "radial_error_at_5s_rad": -0.02,
    "hand_force_max_n": 20.0,
}


def run(back: float = 0.3, turn: float = -0.2, beta_step: float = 0.001, **figures: Any) -> Run:
    """A run whose base goes straight back and turns, with these figures."""
    n = 200
    share = np.linspace(0.0, 1.0, n)
    beta = np.minimum(np.arange(n) * beta_step, 1.0)
    log = {
        "t_s": 0.01 * np.arange(n),
        "base_x_m": -back * share,
        "base_y_m": 0.0 * share,
        "base_yaw_rad": turn * share,
        "beta_lm-lEE": beta,
        "beta_lm-l3": 0.0 * beta,
    }
    return Run({**GOOD, **figures}, log)


def good_runs() -> dict[Experiment, Run]:
    """Runs by which the paper would be right in everything."""
    runs = {e: run() for claim in CLAIMS for e in claim.needs}
    runs[tracking.REPULSIVE] = run(ee_error_final_m=0.1)
    runs[tracking.NONE] = run(min_clearance_m=0.0)
    runs[refrigerator.NONE] = run(door_met_base_s=30.0)
    for experiment in guiding.COMPARED["repulsive"].values():
        runs[experiment] = run(torque_rate_sign_changes=47)
    return runs


JUDGED = [claim for claim in CLAIMS if claim.figure not in MEASURED_APART]


@pytest.mark.parametrize("claim", JUDGED, ids=lambda claim: claim.paper[:40])
def test_with_good_figures_every_claim_holds(claim: Claim, robot, border_data):
    row = judge(claim, sources_of(robot, border_data, good_runs()))
    assert row["holds"], row["measured"]
    assert row["limits"]


@pytest.mark.parametrize(
    ("experiment", "bad", "fails"),
    [
        (tracking.DBB, {"ee_error_final_m": 0.0011}, claims._reaches),
        (tracking.DBB, {"min_clearance_m": 0.049}, claims._reaches),
        (tracking.DBB, {"back": 0.01}, claims._moves_back),
        (tracking.DBB, {"back": -0.3}, claims._moves_back),
        (tracking.REPULSIVE, {"ee_error_final_m": 0.019}, claims._cannot_reach),
        (
            tracking.REPULSIVE,
            {"ee_error_final_m": 0.1, "min_clearance_m": 0.029},
            claims._cannot_reach,
        ),
        (tracking.NONE, {"min_clearance_m": 0.06}, claims._needed),
        (guiding.FRONT, {"back": 0.0}, claims._backs_off_in_front),
        (guiding.LATERAL, {"beta_step": 0.06}, claims._continuous_beta),
        (guiding.FRONT, {"beta_step": 0.06}, claims._continuous_beta),
        (guiding.LATERAL, {"torque_rate_sign_changes": 3}, claims._smoother_than_repulsive),
        *((e, {"base_displacement_m": 0.0}, claims._any_direction) for e in DIRECTIONS.values()),
        *((e, {"min_clearance_m": 0.0}, claims._any_direction) for e in DIRECTIONS.values()),
        *(
            (e, {"ee_error_final_m": 0.055}, claims._any_direction)
            for e in DIRECTIONS.values()
            if e.scenario == "tracking"
        ),
        (refrigerator.NONE, {"door_met_base_s": 36.0}, claims._door_collides),
        (refrigerator.NONE, {"door_met_base_s": 24.0}, claims._door_collides),
        (refrigerator.NONE, {"door_met_base_s": None}, claims._door_collides),
        (refrigerator.DBB, {"door_met_base_s": 30.0}, claims._door_avoided),
        (refrigerator.DBB, {"door_min_distance_m": 0.01}, claims._door_avoided),
        (refrigerator.DBB, {"door_opened_80deg_at_s": None}, claims._door_open),
        (refrigerator.DBB, {"door_opened_80deg_at_s": 41.0}, claims._door_open),
        (refrigerator.DBB, {"base_back_off_s": None}, claims._base_backs_off),
        (refrigerator.DBB, {"base_back_off_s": 5.0}, claims._base_backs_off),
        (refrigerator.DBB, {"turn": 0.2}, claims._base_backs_off),
        (refrigerator.DBB, {"back": -0.3}, claims._base_backs_off),
        (refrigerator.DBB, {"radial_error_at_5s_rad": -0.1}, claims._incomplete_knowledge),
        (refrigerator.DBB, {"radial_error_at_5s_rad": 0.1}, claims._incomplete_knowledge),
        (refrigerator.DBB, {"hand_force_max_n": 51.0}, claims._incomplete_knowledge),
    ],
)
def test_with_a_bad_figure_the_claim_does_not_hold(experiment, bad, fails, robot, border_data):
    runs = {**good_runs(), experiment: run(**bad)}
    assert not fails(sources_of(robot, border_data, runs)).holds


@pytest.mark.parametrize("method", ["dbb", "points"])
@pytest.mark.parametrize(
    "bad",
    [
        {"avoidance_acceleration_jump_max": {"linear_mps2": 0.31, "angular_radps2": 0.0}},
        {"avoidance_acceleration_jump_max": {"linear_mps2": 0.0, "angular_radps2": 0.61}},
        {"avoidance_acceleration_sign_changes": {"linear": 0, "angular": 4}},
        {"avoidance_acceleration_sign_changes": {"linear": 4, "angular": 0}},
    ],
)
@pytest.mark.parametrize("direction", ["lateral", "front"])
def test_smooth_means_few_sign_changes_and_small_ones(method, bad, direction, robot, border_data):
    runs = {**good_runs(), guiding.COMPARED[method][direction]: run(**bad)}
    sources = sources_of(robot, border_data, runs)
    assert not claims._smooth(method)(sources).holds
    other = "points" if method == "dbb" else "dbb"
    assert claims._smooth(other)(sources).holds


@pytest.mark.parametrize("experiment", [guiding.LATERAL, guiding.FRONT])
def test_guiding_needs_clearance_and_a_base_that_moves(experiment, robot, border_data):
    for bad in ({"min_clearance_m": 0.04}, {"base_displacement_m": 0.01}):
        runs = {**good_runs(), experiment: run(**bad)}
        assert not claims._guided(experiment)(sources_of(robot, border_data, runs)).holds


@pytest.mark.parametrize(("p99", "holds"), [(999.0, True), (1001.0, False)])
def test_the_control_rate_is_judged_by_the_slow_steps_not_by_the_median(p99, holds, monkeypatch):
    figures = {"step_p50_us": 100.0, "step_p99_us": p99}
    monkeypatch.setattr(claims.density, "run_at_50_000", lambda _: figures)
    assert claims._fast_enough(None).holds is holds


def test_what_is_missing_or_no_number_does_not_hold():
    for value in (None, float("nan"), float("inf")):
        assert not claims.at_least("x", "x_m", value, thresholds.CLEAR).holds
        assert not claims.at_most("x", "x_m", value, thresholds.CLEAR).holds
        assert claims.at_most("x", "x_m", value, thresholds.CLEAR).values == {"x_m": None}


def test_a_claim_of_several_parts_holds_only_with_all_of_them():
    yes = claims.at_least("x", "x_m", 0.06, thresholds.CLEAR)
    no = claims.at_least("y", "y_m", 0.04, thresholds.CLEAR)
    both = claims.all_of(yes, no)
    assert (yes.holds, no.holds, both.holds) == (True, False, False)
    assert both.values == {"x_m": 0.06, "y_m": 0.04}


def test_the_way_forward_is_along_the_first_heading():
    log = {
        "base_x_m": np.array([1.0, 1.0]),
        "base_y_m": np.array([0.0, 0.4]),
        "base_yaw_rad": np.array([np.pi / 2, 0.0]),
    }
    assert claims.forward_motion(Run({}, log)) == pytest.approx(0.4)


def test_a_jump_of_an_activation_is_seen_wherever_it_is():
    smooth = run(beta_step=0.002)
    assert claims.beta_step(smooth) == pytest.approx(0.002)
    smooth.log["beta_lm-l3"][70:] = 0.3
    assert claims.beta_step(smooth) == pytest.approx(0.3)


def test_claims_belong_to_figures_that_exist_and_come_with_them():
    assert {claim.figure for claim in CLAIMS} <= set(FIGURES)
    assert claims_of(FIGURES) == list(CLAIMS)
    assert claims_of(["fig10"]) == []
    assert {claim.figure for claim in claims_of(["fig12"])} == {"fig12"}


def test_thresholds_say_where_they_come_from():
    found = [x for x in vars(thresholds).values() if isinstance(x, thresholds.Threshold)]
    assert len(found) > 15
    assert all(len(threshold.source) > 15 for threshold in found)


def test_figures_of_a_real_run_have_what_the_claims_read(
    robot: RobotModel, border_data: BorderData
):
    from tests.reproduction import short_run

    real = short_run(robot, border_data, guiding.LATERAL, 0.1)
    needed = {key for key in GOOD if "door" not in key and "radial" not in key}
    assert needed - {"base_back_off_s"} <= set(real.figures)
    assert with_figures(real, contacts=3).figures["contacts"] == 3
