"""Properties of every plant."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest

from app.errors import UnknownNameError
from app.robot.state import RobotState
from app.simulation.plants import PLANTS, make_physics
from tests.robots import husky_panda

MODEL = husky_panda()
READY = np.array(MODEL.description.arm.ready_position)
DAMPING = np.array(MODEL.description.arm.joint_damping)
NOBODY = np.zeros(3)


@pytest.fixture(scope="module", params=PLANTS)
def plant(request):
    """One plant for all tests: each test starts with a reset, which removes all previous state."""
    plant = make_physics(request.param, MODEL)
    plant.kind = request.param
    yield plant
    plant.close()


@pytest.fixture
def planar():
    plant = make_physics("planar", MODEL)
    yield plant
    plant.close()


def hold(state: RobotState) -> np.ndarray:
    """Torques that hold the arm's posture during any base motion."""
    m, M_aa = state.measurement, state.M[2:, 2:]
    return state.h[2:] + M_aa @ (400.0 * (READY - m.q_m) - 40.0 * m.qd_m)


def run(plant, seconds: float, command, torques=hold, force=NOBODY) -> list:
    """Measurements of a run, each before its step."""
    state, trace = RobotState(MODEL), []
    for k in range(round(seconds / plant.dt)):
        trace.append(plant.measure())
        state.update(trace[-1])
        plant.step(
            torques(state),
            command(k * plant.dt) if callable(command) else command,
            force(k * plant.dt) if callable(force) else force,
        )
    return trace


def wave(t: float) -> tuple[float, float]:
    return 0.4 * np.sin(1.5 * t), 0.6 * np.cos(2.0 * t)


def test_reset_puts_the_plant_at_rest_in_the_given_state(plant):
    for pose, q in (((0.0, 0.0, 0.0), READY), ((1.0, -2.0, 2.5), READY + 0.1)):
        plant.reset(np.array(pose), q)
        m = plant.measure()
        np.testing.assert_allclose(m.base_pose, pose, atol=1e-6)
        np.testing.assert_allclose(m.q_m, q, atol=1e-12)
        np.testing.assert_allclose(m.base_velocity, 0, atol=1e-9)
        np.testing.assert_allclose(m.qd_m, 0, atol=1e-12)
        assert not any(plant.contacts())


@pytest.mark.slow
def test_gravity_compensation_holds_the_arm(plant):
    plant.reset(np.zeros(3), READY)
    damping = DAMPING if plant.kind == "mujoco-contact" else 0.0
    trace = run(plant, 5.0, (0.0, 0.0), torques=lambda s: s.g[2:] - damping * s.qd[2:])
    # The base on tyres tilts by 1 mrad, which the compensation does not include.
    limit = {"mujoco-contact": 0.1}.get(plant.kind, 1e-9)
    assert np.abs(trace[-1].q_m - READY).max() < limit
    assert np.abs(trace[-1].base_pose).max() < (3e-3 if plant.kind == "mujoco-contact" else 1e-9)


@pytest.mark.slow
@pytest.mark.parametrize("command", [(0.5, 0.0), (0.0, 0.8), (0.4, -0.6), (-0.3, 0.5)])
def test_commanded_velocity_is_followed(plant, command):
    plant.reset(np.array([0.5, -0.5, 1.0]), READY)
    trace = run(plant, 2.0, command)
    error = np.array([m.base_velocity for m in trace[1000:]]) - command
    v_limit, w_limit = {  # m/s, rad/s
        "planar": (1e-5, 1e-5),
        "mujoco": (1e-5, 1e-5),
        "kinematic": (1e-8, 1e-8),
        "mujoco-contact": (0.03, 0.06),
    }[plant.kind]
    assert np.abs(error[:, 0]).max() < v_limit
    assert np.abs(error[:, 1]).max() < w_limit


