"""Noise, delay, model error and slip: zero changes nothing, and each has its specified effect."""

from __future__ import annotations

import numpy as np
import pytest

from app.border.cache import BorderData
from app.config import Config, DisturbanceConfig, parameter
from app.control.controller import Controller
from app.robot.link_pairs import PairDistances
from app.robot.model import RobotModel
from app.robot.state import Measurement, RobotState
from app.simulation.scenarios import LINES
from app.simulation.scenarios.start import StartSolver
from app.simulation.session import DT, Disturbances, Session, Step, VelocityTracking
from tests.steps import kept

LATERAL = LINES["guiding-lateral"]
PULL = np.add(LATERAL.start, LATERAL.move)  # [m] into the buffer
SIGMA = 0.001  # [rad]


@pytest.fixture(scope="module")
def q_start(robot: RobotModel, border_data: BorderData) -> np.ndarray:
    return StartSolver(robot, border_data.pairs, Config().border.d_b).solve(LATERAL.start)


class Spy:
    """A plant that records the velocity commands of its base."""

    def __init__(self, physics) -> None:
        self._physics, self.commands = physics, []

    def __getattr__(self, name: str):
        return getattr(self._physics, name)

    def step(self, u_a, base_velocity, hand_force, pushes=()) -> None:
        self.commands.append(np.array(base_velocity))
        self._physics.step(u_a, base_velocity, hand_force, pushes)


@pytest.fixture
def make(robot: RobotModel, border_data: BorderData, q_start: np.ndarray):
    """Creates disturbed sessions at the start of guiding-lateral, with a spy."""

    def make(seed: int = 0, **disturbance: float) -> Session:
        config = Config(disturbance=DisturbanceConfig(**disturbance))
        session = Session(robot, border_data, config, physics="kinematic", seed=seed)
        session.physics = Spy(session.physics)
        session.reset(q_start)
        return session

    return make


def pulled(session: Session, steps: int) -> list[Step]:
    return [kept(session.step(pull=PULL)) for _ in range(steps)]


def path(steps: list[Step]) -> np.ndarray:
    return np.array(
        [np.concatenate([*s.truth[:5], s.control.u_cmd, s.base_command]) for s in steps]
    )


@pytest.mark.slow
def test_without_disturbance_sensors_are_true_and_commands_unchanged(make):
    session = make()
    steps = pulled(session, 1500)
    assert all(step.measurement is step.truth for step in steps)
    np.testing.assert_array_equal(session.physics.commands, [s.base_command for s in steps])
    assert np.abs(session.physics.commands).max() > 0.0
    d = [s.control.d[: len(s.control.pairs)] for s in steps]
    np.testing.assert_array_equal([s.distances for s in steps], d)


@pytest.mark.slow
def test_resetting_disturbances_to_zero_restores_the_undisturbed_run(make):
    plain, changed = make(), make(encoder_noise=0.005, base_delay=0.3, mass_error=0.2, slip=0.4)
    changed.configure(Config())
    np.testing.assert_array_equal(path(pulled(plain, 800)), path(pulled(changed, 800)))


@pytest.mark.slow
def test_equal_seeds_give_equal_runs_and_other_seeds_do_not(make):
    all_of_it = {"encoder_noise": SIGMA, "base_delay": 0.1, "mass_error": -0.1, "slip": 0.2}
    a, b, c = make(**all_of_it), make(**all_of_it), make(seed=1, **all_of_it)
    first = path(pulled(a, 600))
    np.testing.assert_array_equal(first, path(pulled(b, 600)))
    assert np.abs(first - path(pulled(c, 600))).max() > 1e-6


def test_a_reset_restarts_the_same_noise(make, q_start):
    session = make(encoder_noise=SIGMA)
    first = [step.measurement.q_m - step.truth.q_m for step in pulled(session, 50)]
    session.reset(q_start)
    second = [step.measurement.q_m - step.truth.q_m for step in pulled(session, 50)]
    np.testing.assert_allclose(second, first, atol=1e-12)


def test_noise_has_its_deviation_and_leaves_the_base_unchanged():
    disturbances = Disturbances(DisturbanceConfig(encoder_noise=SIGMA), DT, 3)
    truth = Measurement(np.arange(3.0), np.array([0.2, -0.1]), np.linspace(-1, 1, 7), np.zeros(7))
    sensed = [disturbances.sensed(truth) for _ in range(5000)]
    noise = np.array([m.q_m for m in sensed]) - truth.q_m
    np.testing.assert_allclose(noise.std(axis=0), SIGMA, rtol=0.05)
    np.testing.assert_allclose(noise.mean(axis=0), 0.0, atol=5 * SIGMA / 5000**0.5)
    neighbours = np.corrcoef(noise[1:, 0], noise[:-1, 0])[0, 1]
    assert abs(neighbours) < 5 / 5000**0.5  # white
    assert all(m.base_pose is truth.base_pose for m in sensed)
    assert all(m.base_velocity is truth.base_velocity for m in sensed)


def test_velocity_noise_has_the_deviation_of_the_tracking_loop():
    rng = np.random.default_rng(0)
    tracking = VelocityTracking(np.zeros(1), np.zeros(1), DT)
    v = [tracking.update(SIGMA * rng.standard_normal(1))[0] for _ in range(50_000)]
    assert np.std(v) == pytest.approx(SIGMA * (250.0**3 * DT) ** 0.5 / 2, rel=0.1)
    assert abs(np.mean(v)) < 0.01 * np.std(v)


