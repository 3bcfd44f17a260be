"""A sweep loses no run, shares its starts and does not depend on the number of processes."""

from __future__ import annotations

import json
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from app.border.cache import BorderData
from app.config import Config
from app.robot.model import RobotModel
from app.simulation.run import run_from_spec
from app.studies.sweep.plan import Approach, Kind, Start, SweepPlan
from app.studies.sweep.sweep import StartFinder, arrival, passes, sweep
from benchmarks.robots import GUIDED_LIMIT

pytestmark = pytest.mark.slow

QUICK = SweepPlan(
    controllers=("dbb", "none"),
    speeds=(0.4,),
    step=90.0,
    wheel_axis=False,
    length=0.04,
    hold=0.1,
    physics="kinematic",
)
GOOD: dict[str, Any] = {
    "ee_error_final_m": 1e-4,
    "min_clearance_m": 0.1,
    "contacts": 0,
    "arm_contacts": 0,
    "solver_failures": 0,
}


@pytest.fixture(scope="module")
def shares() -> list[float]:
    """[-] The finished shares that `quick` reports."""
    return []


@pytest.fixture(scope="module")
def quick(shares: list[float]) -> dict[str, Any]:
    return sweep(QUICK, on_progress=shares.append)


def test_every_direction_is_unreachable_or_run_in_all_combinations(quick) -> None:
    closed = {row["direction_deg"] for row in quick["unreachable"]}
    assert closed >= {180.0}
    runs = [(r["controller"], r["speed_mps"], r["direction_deg"]) for r in quick["paths"]]
    open_ = {0.0, 90.0, 180.0, 270.0} - closed
    assert sorted(runs) == sorted(
        (c, v, d) for c in QUICK.controllers for v in QUICK.speeds for d in open_
    )
    for kinds in quick["summary"].values():
        assert kinds["paths"]["unreachable"] == len(closed)
        assert kinds["paths"]["unreachable_share"] == len(closed) / 4
        assert kinds["paths"]["runs"] == len(open_)


def test_one_and_two_processes_give_the_same_result(quick) -> None:
    again = sweep(QUICK, processes=2)
    assert {**again, "elapsed_s": 0} == {**quick, "elapsed_s": 0}


def test_all_runs_of_a_direction_start_at_the_same_place(quick) -> None:
    for direction in (0.0, 90.0, 270.0):
        rows = [r for r in quick["paths"] if r["direction_deg"] == direction]
        assert len({(r["start_x_m"], r["start_y_m"], r["start_z_m"]) for r in rows}) == 1


def test_the_summary_has_the_worst_values_of_its_rows(quick) -> None:
    rows = [r for r in quick["paths"] if r["controller"] == "dbb"]
    found = quick["summary"]["dbb"]["paths"]
    assert found["ee_error_final_max_m"] == max(r["ee_error_final_m"] for r in rows)
    assert found["min_clearance_m"] == min(r["min_clearance_m"] for r in rows)
    assert found["passed"] == sum(r["passed"] for r in rows)


def test_keys_of_quantities_end_in_their_unit_and_the_result_is_json(quick) -> None:
    plain = {
        "controller",
        "contacts",
        "arm_contacts",
        "floor_contacts",
        "activation_max",
        "solver_failures",
        "passed",
    }
    for row in quick["paths"]:
        assert all(k.endswith(("_m", "_mps", "_deg", "_s", "_rad")) for k in row.keys() - plain)
    assert json.loads(json.dumps(quick, allow_nan=False)) == quick


def test_progress_rises_to_one(quick, shares: list[float]) -> None:
    assert shares == sorted(shares)
    assert (shares[0] > 0.0, shares[-1]) == (True, 1.0)


