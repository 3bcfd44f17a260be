"""Claims hold with good figures and fail with bad ones; each has its threshold and its runs."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from app.border.cache import BorderData
from app.robot.model import RobotModel
from app.simulation.run import RunResult
from app.studies.paper import claims
from app.studies.paper.claims import CLAIMS, DIRECTIONS, Claim, claims_of
from app.studies.paper.experiments import (
    AS_PRINTED,
    DOOR,
    DOOR_NONE,
    FRONT,
    GUIDING,
    LATERAL,
    TRACKING,
    TRACKING_REPULSIVE,
    Experiment,
)
from app.studies.paper.report import FIGURES
from tests.reproduction import sources_of, with_figures

MEASURED_APART = {"density"}  # claims about these figures need their own measurements
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


class Log(dict[str, np.ndarray]):
    """Some columns of a trace, including the base's pose."""

    def of(self, quantity: str) -> np.ndarray:
        assert quantity == "base_pose"
        return np.column_stack([self[k] for k in ("base_x_m", "base_y_m", "base_yaw_rad")])


def run(
    back: float = 0.3, turn: float = -0.2, beta_step: float = 0.001, **figures: Any
) -> RunResult:
    """A run whose base moves straight back and turns, with these figures."""
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
    return RunResult({**GOOD, **figures}, Log(log))


def good_runs() -> dict[Experiment, RunResult]:
    """Artificial results of all runs: the claims of `JUDGED` hold for them."""
    runs = {e: run() for claim in CLAIMS for e in claim.needs}
    runs[TRACKING_REPULSIVE] = run(ee_error_final_m=0.1, torque_jump_max_nm=1.0)
    runs[DOOR_NONE] = run(door_met_base_s=30.0)
    return runs


JUDGED = [claim for claim in CLAIMS if claim.figure not in MEASURED_APART]


@pytest.mark.parametrize("claim", JUDGED, ids=lambda claim: claim.paper[:40])
def test_every_claim_holds_with_good_figures(claim: Claim, robot, border_data):
    row = claim.judge(sources_of(robot, border_data, good_runs()))
    assert row["holds"], row["measured"]
    assert row["limits"]


@pytest.mark.parametrize(
    ("experiment", "bad", "fails"),
    [
        (TRACKING, {"ee_error_final_m": 0.0011}, claims.reached),
        (TRACKING, {"min_clearance_m": 0.049}, claims.reached),
        (TRACKING, {"back": 0.01}, claims.moved_back),
        (TRACKING, {"back": -0.3}, claims.moved_back),
        (TRACKING_REPULSIVE, {"ee_error_final_m": 0.019}, claims.not_reached),
        (
            TRACKING_REPULSIVE,
            {"ee_error_final_m": 0.1, "min_clearance_m": 0.029},
            claims.not_reached,
        ),
        (AS_PRINTED[0], {"ee_error_final_m": 0.0011}, claims.reached_as_printed),
        (AS_PRINTED[0], {"back": 0.01}, claims.reached_as_printed),
        (AS_PRINTED[3], {"min_clearance_m": 0.029}, claims.guided_as_printed),
        (FRONT, {"back": 0.0}, claims.guided_back),
        (LATERAL, {"beta_step": 0.06}, claims.continuous),
        (FRONT, {"beta_step": 0.06}, claims.continuous),
        (TRACKING, {"torque_jump_max_nm": 0.11}, claims.smoother_than_repulsive),
        (TRACKING_REPULSIVE, {"torque_jump_max_nm": 0.09}, claims.smoother_than_repulsive),
        *(
            (e, {"base_displacement_m": 0.0}, claims.from_any_direction)
            for e in DIRECTIONS.values()
        ),
        *((e, {"min_clearance_m": 0.0}, claims.from_any_direction) for e in DIRECTIONS.values()),
        *(
            (e, {"ee_error_final_m": 0.055}, claims.from_any_direction)
            for e in DIRECTIONS.values()
            if e.scenario.name == "tracking"
        ),
        (DOOR_NONE, {"door_met_base_s": 36.0}, claims.door_met),
        (DOOR_NONE, {"door_met_base_s": 24.0}, claims.door_met),
        (DOOR_NONE, {"door_met_base_s": None}, claims.door_met),
        (DOOR, {"door_met_base_s": 30.0}, claims.door_avoided),
        (DOOR, {"door_min_distance_m": 0.01}, claims.door_avoided),
        (DOOR, {"door_opened_80deg_at_s": None}, claims.door_opened),
        (DOOR, {"door_opened_80deg_at_s": 41.0}, claims.door_opened),
        (DOOR, {"base_back_off_s": None}, claims.base_backs_off),
        (DOOR, {"base_back_off_s": 5.0}, claims.base_backs_off),
        (DOOR, {"turn": 0.2}, claims.base_backs_off),
        (DOOR, {"back": -0.3}, claims.base_backs_off),
        (DOOR, {"radial_error_at_5s_rad": -0.1}, claims.incomplete_knowledge),
        (DOOR, {"radial_error_at_5s_rad": 0.1}, claims.incomplete_knowledge),
        (DOOR, {"hand_force_max_n": 51.0}, claims.incomplete_knowledge),
    ],
)
def test_claim_does_not_hold_with_a_bad_figure(experiment, bad, fails, robot, border_data):
    runs = {**good_runs(), experiment: run(**bad)}
    assert not fails.judge(sources_of(robot, border_data, runs))["holds"]


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
def test_smooth_requires_few_sign_changes_and_small_jumps(
    method, bad, direction, robot, border_data
):
    runs = {**good_runs(), GUIDING[method][direction]: run(**bad)}
    sources = sources_of(robot, border_data, runs)
    judged = {"dbb": claims.smooth_on_the_surface, "points": claims.smooth_on_points}
    held = {name: claim.judge(sources)["holds"] for name, claim in judged.items()}
    assert held == {name: name != method for name in judged}