def test_tracked_velocities_are_exact_if_constant_and_lag_8_ms_if_rising():
    t = np.arange(0.0, 0.5, DT)
    steady = VelocityTracking(np.array([0.3]), np.array([0.7]), DT)
    np.testing.assert_allclose([steady.update(np.array([0.3 + 0.7 * s])) for s in t], 0.7)
    rising = VelocityTracking(np.zeros(1), np.zeros(1), DT)
    v = [rising.update(np.array([0.5 * s * s]))[0] for s in t]
    assert v[-1] == pytest.approx(t[-1] - 0.008, abs=0.0006)


def test_distances_and_error_of_a_step_are_true_under_noise(make, robot: RobotModel):
    session = make(encoder_noise=0.005)
    reader = PairDistances(robot, pulled(session, 1)[0].control.pairs)
    state = RobotState(robot)
    seen = []
    for step in pulled(session, 40):
        reader.update(robot.configuration(step.truth.base_pose, step.truth.q_m))
        true = [reader.distances()[i] for i in range(len(step.distances))]
        np.testing.assert_allclose(step.distances, true, atol=1e-9)
        seen.append(np.subtract(true, step.control.d[: len(true)]))
        state.update(step.truth)
        error = np.linalg.norm(state.T_world_ee.translation - PULL)
        assert step.ee_error == pytest.approx(error, abs=1e-12)
    assert np.abs(seen).max() > 1e-3  # [m] the controller's distances differ


@pytest.mark.slow
@pytest.mark.parametrize("delay", [0.001, 0.05, 0.2])
def test_the_base_command_arrives_after_exactly_the_delay(make, delay):
    session = make(base_delay=delay)
    steps, n = pulled(session, 1600), round(delay / DT)
    sent = np.array([step.base_command for step in steps])
    np.testing.assert_array_equal(session.physics.commands[n:], sent[: len(sent) - n])
    np.testing.assert_array_equal(session.physics.commands[:n], 0.0)
    assert np.abs(session.physics.commands).max() > 0.0


def test_the_longest_delay_is_exact():
    longest = parameter("disturbance.base_delay").high
    disturbances = Disturbances(DisturbanceConfig(base_delay=longest), DT, 0)
    arrived = [disturbances.arriving(np.array([k, -k]))[0] for k in range(1, 700)]
    assert arrived.index(1.0) == round(longest / DT)
    assert arrived[-1] == 699 - round(longest / DT)


@pytest.mark.parametrize("slip", [0.2, 0.5])
def test_slip_scales_the_base_command(make, slip):
    session = make(slip=slip)
    steps = pulled(session, 1500)
    sent = np.array([step.base_command for step in steps])
    np.testing.assert_allclose(session.physics.commands, (1 - slip) * sent, atol=1e-15)
    assert steps[-1].measurement is steps[-1].truth  # the odometry sees the true motion


@pytest.mark.parametrize("error", [-0.3, 0.2])
def test_a_mass_error_scales_the_arm_and_not_the_base(robot: RobotModel, error):
    rng = np.random.default_rng(1)
    right, wrong, mirrored = RobotState(robot), RobotState(robot), RobotState(robot)
    wrong.scale_arm_inertias(1 + error)
    mirrored.scale_arm_inertias(1 - error)
    for _ in range(5):
        m = Measurement(
            rng.normal(size=3),
            rng.normal(size=2),
            rng.uniform(robot.q_lower, robot.q_upper),
            rng.normal(size=7),
        )
        for state in (right, wrong, mirrored):
            state.update(m)
        np.testing.assert_allclose(wrong.g[2:], (1 + error) * right.g[2:], atol=1e-9)
        np.testing.assert_allclose(wrong.M[2:], (1 + error) * right.M[2:], atol=1e-9)
        np.testing.assert_allclose(wrong.h[2:], (1 + error) * right.h[2:], atol=1e-9)
        # The change is linear in the error, and the base's own part is unchanged.
        np.testing.assert_allclose(wrong.M - right.M, right.M - mirrored.M, atol=1e-9)
        assert 0 < abs(wrong.M[0, 0] / right.M[0, 0] - 1) < abs(error)
        np.testing.assert_array_equal(wrong.J_ee, right.J_ee)
    wrong.scale_arm_inertias(1.0)
    wrong.update(m)
    np.testing.assert_array_equal(wrong.M, right.M)


def test_a_mass_error_changes_the_torques_during_a_run(make):
    session = make()
    before = pulled(session, 20)[-1].control.u_cmd
    session.configure(Config().replace("disturbance.mass_error", 0.2))
    after = pulled(session, 15)[-1].control.u_cmd  # the torque rate is limited
    np.testing.assert_allclose(after, 1.2 * before, atol=0.3)  # [N m] mostly gravity
    assert np.abs(after - before).max() > 2.0


def test_a_second_controller_on_the_same_model_has_no_mass_error(
    make, robot: RobotModel, border_data: BorderData
):
    session = make(mass_error=0.3)
    step = session.step(pull=PULL)
    answer = Controller(robot, border_data, Config()).step(step.measurement)
    assert np.abs(answer.u_cmd * 1.3 - step.control.u_cmd).max() < 0.05
