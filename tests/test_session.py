"""A session: equal inputs give equal outputs, and the controller depends only on its sensors."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from app.border.cache import BorderData
from app.config import Config
from app.control.algorithm import BUFFER_RATE
from app.control.controller import Controller
from app.errors import ConfigError, DescriptionError, TargetError, UnknownNameError
from app.robot.model import RobotModel
from app.robot.state import Measurement
from app.simulation.scenarios import LINES
from app.simulation.scenarios.start import StartSolver
from app.simulation.session import DT, Session, Step
from tests.admittance import RunningAdmittance
from tests.steps import kept

LATERAL = LINES["guiding-lateral"]
PULL = np.add(LATERAL.start, LATERAL.move)  # [m] into the buffer


@pytest.fixture(scope="module")
def q_start(robot: RobotModel, border_data: BorderData) -> np.ndarray:
    return StartSolver(robot, border_data.pairs, Config().border.d_b).solve(LATERAL.start)


@pytest.fixture
def make(robot: RobotModel, border_data: BorderData, q_start: np.ndarray):
    """Makes sessions at the start of guiding-lateral and closes them at the end."""
    made: list[Session] = []

    def make(physics: str = "kinematic", config: Config | None = None, **options) -> Session:
        session = Session(robot, border_data, config or Config(), physics=physics, **options)
        session.reset(q_start)
        made.append(session)
        return session

    yield make
    for session in made:
        session.close()


@pytest.fixture(scope="module")
def run(robot: RobotModel, border_data: BorderData, q_start: np.ndarray) -> list[Step]:
    """Steps of the kinematic plant with a pull of the end-effector into the buffer."""
    session = Session(robot, border_data, Config(), physics="kinematic")
    session.reset(q_start)
    return pulled(session, 1500)


def pulled(session: Session, steps: int, target: np.ndarray | None = PULL) -> list[Step]:
    """Steps while a person pulls."""
    return [kept(session.step(pull=target)) for _ in range(steps)]


def numbers(step: Step) -> np.ndarray:
    """All physical quantities of a step, without its computing time."""
    m, w = step.measurement, step.control
    return np.concatenate(
        [
            [step.t, step.ee_error, w.activation, w.beta_m, w.solved],
            *m[:5],
            w.u_cmd,
            w.a_base_cmd,
            step.base_command,
            step.hand_force,
            step.contacts,
            *(each.ravel() for each in (w.d, w.p_a, w.p_b)),
        ]
    )


def same(a: list[Step], b: list[Step]) -> None:
    np.testing.assert_array_equal([numbers(step) for step in a], [numbers(step) for step in b])


@pytest.mark.slow
@pytest.mark.parametrize("physics", ["kinematic", "planar"])
def test_equal_inputs_give_bitwise_equal_outputs(make, physics):
    """`test_physics_plants.py` tests the plants alone."""
    a, b = make(physics), make(physics)
    steps = [(kept(a.step(pull=PULL)), kept(b.step(pull=PULL))) for _ in range(1200)]
    same([first for first, _ in steps], [second for _, second in steps])
    assert steps[-1][0].control.activation > 0.0  # avoidance was active


@pytest.mark.slow
def test_a_reset_restarts_the_same_run(make):
    session = make()
    first = pulled(session, 1000)
    angles = session.wheel_angles.copy()
    session.reset(first[0].measurement.q_m)
    assert session.t == 0.0
    np.testing.assert_array_equal(session.wheel_angles, 0.0)
    second = pulled(session, 1000)
    same(second, first)
    np.testing.assert_array_equal(session.wheel_angles, angles)
    assert np.abs(angles).max() > 0.01


@pytest.mark.parametrize("physics", ["kinematic", "planar"])
def test_the_wheel_angles_match_the_base_motion(make, physics):
    session = make(physics)
    steps = pulled(session, 1200)
    base = session.model.description.base
    right, left = session.wheel_angles * base.wheel_radius_m
    turned = session.physics.measure().base_pose[2]
    way = 1e-3 * sum(step.truth.base_velocity[0] for step in steps)  # [m] forward
    assert abs(turned) > 0.01
    assert right - left == pytest.approx(2 * base.half_track_m * turned, abs=1e-3)
    assert (right + left) / 2 == pytest.approx(way, abs=1e-6)
    assert abs(way) > 0.001


def test_a_reset_clears_the_persons_grip_and_the_failure_count(make, q_start):
    session = make()
    pulled(session, 300)
    session.controller.last.failures[()] = 3
    session.reset(q_start)
    step = session.step(pull=PULL)
    assert session.controller.last.failures == 0
    assert np.linalg.norm(step.hand_force) < 0.1  # the grip starts at the current position


def test_the_robot_stands_still_without_a_pull(make, q_start):
    steps = pulled(make(), 500, None)
    np.testing.assert_allclose(steps[-1].measurement.q_m, q_start, atol=1e-4)
    np.testing.assert_allclose(steps[-1].measurement.base_pose, 0.0, atol=1e-6)
    assert all((step.hand_force == 0).all() for step in steps)
    assert {step.ee_error for step in steps} == {0.0}


def test_time_advances_by_the_control_period(make):
    steps = pulled(make(), 50)
    np.testing.assert_allclose([step.t for step in steps], np.arange(50) * DT, atol=1e-12)


def test_the_state_of_a_step_is_true_while_the_controller_refuses_the_readings(make) -> None:
    """The controller's own state stays at the last valid reading."""
    session = make()
    for _ in range(200):
        session.controller.last.contradiction[...] = 1e9
        step = session.step(pull=PULL)
    assert not step.control.valid
    np.testing.assert_array_equal(step.state.q_m, step.measurement.q_m)
    assert np.abs(step.state.q_m - session.controller.state.q_m).max() > 1e-3


