"""Laws of the estimate of the arm and of pushes, and of the distance that is kept against one."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import pytest

from app.border.cache import BorderData
from app.config import Config, EstimateConfig
from app.control.controller import Controller
from app.control.estimate import estimate_arm, predicted_joint_acceleration
from app.control.qp import cholesky
from app.robot.model import RobotModel
from app.robot.state import Measurement, RobotState, at_rest
from app.simulation.scenarios.start import StartSolver
from app.simulation.session import VelocityTracking

Array = np.ndarray

DT = 1e-3


class Gains(NamedTuple):
    """The gains of the estimate, by the names of `GAINS`."""

    dt: float
    external_drift: float
    least_noise: float
    velocity_noise: float
    noise_window: float


class RunningEstimate:
    """The estimate by itself, as a control step runs it."""

    def __init__(self, n_m: int) -> None:
        """Nobody touches the arm, and nothing is known of its readings."""
        self._x, self._P, self._last = np.zeros((3, n_m)), np.zeros((n_m, 3, 3)), np.zeros((3, n_m))
        self._variances, self._samples = np.zeros((2, n_m)), np.zeros(())
        self._v_last: Array | None = None

    @property
    def pushed(self) -> Array:
        """(n_m,) [rad/s²] the external acceleration."""
        return self._x[2].copy()

    @property
    def noise(self) -> Array:
        """(2, n_m) standard deviations of positions and velocities."""
        return np.sqrt(self._variances)

    def update(
        self, read: Measurement, state: RobotState, u_a: Array | None, c: EstimateConfig, dt: float
    ) -> Measurement:
        """The readings with the estimate in their place; `state` is that before them."""
        known, robot = np.empty((0, len(read.q_m))), state.model
        if self._v_last is not None and u_a is not None:
            qdd_b = robot.J_m_inv @ (read.base_velocity - self._v_last) / dt
            L_aa = cholesky(state.M[robot.n_b :, robot.n_b :])
            known = predicted_joint_acceleration(state.M, state.h, L_aa, u_a, qdd_b)[None]
        self._v_last = read.base_velocity
        memory = self._x, self._P, self._variances, self._last, self._samples
        gains = Gains(dt, c.external_drift, c.least_noise, c.velocity_noise, c.noise_window)
        estimate_arm(
            *memory, known, np.stack((read.q_m, read.qd_m)), robot.qd_max, np.zeros(7), gains
        )
        return read._replace(q_m=self._x[0].copy(), qd_m=self._x[1].copy())


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
) -> tuple[RunningEstimate, Array, Array]:
    """The estimate after a motion; (steps, 2, 7) positions and velocities along it, and true ones.

    Torques sway about those that hold the arm; of the velocities a share [-] is read.
    """
    rng, n_m = np.random.default_rng(1), arm.state.model.n_m
    estimate, seen = RunningEstimate(n_m), RobotState(arm.state.model)
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
    """The remainder is steady: a tenth of it in a step."""
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
    """They agree with the travel by construction; at most a tenth of their noise remains."""
    rng, still = np.random.default_rng(2), ready.measurement
    estimate, last = RunningEstimate(7), still.q_m
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
    estimate, config = RunningEstimate(robot.n_m), Config().estimate
    for _ in range(20):
        estimate.update(there, ready.state, ready.state.h[2:], config, DT)
    moved = there._replace(q_m=there.q_m + 0.3)
    found = estimate.update(moved, ready.state, ready.state.h[2:], config, DT)
    np.testing.assert_array_equal(found.q_m, moved.q_m)
    np.testing.assert_array_equal(found.qd_m, moved.qd_m)
    assert not estimate.noise.any()
    estimate = RunningEstimate(robot.n_m)
    for _ in range(20):
        estimate.update(there, ready.state, ready.state.h[2:], config, DT)
    noisy = there._replace(q_m=there.q_m + 0.003)
    found = estimate.update(noisy, ready.state, ready.state.h[2:], config, DT)
    assert (found.q_m != noisy.q_m).all()


@pytest.mark.parametrize("dt", [0.001, 0.01, 0.1])
def test_however_slow_a_loop_is_a_push_is_learnt_and_not_overshot(ready: Pushed, dt: float) -> None:
    """An arm that a push cannot move, whose torques hold against it."""
    state, push = ready.state, np.array([1.0, -2.0, 1.0, 2.0, -1.0, 1.5, -1.0])
    estimate, qdd = RunningEstimate(7), np.linalg.solve(state.M[2:, 2:], push)
    for _ in range(50):
        estimate.update(ready.measurement, state, state.h[2:] - push, Config().estimate, dt)
        assert (estimate.pushed / qdd < 1.3).all()
    np.testing.assert_allclose(estimate.pushed, qdd, rtol=0.01)


def test_after_a_pause_who_pushes_stays_and_after_a_reset_nobody_does(
    ready: Pushed, robot: RobotModel, border_data: BorderData
) -> None:
    controller, gap = Controller(robot, border_data, Config()), np.full(7, np.nan)
    for _ in range(20):
        w = controller.step(ready.measurement)
        ready.move(w.u_cmd, ready.state.M[2:, 2:] @ np.ones(7))
    known = w.x_est[2].copy()
    assert (known > 0.5).all()
    for _ in range(120):
        controller.step(ready.measurement._replace(q_m=gap))
    w = controller.step(ready.measurement)
    np.testing.assert_array_equal(w.x_est[2], known)
    controller.reset()
    assert not controller.last.x_est.any()


HAND_ABOVE = (-0.10, 0.20, 0.60)
"""[m] over the base's deck, where only the arm can keep the distance."""


def least_distance(
    robot: RobotModel, data: BorderData, q_m: Array, *, knows_who_pushes: bool
) -> float:
    """[m] where a hand comes to rest that 40 N press straight onto the deck for 3 s."""
    controller = Controller(robot, data, Config())
    arm, d = Pushed(robot, q_m), np.inf
    for k in range(3000):
        if not knows_who_pushes:
            controller.last.v_last[:] = np.nan  # a gap: the estimate begins anew at each reading
        output = controller.step(arm.measurement, base_acceleration=np.zeros(2))
        force = min(k / 500, 1.0) * np.array([0.0, 0.0, -40.0])
        arm.move(output.u_cmd, arm.torques_of(force))
        d = float(output.d[: output.n_mob].min())
    return d


@pytest.mark.slow
def test_a_distance_is_kept_against_a_push_of_40_n(
    robot: RobotModel, border_data: BorderData
) -> None:
    """And not where nobody is thought to push: the barrier alone gives way like a spring."""
    q_m = StartSolver(robot, border_data.pairs, Config().border.d_b).solve(HAND_ABOVE)
    kept, pressed = (
        least_distance(robot, border_data, q_m, knows_who_pushes=knows) for knows in (True, False)
    )
    assert kept == pytest.approx(Config().barrier.d_min, abs=3e-3)
    assert pressed < kept - 5e-3
