"""Properties of the estimate of arm and external push, and the arm's distance under a push."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import pytest

from app.border.cache import BorderData
from app.config import Config, EstimateConfig
from app.control.controller import Controller
from app.control.estimate import (
    _FRICTION,
    _torque_change,
    estimate_arm,
    predicted_joint_acceleration,
    process_noise,
)
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


class Memory(NamedTuple):
    """The memory of the estimate, by the names of `STEP`."""

    x_read: Array
    P_est: Array
    noise_var: Array
    q_last: Array
    samples: Array
    v_error: Array
    blind_time: Array


def empty_memory(n_m: int) -> Memory:
    """Zero external acceleration, unknown noise, and a blind time of one control period."""
    sizes = (3, n_m), (n_m, 3, 3), (2, n_m), (4, n_m)
    x, P, variances, last = (np.zeros((*size,)) for size in sizes)
    return Memory(x, P, variances, last, np.zeros(()), np.zeros(n_m), np.array(DT))


class RunningEstimate:
    """The estimate without a controller, updated as in a control step."""

    def __init__(self, n_m: int) -> None:
        """Start with zero external acceleration and unknown noise."""
        self._memory = empty_memory(n_m)
        self._v_last: Array | None = None

    @property
    def pushed(self) -> Array:
        """(n_m,) [rad/s²] the external acceleration."""
        return self._memory.x_read[2].copy()

    @property
    def noise(self) -> Array:
        """(2, n_m) [rad, rad/s] standard deviations of positions and velocities."""
        return np.sqrt(self._memory.noise_var)

    def update(
        self, read: Measurement, state: RobotState, u_a: Array | None, c: EstimateConfig, dt: float
    ) -> Measurement:
        """Update the estimate; return the readings with the estimated positions and velocities.

        `state` and the torques `u_a` are those of the previous step.
        """
        known, robot = np.empty((0, len(read.q_m))), state.model
        if self._v_last is not None and u_a is not None:
            qdd_b = robot.J_m_inv @ (read.base_velocity - self._v_last) / dt
            L_aa = cholesky(state.M[robot.n_b :, robot.n_b :])
            known = predicted_joint_acceleration(state.M, state.h, L_aa, u_a, qdd_b)[None]
        self._v_last = read.base_velocity
        gains = Gains(dt, c.external_drift, c.least_noise, c.velocity_noise, c.noise_window)
        readings = np.stack((read.q_m, read.qd_m))
        estimate_arm(self._memory, known, readings, robot.qd_max, np.zeros(7), gains)
        x = self._memory.x_read
        return read._replace(q_m=x[0].copy(), qd_m=x[1].copy())


class PushedArm:
    """An arm that moves by its equation of motion under torques and a push; its base rests."""

    def __init__(self, robot: RobotModel, q_m: Array) -> None:
        self.state = RobotState(robot)
        self.measurement = at_rest(robot, q_m)
        self.state.update(self.measurement)

    def move(self, u_a: Array, push: Array) -> None:
        """Simulate one control period with the torques `u_a` and `push`, both (7,) [N m]."""
        state, m = self.state, self.measurement
        qdd = np.linalg.solve(state.M[2:, 2:], u_a + push - state.h[2:])
        qd = m.qd_m + DT * qdd
        self.measurement = Measurement(m.base_pose, np.zeros(2), m.q_m + DT * qd, qd)
        state.update(self.measurement)

    def torques_of(self, force: Array) -> Array:
        """(7,) [N m] joint torques of a force (3,) [N] on the end-effector."""
        return self.state.J_ee[:3, 2:].T @ force


@pytest.fixture
def ready(robot: RobotModel) -> PushedArm:
    """The arm at rest in its ready posture."""
    return PushedArm(robot, np.array(robot.description.arm.ready_position))


def estimated_motion(
    arm: PushedArm, push: Array, steps: int, noise: float = 0.0, of_velocity: float = 1.0
) -> tuple[RunningEstimate, Array, Array]:
    """The estimate after a motion; estimated and true positions and velocities (steps, 2, 7).

    The torques oscillate about the bias torques; `of_velocity` [-] scales the measured velocities.
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
        estimated = estimate.update(read, seen, u_a, Config().estimate, DT)
        seen.update(estimated)
        found[k], truth[k] = (
            (estimated.q_m, estimated.qd_m),
            (arm.measurement.q_m, arm.measurement.qd_m),
        )
        u_a = arm.state.h[2:] + arm.state.M[2:, 2:] @ np.sin(0.02 * k + np.arange(n_m))
        arm.move(u_a, push)
    return estimate, found, truth


