"""Wheels in contact: they roll, skid and resist up to their traction limit; a base can tip."""

from __future__ import annotations

from functools import cache

import numpy as np
import pinocchio as pin
import pytest

from app.robot.model import RobotModel
from app.robot.state import RobotState
from app.simulation.plants.interface import Push
from app.simulation.plants.mujoco_wheels import MujocoWheels
from tests.robots import husky_panda
from tests.steps import tilt

MODEL = husky_panda()
READY = np.array(MODEL.description.arm.ready_position)
NOBODY = np.zeros(3)
HOME = np.zeros(3)


@cache
def two_wheeled() -> RobotModel:
    """The same robot on two wheels at the half track, and casters."""
    base = MODEL.description.base.model_copy(
        update={"left_wheel_joints": (), "right_wheel_joints": ()}
    )
    return RobotModel(MODEL.description.model_copy(update={"base": base}))


MODELS = {"four": husky_panda, "two": two_wheeled}


@pytest.fixture(params=MODELS)
def plant(request):
    plant = MujocoWheels(MODELS[request.param]())
    plant.reset(HOME, READY)
    return plant


def stiff(state: RobotState) -> np.ndarray:
    """Torques of a stiff position control at `READY`."""
    m = state.measurement
    return state.h[2:] + state.M[2:, 2:] @ (9e4 * (READY - m.q_m) - 600.0 * m.qd_m)


def run(plant: MujocoWheels, seconds: float, command, force=NOBODY) -> list:
    """Drive with a command, and return the measurements before each step."""
    state, trace = RobotState(MODEL), []
    for _ in range(round(seconds / plant.dt)):
        trace.append(plant.measure())
        state.update(trace[-1])
        plant.step(stiff(state), command, np.asarray(force, dtype=float))
    return trace


def rates(trace: list) -> np.ndarray:
    """(n, 2) [m/s, rad/s] velocities of the base in the last half second of a run."""
    return np.array([m.base_velocity for m in trace[-500:]])


def test_mass_and_inertia_agree_with_the_description(plant):
    """Mass and inertia of the wheels are subtracted from those of the base."""
    assert plant.world.model.body_mass.sum() == pytest.approx(pin.computeTotalMass(MODEL.pin))
    run(plant, 0.002, (0.0, 0.0))
    v = np.zeros(plant.world.model.nv)
    v[5] = 1.0  # the whole robot turns
    whole = 0.5 * v @ plant.world.mass_matrix() @ v
    data = MODEL.pin.createData()
    M = pin.crba(MODEL.pin, data, MODEL.configuration(HOME, READY))
    assert whole == pytest.approx(0.5 * M[2, 2], rel=1e-3)


@pytest.mark.parametrize("command", [(0.5, 0.0), (0.0, 0.6), (0.4, -0.5), (-0.2, 0.3)])
def test_two_wheels_follow_the_commanded_velocity(command):
    plant = MujocoWheels(two_wheeled())
    trace = run(plant, 1.5, command)
    assert np.abs(rates(trace) - command).max() < 1e-3  # [m/s, rad/s]


def test_path_of_two_wheels_is_the_circle_of_the_commanded_velocities():
    plant, (v, w) = MujocoWheels(two_wheeled()), (0.4, 0.8)
    run(plant, 1.0, (v, w))
    start = plant.measure().base_pose
    run(plant, 2.0, (v, w))
    turn = pin.SE3(pin.rpy.rpyToMatrix(0, 0, start[2]), np.array([*start[:2], 0.0]))
    arc = np.array([v / w * np.sin(w * 2.0), v / w * (1 - np.cos(w * 2.0)), 0.0])
    end = plant.measure().base_pose
    np.testing.assert_allclose(end[:2], turn.act(arc)[:2], atol=5e-3)
    assert end[2] == pytest.approx(start[2] + 2.0 * w, abs=5e-3)


@pytest.mark.parametrize("command", [(0.5, 0.0), (0.0, 0.1), (0.0, 0.8), (0.4, -0.6), (-0.3, 0.5)])
def test_four_wheels_nearly_follow_the_command_without_jerks(command):
    """The wheels skid sideways, and the loss of speed depends on the speed."""
    found = rates(run(MujocoWheels(MODEL), 1.5, command))
    mean = found.mean(axis=0)
    np.testing.assert_allclose(mean, command, atol=0.02 + 0.1 * abs(command[1]))
    assert found.std(axis=0).max() < 0.01 * (0.1 + abs(command[1]))


def test_effective_track_of_skid_steering_is_wider_than_its_wheels():
    """Its half is (a² + b²) / b with equal loads at (±a, ±b), and less with a load in front."""
    plant = MujocoWheels(MODEL)
    a, b = plant.wheels.centres[plant.wheels.centres.min(axis=1) > 0][0][:2]
    assert b < plant.half_track < (a**2 + b**2) / b
    assert MujocoWheels(two_wheeled()).half_track == MODEL.description.base.half_track_m


def test_heading_does_not_wrap(plant):
    plant.reset(np.array([0.0, 0.0, 3.0]), READY)
    headings = [m.base_pose[2] for m in run(plant, 1.0, (0.0, 0.6))]
    assert headings[0] == pytest.approx(3.0, abs=1e-3)
    assert headings[-1] > np.pi
    assert np.abs(np.diff(headings)).max() < 1e-3


def test_wheels_roll_as_far_as_the_base_drives(plant):
    run(plant, 1.0, (0.3, 0.0))
    wheels = [plant.world.data.joint(f"wheel_{i}") for i in range(len(plant.wheels.centres))]
    angles, start = [wheel.qpos[0] for wheel in wheels], plant.measure().base_pose
    run(plant, 1.0, (0.3, 0.0))
    rolled = np.subtract([wheel.qpos[0] for wheel in wheels], angles) * plant.wheels.radius
    way = np.linalg.norm(plant.measure().base_pose[:2] - start[:2])
    np.testing.assert_allclose(
        rolled, way, rtol=5e-3
    )  # a compliant tyre has a smaller rolling radius


def test_base_resists_a_push_within_its_traction_and_slides_beyond(plant):
    """The push acts at the arm's mount, where it changes the wheel loads little."""
    limit = MODEL.description.base.traction_limit_n
    moved = {}
    for share in (0.5, 1.5):
        plant.reset(HOME, READY)
        push, state = (
            Push("panda_joint1", HOME, np.array([-share * limit, 0.0, 0.0])),
            RobotState(MODEL),
        )
        for _ in range(500):
            state.update(plant.measure())
            plant.step(stiff(state), (0.0, 0.0), NOBODY, [push])
        moved[share] = abs(plant.measure().base_pose[0])
    assert moved[0.5] < 5e-3  # [m]
    assert moved[1.5] > 0.05


def test_large_pull_tips_the_base(plant):
    assert tilt(plant) < 0.004  # [rad]
    run(plant, 0.6, (0.0, 0.0), force=(0.0, 0.0, -50.0))
    assert tilt(plant) < 0.02
    run(plant, 0.6, (0.0, 0.0), force=(150.0, 0.0, -900.0))
    assert tilt(plant) > 0.05


def test_reset_places_the_base_in_static_equilibrium(plant):
    at = np.array([1.0, -2.0, 2.5])
    plant.reset(at, READY)
    m = plant.measure()
    np.testing.assert_allclose(m.base_pose, at, atol=1e-9)
    assert not m.base_velocity.any()
    trace = run(plant, 0.2, (0.0, 0.0))
    assert np.abs([m.base_velocity for m in trace]).max() < 0.02
