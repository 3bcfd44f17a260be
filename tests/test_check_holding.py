"""The warning that the arm cannot hold its hand while the base moves."""

from __future__ import annotations

import pytest

from app.onboarding.check_holding import carried_hand, holding_row, holding_warning
from app.robot.assets import load_robot, package_roots
from app.robot.model import RobotModel
from tests.robots import husky_panda


def at_speeds(factor: float) -> RobotModel:
    """The paper's robot with joints as many times as fast."""
    description = husky_panda().description
    speeds = tuple(float(factor * v) for v in husky_panda().qd_max)
    arm = description.arm.model_copy(update={"max_velocity": speeds})
    return RobotModel(description.model_copy(update={"arm": arm}))


def test_stretch_is_warned_of_along_its_wheels() -> None:
    if not package_roots("stretch_urdf"):
        pytest.skip("pip install '.[robots]'")
    row = holding_row(RobotModel(load_robot("stretch_se3")))
    assert row.outcome == "warned"
    assert "while the base moves forward at 0.5 m/s (in 100% of poses" in row.text
    assert row.numbers["place_lost_v_share"] > 0.9


def test_the_papers_robot_is_not() -> None:
    row = holding_row(husky_panda())
    assert row.outcome == "passed"
    assert not holding_warning(carried_hand(husky_panda()))
    assert row.numbers["place_lost_v_share"] < 0.1
    assert row.numbers["place_lost_w_share"] < 0.1


def test_to_hold_place_and_orientation_is_never_easier_and_a_faster_arm_never_holds_less() -> None:
    slow, same, fast = (carried_hand(at_speeds(f)) for f in (0.05, 1.0, 100.0))
    for each in (*slow, *same, *fast):
        assert each.place <= each.pose
    for a, b, c in zip(slow, same, fast, strict=True):
        assert a.place >= b.place >= c.place
        assert a.pose >= b.pose >= c.pose
    assert slow[0].place == 1.0
    assert fast[0].place == 0.0


def test_the_sentence_names_each_axis_that_is_often_lost_and_no_other() -> None:
    told = holding_warning(carried_hand(at_speeds(0.05)))
    assert "moves forward at 0.5 m/s" in told
    assert "turns at 1 rad/s" in told
    lost, kept = (carried_hand(at_speeds(f)) for f in (0.05, 1.0))
    one = holding_warning((lost[0], kept[1]))
    assert "moves forward" in one
    assert "turns" not in one
