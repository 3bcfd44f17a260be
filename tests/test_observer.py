"""Laws of the observer of pushes, and of the distance that is kept against one."""

from __future__ import annotations

import numpy as np
import pytest

from app.border.cache import BorderData
from app.config import Config
from app.control.controller import Controller
from app.control.limits import PushObserver
from app.robot.model import RobotModel
from app.robot.state import Measurement, RobotState, at_rest
from app.simulation.scenarios.start import StartSolver

Array = np.ndarray

DT, RATE = 1e-3, Config().limit.push_rate


class Pushed:
    """An arm that torques and a push move, its base at rest, by its own equation of motion."""

    def __init__(self, robot: RobotModel, q_m: Array) -> None:
        self.state = RobotState(robot)
        self.measurement = at_rest(robot, q_m)
        self.state.update(self.measurement)

    def move(self, u_a: Array, push: Array) -> None:
        """One period under torques and the push's (7,) [N m]."""
        state, m = self.state, self.measurement
        qdd = np.linalg.solve(state.M[2:, 2:], u_a + push - state.h[2:])
        qd = m.qd_m + DT * qdd
        self.measurement = Measurement(m.base_pose, np.zeros(2), m.q_m + DT * qd, qd)
        state.update(self.measurement)

    def torques_of(self, force: Array) -> Array:
        """(7,) [N m] that a force [N] on the hand makes."""
        return self.state.J_ee[:3, 2:].T @ force


def test_where_nobody_pushes_it_learns_nothing_however_the_arm_moves(robot: RobotModel) -> None:
    arm = Pushed(robot, np.array(robot.description.arm.ready_position))
    observer, rng, largest = PushObserver(robot.n_m), np.random.default_rng(0), 0.0
    observer.update(arm.state, arm.state.g[2:], RATE, DT)
    for k in range(300):
        u_a = arm.state.g[2:] + 3.0 * np.sin(0.02 * k + rng.permutation(7))
        arm.move(u_a, np.zeros(7))
        observer.update(arm.state, u_a, RATE, DT)
        largest = max(largest, float(np.abs(observer.r).max()))
    assert np.abs(arm.measurement.qd_m).max() > 0.05
    assert largest < 0.3


def test_a_constant_push_is_learnt_at_its_rate(robot: RobotModel) -> None:
    arm = Pushed(robot, np.array(robot.description.arm.ready_position))
    push = arm.state.M[2:, 2:] @ np.array([1.0, -2.0, 1.0, 2.0, -1.0, 1.5, -1.0])
    observer, errors = PushObserver(robot.n_m), []
    observer.update(arm.state, arm.state.h[2:], RATE, DT)
    for after in range(1, 151):
        u_a = arm.state.h[2:].copy()
        arm.move(u_a, push)
        observer.update(arm.state, u_a, RATE, DT)
        errors.append(observer.r - push * (1.0 - np.exp(-RATE * DT * after)))
    assert np.abs(errors).max() < 0.1 * np.abs(push).max()
    assert np.abs(observer.r - push).max() < 0.1 * np.abs(push).max()


@pytest.mark.parametrize("dt", [0.001, 0.01, 0.1])
def test_however_slow_a_loop_is_a_push_is_learnt_and_not_overshot(
    robot: RobotModel, dt: float
) -> None:
    """An arm that a push cannot move, whose observer learns at the greatest rate."""
    state, push = RobotState(robot), np.array([1.0, -2.0, 1.0, 2.0, -1.0, 1.5, -1.0])
    state.update(at_rest(robot, np.array(robot.description.arm.ready_position)))
    observer, rate = PushObserver(robot.n_m), 300.0
    observer.update(state, state.h[2:], rate, dt)
    for after in range(1, 6):
        observer.update(state, state.h[2:] - push, rate, dt)
        np.testing.assert_allclose(observer.r, push * (1.0 - np.exp(-rate * dt * after)))


def test_after_a_reset_and_a_pause_nothing_of_before_counts(robot: RobotModel) -> None:
    arm = Pushed(robot, np.array(robot.description.arm.ready_position))
    observer = PushObserver(robot.n_m)
    observer.update(arm.state, arm.state.g[2:], RATE, DT)
    arm.move(arm.state.g[2:] + 50.0, np.zeros(7))
    observer.pause()
    observer.update(arm.state, arm.state.g[2:], RATE, DT)
    assert not observer.r.any()
    observer.update(arm.state, arm.state.g[2:] + 5.0, RATE, DT)
    assert observer.r.any()
    observer.reset()
    assert not observer.r.any()


HAND_ABOVE = (-0.10, 0.20, 0.60)
"""[m] over the base's deck, where only the arm can keep the distance."""


def least_distance(robot: RobotModel, data: BorderData, q_m: Array, push_rate: float) -> float:
    """[m] where a hand comes to rest that 40 N press straight onto the deck for 3 s."""
    controller = Controller(robot, data, Config().replace("limit.push_rate", push_rate))
    arm, d = Pushed(robot, q_m), np.inf
    for k in range(3000):
        output = controller.step(arm.measurement, base_acceleration=np.zeros(2))
        force = min(k / 500, 1.0) * np.array([0.0, 0.0, -40.0])
        arm.move(output.u_a, arm.torques_of(force))
        d = min(p.closest.d for p in output.avoidance.mobile)
    return d


@pytest.mark.slow
def test_a_distance_is_kept_against_a_push_of_40_n(
    robot: RobotModel, border_data: BorderData
) -> None:
    """And not without the observer: the barrier alone gives way like a spring."""
    q_m = StartSolver(robot, border_data.pairs, Config().border.d_b).solve(HAND_ABOVE)
    kept = least_distance(robot, border_data, q_m, RATE)
    pressed = least_distance(robot, border_data, q_m, 0.0)
    assert kept == pytest.approx(Config().barrier.d_min, abs=3e-3)
    assert pressed < kept - 5e-3