@pytest.mark.parametrize(
    ("experiment", "claim"),
    [(LATERAL, claims.guided_laterally), (FRONT, claims.guided_from_the_front)],
)
def test_guiding_claim_requires_clearance_and_base_motion(experiment, claim, robot, border_data):
    for bad in ({"min_clearance_m": 0.04}, {"base_displacement_m": 0.01}):
        runs = {**good_runs(), experiment: run(**bad)}
        assert not claim.judge(sources_of(robot, border_data, runs))["holds"]


@pytest.mark.parametrize(("p99", "holds"), [(999.0, True), (1001.0, False)])
def test_control_rate_is_judged_by_the_99th_percentile(p99, holds, monkeypatch):
    figures = {"step_p50_us": 100.0, "step_p99_us": p99}
    monkeypatch.setattr(claims.density, "run_at_50_000", lambda _: figures)
    assert claims.fast_enough.judge(None)["holds"] is holds


def test_missing_or_infinite_value_does_not_hold():
    for value in (None, float("nan"), float("inf")):
        for bound in ({"low": claims.CLEAR}, {"high": claims.CLEAR}):
            finding = claims.compare("x", "x_m", value, **bound)
            assert (finding.holds, finding.values) == (False, {"x_m": None})


def test_claim_with_several_parts_holds_only_with_all_of_them():
    yes = claims.compare("x", "x_m", 0.06, low=claims.CLEAR)
    no = claims.compare("y", "y_m", 0.04, low=claims.CLEAR)
    assert (yes.holds, no.holds) == (True, False)
    for findings in ((yes, no), (no, yes), (yes, yes)):
        row = Claim("1", "fig3", "", (), lambda _, found=findings: found).judge(None)
        assert row["holds"] is (no not in findings)
        assert row["values"] == {key: v for f in findings for key, v in f.values.items()}


@pytest.mark.parametrize(("value", "holds"), [(24.9, False), (25.0, True), (35.1, False)])
def test_value_with_two_bounds_holds_only_between_them(value, holds):
    finding = claims.compare("x", "x_s", value, low=claims.MET_FROM, high=claims.MET_TO)
    assert finding.holds is holds
    assert finding.measured.endswith("(required: 25 to 35 s)")


def test_forward_motion_is_measured_along_the_initial_heading():
    log = {
        "base_x_m": np.array([1.0, 1.0]),
        "base_y_m": np.array([0.0, 0.4]),
        "base_yaw_rad": np.array([np.pi / 2, 0.0]),
    }
    (backward,) = claims._back(RunResult({}, Log(log))).values.values()
    assert backward == pytest.approx(-0.4)


def test_jump_of_any_activation_is_detected():
    smooth = run(beta_step=0.002)
    assert claims.beta_step(smooth) == pytest.approx(0.002)
    smooth.trace["beta_lm-l3"][70:] = 0.3
    assert claims.beta_step(smooth) == pytest.approx(0.3)


def test_claims_are_selected_with_their_figures():
    assert {claim.figure for claim in CLAIMS} <= set(FIGURES)
    assert claims_of(FIGURES) == CLAIMS
    assert claims_of(["fig10"]) == []
    assert {claim.figure for claim in claims_of(["fig12"])} == {"fig12"}


def test_thresholds_state_their_source():
    found = [x for x in vars(claims).values() if isinstance(x, claims.Threshold)]
    assert len(found) > 15
    assert all(len(threshold.source) > 15 for threshold in found)


def test_figures_of_a_real_run_contain_all_that_claims_read(
    robot: RobotModel, border_data: BorderData
):
    from tests.reproduction import short_run

    real = short_run(robot, border_data, LATERAL, 0.1)
    needed = {key for key in GOOD if "door" not in key and "radial" not in key}
    assert needed - {"base_back_off_s"} <= set(real.figures)
    assert with_figures(real, contacts=3).figures["contacts"] == 3
