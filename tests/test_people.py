"""Pulls anywhere on the arm, by several people: every plant obeys mechanics."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest

from app.border.cache import BorderData
from app.config import Config, PersonConfig
from app.robot.model import RobotModel
from app.robot.state import Measurement, RobotState
from app.simulation.people import Hold, People, held_links, held_point
from app.simulation.plants import PLANTS, make_physics
from app.simulation.plants.interface import Push
from app.simulation.session import DT, Session
from tests.robots import husky_panda

MODEL = husky_panda()
READY = np.array(MODEL.description.arm.ready_position)
FOREARM = Push("panda_joint5", np.array([0.02, 0.06, -0.12]), np.array([30.0, -45.0, 20.0]))

ROUNDING = {"planar": 1e-9, "mujoco": 1e-9, "kinematic": 1e-9, "mujoco-contact": 1e-3}
"""[rad, rad/s] growth of rounding errors in 0.1 s; wheels in contact amplify them."""


@pytest.fixture(params=PLANTS)
def plant(request):
    plant = make_physics(request.param, MODEL)
    plant.kind = request.param
    plant.reset(np.zeros(3), READY)
    yield plant
    plant.close()


def place(q_m: np.ndarray, push: Push) -> np.ndarray:
    """(3,) [m] position of the push's point in the world, with the base at the origin."""
    state = RobotState(MODEL)
    state.update(Measurement(np.zeros(3), np.zeros(2), q_m, np.zeros(7)))
    return state.data.oMi[MODEL.pin.getJointId(push.joint)].act(push.p)


def test_push_on_a_link_satisfies_the_equation_of_motion(plant):
    """One step from rest: M_aa q̈_a = Jᵀ f, with J of the point by finite differences."""
    J = np.array(
        [(place(READY + h, FOREARM) - place(READY - h, FOREARM)) / 2e-6 for h in 1e-6 * np.eye(7)]
    ).T
    state = RobotState(MODEL)
    state.update(plant.measure())
    plant.step(state.g[2:], (0.0, 0.0), np.zeros(3), [FOREARM])
    expected = np.linalg.solve(state.M[2:, 2:], J.T @ FOREARM.force) * DT
    limit = {"planar": 1e-6, "mujoco": 1e-6, "kinematic": 1e-9, "mujoco-contact": 3e-3}[plant.kind]
    np.testing.assert_allclose(plant.measure().qd_m, expected, atol=limit)
    assert np.abs(expected).max() > 0.02
    np.testing.assert_allclose(J[:, 5:], 0.0, atol=1e-9)  # joints farther out have no effect


def test_work_of_a_push_becomes_kinetic_energy(plant):
    if plant.kind == "mujoco-contact":
        pytest.skip("its wheels and joints have friction")
    state, work = RobotState(MODEL), 0.0
    joint = MODEL.pin.getJointId(FOREARM.joint)
    for _ in range(150):
        state.update(plant.measure())
        p = state.data.oMi[joint].act(FOREARM.p)
        before = state.point_jacobian(joint, p) @ state.qd
        plant.step(state.g[2:], (0.0, 0.0), np.zeros(3), [FOREARM])
        state.update(plant.measure())
        p = state.data.oMi[joint].act(FOREARM.p)
        after = state.point_jacobian(joint, p) @ state.qd
        work += FOREARM.force @ (before + after) / 2 * DT
    energy = 0.5 * state.qd @ state.M @ state.qd
    assert energy > 0.3  # [J]
    assert energy == pytest.approx(work, rel=0.01)


def test_opposite_pushes_on_one_point_cancel(plant):
    state, traces = RobotState(MODEL), []
    for pushes in ([], [FOREARM, FOREARM._replace(force=-FOREARM.force)]):
        plant.reset(np.zeros(3), READY)
        for _ in range(100):
            state.update(plant.measure())
            plant.step(state.g[2:], (0.1, 0.2), np.zeros(3), pushes)
        traces.append(np.concatenate(plant.measure()[:5]))
    np.testing.assert_allclose(*traces, atol=ROUNDING[plant.kind])


def test_pushes_on_one_point_add_up(plant):
    state, traces = RobotState(MODEL), []
    halves = [FOREARM._replace(force=FOREARM.force / 2)] * 2
    for pushes in ([FOREARM], halves):
        plant.reset(np.zeros(3), READY)
        for _ in range(100):
            state.update(plant.measure())
            plant.step(state.g[2:], (0.0, 0.0), np.zeros(3), pushes)
        traces.append(np.concatenate(plant.measure()[:5]))
    np.testing.assert_allclose(*traces, atol=ROUNDING[plant.kind])


