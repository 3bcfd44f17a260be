"""Holonomic and car-like bases give way without contact when guiding or tracking."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from app.border.cache import BorderData, load_border_data
from app.config import Config
from app.control.controller import ControlLoop
from app.errors import ConfigError, MeasurementError
from app.robot.state import at_rest
from app.simulation.plants import make_physics
from app.simulation.run import run_scenario
from app.simulation.scenarios import LINES
from tests.bases import robot_on

pytestmark = pytest.mark.slow

PATHS = {
    "left": ((0.30, 0.72, 0.30), (0.0, -0.25, 0.0)),
    "right": ((0.35, -0.70, 0.30), (0.0, 0.20, 0.0)),
    "front": ((0.92, 0.10, 0.30), (-0.30, 0.0, 0.0)),
}


@cache
def border(kind: str) -> BorderData:
    """The border that all runs with the base `kind` share."""
    return load_border_data(robot_on(kind))


@cache
def figures(kind: str, path: str, mode: str, physics: str = "kinematic") -> dict[str, object]:
    """Figures of a run of the base `kind` on a path of `PATHS`, simulated once for all tests."""
    start, move = PATHS[path]
    scenario = LINES["guiding-lateral"].changed(start=start, move=move, mode=mode, duration=3.0)
    return run_scenario(robot_on(kind), border(kind), scenario, Config(), physics=physics).figures


@pytest.mark.parametrize("kind", ["holonomic", "car-like"])
@pytest.mark.parametrize(
    ("path", "mode"), [("left", "guiding"), ("right", "tracking"), ("front", "tracking")]
)
def test_a_base_gives_way_without_contact(kind: str, path: str, mode: str) -> None:
    result = figures(kind, path, mode)
    assert result["min_clearance_m"] >= 0.03
    assert result["contacts"] == result["solver_failures"] == 0
    assert result["base_displacement_m"] > 0.05
    if mode == "tracking":
        assert result["ee_error_max_m"] < 1e-3
    else:
        assert result["ee_error_final_m"] < 0.03


def test_a_holonomic_base_moves_alike_in_planar_and_kinematic_physics() -> None:
    one, other = (figures("holonomic", "right", "tracking", p) for p in ("planar", "kinematic"))
    assert one["min_clearance_m"] == pytest.approx(other["min_clearance_m"], abs=2e-3)
    assert one["base_displacement_m"] == pytest.approx(other["base_displacement_m"], abs=5e-3)


@pytest.mark.parametrize("kind", ["holonomic", "car-like"])
def test_the_contact_plant_refuses_other_bases_and_names_alternatives(kind: str) -> None:
    with pytest.raises(ConfigError, match=rf"{kind}: choose mujoco, planar or kinematic"):
        make_physics("mujoco-contact", robot_on(kind))


def test_drive_model_of_a_kind_continues_from_the_velocity_in_use() -> None:
    """The odometry is 50 ms late while the base accelerates."""
    robot = robot_on("car-like")
    loop, drive = ControlLoop(robot, border("car-like")), np.array([0.1])
    ready = at_rest(robot, np.array(robot.description.arm.ready_position))
    command = np.zeros(2)
    for k in range(300):
        t = 0.001 * k
        moved, v = 0.25 * max(t - 0.05, 0.0) ** 2, 0.5 * max(t - 0.05, 0.0)
        turn = v * np.tan(0.1) / robot.description.base.wheelbase_m
        odometry = {"base_pose": np.array([moved, 0.0, 0.0]), "base_velocity": np.array([v, turn])}
        measured = ready._replace(**odometry, drive=drive, now=t, time=t, base_time=t - 0.05)
        step = loop.step(measured).step
        expected = robot.description.base.drive_acceleration(step.base_velocity, drive, command)
        np.testing.assert_allclose(step.a_base_meas, expected, rtol=0.0, atol=1e-12)
        command = step.v_cmd.copy()
    assert abs(step.base_velocity[0] - v) > 0.005, "the reading itself was in use"


@pytest.mark.parametrize("angle", [np.nan, np.inf, -np.inf])
def test_an_unread_steering_angle_is_a_fault_with_finite_commands(angle: float) -> None:
    robot = robot_on("car-like")
    loop = ControlLoop(robot, border("car-like"))
    good = at_rest(robot, np.array(robot.description.arm.ready_position))
    good = good._replace(base_velocity=np.array([0.5, 0.0]))
    step = loop.step(good).step
    assert step.solved
    a_base = step.a_base_meas.copy()
    unread = good._replace(drive=np.array([angle]))
    for k in range(150):  # the state is predicted for 0.1 s, then the fallback command follows
        command = loop.step(unread)
        np.testing.assert_array_equal(command.step.a_base_meas, a_base)
        assert "invalid" in command.faults, k
        assert np.isfinite(command.u_a).all()
        assert np.isfinite(command.base_velocity).all()
    assert not command.step.solved
    assert loop.step(good).step.solved
    with pytest.raises(MeasurementError, match=r"measurement.drive must be 1 numbers"):
        loop.step(good._replace(drive=np.zeros(2)))
