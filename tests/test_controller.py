"""Properties of the complete Algorithm 2 on the paper's robot."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pinocchio as pin
import pytest
from scipy.optimize import lsq_linear

from app.border.cache import BorderData
from app.config import Config, slowed
from app.control import CONTROLLERS
from app.control.algorithm import response
from app.control.controller import Controller
from app.control.quantities import ControlStep
from app.control.tasks import Reference, free_arm_torque, reaction_torque
from app.errors import MeasurementError, UnknownNameError
from app.robot.link_pairs import PairDistances, candidate_pairs
from app.robot.model import RobotModel
from app.robot.state import Measurement, RobotState
from tests.qps import (
    Limits,
    Rows,
    base_limits,
    ee_task,
    inserted,
    joint_bounds_of,
    least,
    posture_of,
    robot_limits,
    solved,
    with_ee,
)

ZERO = np.zeros(3)
AT_ONCE = Config().replace("limit.torque_rate", 1e6).replace("limit.velocity_rate", 30.0)
"""Torques may change at once. The low rate makes speed limits act early: states without active
limits are far from these."""
UNHELD = AT_ONCE.replace("ee_hold.weight", 0.01)
"""The hold of the end-effector has almost no weight, so that the base follows (29)."""


@pytest.fixture(scope="module")
def controller(robot: RobotModel, border_data: BorderData) -> Controller:
    """Torques may change at once, so that each step shows the demand of the tasks."""
    return Controller(robot, border_data, AT_ONCE)


def measured(robot: RobotModel, q_m: np.ndarray, **more: np.ndarray) -> Measurement:
    rest = Measurement(np.zeros(3), np.zeros(2), q_m, np.zeros(robot.n_m))
    return rest._replace(**more)


def in_buffer(robot: RobotModel, controller: Controller, seed: int, pair: str) -> Measurement:
    """A random slow state with a pair inside its buffer, without contact or active limits."""
    rng = np.random.default_rng(seed)
    reader = PairDistances(robot, candidate_pairs(robot))
    names = [p.name for p in reader.pairs]
    while True:
        q_m = rng.uniform(robot.q_lower + 0.3, robot.q_upper - 0.3)
        reader.update(robot.configuration(ZERO, q_m))
        d = dict(zip(names, reader.distances(), strict=True))
        if not (0.06 < d[pair] < 0.13 and all(v > 0.02 for v in d.values())):
            continue
        velocities = rng.normal(scale=0.05, size=robot.n)
        m = measured(robot, q_m, qd_m=velocities[2:], base_velocity=velocities[:2])
        controller.reset()  # a jump between states must not look like a push
        if not at_a_limit(controller.step(m)):
            return m


def unheld_step(
    controller: Controller, m: Measurement, reference: Reference | None = None
) -> ControlStep:
    """A first step with the configuration `UNHELD`."""
    controller.reset()
    controller.configure(UNHELD)
    output = controller.step(m, reference).copy()
    controller.configure(AT_ONCE)
    return output


def free_torque(robot: RobotModel, w: ControlStep) -> np.ndarray:
    """(n_m,) [N m] torques of a guided arm without avoidance at the state of a step."""
    return free_arm_torque(w.g, w.qd, robot.joint_damping)


def at_a_limit(output: ControlStep) -> bool:
    """Whether the solution is at a limit of torque or joint acceleration."""
    limits = Limits.of(output)
    reached = limits.C @ output.qdd
    return bool(((reached < limits.l + 1e-2) | (reached > limits.u - 1e-2)).any())


def reference_here(controller: Controller, acceleration: np.ndarray) -> Reference:
    T = pin.SE3(controller.state.T_world_ee)
    return Reference(T, np.zeros(6), acceleration)


def reference_at(robot: RobotModel, m: Measurement) -> Reference:
    """A reference at rest at the measured pose of the end-effector."""
    state = RobotState(robot)
    state.update(m)
    return Reference(state.T_world_ee.copy(), np.zeros(6), np.zeros(6))


def test_a_guided_arm_far_from_pairs_only_compensates_gravity_and_damps(
    robot: RobotModel, controller: Controller
) -> None:
    m = measured(robot, np.array(robot.description.arm.ready_position), qd_m=np.full(7, 0.1))
    output = controller.step(m)
    np.testing.assert_allclose(output.u_cmd, free_torque(robot, output), atol=1e-6)
    np.testing.assert_array_equal(output.a_base_cmd, np.zeros(2))
    assert output.activation == 0.0


@pytest.mark.parametrize("name", CONTROLLERS)
def test_a_robot_without_pairs_is_solved_without_avoidance(
    robot: RobotModel, border_data: BorderData, name: str
) -> None:
    data = replace(border_data, pairs=replace(border_data.pairs, mobile=(), manipulator=()))
    controller = Controller(robot, data, AT_ONCE, name=name)
    m = measured(robot, np.array(robot.description.arm.ready_position))
    for reference in (None, reference_at(robot, m)):
        output = controller.step(m, reference)
        assert output.solved
        assert output.pairs == ()


@pytest.mark.parametrize("seed", range(5))
def test_guided_avoidance_adds_only_torques_along_its_rows(
    robot: RobotModel, controller: Controller, seed: int
) -> None:
    """u_a = u_0 + J_rᵀ λ, without a posture term."""
    m = in_buffer(robot, controller, seed, "l1-lEE")
    output = controller.step(m)
    rows = output.J_sca[2:][output.B[2:] > 0.0, 2:]
    near, f_arm = slice(output.n_mob), Config().force.f_arm
    reaction = reaction_torque(output.d[near], output.J[near], f_arm, float(output.d_b), 2)
    added = output.u_cmd - free_torque(robot, output) - reaction
    residual = added - rows.T @ np.linalg.lstsq(rows.T, added, rcond=None)[0]
    assert np.abs(added).max() > 0.1
    np.testing.assert_allclose(residual, 0.0, atol=1e-4)


@pytest.mark.parametrize("seed", range(5))
def test_a_guided_base_blends_desired_acceleration_and_damping_by_beta(
    robot: RobotModel, controller: Controller, seed: int
) -> None:
    m = in_buffer(robot, controller, seed, "lm-lEE")
    output = unheld_step(controller, m)
    beta, rest = output.beta_m, -Config().task.base_damping * m.base_velocity
    base = robot.description.base
    limit = [base.max_linear_acceleration_mps2, base.max_angular_acceleration_radps2]
    expected = np.clip(beta * output.xdd_m + (1 - beta) * rest, np.negative(limit), limit)
    np.testing.assert_allclose(output.a_base_cmd, expected, rtol=0.01, atol=2e-3)


@pytest.mark.parametrize("pair", ["lm-lEE", "l1-lEE"])
@pytest.mark.parametrize("seed", range(3))
def test_the_base_command_equals_29_solved_for_the_whole_body(
    robot: RobotModel, controller: Controller, seed: int, pair: str
) -> None:
    """The controller solves base and arm separately; (29) in one QP gives the same."""
    config = UNHELD.replace("task.base_time_scale", 1.0)
    controller.configure(config)
    m = in_buffer(robot, controller, seed, pair)
    controller.reset()
    controller.step(m)
    reference = reference_here(controller, 0.05 * np.ones(6))
    controller.reset()
    output = controller.step(m, reference)
    controller.configure(AT_ONCE)
    links = len(output.pairs) - output.n_mob
    rows = Rows(output.J_sca, output.b_sca, output.B).of(np.arange(2 + links))
    state, softness = controller.state, config.task.slack_weight
    ee = ee_task(state, reference, config.task)
    objective = with_ee(posture_of(robot, state, m.q_m, config.task), ee, state, config.task)
    objective = inserted(objective, rows, softness)
    limits = robot_limits(robot, state, config.limit, softness).and_also(base_limits(robot))
    whole = solved(objective, limits)
    by_whole, (_, low, high, _) = robot.J_m @ whole[:2], base_limits(robot)
    wanted = np.clip(output.a_base_des, low, high)
    np.testing.assert_allclose(by_whole, wanted, atol=2e-2, rtol=2e-2)
    if not rows.beta[2:].any():  # otherwise the base also makes room for the links
        np.testing.assert_allclose(by_whole, output.a_base_cmd, atol=2e-2, rtol=2e-2)


@pytest.mark.parametrize("seed", [6, 10, 13, 20, 28])
def test_a_tracking_base_spares_joints_near_their_limits(
    robot: RobotModel, controller: Controller, seed: int
) -> None:
    """The arm cannot compensate the demand of the rows alone, but it can compensate the command."""
    m = near_limits(robot, controller, seed)
    output = unheld_step(controller, m, reference_at(robot, m))
    by_rows, commanded = output.a_base_des, output.a_base_cmd
    assert missing(controller.state, by_rows) > 5e-3
    assert missing(controller.state, commanded) < 0.05 * missing(controller.state, by_rows)


@pytest.mark.parametrize("seed", range(3))
def test_distant_joint_limits_do_not_change_a_tracking_base(
    robot: RobotModel, controller: Controller, seed: int
) -> None:
    m = in_buffer(robot, controller, seed, "lm-lEE")
    output = unheld_step(controller, m, reference_at(robot, m))
    np.testing.assert_allclose(output.a_base_cmd, output.a_base_des, rtol=1e-3)


def near_limits(robot: RobotModel, controller: Controller, seed: int) -> Measurement:
    """A state in the buffer with two joints 0.01 rad from a limit and a moving base."""
    rng = np.random.default_rng(seed)
    reader = PairDistances(robot, candidate_pairs(robot))
    while True:
        q_m = rng.uniform(robot.q_lower + 0.3, robot.q_upper - 0.3)
        for i in rng.choice(robot.n_m, 2, replace=False):
            q_m[i] = rng.choice([robot.q_lower[i] + 0.01, robot.q_upper[i] - 0.01])
        reader.update(robot.configuration(ZERO, q_m))
        if min(reader.distances()) < 0.04:
            continue
        m = measured(robot, q_m, base_velocity=rng.uniform(-0.2, 0.2, 2))
        controller.reset()
        if controller.step(m).beta_m > 0.1:
            return m


def missing(state: RobotState, base: np.ndarray) -> float:
    """[m/s²] acceleration of the end-effector that remains if the arm tries to keep it at rest.

    The joint limits have the slow approach rates of `app.config.slowed`.

    Args:
        state: State of the robot.
        base: (2,) the commanded base acceleration; the admittance law responds to it.
    """
    law, by_axis = UNHELD.admittance, state.model.description.base.by_axis
    inertia, damping = by_axis(law.mass, law.inertia), by_axis(law.damping, law.angular_damping)
    gain, drag = response(inertia, damping, law.period)
    moved = state.model.J_m_inv @ (gain * (base - drag * state.measurement.base_velocity))
    slow = slowed(UNHELD)
    hold = Reference(state.T_world_ee, np.zeros(6), np.zeros(6))
    task = ee_task(state, hold, slow.task)
    wanted = task.b - task.J[:, :2] @ moved
    bounds = joint_bounds_of(state.model, state, slow.limit)
    return float(np.linalg.norm(lsq_linear(task.J[:, 2:], wanted, bounds).fun))


def test_a_failed_base_qp_leaves_the_arm_solved_and_is_counted(
    robot: RobotModel, border_data: BorderData
) -> None:
    """NaN gains, which only the QP over base and arm uses, make this QP fail."""
    task = Config().task.model_copy(update={"base_time_scale": np.nan})
    controller = Controller(robot, border_data, Config().model_copy(update={"task": task}))
    m = measured(robot, np.array(robot.description.arm.ready_position))
    output = controller.step(m, reference_at(robot, m))
    assert output.solved
    assert (output.failures, output.given_up) == (0, 1)
    np.testing.assert_array_equal(output.a_base_cmd, np.zeros(2))


@pytest.mark.parametrize("seed", range(5))
def test_the_end_effectors_task_precedes_the_posture_by_its_weight(
    robot: RobotModel, controller: Controller, seed: int
) -> None:
    """The error due to the posture task tends to zero as the weight grows."""
    rng = np.random.default_rng(seed)
    q_m = np.array([0.3, 0.6, 0.1, -1.6, 0.2, 2.2, 0.5]) + rng.normal(scale=0.1, size=7)
    controller.reset()
    controller.step(measured(robot, q_m))
    state, reference = controller.state, reference_here(controller, rng.normal(size=6))
    ee = ee_task(state, reference, Config().task)
    off = []
    for weight in (1e1, 1e3, 1e5, 1e7):
        task = Config().task.model_copy(update={"ee_weight": weight})
        qdd = least(with_ee(posture_of(robot, state, q_m + 0.5, task), ee, state, task))
        off.append(np.abs(ee.J @ qdd - ee.b).max())
    assert all(a > 10 * b for a, b in pairwise(off))
    assert off[2] < 1e-2


@pytest.mark.parametrize("seed", range(5))
def test_tracking_compensates_the_base_acceleration_at_the_end_effector(
    robot: RobotModel, controller: Controller, seed: int
) -> None:
    """Forward dynamics with this base acceleration return ẍ_d at the end-effector."""
    rng = np.random.default_rng(seed)
    q_m = np.array([0.3, 0.6, 0.1, -1.6, 0.2, 2.2, 0.5]) + rng.normal(scale=0.1, size=7)
    m = measured(
        robot, q_m, qd_m=rng.normal(scale=0.05, size=7), base_velocity=np.array([0.1, 0.1])
    )
    controller.reset()
    controller.step(m)
    wanted = rng.normal(scale=0.3, size=6)
    v_ee = controller.state.v_ee.copy()
    reference = Reference(pin.SE3(controller.state.T_world_ee), v_ee, wanted)
    base = np.array([-0.4, 0.3])
    controller.reset()
    output = controller.step(m, reference, base_acceleration=base)
    state = controller.state
    qdd = np.empty(robot.n)
    qdd[:2] = np.linalg.solve(robot.J_m, base)
    rhs = output.u_cmd - state.h[2:] - state.M[2:, :2] @ qdd[:2]
    qdd[2:] = np.linalg.solve(state.M[2:, 2:], rhs)
    np.testing.assert_allclose(state.J_ee @ qdd + state.Jdqd_ee, wanted, atol=1e-2)


def test_the_base_stays_while_the_arm_can_do_the_task_alone(
    robot: RobotModel, controller: Controller
) -> None:
    m = measured(robot, np.array(robot.description.arm.ready_position))
    controller.reset()
    controller.step(m)
    output = controller.step(m, reference_here(controller, np.array([0.1, 0.1, 0.1, 0, 0, 0])))
    assert np.abs(output.a_base_cmd).max() < 2e-3


def test_torques_stay_within_limits_for_an_infeasible_reference(
    robot: RobotModel, controller: Controller
) -> None:
    m = measured(robot, np.array(robot.description.arm.ready_position))
    controller.reset()
    controller.step(m)
    output = controller.step(m, reference_here(controller, np.full(6, 60.0)))
    assert output.solved
    assert (np.abs(output.u_cmd) <= robot.tau_max + 1e-9).all()


@pytest.mark.parametrize("seed", range(3))
def test_a_joint_beyond_its_limit_accelerates_back(
    robot: RobotModel, border_data: BorderData, seed: int
) -> None:
    controller = Controller(robot, border_data, AT_ONCE, name="none")
    rng = np.random.default_rng(seed)
    q_m = np.array(robot.description.arm.ready_position)
    i = int(rng.integers(7))
    q_m[i] = robot.q_upper[i] + 0.01
    m = measured(robot, q_m)
    output = controller.step(m)
    state = controller.state
    qdd = np.linalg.solve(state.M[2:, 2:], output.u_cmd - state.h[2:])
    assert qdd[i] < -1.0


def test_a_failed_qp_gives_the_safe_command_and_is_counted(
    robot: RobotModel, border_data: BorderData
) -> None:
    """A far too large base acceleration makes the arm's QP fail."""
    controller = Controller(robot, border_data, Config())
    m = measured(
        robot,
        np.array(robot.description.arm.ready_position),
        qd_m=np.full(7, 0.2),
        base_velocity=np.array([0.3, -0.2]),
    )
    output = controller.step(m, base_acceleration=np.full(2, 1e308))
    assert not output.solved
    assert output.failures == 1
    np.testing.assert_allclose(output.u_cmd, free_torque(robot, output))
    assert (output.a_base_cmd * m.base_velocity < 0).all()


