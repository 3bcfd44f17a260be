"""Properties of kinematics and dynamics in the reduced coordinates."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest

from app.robot.bases.differential import mobile_jacobian
from app.robot.state import Measurement, RobotState, point_bias
from tests.finite_differences import derivative, jacobian
from tests.robots import husky_panda, random_measurement, random_state

SEEDS = range(5)


def moved(m: Measurement, dq: np.ndarray) -> Measurement:
    """The measurement m after a small displacement dq of wheels and arm [rad]; the wheels roll."""
    forward, turn = husky_panda().J_m @ dq[:2]
    x, y, phi = m.base_pose
    middle = phi + turn / 2
    pose = np.array([x + forward * np.cos(middle), y + forward * np.sin(middle), phi + turn])
    return m._replace(base_pose=pose, q_m=m.q_m + dq[2:])


def state_at(m: Measurement) -> RobotState:
    state = RobotState(husky_panda())
    state.update(m)
    return state


def moved_point(joint: int, p_world: np.ndarray, at: RobotState, to: RobotState) -> np.ndarray:
    """(3,) [m] position in the state `to` of the body's point that is at `p_world` in `at`."""
    return to.data.oMi[joint].act(at.data.oMi[joint].actInv(p_world))


@pytest.mark.parametrize("seed", SEEDS)
def test_end_effector_jacobian_is_the_derivative_of_its_pose(seed):
    m = random_measurement(np.random.default_rng(seed))
    state = state_at(m)
    T = state.T_world_ee.copy()

    def displacement(dq):
        now = state_at(moved(m, dq)).T_world_ee
        return np.concatenate([now.translation, pin.log3(now.rotation @ T.rotation.T)])

    np.testing.assert_allclose(state.J_ee, jacobian(displacement, state.model.n), atol=1e-8)


@pytest.mark.parametrize("seed", SEEDS)
def test_end_effector_bias_is_the_jacobians_derivative_times_velocity(seed):
    m = random_measurement(np.random.default_rng(seed))
    state = state_at(m)
    qd = state.qd.copy()
    expected = derivative(lambda t: state_at(moved(m, qd * t)).J_ee @ qd)
    np.testing.assert_allclose(state.Jdqd_ee, expected, atol=1e-7)
    np.testing.assert_allclose(state.v_ee, state.J_ee @ qd, atol=1e-12)


@pytest.mark.parametrize("seed", SEEDS)
def test_point_jacobian_is_the_derivative_of_the_point(seed):
    rng = np.random.default_rng(seed)
    m = random_measurement(rng)
    state = state_at(m)
    for joint in range(1, state.model.pin.njoints):
        p = state.data.oMi[joint].translation + rng.uniform(-0.3, 0.3, 3)

        def point(dq, joint=joint, p=p):
            return moved_point(joint, p, state, state_at(moved(m, dq)))

        expected = jacobian(point, state.model.n)
        np.testing.assert_allclose(state.point_jacobian(joint, p), expected, atol=1e-8)


@pytest.mark.parametrize("seed", SEEDS)
def test_point_bias_is_the_acceleration_at_zero_joint_acceleration(seed):
    rng = np.random.default_rng(seed)
    m = random_measurement(rng)
    state = state_at(m)
    qd = state.qd.copy()
    for joint in range(1, state.model.pin.njoints):
        p = state.data.oMi[joint].translation + rng.uniform(-0.3, 0.3, 3)

        def velocity(t, joint=joint, p=p):
            then = state_at(moved(m, qd * t))
            return then.point_jacobian(joint, moved_point(joint, p, state, then)) @ qd

        bias = point_bias(state.twists[joint], state.biases[joint], p)
        np.testing.assert_allclose(bias, derivative(velocity), atol=1e-7)


@pytest.mark.parametrize("seed", SEEDS)
def test_inertia_matrix_is_positive_definite_and_gives_kinetic_energy(seed):
    state = random_state(np.random.default_rng(seed))
    np.testing.assert_allclose(state.M, state.M.T, atol=1e-12)
    assert np.linalg.eigvalsh(state.M).min() > 0
    v = state.model.S @ state.qd
    q = state.model.configuration(state.measurement.base_pose, state.measurement.q_m)
    energy = pin.computeKineticEnergy(state.model.pin, state.model.pin.createData(), q, v)
    assert 0.5 * state.qd @ state.M @ state.qd == pytest.approx(energy, rel=1e-12)


@pytest.mark.parametrize("seed", SEEDS)
def test_reduced_forces_do_the_work_of_the_full_ones(seed):
    """q̇ᵀ (M_r q̈ + h_r) = vᵀ rnea(q, v, S q̈): the reduction by S loses no power."""
    rng = np.random.default_rng(seed)
    state = random_state(rng)
    qdd = rng.normal(size=state.model.n)
    model, S = state.model.pin, state.model.S
    q = state.model.configuration(state.measurement.base_pose, state.measurement.q_m)
    tau = pin.rnea(model, model.createData(), q, S @ state.qd, S @ qdd)
    reduced = state.M @ qdd + state.h
    assert state.qd @ reduced == pytest.approx((S @ state.qd) @ tau, rel=1e-10, abs=1e-9)
    np.testing.assert_allclose(reduced, S.T @ tau, atol=1e-9)