def test_path_is_the_circle_of_the_commanded_velocities(plant):
    if plant.kind == "mujoco-contact":
        pytest.skip("four wheels skid; test_mujoco_wheels.py has the test for two")
    plant.reset(np.zeros(3), READY)
    v, w = 0.4, 0.8
    run(plant, 1.0, (v, w))
    start = plant.measure().base_pose
    run(plant, 2.0, (v, w))
    turn = pin.SE3(pin.rpy.rpyToMatrix(0, 0, start[2]), np.array([*start[:2], 0.0]))
    arc = np.array([v / w * np.sin(w * 2.0), v / w * (1 - np.cos(w * 2.0)), 0.0])
    end = plant.measure().base_pose
    np.testing.assert_allclose(end[:2], turn.act(arc)[:2], atol=1e-4)
    assert end[2] == pytest.approx(start[2] + 2.0 * w, abs=1e-4)


def test_base_at_rest_does_not_creep_when_the_arm_moves(plant):
    """The drive holds the base against the arm, up to its traction."""
    plant.reset(np.zeros(3), READY)
    swing = np.array([0.3, 0.2, 0.3, 0.2, 0.3, 0.2, 0.3])

    def torques(state):
        t = len(times) * plant.dt
        times.append(t)
        m = state.measurement
        goal = READY + swing * np.sin(3 * t)
        return state.h[2:] + state.M[2:, 2:] @ (400 * (goal - m.q_m) - 40 * m.qd_m)

    times: list[float] = []
    trace = run(plant, 3.0, (0.0, 0.0), torques)
    moved = np.abs([m.base_pose for m in trace]).max(axis=0)
    assert np.ptp([m.q_m for m in trace], axis=0).min() > 0.2
    assert moved.max() < (3e-3 if plant.kind == "mujoco-contact" else 1e-5)


def test_force_on_the_end_effector_satisfies_the_equation_of_motion(plant):
    """One step from rest with the base fixed: M_aa q̈_a = Jᵀ f."""
    plant.reset(np.zeros(3), READY)
    state = RobotState(MODEL)
    state.update(plant.measure())
    f = np.array([7.0, -4.0, 5.0])
    plant.step(state.g[2:], (0.0, 0.0), f)
    expected = np.linalg.solve(state.M[2:, 2:], state.J_ee[:3, 2:].T @ f) * plant.dt
    limit = {"planar": 1e-6, "mujoco": 1e-6, "kinematic": 1e-12, "mujoco-contact": 2e-3}[plant.kind]
    np.testing.assert_allclose(plant.measure().qd_m, expected, atol=limit)
    assert np.abs(expected).max() > 0.01


@pytest.mark.slow
@pytest.mark.parametrize("joint", range(7))
@pytest.mark.parametrize("sign", [-1, 1])
def test_torque_into_a_joint_limit_stays_stable(plant, joint, sign):
    """With half of the torque limit for 1 s the joint stays at its position limit."""
    limits = MODEL.q_lower if sign < 0 else MODEL.q_upper
    q = np.array([0.0, -0.3, 0.0, -0.8, 0.0, 1.6, 0.8])  # all limits can be reached from here
    q[joint] = limits[joint] - sign * 0.15
    plant.reset(np.zeros(3), q)
    push = np.zeros(7)
    push[joint] = sign * 0.5 * MODEL.tau_max[joint]

    def torques(state):
        m, M_aa = state.measurement, state.M[2:, 2:]
        others = np.where(np.arange(7) == joint, 0.0, q - m.q_m)
        return state.h[2:] + M_aa @ (200 * others - 30 * m.qd_m) + push

    trace = run(plant, 1.0, (0.0, 0.0), torques)
    beyond = [max((m.q_m - MODEL.q_upper).max(), (MODEL.q_lower - m.q_m).max()) for m in trace]
    assert np.max(beyond) < 0.02  # [rad]
    end = np.array([m.q_m for m in trace[-300:]])
    assert np.abs(end[:, joint] - limits[joint]).max() < 0.005  # [rad] small rattling is acceptable
    assert np.ptp(end, axis=0).max() < 0.01


