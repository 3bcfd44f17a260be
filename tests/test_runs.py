"""Required results of whole runs of every scenario, with and without avoidance."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
import pytest

from app.border.cache import BorderData, load_border_data
from app.config import Config
from app.control.controller import CONTROLLERS
from app.robot.model import RobotModel
from app.simulation.run import run_scenario
from app.simulation.scenarios import LINES
from app.simulation.scenarios.start import StartSolver
from app.simulation.session import DT, Session
from app.simulation.trace.metrics import metrics
from app.simulation.trace.trace import Recorder
from tests.robots import husky_panda

pytestmark = pytest.mark.slow

GUIDED = ("guiding-lateral", "guiding-front", "guiding-above", "guiding-fold")


@cache
def figures(
    name: str, controller: str = "dbb", physics: str = "planar", duration: float | None = None
) -> dict[str, Any]:
    """Figures of a run, computed once for all tests."""
    scenario = LINES[name].changed(duration=duration)
    return run_scenario(
        husky_panda(), border(), scenario, Config(), controller=controller, physics=physics
    ).figures


@cache
def without_avoidance(name: str) -> dict[str, Any]:
    """The same path of the end-effector in half the time."""
    return figures(name, "none", duration=4.0)


@cache
def border() -> BorderData:
    """The border of all runs."""
    return load_border_data(husky_panda(), progress=False)


def assert_base_moves_away(run: dict[str, Any]) -> None:
    """The thresholds of guiding-lateral and guiding-front."""
    assert run["contacts"] == 0
    assert run["min_clearance_m"] >= 0.05
    assert run["ee_error_final_m"] <= 0.03  # the end-effector follows the pull
    assert run["activation_max"] >= 0.3
    assert run["base_displacement_m"] >= 0.05
    assert run["solver_failures"] == 0


def assert_arm_resists_from_above(run: dict[str, Any]) -> None:
    """The thresholds of guiding-above."""
    assert run["contacts"] == 0
    assert run["min_clearance_m"] >= 0.03
    assert run["base_displacement_m"] < 0.1
    assert run["ee_error_final_m"] > 0.05  # the pull does not bring the end-effector down
    assert run["hand_force_max_n"] > 10.0  # the force of the pull
    assert run["solver_failures"] == 0


def assert_arm_does_not_fold_into_itself(run: dict[str, Any]) -> None:
    """The thresholds of guiding-fold."""
    assert run["arm_contacts"] == 0
    assert run["arm_min_clearance_m"] >= 0.03
    assert run["contacts"] == 0
    assert run["solver_failures"] == 0


SHOWN = {
    "guiding-lateral": assert_base_moves_away,
    "guiding-front": assert_base_moves_away,
    "guiding-above": assert_arm_resists_from_above,
    "guiding-fold": assert_arm_does_not_fold_into_itself,
}


@pytest.mark.parametrize("name", GUIDED)
def test_guided_run_meets_its_thresholds(name: str):
    """From one start; `dbb study` draws many."""
    SHOWN[name](figures(name))


@pytest.mark.parametrize("name", ["guiding-lateral", "guiding-front"])
def test_without_avoidance_the_base_stays_and_the_arm_comes_close(name: str):
    run = without_avoidance(name)
    assert run["contacts"] > 0 or run["min_clearance_m"] <= 0.03
    assert run["base_displacement_m"] < 0.01
    assert run["activation_max"] == 0.0


def test_without_avoidance_the_end_effector_hits_the_base():
    run = without_avoidance("guiding-above")
    assert run["contacts"] > 0
    assert run["min_clearance_m"] < 0.03 < figures("guiding-above")["min_clearance_m"]


def test_without_avoidance_the_arm_folds_into_itself():
    assert without_avoidance("guiding-fold")["arm_contacts"] > 0


@pytest.mark.parametrize("name", GUIDED)
def test_arm_does_not_touch_the_floor(name: str):
    assert figures(name)["floor_contacts"] == 0


@pytest.mark.parametrize("name", GUIDED)
def test_torques_do_not_jump(name: str):
    """The rates of the torques stay below their limit; at the limit, a jump would be hidden."""
    assert figures(name)["torque_jump_max_nm"] < 0.75 * Config().limit.torque_rate * DT


def test_tracking_keeps_its_path_and_its_distance():
    """0.2 m towards the base's side, in 6 s instead of the scenario's 30 s."""
    run = figures("tracking", duration=6.0)
    assert run["ee_error_max_m"] <= 0.002
    assert run["min_clearance_m"] >= 0.05
    assert run["contacts"] == 0
    assert run["solver_failures"] == 0
    plain = figures("tracking", "none", duration=3.0)  # the same path, faster
    assert plain["min_clearance_m"] <= run["min_clearance_m"] - 0.05


def test_kinematic_plant_agrees_with_the_physics():
    run, real = figures("guiding-lateral", physics="kinematic"), figures("guiding-lateral")
    assert_base_moves_away(run)
    assert run["min_clearance_m"] == pytest.approx(real["min_clearance_m"], abs=0.01)
    assert run["base_displacement_m"] == pytest.approx(real["base_displacement_m"], abs=0.05)


def test_no_collision_on_wheels_in_contact():
    run = figures("guiding-lateral", physics="mujoco-contact")
    assert run["contacts"] == 0
    assert run["min_clearance_m"] >= 0.03
    assert run["base_displacement_m"] >= 0.05
    assert run["solver_failures"] == 0


def test_mirrored_pull_gives_the_mirrored_motion(robot: RobotModel, border_data: BorderData):
    """The motions agree only approximately.

    The clouds are sampled, the links' centres of mass are beside the plane, and the guided arm has
    no posture, so its elbow drifts differently.
    """
    q_left = StartSolver(robot, border_data.pairs, Config().border.d_b).solve(
        LINES["guiding-lateral"].start
    )
    mirror = np.array([-1, 1, -1, 1, -1, 1, -1])  # joints with axes in the plane change sign
    left, (right, begin) = figures("guiding-lateral"), mirrored_run(robot, mirror * q_left)
    np.testing.assert_allclose(begin * [1, -1, 1], LINES["guiding-lateral"].start, atol=1e-4)
    for run in (left, right):
        assert_base_moves_away(run)
    assert right["min_clearance_m"] == pytest.approx(left["min_clearance_m"], abs=0.01)
    assert right["ee_error_final_m"] == pytest.approx(left["ee_error_final_m"], abs=0.005)
    assert right["base_yaw_rad"] == pytest.approx(-left["base_yaw_rad"], abs=0.2)


def mirrored_run(robot: RobotModel, q_start: np.ndarray) -> tuple[dict[str, Any], np.ndarray]:
    """guiding-lateral from the right: figures, and the initial position of the end-effector."""
    scenario = LINES["guiding-lateral"]
    session = Session(robot, border(), Config())
    recorder = Recorder()
    try:
        session.reset(q_start)
        began = session.T_world_ee.translation.copy()
        for _ in range(round(scenario.duration / DT)):
            pull = scenario.place(session.t) * [1.0, -1.0, 1.0]
            recorder.add(session, session.step(pull=pull))
    finally:
        session.close()
    return metrics(recorder.trace()), began


@pytest.mark.parametrize("controller", [name for name in CONTROLLERS if name != "none"])
def test_every_method_keeps_a_clearance_that_the_arm_alone_does_not(controller: str):
    run, plain = (
        figures("guiding-lateral", name, "kinematic", duration=3.0) for name in (controller, "none")
    )
    assert run["min_clearance_m"] > 0.03 > 2 * plain["min_clearance_m"]
    assert run["contacts"] == run["solver_failures"] == 0