def test_estimated_push_stays_small_during_a_motion_without_a_push(ready: PushedArm) -> None:
    estimate, found, truth = estimated_motion(ready, np.zeros(7), 300)
    assert np.abs(truth[:, 1]).max() > 0.05
    assert np.abs(estimate.pushed).max() < 0.1
    np.testing.assert_allclose(found, truth, atol=1e-9)


def test_push_is_estimated_within_10_ms_without_noise(ready: PushedArm) -> None:
    qdd = np.array([1.0, -2.0, 1.0, 2.0, -1.0, 1.5, -1.0])
    estimate, found, truth = estimated_motion(ready, ready.state.M[2:, 2:] @ qdd, 10)
    np.testing.assert_allclose(estimate.pushed, qdd, atol=0.1)
    np.testing.assert_allclose(found, truth, atol=1e-3)


@pytest.mark.parametrize("of_velocity", [0.0, -1.0, 0.9])
def test_wrong_velocities_are_corrected_by_the_positions(
    ready: PushedArm, of_velocity: float
) -> None:
    estimate, found, truth = estimated_motion(ready, np.zeros(7), 300, 0.0, of_velocity)
    assert np.abs(truth[:, 1]).max() > 0.05
    np.testing.assert_allclose(found[20:], truth[20:], atol=1e-4)
    assert np.abs(estimate.pushed).max() < 0.1


@pytest.mark.parametrize("noise", [3e-4, 1e-3, 3e-3])
def test_noise_is_estimated_and_filtered(ready: PushedArm, noise: float) -> None:
    """The remaining error changes slowly from step to step."""
    estimate, found, truth = estimated_motion(ready, np.zeros(7), 1000, noise)
    np.testing.assert_allclose(estimate.noise[0], noise, rtol=0.4)
    off = (found - truth)[300:]
    assert off[:, 0].std() < 0.5 * noise
    assert np.diff(off[:, 0], axis=0).std() < 0.15 * noise
    assert off[:, 1].std() < 25.0 * noise


@pytest.mark.parametrize("noise", [1e-4, 1e-3])
def test_velocities_differentiated_from_noisy_positions_are_filtered(
    ready: PushedArm, noise: float
) -> None:
    """They agree with the positions by construction; less than 10 % of their noise remains."""
    rng, still = np.random.default_rng(2), ready.measurement
    estimate, last = RunningEstimate(7), still.q_m
    found = np.empty((600, 7))
    for k in range(600):
        q_m = still.q_m + noise * rng.standard_normal(7)
        read = still._replace(q_m=q_m, qd_m=(q_m - last) / DT)
        last = q_m
        estimated = estimate.update(read, ready.state, ready.state.h[2:], Config().estimate, DT)
        found[k] = estimated.qd_m
    assert found[300:].std() < 0.1 * np.sqrt(2.0) * noise / DT


def test_push_is_estimated_from_noisy_readings(ready: PushedArm) -> None:
    qdd = np.array([5.0, -10.0, 5.0, 10.0, -5.0, 7.0, -5.0])
    estimate, _, _ = estimated_motion(ready, ready.state.M[2:, 2:] @ qdd, 200, 1e-3)
    assert np.abs(estimate.pushed - qdd).max() < 0.9 * np.abs(qdd).max()
    assert (estimate.pushed * qdd).sum() > 0.7 * (qdd**2).sum()


