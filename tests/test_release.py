"""After a release inside the buffer, the base comes to rest nearby."""

from __future__ import annotations

import numpy as np
import pytest

from app.border.cache import BorderData
from app.config import Config
from app.robot.model import RobotModel
from app.simulation.scenarios.start import StartSolver
from app.simulation.session import DT, Session

pytestmark = pytest.mark.slow

START, MOVE = np.array([0.95, 0.0, 0.35]), np.array([-0.30, 0.0, 0.0])
"""[m] in front of the base, towards it; the front is at x = 0.49."""


def after_release(robot: RobotModel, data: BorderData, config: Config) -> tuple[float, float]:
    """[m] path of the base after the release, and [m/s] its speed 10 s later."""
    q_m = StartSolver(robot, data.pairs, config.border.d_b).solve(tuple(START.tolist()))
    session = Session(robot, data, config)
    session.reset(q_m)
    for s in np.linspace(0.0, 1.0, round(2.0 / DT)):
        step = session.step(pull=START + s * s * (3 - 2 * s) * MOVE)
    assert step.control.beta_m > 0.1  # the release is inside the buffer
    path = speed = 0.0
    for _ in range(round(10.0 / DT)):
        speed = abs(float(session.step().measurement.base_velocity[0]))
        path += speed * DT
    session.close()
    return path, speed


def test_base_comes_to_rest_within_0_3_m_after_a_release_in_front(
    robot: RobotModel, border_data: BorderData
) -> None:
    """Without the reaction on the arm it would continue to move."""
    path, speed = after_release(robot, border_data, Config())
    assert path <= 0.3
    assert speed < 1e-3
    path, speed = after_release(robot, border_data, Config().replace("force.f_arm", 0.0))
    assert path > 0.6
    assert speed > 0.02
