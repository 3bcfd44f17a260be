"""pinocchio and pybullet, from one URDF, agree on the dynamics of the planar plant."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest
import trimesh

from app.robot.assets import resolved_urdf
from app.robot.model import RobotModel
from app.robot.state import Measurement, RobotState
from app.simulation.plants.planar import Planar
from tests.robots import husky_panda, random_measurement

pybullet = pytest.importorskip("pybullet")

SEEDS = range(5)
TOLERANCE = {"rtol": 1e-9, "atol": 1e-9}


@pytest.fixture(scope="module")
def plant():
    plant = Planar("pybullet", husky_panda())
    yield plant
    plant.close()


def random_motion(seed: int):
    """One motion: pinocchio's q and v, pybullet's q, and the map between the velocities."""
    rng, model = np.random.default_rng(seed), husky_panda()
    m = random_measurement(rng)
    phi = m.base_pose[2]
    # pinocchio's planar velocity is in the base's frame, pybullet's x and y are the world's.
    to_world = np.eye(3 + model.n_m)
    to_world[:2, :2] = [[np.cos(phi), -np.sin(phi)], [np.sin(phi), np.cos(phi)]]
    v = rng.uniform(-1, 1, 3 + model.n_m)
    q = model.configuration(m.base_pose, m.q_m)
    return q, v, np.concatenate([m.base_pose, m.q_m]), to_world


def bias_of_turning_axes(v: np.ndarray) -> np.ndarray:
    """Acceleration in pinocchio's planar coordinates for zero acceleration in the world's."""
    a = np.zeros_like(v)
    a[:2] = v[2] * v[1], -v[2] * v[0]
    return a


@pytest.mark.parametrize("seed", SEEDS)
def test_mass_matrices_agree(plant, seed):
    q, _, q_bullet, to_world = random_motion(seed)
    model = husky_panda().pin
    M = pin.crba(model, model.createData(), q)
    M = np.triu(M) + np.triu(M, 1).T
    M_bullet = np.array(
        pybullet.calculateMassMatrix(
            plant.world.robot, q_bullet.tolist(), physicsClientId=plant.world.client.id
        )
    )
    np.testing.assert_allclose(M_bullet, to_world @ M @ to_world.T, **TOLERANCE)


@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize("accelerating", [False, True], ids=["bias", "inverse dynamics"])
def test_inverse_dynamics_agree(plant, seed, accelerating):
    q, v, q_bullet, to_world = random_motion(seed)
    a_bullet = np.random.default_rng(seed + 100).normal(size=len(v)) * accelerating
    model = husky_panda().pin
    a = to_world.T @ a_bullet + bias_of_turning_axes(v)
    tau = pin.rnea(model, model.createData(), q, v, a)
    tau_bullet = pybullet.calculateInverseDynamics(
        plant.world.robot,
        q_bullet.tolist(),
        (to_world @ v).tolist(),
        a_bullet.tolist(),
        physicsClientId=plant.world.client.id,
    )
    np.testing.assert_allclose(tau_bullet, to_world @ tau, **TOLERANCE)


@pytest.mark.parametrize("seed", SEEDS)
def test_one_step_of_forward_dynamics_agrees(plant, seed):
    """The whole robot, base included, falling and driven by torques on all joints."""
    q, v, q_bullet, to_world = random_motion(seed)
    model, world = husky_panda().pin, plant.world
    tau_bullet = np.random.default_rng(seed + 200).normal(0, 5, len(v))
    client, robot, joints = world.client, world.robot, world.moving
    plant.reset(np.zeros(3), q_bullet[3:])
    for joint, at, speed in zip(joints, q_bullet, to_world @ v, strict=True):
        client.resetJointState(robot, joint, at, speed)
    free = [0.0] * len(joints)
    client.setJointMotorControlArray(robot, joints, pybullet.VELOCITY_CONTROL, forces=free)
    client.setJointMotorControlArray(robot, joints, pybullet.TORQUE_CONTROL, forces=tau_bullet)
    client.stepSimulation()
    states = client.getJointStates(robot, joints)
    a = pin.aba(model, model.createData(), q, v, to_world.T @ tau_bullet)
    speeds = to_world @ (v + (a - bias_of_turning_axes(v)) * plant.dt)
    assert not any(plant.contacts())
    np.testing.assert_allclose([s[1] for s in states], speeds, **TOLERANCE)
    np.testing.assert_allclose([s[0] for s in states], q_bullet + speeds * plant.dt, **TOLERANCE)


def test_fixed_links_do_not_count_towards_the_limit_of_the_engine(tmp_path):
    """The engine's limit is 128 links; grippers with fixed fingers can exceed it."""
    known, parts, above = husky_panda().description, [], "panda_hand"
    for k in range(140):
        parts.append(
            f'<link name="f{k}"><inertial><origin xyz="0 0.01 0" rpy="0.3 0 0"/>'
            '<mass value="0.02"/><inertia ixx="2e-5" ixy="3e-6" ixz="0" iyy="3e-5" iyz="0"'
            ' izz="4e-5"/></inertial>'
            '<collision><geometry><sphere radius="0.005"/></geometry></collision></link>'
            f'<joint name="j{k}" type="fixed"><parent link="{above}"/><child link="f{k}"/>'
            '<origin xyz="0.0002 0 0.0003" rpy="0.01 0.02 0"/></joint>'
        )
        above = f"f{k}"
    path = tmp_path / "robot.urdf"
    urdf = resolved_urdf(known).replace("</robot>", "".join(parts) + "</robot>")
    path.write_text(urdf, encoding="utf-8")
    *inner, last = known.bodies
    covers = (*last.covers, *(f"f{k}" for k in range(140)))
    bodies = (*inner, last.model_copy(update={"covers": covers}))
    model = RobotModel(known.model_copy(update={"urdf": str(path), "bodies": bodies}))
    state, q_m = RobotState(model), np.array(known.arm.ready_position)
    qd = np.linspace(-0.5, 0.5, model.n_b + model.n_m)
    state.update(Measurement(np.zeros(3), model.J_m @ qd[: model.n_b], q_m, qd[model.n_b :]))
    plant = Planar("pybullet", model)
    try:
        plant.reset(np.zeros(3), q_m)
        np.testing.assert_array_equal(plant.measure().q_m, q_m)
        M, nle = plant.mass_and_bias(q_m, qd)
    finally:
        plant.close()
    np.testing.assert_allclose(M, state.M, **TOLERANCE)
    np.testing.assert_allclose(nle, state.h, **TOLERANCE)


def test_mesh_without_thickness_loads_in_mujoco(tmp_path):
    """An example is a printed mark on the base."""
    corners = np.array([[0.0, 0.0, 0.2], [0.1, 0.0, 0.2], [0.1, 0.1, 0.2], [0.0, 0.1, 0.2]])
    sheet = tmp_path / "mark.stl"
    trimesh.Trimesh(corners, [[0, 1, 2], [0, 2, 3]], process=False).export(sheet)
    known, path = husky_panda().description, tmp_path / "robot.urdf"
    mesh = f'<collision><geometry><mesh filename="{sheet}"/></geometry></collision></link>'
    head, link, rest = resolved_urdf(known).partition('<link name="base_link">')
    first, _, others = rest.partition("</link>")
    path.write_text(head + link + first + mesh + others, encoding="utf-8")
    model = RobotModel(known.model_copy(update={"urdf": str(path)}))
    Planar("mujoco", model).close()