@pytest.mark.parametrize("seed", SEEDS)
def test_gravity_is_the_gradient_of_the_potential_energy(seed):
    m = random_measurement(np.random.default_rng(seed))
    state = state_at(m)
    model = state.model

    def potential(dq):
        at = moved(m, dq)
        q = model.configuration(at.base_pose, at.q_m)
        return pin.computePotentialEnergy(model.pin, model.pin.createData(), q)

    np.testing.assert_allclose(state.g, jacobian(potential, model.n), atol=2e-6)


def test_mobile_jacobian_gives_the_planar_motion_of_the_papers_control_point():
    """[[cos φ, -y], [sin φ, x]] J_m is the Jacobian (6) of a point of the base at heading φ."""
    r, b = 0.165, 0.51
    rng = np.random.default_rng(0)
    for _ in range(20):
        phi, x, y = rng.uniform(-3, 3, 3)  # x, y: from the base's centre, in axes of the world

        def point(d, phi=phi, x=x, y=y):
            right, left = d
            turn, forward = r * (right - left) / (2 * b), r * (right + left) / 2
            c, s = np.cos(turn), np.sin(turn)
            middle = phi + turn / 2
            return np.array(
                [forward * np.cos(middle) + c * x - s * y, forward * np.sin(middle) + s * x + c * y]
            )

        planar = np.array([[np.cos(phi), -y], [np.sin(phi), x]]) @ mobile_jacobian(r, b)
        np.testing.assert_allclose(planar, jacobian(point, 2), atol=1e-9)


def test_equal_wheels_drive_straight_and_opposite_ones_turn_on_the_spot():
    J_m = mobile_jacobian(0.2, 0.5)
    np.testing.assert_allclose(J_m @ [1.0, 1.0], [0.2, 0.0], atol=1e-15)
    np.testing.assert_allclose(J_m @ [1.0, -1.0], [0.0, 0.4], atol=1e-15)


def test_to_base_and_to_world_are_inverse_to_each_other():
    rng = np.random.default_rng(3)
    state = random_state(rng)
    p = rng.normal(size=3)
    np.testing.assert_allclose(state.to_base(state.to_world(p)), p, atol=1e-12)
    np.testing.assert_allclose(state.to_world(np.zeros(3))[:2], state.measurement.base_pose[:2])


def test_base_pose_does_not_change_the_robot_in_the_base_frame():
    rng = np.random.default_rng(4)
    m = random_measurement(rng)
    here, home = state_at(m), state_at(m._replace(base_pose=np.zeros(3)))
    np.testing.assert_allclose(
        here.to_base(here.T_world_ee.translation), home.T_world_ee.translation, atol=1e-12
    )
    np.testing.assert_allclose(here.M, home.M, atol=1e-10)
    np.testing.assert_allclose(here.h, home.h, atol=1e-9)


@pytest.mark.parametrize("seed", SEEDS)
def test_update_kinematics_agrees_with_a_full_update(seed):
    rng = np.random.default_rng(seed)
    state, m = state_at(random_measurement(rng)), random_measurement(rng)
    whole = state_at(m)
    state.update_kinematics(m)
    for name in ("qd", "J_ee", "v_ee", "Jdqd_ee", "R_world_base", "p_o"):
        np.testing.assert_allclose(getattr(state, name), getattr(whole, name), atol=1e-12)
    np.testing.assert_allclose(state.T_world_ee.homogeneous, whole.T_world_ee.homogeneous)
    for joint in range(1, state.model.pin.njoints):
        p = whole.data.oMi[joint].translation + rng.uniform(-0.3, 0.3, 3)
        J, J_whole = state.point_jacobian(joint, p), whole.point_jacobian(joint, p)
        np.testing.assert_allclose(J, J_whole, atol=1e-11)
        bias, whole_bias = (point_bias(s.twists[joint], s.biases[joint], p) for s in (state, whole))
        np.testing.assert_allclose(bias, whole_bias, atol=1e-11)


def test_measurements_may_be_read_only_or_strided_arrays():
    """The arrays of snapshots are read-only."""
    robot = husky_panda()
    m = random_measurement(np.random.default_rng(5))
    frozen = Measurement(*(np.repeat(values, 2)[::2] for values in m))
    for values in frozen:
        values.setflags(write=False)
    state, same = RobotState(robot), RobotState(robot)
    state.update(m)
    same.update(frozen)
    np.testing.assert_array_equal(same.M, state.M)
    np.testing.assert_array_equal(same.J_ee, state.J_ee)
    p = np.array([0.3, 0.2, 0.5])
    p.setflags(write=False)
    np.testing.assert_array_equal(same.point_jacobian(3, p), state.point_jacobian(3, p))
