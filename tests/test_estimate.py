"""Laws of the estimate of the arm and of pushes, and of the distance that is kept against one."""

from __future__ import annotations

import numpy as np
import pytest

from app.border.cache import BorderData
from app.config import Config
from app.control.controller import Controller
from app.control.estimate import ArmEstimate
from app.robot.model import RobotModel
from app.robot.state import Measurement, RobotState, at_rest
from app.simulation.scenarios.start import StartSolver
from app.simulation.session import VelocityTracking

Array = np.ndarray

DT = 1e-3


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


@pytest.fixture
def ready(robot: RobotModel) -> Pushed:
    """The arm at rest in its ready pose."""
    return Pushed(robot, np.array(robot.description.arm.ready_position))


def followed(
    arm: Pushed, push: Array, steps: int, noise: float = 0.0, of_velocity: float = 1.0
) -> tuple[ArmEstimate, Array, Array]:
    """The estimate after a motion; (steps, 2, 7) positions and velocities along it, and true ones.

    Torques sway about those that hold the arm; of the velocities a share [-] is read.
    """
    rng, n_m = np.random.default_rng(1), arm.state.model.n_m
    estimate, seen = ArmEstimate(n_m), RobotState(arm.state.model)
    tracking = VelocityTracking(arm.measurement.q_m, arm.measurement.qd_m, DT)
    found, truth = np.empty((2, steps, 2, n_m))
    u_a = None
    for k in range(steps):
        read = arm.measurement
        if noise > 0.0:
            q_m = read.q_m + noise * rng.standard_normal(n_m)
            read = read._replace(q_m=q_m, qd_m=tracking.update(q_m))
        read = read._replace(qd_m=of_velocity * read.qd_m)
        told = estimate.update(read, seen, u_a, Config().estimate, DT)
        seen.update(told)
        found[k], truth[k] = (told.q_m, told.qd_m), (arm.measurement.q_m, arm.measurement.qd_m)
        u_a = arm.state.h[2:] + arm.state.M[2:, 2:] @ np.sin(0.02 * k + np.arange(n_m))
        arm.move(u_a, push)
    return estimate, found, truth


def test_where_nobody_pushes_it_learns_nothing_however_the_arm_moves(ready: Pushed) -> None:
    estimate, found, truth = followed(ready, np.zeros(7), 300)
    assert np.abs(truth[:, 1]).max() > 0.05
    assert np.abs(estimate.pushed).max() < 0.1
    np.testing.assert_allclose(found, truth, atol=1e-9)


def test_without_noise_a_push_is_known_within_milliseconds(ready: Pushed) -> None:
    qdd = np.array([1.0, -2.0, 1.0, 2.0, -1.0, 1.5, -1.0])
    estimate, found, truth = followed(ready, ready.state.M[2:, 2:] @ qdd, 10)
    np.testing.assert_allclose(estimate.pushed, qdd, atol=0.1)
    np.testing.assert_allclose(found, truth, atol=1e-3)


@pytest.mark.parametrize("of_velocity", [0.0, -1.0, 0.9])
def test_velocities_that_are_wrong_are_left_to_the_positions(
    ready: Pushed, of_velocity: float
) -> None:
    estimate, found, truth = followed(ready, np.zeros(7), 300, 0.0, of_velocity)
    assert np.abs(truth[:, 1]).max() > 0.05
    np.testing.assert_allclose(found[20:], truth[20:], atol=1e-4)
    assert np.abs(estimate.pushed).max() < 0.1


@pytest.mark.parametrize("noise", [3e-4, 1e-3, 3e-3])
def test_noise_is_learnt_and_taken_out(ready: Pushed, noise: float) -> None:
    """What is left of it is steady: a tenth of it in a step."""
    estimate, found, truth = followed(ready, np.zeros(7), 1000, noise)
    np.testing.assert_allclose(estimate.noise[0], noise, rtol=0.4)
    off = (found - truth)[300:]
    assert off[:, 0].std() < 0.5 * noise
    assert np.diff(off[:, 0], axis=0).std() < 0.15 * noise
    assert off[:, 1].std() < 25.0 * noise


