"""An end-effector that stops before its target: its position, the reasons and the exceptions."""

from __future__ import annotations

import json
from collections.abc import Iterator

import numpy as np
import pinocchio as pin
import pytest

from app.border.cache import BorderData
from app.config import Config
from app.control.tasks import Reference
from app.robot.model import RobotModel
from app.simulation.session import Session, Step
from app.simulation.trace.trace import SHORT, Recorder, find_stuck

ABOVE = np.array([0.0, 0.0, 2.5])  # [m] above the reach of the arm
STILL = 0.02  # [m/s], [rad/s]


def reference_at(session: Session, p: np.ndarray) -> Reference:
    return Reference(pin.SE3(session.T_world_ee.rotation, p), np.zeros(6), np.zeros(6))


@pytest.fixture(scope="module")
def session(robot: RobotModel, border_data: BorderData) -> Session:
    return Session(robot, border_data, Config(), physics="kinematic")


@pytest.fixture
def short(session: Session) -> Step:
    """One step at the ready posture, 5 cm from a target at rest."""
    session.reset(np.array(session.model.description.arm.ready_position))
    p = session.T_world_ee.translation + np.array([0.05, 0.0, 0.0])
    return session.step(reference_at(session, p))


def test_end_effector_at_its_target_is_not_stuck(session: Session):
    session.reset(np.array(session.model.description.arm.ready_position))
    p = session.T_world_ee.translation + np.array([0.9 * SHORT, 0.0, 0.0])
    assert find_stuck(session.model, session.step(reference_at(session, p))) is None


def test_end_effector_without_a_resting_reference_is_not_stuck(session, short: Step):
    assert find_stuck(session.model, short) is not None
    assert find_stuck(session.model, short._replace(reference=None)) is None
    moving = short.reference._replace(velocity=np.array([0.1, 0, 0, 0, 0, 0]))
    assert find_stuck(session.model, short._replace(reference=moving)) is None


def test_report_contains_actual_and_target_position(session, short: Step):
    stuck = find_stuck(session.model, short)
    np.testing.assert_allclose(np.subtract(stuck.target_m, stuck.ee_m), [0.05, 0, 0], atol=1e-12)
    assert stuck.ee_error_m == pytest.approx(0.05)
    assert stuck.reasons == ("unknown",)
    assert json.loads(json.dumps(stuck._asdict()))["joints"] == []


def test_report_names_joints_at_their_limits(session, short: Step):
    q_m = short.truth.q_m.copy()
    q_m[3], q_m[5] = session.model.q_lower[3], session.model.q_upper[5] - 1e-3
    stuck = find_stuck(session.model, short._replace(truth=short.truth._replace(q_m=q_m)))
    assert "joint limits" in stuck.reasons
    assert stuck.joints == ("panda_joint4", "panda_joint6")


def test_log_reports_the_largest_deviation_from_the_path_and_its_joints(
    session: Session, short: Step
):
    """The reference moves, and the end-effector is back on its path at the end."""
    q_m = short.truth.q_m.copy()
    q_m[4] = session.model.q_lower[4]
    assert short.reference is not None
    moving = short.reference._replace(velocity=np.array([0.1, 0, 0, 0, 0, 0]))
    off = short._replace(t=1.0, reference=moving, truth=short.truth._replace(q_m=q_m))
    recorder = Recorder()
    for step in (short._replace(ee_error=0.5 * SHORT, reference=moving), off):
        recorder.add(session, step)
        recorder.add(session, short._replace(ee_error=2 * SHORT, reference=moving))
    recorder.add(session, short._replace(ee_error=0.0))
    meta = recorder.trace().meta
    assert meta.stuck is None
    assert meta.left_way is not None
    assert (meta.left_way["t_s"], meta.left_way["ee_error_m"]) == (1.0, pytest.approx(0.05))
    assert meta.left_way["joints"] == ("panda_joint5",)


def test_small_deviation_from_the_path_is_not_reported(session: Session, short: Step):
    recorder = Recorder()
    recorder.add(session, short._replace(ee_error=0.9 * SHORT))
    recorder.add(session, short._replace(reference=None))
    assert recorder.trace().meta.left_way is None


@pytest.mark.parametrize(("push", "reported"), [(-0.5, True), (0.5, False)])
def test_report_names_avoidance_that_moves_the_base_off_the_target(
    session, short: Step, push: float, reported: bool
):
    control = short.control.copy()
    control.B[:2], control.xdd_m[:] = 1.0, (push, 0.0)  # the target is ahead
    stuck = find_stuck(session.model, short._replace(control=control))
    assert ("border against end-effector" in stuck.reasons) == reported


def test_report_names_links_in_their_buffer_and_joints_at_top_speed(session, short: Step):
    control = short.control.copy()
    assert not control.B.any()
    control.B[2] = 0.02
    near = short._replace(control=control)
    assert find_stuck(session.model, near).reasons == ("links too near",)
    fast = short._replace(truth=short.truth._replace(qd_m=-session.model.qd_max))
    assert "joint speeds" in find_stuck(session.model, fast).reasons


def test_report_names_an_end_effector_that_still_moves(session, short: Step):
    qd_m = np.linalg.pinv(session.state.J_ee[:3, 2:]) @ [0.05, 0.0, 0.0]
    truth = short.truth._replace(qd_m=qd_m, base_velocity=np.zeros(2))
    assert "still moving" in find_stuck(session.model, short._replace(truth=truth)).reasons


def until_rest(session: Session, reference: Reference, most: int) -> Iterator[Step]:
    """At most `most` steps, until the robot has been at rest for 1 s."""
    still = 0
    for _ in range(most):
        step = session.step(reference)
        yield step
        moves = np.abs([*step.truth.base_velocity, *step.truth.qd_m]).max() >= STILL
        still = 0 if moves else still + 1
        if still == 1000:
            return


@pytest.mark.slow
@pytest.mark.parametrize("target", [[-2.5, 0.0, 0.5], [0.5, 2.0, 0.4]], ids=["behind", "beside"])
def test_base_drives_to_a_target_out_of_reach_of_the_arm(
    robot: RobotModel, border_data: BorderData, target: list[float]
):
    session = Session(robot, border_data, Config(), physics="kinematic")
    session.reset(np.array(robot.description.arm.ready_position))
    for step in until_rest(session, reference_at(session, np.array(target)), 11000):
        assert step.control.solved
    assert step.ee_error < 1e-3
    assert np.abs(step.truth.base_velocity).max() < STILL
    assert find_stuck(robot, step) is None


@pytest.mark.slow
@pytest.mark.parametrize("target", [ABOVE, [0.6, 0.8, -0.3]], ids=["above", "below"])
def test_robot_with_an_unreachable_target_comes_to_rest_with_a_reason(
    robot: RobotModel, border_data: BorderData, target: list[float]
):
    session = Session(robot, border_data, Config(), physics="kinematic")
    session.reset(np.array(robot.description.arm.ready_position))
    reference, nearest, share = reference_at(session, np.array(target)), np.inf, 0.0
    for step in until_rest(session, reference, 16000):
        nearest = min(nearest, *step.distances)
        share = max(share, np.max(np.abs(step.truth.qd_m) / robot.qd_max))
    assert nearest >= 0.025  # the base drives towards its target meanwhile
    assert share <= 1.01
    assert np.abs(step.truth.base_velocity).max() < STILL
    assert np.abs(step.truth.qd_m).max() < STILL
    stuck = find_stuck(robot, step)
    assert stuck.ee_error_m > 0.1
    assert {"full stretch", "joint limits"} & set(stuck.reasons), stuck