@pytest.mark.slow
def test_equal_inputs_give_bitwise_equal_states(plant):
    """After a first start, after a reset during contact, and with another plant running."""

    def trace(p, beside=None):
        p.reset(np.array([0.1, 0.2, 0.3]), READY)
        state, out = RobotState(MODEL), []
        for k in range(400):
            m = p.measure()
            state.update(m)
            out.append(np.concatenate(m[:5]))
            p.step(state.g[2:] - DAMPING * m.qd_m, wave(k * p.dt), np.array([-30.0, 9.0, -30.0]))
            if beside is not None:
                beside.step(READY, (0.5, 0.5), NOBODY)
        return np.array(out)

    first = trace(plant)
    run(plant, 1.0, (0.1, 0.0), lambda s: s.g[2:] - DAMPING * s.qd[2:], np.array([-40.0, 0, -40.0]))
    np.testing.assert_array_equal(trace(plant), first)
    other, third = make_physics(plant.kind, MODEL), make_physics("planar", MODEL)
    np.testing.assert_array_equal(trace(other, beside=third), first)
    other.close()
    third.close()
    np.testing.assert_array_equal(trace(plant), first)


def test_measuring_does_not_change_the_simulation(plant):
    ends = []
    for every in (10, 1):
        plant.reset(np.array([0.3, -0.2, 0.7]), READY)
        for k in range(300):
            if k % every == 0:
                plant.measure()
            plant.step(np.zeros(7), np.array(wave(k * plant.dt)), NOBODY)
        ends.append(np.concatenate(plant.measure()[:5]))
    np.testing.assert_array_equal(*ends)


def test_kinematic_and_planar_plants_agree_on_the_same_torques(planar):
    """Within 0.1 mm and 0.1 mrad of the base and 2 mrad of the arm over 1 s."""
    kinematic = make_physics("kinematic", MODEL)
    state, worst_base, worst_arm = RobotState(MODEL), 0.0, 0.0
    for k in range(1000):
        a, b = planar.measure(), kinematic.measure()
        worst_base = max(worst_base, np.abs(a.base_pose - b.base_pose).max())
        worst_arm = max(worst_arm, np.abs(a.q_m - b.q_m).max())
        state.update(a)
        u = state.g[2:] - 3 * DAMPING * a.qd_m + 2.0 * np.sin(0.004 * k + np.arange(7.0))
        force = 10 * np.array([np.sin(0.01 * k), 0.5, 0.3])
        planar.step(u, wave(k * 1e-3), force)
        kinematic.step(u, wave(k * 1e-3), force)
    assert np.abs(a.q_m - READY).max() > 0.2
    assert worst_base < 1e-4
    assert worst_arm < 2e-3
    kinematic.close()


def test_step_of_the_planar_plant_with_a_fixed_base_is_exact(planar):
    """The base's motors do not disturb q̈_a by more than 1e-6 rad/s²."""
    kinematic = make_physics("kinematic", MODEL)
    torques = 5.0 * np.sin(np.arange(7.0))
    for plant in (planar, kinematic):
        plant.reset(np.zeros(3), READY)
        plant.step(torques, (0.0, 0.0), NOBODY)
    np.testing.assert_allclose(planar.measure().qd_m, kinematic.measure().qd_m, atol=1e-9)
    kinematic.close()


def test_base_slips_when_pushed_beyond_its_traction(planar):
    limit = MODEL.description.base.traction_limit_n
    mass = pin.computeTotalMass(MODEL.pin)
    slid = {}
    for share in (0.9, 1.1):
        planar.reset(np.zeros(3), READY)
        trace = run(
            planar, 0.5, (0.0, 0.0), force=np.array([share * limit, 0.0, 0.0]), torques=stiff
        )
        slid[share] = trace[-1].base_pose[0]
    assert abs(slid[0.9]) < 1e-4
    # the 10 % beyond the traction accelerate the whole robot
    assert slid[1.1] == pytest.approx(0.5 * 0.1 * limit / mass * 0.5**2, rel=0.1)


def stiff(state: RobotState) -> np.ndarray:
    """Torques of a very stiff arm, against a strong push."""
    m = state.measurement
    return state.h[2:] + state.M[2:, 2:] @ (9e4 * (READY - m.q_m) - 600.0 * m.qd_m)


def test_unknown_plant_error_lists_the_available_plants():
    with pytest.raises(
        UnknownNameError, match="choose from: kinematic, mujoco, mujoco-contact, planar"
    ):
        make_physics("gazebo", MODEL)