def test_large_jump_of_the_positions_restarts_the_estimate(ready: PushedArm) -> None:
    """Only jumps that no motion explains restart the estimate; smaller ones are noise."""
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


@pytest.mark.parametrize("noise", [1e-5, 3e-4, 1e-3])
def test_noise_of_mean_external_accelerations_is_known(noise: float) -> None:
    """Changes from one interval to the next but one, with a mass matrix of 1 and without motion."""
    rng, c, qd_max = np.random.default_rng(0), Config().estimate, np.full(7, 2.0)
    memory, pushed = empty_memory(7), []
    gains = Gains(DT, c.external_drift, c.least_noise, c.velocity_noise, c.noise_window)
    for _ in range(4000):
        read = np.stack((noise * rng.standard_normal(7), np.full(7, np.nan)))
        drift = process_noise(memory, qd_max, np.ones(7), gains)
        estimate_arm(memory, np.zeros((1, 7)), read, qd_max, drift, gains)
        pushed.append(memory.x_read[2].copy())
    means = np.array(pushed[1000:]).reshape(-1, 20, 7).mean(axis=1)
    expected = (
        np.diag(_torque_change(np.eye(7), np.eye(3, 7), memory.P_est, 0.0, 20 * DT)) - _FRICTION**2
    )
    np.testing.assert_allclose((means[2:] - means[:-2]).std(axis=0), np.sqrt(expected), rtol=0.4)


@pytest.mark.parametrize("dt", [0.001, 0.01, 0.1])
def test_push_is_estimated_with_little_overshoot_at_any_period(ready: PushedArm, dt: float) -> None:
    """The arm is at rest because its torques balance the push."""
    state, push = ready.state, np.array([1.0, -2.0, 1.0, 2.0, -1.0, 1.5, -1.0])
    estimate, qdd = RunningEstimate(7), np.linalg.solve(state.M[2:, 2:], push)
    for _ in range(50):
        estimate.update(ready.measurement, state, state.h[2:] - push, Config().estimate, dt)
        assert (estimate.pushed / qdd < 1.3).all()
    np.testing.assert_allclose(estimate.pushed, qdd, rtol=0.01)


def test_estimated_push_survives_a_gap_in_the_readings_but_not_a_reset(
    ready: PushedArm, robot: RobotModel, border_data: BorderData
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


ABOVE_DECK = (-0.10, 0.20, 0.60)
"""[m] above the base's deck, where base motion cannot increase the distance."""


def least_distance(
    robot: RobotModel, data: BorderData, q_m: Array, *, estimates_push: bool
) -> float:
    """[m] distance from the base after 3 s of a downward force of 40 N on the end-effector."""
    controller = Controller(robot, data, Config())
    arm, d = PushedArm(robot, q_m), np.inf
    for k in range(3000):
        if not estimates_push:
            controller.last.v_last[:] = np.nan  # a gap: the estimate restarts at each reading
        output = controller.step(arm.measurement, base_acceleration=np.zeros(2))
        force = min(k / 500, 1.0) * np.array([0.0, 0.0, -40.0])
        arm.move(output.u_cmd, arm.torques_of(force))
        d = float(output.d[: output.n_mob].min())
    return d


@pytest.mark.slow
def test_arm_stops_at_the_minimum_distance_under_a_push_of_40_n(
    robot: RobotModel, border_data: BorderData
) -> None:
    """Without the estimate of the push, the barrier alone yields like a spring."""
    q_m = StartSolver(robot, border_data.pairs, Config().border.d_b).solve(ABOVE_DECK)
    kept, pressed = (
        least_distance(robot, border_data, q_m, estimates_push=estimates)
        for estimates in (True, False)
    )
    assert kept == pytest.approx(Config().barrier.d_min, abs=3e-3)
    assert pressed < kept - 5e-3