def test_a_reference_that_is_not_finite_is_refused_and_changes_nothing(
    robot: RobotModel, border_data: BorderData
) -> None:
    spoiled_one, other = (Controller(robot, border_data, Config()) for _ in range(2))
    m = measured(robot, np.array(robot.description.arm.ready_position))
    reference = reference_at(robot, m)
    with pytest.raises(MeasurementError, match="finite"):
        spoiled_one.step(m, reference._replace(velocity=np.full(6, np.nan)))
    np.testing.assert_array_equal(
        spoiled_one.step(m, reference).u_cmd, other.step(m, reference).u_cmd
    )


def test_initial_nan_measurements_do_not_become_the_posture(
    robot: RobotModel, border_data: BorderData
) -> None:
    """After initial NaN, the results equal those without NaN."""
    good = measured(robot, np.array(robot.description.arm.ready_position) + 0.1)
    late, well = (Controller(robot, border_data, Config()) for _ in range(2))
    for _ in range(3):
        bad = good._replace(q_m=np.full(robot.n_m, np.nan))
        first = late.step(bad, Reference(late.state.T_world_ee.copy(), np.zeros(6), np.zeros(6)))
        assert not first.solved
        assert np.isfinite(first.u_cmd).all()
    reference = reference_at(robot, good)
    for _ in range(2):
        np.testing.assert_array_equal(
            late.step(good, reference).u_cmd, well.step(good, reference).u_cmd
        )
    assert (late.last.failures, well.last.failures) == (3, 0)
    np.testing.assert_array_equal(late.last.q_posture, good.q_m)


