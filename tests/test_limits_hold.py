"""Limits of the arm hold in runs: velocities to 1 %, and a base that was pushed comes to rest."""

from __future__ import annotations

import numpy as np
import pytest

from app.border.cache import BorderData
from app.config import Config
from app.control.tasks import Reference
from app.robot.model import RobotModel
from app.simulation.session import DT, Session

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
        m, u_a, workings = step.measurement, step.output.u_a, step.output.workings
        fastest = max(fastest, float((np.abs(m.qd_m) / robot.qd_max).max()))
        assert (m.q_m > robot.q_lower - 1e-3).all()
        assert (m.q_m < robot.q_upper + 1e-3).all()
        assert workings is not None
        state = session.controller.state
        assert np.abs(state.M[2:] @ workings.qdd + state.h[2:] - u_a).max() < 1e-5
        if last is not None:
            assert np.abs(u_a - last).max() <= Config().limit.torque_rate * DT + 1e-6
        last = u_a
    session.close()
    assert 0.05 < fastest <= 1.01