@pytest.mark.slow
def test_the_controllers_output_depends_on_its_sensors_alone(
    run: list[Step], robot: RobotModel, border_data: BorderData
):
    """Another controller with only the measured values gives bitwise the same result.

    This controller has no access to the person, so their force has no other influence.
    """
    assert max(np.linalg.norm(step.hand_force) for step in run) > 1.0
    assert max(step.control.activation for step in run) > 0.05
    blind = Controller(robot, border_data, Config())
    blind.reset()
    for step, expected in zip(run, expected_accelerations(robot, run), strict=True):
        answer = blind.step_with_drive(step.measurement, None)
        np.testing.assert_array_equal(answer.u_cmd, step.control.u_cmd)
        np.testing.assert_array_equal(answer.a_base_cmd, step.control.a_base_cmd)
        np.testing.assert_allclose(step.control.a_base_meas, expected, rtol=1e-9, atol=1e-12)


def expected_accelerations(robot: RobotModel, steps: list[Step]) -> list[np.ndarray]:
    """The known response of the base's drive from commands and measured velocities alone."""
    base = robot.description.base
    commands = [np.zeros(2)] + [step.base_command for step in steps[:-1]]
    return [
        base.drive_acceleration(step.measurement.base_velocity, base.drive_at_rest(), command)
        for command, step in zip(commands, steps, strict=True)
    ]


@pytest.mark.slow
def test_the_base_command_is_the_admittance_law_of_the_acceleration(
    run: list[Step], robot: RobotModel
):
    law = RunningAdmittance(robot.description.base, Config().admittance)
    for step in run:
        command = law.update(step.control.a_base_cmd, DT)
        np.testing.assert_array_equal(step.base_command, command)


@pytest.mark.slow
def test_the_base_command_changes_at_the_rate_of_the_admittance(run: list[Step]):
    changes = [
        k
        for k, (a, b) in enumerate(pairwise(run), start=1)
        if (a.base_command != b.base_command).any()
    ]
    assert len(changes) > 3
    period = round(Config().admittance.period / DT)
    assert {k % period for k in changes} == {changes[0] % period}


def test_a_configuration_applies_at_once_and_a_buffer_gradually(make):
    session = make()
    before = pulled(session, 5)[-1]
    wide = Config().replace("border.d_b", 0.30).replace("hand.stiffness", 900.0)
    session.configure(wide)
    assert before.control.activation == 0.0
    after = pulled(session, round(0.15 / BUFFER_RATE / DT) + 1)
    assert session.controller.d_b == pytest.approx(0.30)
    beta = np.array([step.control.beta_m for step in after])
    assert beta[-1] > 0.1
    assert np.abs(np.diff(beta)).max() < 0.05, "β_m jumps"
    assert session.config is wide
    session.configure(Config().replace("hand.f_max", 1.0))
    assert max(np.linalg.norm(step.hand_force) for step in pulled(session, 300)) <= 1.0 + 1e-9


