"""Warnings if the arm cannot hold its end-effector or a person can push it into the base."""

from __future__ import annotations

import numpy as np
import pytest

from app.border.cache import BorderData
from app.onboarding.check import holding_row, push_row
from app.onboarding.warn import borne_push, carried_ee, holding_warning, lost_ee
from app.robot.assets import package_roots
from app.robot.description import load_robot
from app.robot.model import RobotModel
from tests.robots import husky_panda


def at_speeds(factor: float) -> RobotModel:
    """The paper's robot with its joint speed limits times `factor`."""
    description = husky_panda().description
    speeds = tuple(float(factor * v) for v in husky_panda().qd_max)
    arm = description.arm.model_copy(update={"max_velocity": speeds})
    return RobotModel(description.model_copy(update={"arm": arm}))


def test_stretch_gets_a_warning_for_forward_motion() -> None:
    if not package_roots("stretch_urdf"):
        pytest.skip("pip install '.[robots]'")
    row = holding_row(RobotModel(load_robot("stretch_se3")))
    assert row.outcome == "warned"
    for stated in ("forward", "0.5 m/s", "100% of the postures"):
        assert stated in row.text
    assert row.numbers["place_lost_v_share"] > 0.9


def test_the_papers_robot_gets_no_warning() -> None:
    row = holding_row(husky_panda())
    assert row.outcome == "passed"
    assert not holding_warning(carried_ee(husky_panda()))
    assert row.numbers["place_lost_v_share"] < 0.1
    assert row.numbers["place_lost_w_share"] < 0.1


def test_check_warns_if_a_person_can_push_the_arm_into_the_base(
    border_data: BorderData,
) -> None:
    """A Panda with 30 % of its torque limits gets the warning; with its own limits it gets none."""
    strong, pairs = husky_panda(), border_data.pairs.mobile
    row = push_row(strong, border_data)
    assert row.outcome == "passed"
    assert row.numbers["least_push_borne_n"] > 40.0
    arm = strong.description.arm.model_copy(
        update={"max_effort": tuple((0.3 * strong.tau_max).tolist())}
    )
    weak = RobotModel(strong.description.model_copy(update={"arm": arm}))
    row = push_row(weak, border_data)
    assert row.outcome == "warned"
    assert "40 N" in row.text
    assert (borne_push(weak, pairs) <= borne_push(strong, pairs)).all()


def test_lost_poses_exceed_lost_positions_and_fall_with_joint_speed() -> None:
    slow, same, fast = (carried_ee(at_speeds(f)) for f in (0.05, 1.0, 100.0))
    for each in (*slow, *same, *fast):
        assert each.place <= each.pose
    for a, b, c in zip(slow, same, fast, strict=True):
        assert a.place >= b.place >= c.place
        assert a.pose >= b.pose >= c.pose
    assert slow[0].place == 1.0
    assert fast[0].place == 0.0


def test_the_warning_names_only_the_axes_that_are_often_lost() -> None:
    text = holding_warning(carried_ee(at_speeds(0.05)))
    assert "moves forward at 0.5 m/s" in text
    assert "turns at 1 rad/s" in text
    lost, kept = (carried_ee(at_speeds(f)) for f in (0.05, 1.0))
    one = holding_warning((lost[0], kept[1]))
    assert "moves forward" in one
    assert "turns" not in one


FAST = np.full(6, 10.0)


def test_yaw_of_the_base_loses_no_position_on_the_yaw_axis() -> None:
    turning = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 1.0])
    stiff, free = np.zeros((6, 6)), np.eye(6)
    assert lost_ee(stiff, turning, FAST) == (False, True)
    assert lost_ee(free, turning, FAST) == (False, False)
    assert lost_ee(stiff, np.zeros(6), FAST) == (False, False)


@pytest.mark.parametrize(("joint", "lost"), [(0, (True, True)), (5, (False, True))])
def test_only_a_direction_that_no_joint_moves_is_lost(joint: int, lost: tuple[bool, bool]) -> None:
    moved = np.array([0.5, 0.0, 0.0, 0.0, 0.0, 1.0])
    J = np.eye(6)
    J[joint, joint] = 0.0
    assert lost_ee(J, moved, FAST) == lost
    assert lost_ee(np.eye(6), moved, FAST) == (False, False)


@pytest.mark.parametrize("speed", [0.85, 0.95])
def test_only_a_residual_above_ten_percent_is_lost(speed: float) -> None:
    along = np.array([1.0, 0.0, 0.0, 0.0, 0.0, 0.0])
    assert lost_ee(np.eye(6), along, np.full(6, speed)) == (speed < 0.9, speed < 0.9)
    turning = along[[3, 4, 5, 0, 1, 2]]
    assert lost_ee(np.eye(6), turning, np.full(6, speed)) == (False, speed < 0.9)


def test_a_position_held_by_turning_the_end_effector_loses_only_the_pose() -> None:
    J = np.zeros((6, 1))
    J[0, 0], J[5, 0] = 0.5, 1.0  # a lever of half a metre
    moved = np.array([0.5, 0.0, 0.0, 0.0, 0.0, 0.0])
    assert lost_ee(J, moved, FAST[:1]) == (False, True)


@pytest.mark.parametrize("seed", range(20))
def test_a_lost_position_implies_a_lost_pose(seed: int) -> None:
    rng = np.random.default_rng(seed)
    J, moved = rng.normal(size=(6, 7)), rng.normal(size=6)
    for speed in (0.01, 0.1, 0.3, 1.0, 10.0):
        place, pose = lost_ee(J, moved, np.full(7, speed))
        assert pose or not place
