"""Required results of the commands: every scenario with avoidance and without, in whole runs."""

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
    """Figures of a run, made once however many tests look at them."""
    scenario = LINES[name].changed(duration=duration)
    return run_scenario(
        husky_panda(), border(), scenario, Config(), controller=controller, physics=physics
    ).figures


@cache
def without_avoidance(name: str) -> dict[str, Any]:
    """The same way in half the time, which takes the hand as far."""
    return figures(name, "none", duration=4.0)


@cache
def border() -> BorderData:
    """The border that all runs share."""
    return load_border_data(husky_panda(), progress=False)


def assert_the_base_gets_out_of_the_way(run: dict[str, Any]) -> None:
    """The thresholds of guiding-lateral and guiding-front."""
    assert run["contacts"] == 0
    assert run["min_clearance_m"] >= 0.05
    assert run["ee_error_final_m"] <= 0.03  # the hand goes where the person pulls it
    assert run["activation_max"] >= 0.3
    assert run["base_displacement_m"] >= 0.05
    assert run["solver_failures"] == 0


def assert_the_arm_resists_from_above(run: dict[str, Any]) -> None:
    """The thresholds of guiding-above."""
    assert run["contacts"] == 0
    assert run["min_clearance_m"] >= 0.03
    assert run["base_displacement_m"] < 0.1
    assert run["ee_error_final_m"] > 0.05  # the person does not get the hand down
    assert run["hand_force_max_n"] > 10.0  # although the person pulls
    assert run["solver_failures"] == 0


def assert_the_arm_does_not_fold_into_itself(run: dict[str, Any]) -> None:
    """The thresholds of guiding-fold."""
    assert run["arm_contacts"] == 0
    assert run["arm_min_clearance_m"] >= 0.03
    assert run["contacts"] == 0
    assert run["solver_failures"] == 0


SHOWN = {
    "guiding-lateral": assert_the_base_gets_out_of_the_way,
    "guiding-front": assert_the_base_gets_out_of_the_way,
    "guiding-above": assert_the_arm_resists_from_above,
    "guiding-fold": assert_the_arm_does_not_fold_into_itself,
}


@pytest.mark.parametrize("name", GUIDED)
def test_guided_by_hand_nothing_collides(name: str):
    """From one start; `dbb study` draws many."""
    SHOWN[name](figures(name))


@pytest.mark.parametrize("name", ["guiding-lateral", "guiding-front"])
def test_without_avoidance_the_base_stays_and_is_met(name: str):
    run = without_avoidance(name)
    assert run["contacts"] > 0 or run["min_clearance_m"] <= 0.03
    assert run["base_displacement_m"] < 0.01
    assert run["activation_max"] == 0.0


def test_without_avoidance_the_hand_lands_on_the_base():
    run = without_avoidance("guiding-above")
    assert run["contacts"] > 0
    assert run["min_clearance_m"] < 0.03 < figures("guiding-above")["min_clearance_m"]


def test_without_avoidance_the_arm_folds_into_itself():
    assert without_avoidance("guiding-fold")["arm_contacts"] > 0


@pytest.mark.parametrize("name", GUIDED)
def test_no_floor_is_touched(name: str):
    assert figures(name)["floor_contacts"] == 0


@pytest.mark.parametrize("name", GUIDED)
def test_torques_have_no_steps(name: str):
    """Rows enter and leave; the limit of the torques' rate, which would hide a step, is not met."""
    assert figures(name)["torque_jump_max_nm"] < 0.75 * Config().limit.torque_rate * DT


def test_tracking_keeps_its_line_and_its_distance():
    """The hand's 0.2 m towards the base's side, five times as fast as the scenario's 30 s."""
    run = figures("tracking", duration=6.0)
    assert run["ee_error_max_m"] <= 0.002
    assert run["min_clearance_m"] >= 0.05
    assert run["contacts"] == 0
    assert run["solver_failures"] == 0
    plain = figures("tracking", "none", duration=3.0)  # the same line, faster
    assert plain["min_clearance_m"] <= run["min_clearance_m"] - 0.05


def test_the_stand_in_shows_the_same_as_the_physics():
    run, real = figures("guiding-lateral", physics="kinematic"), figures("guiding-lateral")
    assert_the_base_gets_out_of_the_way(run)
    assert run["min_clearance_m"] == pytest.approx(real["min_clearance_m"], abs=0.01)
    assert run["base_displacement_m"] == pytest.approx(real["base_displacement_m"], abs=0.05)


def test_on_wheels_in_contact_nothing_collides_either():
    run = figures("guiding-lateral", physics="mujoco-contact")
    assert run["contacts"] == 0
    assert run["min_clearance_m"] >= 0.03
    assert run["base_displacement_m"] >= 0.05
    assert run["solver_failures"] == 0


def test_left_and_right_are_alike(robot: RobotModel, border_data: BorderData):
    """A pull mirrored at the base's plane of symmetry gives the mirrored motion.

    Only nearly: the clouds are sampled, the links' centres of mass lie beside the plane, and the
    guided arm has no posture, so the elbow drifts differently and with it how far the base goes.
    """
    q_left = StartSolver(robot, border_data.pairs, Config().border.d_b).solve(
        LINES["guiding-lateral"].start
    )
    mirror = np.array([-1, 1, -1, 1, -1, 1, -1])  # joints whose axes lie in the plane turn back
    left, (right, hand) = figures("guiding-lateral"), mirrored_run(robot, mirror * q_left)
    np.testing.assert_allclose(hand * [1, -1, 1], LINES["guiding-lateral"].start, atol=1e-4)
    for run in (left, right):
        assert_the_base_gets_out_of_the_way(run)
    assert right["min_clearance_m"] == pytest.approx(left["min_clearance_m"], abs=0.01)
    assert right["ee_error_final_m"] == pytest.approx(left["ee_error_final_m"], abs=0.005)
    assert right["base_yaw_rad"] == pytest.approx(-left["base_yaw_rad"], abs=0.2)


def mirrored_run(robot: RobotModel, q_start: np.ndarray) -> tuple[dict[str, Any], np.ndarray]:
    """guiding-lateral from the right: figures, and where the hand began."""
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


def test_every_controller_has_been_run():
    """A controller that is added must be shown here or in test_methods.py."""
    assert set(CONTROLLERS) == {"dbb", "hqp", "repulsive", "barrier", "none"}