@pytest.mark.slow
@pytest.mark.parametrize("physics", PLANTS)
def test_pull_at_the_end_effector_frame_equals_a_pull_of_the_end_effector(
    robot: RobotModel, border_data: BorderData, physics: str
):
    arm = robot.description.arm
    holds = [
        Hold(3, np.zeros(3)),
        Hold(3, np.zeros(3), "end_effector"),
        Hold(3, np.zeros(3), arm.end_effector_link, arm.end_effector_xyz_m),
    ]
    runs = []
    for hold in holds:
        session = Session(robot, border_data, Config(), physics=physics)
        target = np.add(session.T_world_ee.translation, (-0.2, 0.1, -0.1))
        steps = [session.step(holds=[hold._replace(target=target)]) for _ in range(400)]
        session.close()
        assert np.linalg.norm(steps[-1].pulls[0].force) > 5.0  # [N]
        runs.append([[*s.truth.q_m, *s.pulls[0].point, *s.pulls[0].force] for s in steps])
    for run in runs[1:]:
        np.testing.assert_allclose(run, runs[0], atol=1e-3 if physics == "mujoco-contact" else 1e-6)


@pytest.mark.slow
def test_pull_at_the_elbow_moves_the_elbow_to_its_target(
    robot: RobotModel, border_data: BorderData
):
    session = Session(robot, border_data, Config(), physics="planar")
    reading = session.step(holds=[Hold(0, np.array([0.0, 0.0, 1.0]), "panda_link4")]).pulls[0]
    target = np.add(reading.point, (0.0, 0.12, 0.0))
    hold = Hold(0, target, "panda_link4")
    steps = [session.step(holds=[hold]) for _ in range(2000)]
    session.close()
    at = steps[-1].pulls[0]
    assert np.linalg.norm(at.point - target) < 0.5 * 0.12
    np.testing.assert_array_equal(steps[-1].hand_force, 0.0)  # no pull at the end-effector
    assert steps[-1].hand_target is None
    forces = [np.linalg.norm(s.pulls[0].force) for s in steps]
    assert max(forces) <= PersonConfig().f_max + 1e-9


def test_pulls_of_several_people_are_independent(robot: RobotModel):
    state = RobotState(robot)
    there, high = np.array([0.6, 0.2, 0.6]), np.array([0.2, -0.1, 1.1])
    both, one, other = (People(robot, PersonConfig(), DT) for _ in range(3))
    a, b = Hold(0, there), Hold(7, high, "panda_link4", (0.0, 0.05, 0.0))
    for _ in range(200):
        together, forces = both.pull(state, [a, b])
        alone = [*one.pull(state, [a])[0], *other.pull(state, [b])[0]]
        for reading, same in zip(together, alone, strict=True):
            np.testing.assert_array_equal(reading.force, same.force)
    np.testing.assert_array_equal(forces.hand, together[0].force)
    assert [push.joint for push in forces.pushes] == ["panda_joint4"]
    (left,), _ = both.pull(state, [b])  # a released pull has no effect
    np.testing.assert_allclose(left.force, other.pull(state, [b])[0][0].force)


def test_new_grip_starts_without_force(robot: RobotModel):
    state, people = RobotState(robot), People(robot, PersonConfig(), DT)
    for _ in range(500):
        (before,), _ = people.pull(state, [Hold(0, np.array([0.2, 0.3, 0.9]))])
    assert np.linalg.norm(before.force) > 10.0
    (after,), _ = people.pull(state, [Hold(0, np.array([0.2, 0.3, 0.9]), "panda_link3")])
    assert np.linalg.norm(after.force) < 0.1


def test_held_links_are_the_links_that_move_relative_to_the_base(robot: RobotModel):
    links = held_links(robot)
    assert {*robot.description.arm.joints, "panda_hand", "end_effector"} <= set(links)
    assert not {"base_link", "panda_link0", "root_joint", "universe"} & set(links)
    state = RobotState(robot)
    pin.updateFramePlacements(robot.pin, state.data)
    for link in links:
        joint, p = held_point(robot, link, (0.01, -0.02, 0.03))
        frame = state.data.oMf[robot.pin.getFrameId(link)]
        np.testing.assert_allclose(
            state.data.oMi[joint].act(p), frame.act(np.array([0.01, -0.02, 0.03])), atol=1e-12
        )


@pytest.mark.parametrize("mass", [0.0, 0.2, 5.0])
@pytest.mark.parametrize("plant", ["planar", "kinematic"])
def test_stiffest_hand_guides_the_arm_without_oscillation(
    robot: RobotModel, border_data: BorderData, plant: str, mass: float
):
    """0.1 m away from the base in 0.3 s, then at rest: the force has no steps."""
    config = Config().replace("hand.stiffness", 3000.0).replace("hand.mass", mass)
    session = Session(robot, border_data, config, physics=plant)
    session.reset(READY)
    start, forces, speeds = session.T_world_ee.translation.copy(), [], []
    for k in range(900):
        s = min(k / 300, 1.0)
        step = session.step(pull=start + np.array([0.1 * s * s * (3 - 2 * s), 0, 0]))
        forces.append(step.hand_force)
        speeds.append(step.ee_speed)
    session.close()
    assert 0.2 < max(speeds) < 0.8
    assert np.abs(np.diff(forces, axis=0)).max() < 1.0  # [N] a step
    assert speeds[-1] < 0.1  # a heavy hand on a stiff spring still oscillates
    assert step.ee_error < 0.01