@pytest.mark.slow
def test_configuring_equals_creating_with_the_configuration(make):
    config = Config().replace("border.d_b", 0.20).replace("admittance.mass", 30.0)
    changed = make()
    changed.configure(config)
    same(pulled(changed, 800), pulled(make(config=config), 800))


def test_a_new_stated_period_applies_from_the_next_reset_on(make):
    config = Config().replace("disturbance.stated_period", 0.004)
    session = make()
    start = session.physics.measure().q_m
    session.configure(config)
    same(pulled(session, 50), pulled(make(), 50))
    session.reset(start, config=config)
    same(pulled(session, 300), pulled(make(config=config), 300))
    slow = config.changed({"disturbance.stated_period": 0.008, "repulsion.k_v": 100.0})
    with pytest.raises(ConfigError, match="too large for a control period of 8 ms"):
        session.reset(start, config=slow)
    assert session.config is config
    fast = slow.replace("disturbance.stated_period", 0.001)
    session.reset(start, config=fast)  # the gain suits the new period, not the former one
    same(pulled(session, 50), pulled(make(config=fast), 50))


def test_a_configuration_does_not_jerk_a_carried_load(make):
    config, speeds = Config().replace("payload.mass", 5.0), []
    for configures in (False, True):
        session = make(config=config)
        before = pulled(session, 100)
        if configures:
            session.configure(config.replace("hand.f_max", 50.0))
        speeds.append([step.truth.qd_m for step in (before[-1], *pulled(session, 3))])
    np.testing.assert_array_equal(*speeds)


def test_the_error_refers_to_the_reference_or_the_persons_target(make):
    session = make()
    orientation = session.T_world_ee.rotation.copy()
    away = LATERAL.changed(start=tuple(np.add(LATERAL.start, (0.0, 0.1, 0.0)).tolist()))
    assert session.step(reference=away.reference(0.0, orientation)).ee_error == pytest.approx(
        0.1, abs=1e-3
    )
    step = session.step(pull=PULL)
    at = session.T_world_ee.translation
    assert step.ee_error == pytest.approx(float(np.linalg.norm(at - PULL)))


def test_a_pull_below_the_floor_is_refused(make):
    with pytest.raises(TargetError, match="below the floor"):
        make().step(pull=np.array([0.7, 0.0, -0.01]))


@pytest.mark.parametrize("option", [{"controller": "x"}, {"physics": "x"}])
def test_the_error_of_an_unknown_name_lists_the_known_ones(make, option):
    with pytest.raises(UnknownNameError, match="choose from"):
        make(**option)


def test_a_robot_without_pairs_to_avoid_is_refused_with_its_name(
    robot: RobotModel, border_data: BorderData
):
    data = replace(border_data, pairs=replace(border_data.pairs, mobile=()))
    with pytest.raises(
        DescriptionError, match=r"husky_panda: no monitored part of the arm can meet"
    ):
        Session(robot, data, Config())


@pytest.mark.parametrize("reading", ["base_pose", "base_velocity", "q_m"])
def test_nan_readings_brake_the_robot_are_counted_and_it_recovers(make, monkeypatch, reading):
    session, spoiled = make(), range(60, 260)
    steps: list[Step] = []

    def sensed(measured: Measurement) -> Measurement:
        values = getattr(measured, reading).copy()
        values[0] = np.nan
        return measured._replace(**{reading: values}) if len(steps) in spoiled else measured

    monkeypatch.setattr(session._disturbances, "sensed", sensed)
    while len(steps) < 300:
        steps += pulled(session, 1)
    assert all(np.isfinite(step.control.u_cmd).all() for step in steps)
    assert all(np.isfinite(step.base_command).all() for step in steps)
    braked = [k for k, step in enumerate(steps) if not step.control.solved]
    predicted = 100 if reading == "q_m" else len(spoiled)  # [ms]; the base has a model of its drive
    assert braked == list(spoiled)[predicted:]
    assert session.controller.last.failures == len(braked)
