"""Limits of the arm hold in runs: velocities to 1 %, and a base that was pushed comes to rest."""

from __future__ import annotations

import numpy as np
import pytest

from app.border.cache import BorderData
from app.config import Config
from app.control.tasks import Reference
from app.robot.model import RobotModel
from app.simulation.session import DT, Session
from benchmarks.law.curves import Curve
from benchmarks.law.options import Options
from benchmarks.law.paths import Tracking, follow
from benchmarks.law.paths import play as play_path
from benchmarks.law.pulls import cases, play

pytestmark = pytest.mark.slow

ARC, TIME = 1.4, 7.0
"""[rad] about the base's vertical axis, [s] that the hand takes for it."""


def test_no_joint_leaves_its_velocity_or_position_limit_on_an_ordinary_arc(
    robot: RobotModel, border_data: BorderData
) -> None:
    """Nor does a torque change faster than its rate, with nothing cut off after the QP."""
    session = Session(robot, border_data, Config())
    session.reset(np.array(robot.description.arm.ready_position))
    begin = session.T_world_ee.copy()
    radius, fastest, last = begin.translation[:2].copy(), 0.0, None
    for k in range(round((TIME + 0.5) / DT)):
        s = min(k * DT / TIME, 1.0)
        angle = ARC * s * s * (3 - 2 * s)
        turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
        pose = begin.copy()
        pose.translation = np.array([*(turn @ radius), begin.translation[2]])
        step = session.step(reference=Reference(pose, np.zeros(6), np.zeros(6)))
        m, w, u_a = step.measurement, step.control, step.control.u_cmd.copy()
        fastest = max(fastest, float((np.abs(m.qd_m) / robot.qd_max).max()))
        assert (m.q_m > robot.q_lower - 1e-3).all()
        assert (m.q_m < robot.q_upper + 1e-3).all()
        assert np.abs(w.M[2:] @ w.qdd + w.h[2:] - u_a).max() < 1e-5
        if last is not None:
            assert np.abs(u_a - last).max() <= Config().limit.torque_rate * DT + 1e-6
        last = u_a
    session.close()
    assert 0.05 < fastest <= 1.01


def test_a_wrist_that_comes_to_its_limit_while_the_base_makes_room_keeps_to_its_target() -> None:
    """A curve around the base's corner (`python -m benchmarks.law paths --first 10 --count 1`)."""
    begin, end = (0.330713, 0.721916, 0.195174), (0.716204, 0.370628, 0.1)
    q_m = 1.544053, 1.588897, -0.028581, -0.811761, 0.042323, 2.400219, 0.0
    row = follow(Options(), Curve("arc", begin, end, (0.0, 0.0), 4.368467), q_m)
    assert row["error_max_mm"] < 1.0  # 8.7 if the base looks at its rows alone
    assert row["least_distance_m"] > 0.05
    assert row["contact_steps"] == row["failures"] == 0


def test_a_joint_that_a_tracking_arm_throws_aside_stops_gaining_speed_in_time() -> None:
    """A fast curve onto the deck's edge (`python -m benchmarks.law paths --first 290 --count 1`).

    Its shoulder gains speed by torques that change at their rate, and cannot lose it any faster.
    """
    row = play_path(Tracking(Options(), 290))
    assert 0.98 < row["joint_speed_share"] <= 1.01  # 1.10 by bounds that know no rate
    assert row["contact_steps"] == row["failures"] == 0


@pytest.mark.parametrize("number", [0, 8, 17])
def test_a_hard_pull_takes_no_joint_beyond_its_speed_where_torques_suffice(number: int) -> None:
    """As `python -m benchmarks.law pulls` pulls; it took them to 1.5 of it."""
    (case,) = cases(Options(), 1, 1.5, number)[-1:]
    row = play(case)
    assert row["torque_share"] < 0.99
    assert 0.9 < row["joint_speed_share"] <= 1.01
    assert row["least_distance_m"] > 0.02


def test_noise_of_encoders_does_not_shake_an_arm_that_tracks(
    robot: RobotModel, border_data: BorderData
) -> None:
    """Torques that follow each reading hit their rate limit, and joints swing at top speed."""
    session = Session(robot, border_data, Config().replace("disturbance.encoder_noise", 1e-3))
    session.reset(np.array(robot.description.arm.ready_position))
    here = Reference(session.T_world_ee.copy(), np.zeros(6), np.zeros(6))
    steps = [session.step(reference=here) for _ in range(2000)][500:]
    session.close()
    assert max((np.abs(s.truth.qd_m) / robot.qd_max).max() for s in steps) < 0.2  # it was 0.9
    assert max(s.ee_error for s in steps) < 2e-3