@pytest.mark.parametrize(("weight", "moves"), [(300.0, False), (1.0, True)])
def test_on_the_wheel_axis_a_barrier_moves_only_a_base_of_low_weight(
    robot: RobotModel, border_data: BorderData, weight: float, moves: bool
) -> None:
    config = Config().replace("task.base_weight", weight)
    plan = replace(QUICK, length=0.16, hold=0.2, config=config)
    start = StartFinder(robot, border_data, config.border.d_b).find(
        Approach("wheel_axis", 0.3, 90.0), plan.distance
    )
    found = run_from_spec(plan.spec(start, "barrier", 0.16), robot, border_data)
    displacement = found.figures["base_displacement_m"]
    assert isinstance(displacement, float)
    assert (displacement > 0.008) == moves


@pytest.mark.parametrize(
    ("kind", "direction_deg", "speed", "hold"),
    [("side", 60.0, 0.4, 2.0), ("side", 270.0, 0.4, 2.0), ("wheel_axis", 270.0, 0.1, 3.0)],
)
def test_a_fast_target_close_above_the_deck_is_reached_in_time(
    robot: RobotModel,
    border_data: BorderData,
    kind: Kind,
    direction_deg: float,
    speed: float,
    hold: float,
) -> None:
    """With a base that is too slow, links above the end-effector would enter their buffers.

    On the wheel axis, the end-effector passes the base's edge, where the normal is partly vertical,
    so the force on the base is smaller.
    """
    plan = replace(QUICK, length=0.2, hold=hold)
    start = StartFinder(robot, border_data, plan.config.border.d_b).find(
        Approach(kind, 0.45, direction_deg), plan.distance
    )
    found = run_from_spec(plan.spec(start, "dbb", speed), robot, border_data).figures
    assert found["ee_error_final_m"] < 1e-4


def test_each_start_runs_once_with_each_controller_and_speed() -> None:
    plan = replace(QUICK, speeds=(0.2, 0.4))
    starts = [Start(Approach("side", 0.3, d), reason="far" * (d == 180.0)) for d in (0.0, 180.0)]
    trials = list(plan.trials(starts))
    assert len(set(trials)) == len(trials) == 4
    assert {start.approach.direction_deg for start, *_ in trials} == {0.0}


def test_the_scenario_of_a_run_has_the_mode_and_speed_of_the_plan() -> None:
    start = Start(Approach("side", 0.3, 90.0), (0.0,) * 7, (0.0, 0.6, 0.3))
    for mode in ("tracking", "guiding"):
        scenario = replace(QUICK, mode=mode).spec(start, "dbb", 0.2).scenario
        assert scenario.mode == mode
        np.testing.assert_allclose(scenario.move, (0.0, -0.04, 0.0), atol=1e-12)
        assert scenario.duration * scenario.moving == pytest.approx(0.2)
        assert scenario.duration == pytest.approx(0.3)


def test_the_start_distance_is_outside_any_buffer_by_default() -> None:
    config = Config().replace("border.d_b", 0.1)
    assert replace(QUICK, config=config).distance == pytest.approx(0.12)
    assert replace(QUICK, start_distance=0.2).distance == 0.2


def test_arrival_is_when_the_error_stays_within_a_millimetre() -> None:
    t = np.array([0.0, 1.0, 2.0, 3.0])
    assert arrival(t, np.array([0.1, 5e-4, 0.002, 5e-4])) == 3.0
    assert arrival(t, np.array([0.1, 5e-4, 5e-4, 1e-3])) == 1.0
    assert arrival(t, np.array([0.1, 0.0, 0.0, 0.0011])) is None
    assert arrival(t, np.zeros(4)) == 0.0


@pytest.mark.parametrize(
    "fault",
    [
        {"ee_error_final_m": 0.0011},
        {"min_clearance_m": 0.029},
        {"min_clearance_m": None},
        {"contacts": 1},
        {"arm_contacts": 1},
        {"solver_failures": 1},
    ],
)
def test_any_single_fault_fails_a_path(fault: dict[str, Any]) -> None:
    assert passes(GOOD)
    assert not passes(GOOD | fault)


def test_a_guided_end_effector_may_have_a_larger_error() -> None:
    off = GOOD | {"ee_error_final_m": GUIDED_LIMIT}
    assert passes(off, GUIDED_LIMIT)
    assert not passes(off)