@pytest.mark.parametrize("noise", [1e-4, 1e-3])
def test_velocities_made_of_the_same_noisy_positions_are_no_better(
    ready: Pushed, noise: float
) -> None:
    """They agree with the way by construction; of their noise a tenth is left at most."""
    rng, still = np.random.default_rng(2), ready.measurement
    estimate, last = ArmEstimate(7), still.q_m
    found = np.empty((600, 7))
    for k in range(600):
        q_m = still.q_m + noise * rng.standard_normal(7)
        read = still._replace(q_m=q_m, qd_m=(q_m - last) / DT)
        last = q_m
        told = estimate.update(read, ready.state, ready.state.h[2:], Config().estimate, DT)
        found[k] = told.qd_m
    assert found[300:].std() < 0.1 * np.sqrt(2.0) * noise / DT


def test_a_push_is_learnt_from_noisy_readings_too(ready: Pushed) -> None:
    qdd = np.array([5.0, -10.0, 5.0, 10.0, -5.0, 7.0, -5.0])
    estimate, _, _ = followed(ready, ready.state.M[2:, 2:] @ qdd, 200, 1e-3)
    assert np.abs(estimate.pushed - qdd).max() < 0.9 * np.abs(qdd).max()
    assert (estimate.pushed * qdd).sum() > 0.7 * (qdd**2).sum()


def test_an_arm_that_was_moved_meanwhile_is_where_it_is_read(ready: Pushed) -> None:
    """Positions that no motion leads to begin the estimate anew; small leaps are noise."""
    robot, there = ready.state.model, ready.measurement
    estimate, config = ArmEstimate(robot.n_m), Config().estimate
    for _ in range(20):
        estimate.update(there, ready.state, ready.state.h[2:], config, DT)
    moved = there._replace(q_m=there.q_m + 0.3)
    assert estimate.update(moved, ready.state, ready.state.h[2:], config, DT) is moved
    assert not estimate.noise.any()
    estimate.reset()
    for _ in range(20):
        estimate.update(there, ready.state, ready.state.h[2:], config, DT)
    noisy = there._replace(q_m=there.q_m + 0.003)
    assert estimate.update(noisy, ready.state, ready.state.h[2:], config, DT) is not noisy


@pytest.mark.parametrize("dt", [0.001, 0.01, 0.1])
def test_however_slow_a_loop_is_a_push_is_learnt_and_not_overshot(ready: Pushed, dt: float) -> None:
    """An arm that a push cannot move, whose torques hold against it."""
    state, push = ready.state, np.array([1.0, -2.0, 1.0, 2.0, -1.0, 1.5, -1.0])
    estimate, qdd = ArmEstimate(7), np.linalg.solve(state.M[2:, 2:], push)
    for _ in range(50):
        estimate.update(ready.measurement, state, state.h[2:] - push, Config().estimate, dt)
        assert (estimate.pushed / qdd < 1.3).all()
    np.testing.assert_allclose(estimate.pushed, qdd, rtol=0.01)


def test_after_a_pause_who_pushes_stays_and_after_a_reset_nobody_does(ready: Pushed) -> None:
    estimate, _, _ = followed(ready, ready.state.M[2:, 2:] @ np.ones(7), 10)
    known = estimate.pushed
    estimate.begin_anew()
    assert known.any()
    np.testing.assert_array_equal(estimate.pushed, known)
    estimate.reset()
    assert not estimate.pushed.any()


HAND_ABOVE = (-0.10, 0.20, 0.60)
"""[m] over the base's deck, where only the arm can keep the distance."""


def least_distance(robot: RobotModel, data: BorderData, q_m: Array) -> float:
    """[m] where a hand comes to rest that 40 N press straight onto the deck for 3 s."""
    controller = Controller(robot, data, Config())
    arm, d = Pushed(robot, q_m), np.inf
    for k in range(3000):
        output = controller.step(arm.measurement, base_acceleration=np.zeros(2))
        force = min(k / 500, 1.0) * np.array([0.0, 0.0, -40.0])
        arm.move(output.u_a, arm.torques_of(force))
        d = min(p.closest.d for p in output.avoidance.mobile)
    return d


@pytest.mark.slow
def test_a_distance_is_kept_against_a_push_of_40_n(
    robot: RobotModel, border_data: BorderData, monkeypatch: pytest.MonkeyPatch
) -> None:
    """And not where nobody is thought to push: the barrier alone gives way like a spring."""
    q_m = StartSolver(robot, border_data.pairs, Config().border.d_b).solve(HAND_ABOVE)
    kept = least_distance(robot, border_data, q_m)
    monkeypatch.setattr(ArmEstimate, "update", lambda _, measured, *__: measured)
    pressed = least_distance(robot, border_data, q_m)
    assert kept == pytest.approx(Config().barrier.d_min, abs=3e-3)
    assert pressed < kept - 5e-3