def test_the_command_does_not_depend_on_the_base_pose_in_the_world(
    robot: RobotModel, controller: Controller
) -> None:
    m = in_buffer(robot, controller, 1, "lm-lEE")
    controller.reset()
    here = controller.step(m).copy()
    controller.reset()
    there = controller.step(m._replace(base_pose=np.array([3.0, -2.0, 1.1])))
    np.testing.assert_allclose(there.a_base_cmd, here.a_base_cmd, atol=1e-6)
    np.testing.assert_allclose(there.u_cmd, here.u_cmd, atol=1e-5)


def test_no_torque_changes_faster_than_its_limit(
    robot: RobotModel, controller: Controller, border_data: BorderData
) -> None:
    """After a jump between two postures, the torques change at the limit of their rate."""
    slow = Controller(robot, border_data, Config())
    ready = measured(robot, np.array(robot.description.arm.ready_position))
    other = measured(robot, np.array([0.5, 0.5, 0.3, -1.5, 0.2, 2.0, 0.1]))
    torques = [slow.step(ready).u_cmd.copy()]
    torques += [slow.step(other).u_cmd.copy() for _ in range(100)]
    changes = np.abs(np.diff(torques, axis=0))
    assert changes.max() == pytest.approx(Config().limit.torque_rate * 0.001)
    controller.reset()  # the jump must not look like a push
    np.testing.assert_allclose(torques[-1], controller.step(other).u_cmd, atol=1e-6)


