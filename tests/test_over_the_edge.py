"""An end-effector guided over the base's edge to its side and back: no jump, no contact."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from app.border.cache import BorderData
from app.config import Config
from app.robot.model import RobotModel
from app.simulation.scenarios.start import StartSolver
from app.simulation.session import DT, Session, Step
from tests.steps import kept

pytestmark = pytest.mark.slow

ABOVE, OUT, DOWN = (-0.10, 0.20, 0.60), (0.05, 0.60, 0.52), (0.15, 0.53, 0.28)
"""[m] Points above the deck, beside its edge, and at the side inside the buffer. At the start the
base is at the origin facing +x, its side at y = 0.345 and its top at z = 0.38.
"""
LEG = 2.0  # [s] from one point to the next


@pytest.fixture(scope="module")
def steps(robot: RobotModel, border_data: BorderData) -> list[Step]:
    """Steps of a pull over the edge, down to the side, and back on the same path."""
    places = [np.array(place) for place in (ABOVE, OUT, DOWN, OUT, ABOVE)]
    q_m = StartSolver(robot, border_data.pairs, Config().border.d_b).solve(tuple(places[0]))
    session = Session(robot, border_data, Config())
    session.reset(q_m)
    ways = [(a, b, s) for a, b in pairwise(places) for s in np.linspace(0, 1, round(LEG / DT))]
    taken = [kept(session.step(pull=a + s * s * (3 - 2 * s) * (b - a))) for a, b, s in ways]
    session.close()
    return taken


def test_no_contact_and_every_qp_has_a_solution(steps):
    assert not any(any(step.contacts) or not step.control.solved for step in steps)
    least = min(min(step.distances[:2]) for step in steps)
    assert least > 0.95 * Config().barrier.d_min  # the barrier is soft


def test_normal_turns_from_vertical_to_horizontal(steps):
    """This verifies that the path leads over the edge inside the buffer."""
    nearest = [(w := step.control, int(w.d[: w.n_mob].argmin())) for step in steps]
    inside = np.array([w.normal[i, 2] for w, i in nearest if w.beta[i] > 0.0])
    assert inside.min() < 0.7
    assert inside.max() > 0.8


def test_torques_and_base_acceleration_do_not_jump(steps):
    """Torques stay below their rate limit, which would hide a jump."""
    for before, after in pairwise(steps):
        jump = np.abs(after.control.u_cmd - before.control.u_cmd).max()
        assert jump < 0.75 * Config().limit.torque_rate * DT
        jump = after.control.a_base_cmd - before.control.a_base_cmd
        assert np.abs(jump).max() < 0.1
