"""Limits of the arm in runs: joint speeds exceed their limits by at most 1 %."""

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
"""[rad] angle of the arc about the base's vertical axis, and [s] duration of the motion."""


def test_ordinary_arc_satisfies_joint_and_torque_rate_limits(
    robot: RobotModel, border_data: BorderData
) -> None:
    """The torques satisfy the equation of motion: none is cut off after the QP."""
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


def test_wrist_at_its_limit_keeps_its_target_while_the_base_moves_away() -> None:
    """A path around the base's corner (`python -m benchmarks.law paths --first 10 --count 1`)."""
    begin, end = (0.330713, 0.721916, 0.195174), (0.716204, 0.370628, 0.1)
    q_m = 1.544053, 1.588897, -0.028581, -0.811761, 0.042323, 2.400219, 0.0
    row = follow(Options(), Curve("arc", begin, end, (0.0, 0.0), 4.368467), q_m)
    assert row["error_max_mm"] < 1.0  # 8.7 if the base ignores the arm's limits
    assert row["least_distance_m"] > 0.05
    assert row["contact_steps"] == row["failures"] == 0


def test_accelerated_joint_of_a_tracking_arm_brakes_in_time() -> None:
    """A fast path onto the deck's edge (`python -m benchmarks.law paths --first 290 --count 1`).

    The torque rate limits how fast the shoulder can brake.
    """
    row = play_path(Tracking(Options(), 290))
    assert 0.98 < row["joint_speed_share"] <= 1.01  # 1.10 by bounds without the torque rate
    assert row["contact_steps"] == row["failures"] == 0


@pytest.mark.parametrize("number", [0, 8, 17])
def test_hard_pull_keeps_joint_speed_limits_if_torques_suffice(number: int) -> None:
    """The pulls are those of `python -m benchmarks.law pulls`."""
    (case,) = cases(Options(), 1, 1.5, number)[-1:]
    row = play(case)
    assert row["torque_share"] < 0.99
    assert 0.9 < row["joint_speed_share"] <= 1.01
    assert row["least_distance_m"] > 0.02


def test_encoder_noise_does_not_shake_a_tracking_arm(
    robot: RobotModel, border_data: BorderData
) -> None:
    """Torques that follow the noise would reach their rate limit and shake the joints."""
    config, speeds = Config().replace("disturbance.encoder_noise", 1e-3), []
    for seed in range(5):
        session = Session(robot, border_data, config, seed=seed)
        session.reset(np.array(robot.description.arm.ready_position))
        here = Reference(session.T_world_ee.copy(), np.zeros(6), np.zeros(6))
        steps = [session.step(reference=here) for _ in range(2000)][500:]
        session.close()
        speeds.append(max((np.abs(s.truth.qd_m) / robot.qd_max).max() for s in steps))
        assert max(s.ee_error for s in steps) < 2e-3
    assert np.median(speeds) < 0.35  # 0.9 with a filter that follows this noise