def test_controller_none_inserts_no_avoidance(robot: RobotModel, border_data: BorderData) -> None:
    plain = Controller(robot, border_data, AT_ONCE, name="none")
    m = in_buffer(robot, plain, 0, "lm-lEE")
    output = plain.step(m)
    assert output.activation == 0.0
    np.testing.assert_allclose(output.u_cmd, free_torque(robot, output), atol=1e-6)


def test_the_error_of_an_unknown_controller_lists_the_known_ones(
    robot: RobotModel, border_data: BorderData
) -> None:
    with pytest.raises(UnknownNameError, match="dbb, hqp, none"):
        Controller(robot, border_data, Config(), name="dbbb")


@pytest.mark.parametrize("seed", range(3))
def test_the_base_yields_less_if_the_arm_is_too_slow_to_compensate(
    robot: RobotModel, border_data: BorderData, controller: Controller, seed: int
) -> None:
    """The slow arm has 2 % of its joint speed limits."""
    m = measured(robot, in_buffer(robot, controller, seed, "lm-lEE").q_m)
    slow = slower(robot, 0.02)
    controller.reset()
    held, taken = (c.step(m) for c in (controller, Controller(slow, border_data, AT_ONCE)))
    assert held.beta_m == taken.beta_m > 0.05
    commanded = np.linalg.norm(held.a_base_cmd)
    assert commanded > 0.005
    assert np.linalg.norm(taken.a_base_cmd) < 0.15 * commanded


def slower(robot: RobotModel, arm: float) -> RobotModel:
    """The robot with its joint speed limits times `arm`."""
    speeds = tuple(float(v) for v in robot.qd_max * arm)
    changed = robot.description.arm.model_copy(update={"max_velocity": speeds})
    return RobotModel(robot.description.model_copy(update={"arm": changed}))
