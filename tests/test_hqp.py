"""The method `hqp`, the paper's hierarchy: levels, transition, behaviour and jumps."""

from typing import Any

import numpy as np
import pytest

from app.border.cache import BorderData
from app.border.dbb import Cloud
from app.border.offset import border_of
from app.config import BorderConfig, Config
from app.control import controller as controller_module
from app.control.controller import Controller
from app.control.hqp import Task, cascade, inserted, solved_by_hierarchy
from app.robot.model import RobotModel
from app.robot.state import at_rest
from app.simulation.run import run_scenario
from app.simulation.scenarios import scenario_by_name
from app.strict import Array
from benchmarks.law.continuity import Kind, continuity
from benchmarks.law.options import Options

N = 9
TRACKING: tuple[Kind, ...] = ("tracking",)


def level(rng: np.random.Generator, rows: int) -> Task:
    return Task(rng.normal(size=(rows, N)), rng.normal(size=rows))


def levels(seed: int, *rows: int) -> list[Task]:
    """Levels with these numbers of rows, and a last level of full rank."""
    rng = np.random.default_rng(seed)
    lowest = Task(np.diag(np.sqrt([1e3, 1e3, 1, 1, 1, 1, 1, 1, 1])), rng.normal(size=N))
    return [*(level(rng, m) for m in rows), lowest]


def slack(task: Task, qdd: Array) -> float:
    return float(np.linalg.norm(task.J @ qdd - task.b))


def null_space(J: Array) -> Array:
    _, s, Vt = np.linalg.svd(J)
    return Vt[int((s > 1e-9).sum()) :].T


@pytest.mark.parametrize("seed", range(5))
def test_lower_levels_do_not_change_higher_levels(seed: int) -> None:
    """Each level's slack is minimal in the null space of the higher levels."""
    T_sca, T_2, lowest = levels(seed, 3, 5)
    qdd = cascade([T_sca, T_2, lowest])
    assert slack(T_sca, qdd) < 1e-7
    above = cascade([T_sca, T_2])
    np.testing.assert_allclose(T_2.J @ qdd, T_2.J @ above, atol=1e-6)
    Z = null_space(np.vstack([T_sca.J, T_2.J]))
    np.testing.assert_allclose(Z.T @ lowest.J.T @ (lowest.J @ qdd - lowest.b), 0.0, atol=1e-4)


@pytest.mark.parametrize("seed", range(5))
def test_conflicting_row_yields_to_the_higher_level(seed: int) -> None:
    T_sca, T_2, lowest = levels(seed, 4, 6)  # ten rows of nine axes
    T_2 = Task(np.vstack([T_sca.J[:1], T_2.J[1:]]), T_2.b)
    qdd = cascade([T_sca, T_2, lowest])
    assert slack(T_sca, qdd) < 1e-6
    assert (T_2.J @ qdd - T_2.b)[0] == pytest.approx(T_sca.b[0] - T_2.b[0], abs=1e-6)


@pytest.mark.parametrize("seed", range(5))
def test_29_equals_26_at_B_zero_and_the_avoidance_task_at_B_identity(seed: int) -> None:
    T_sca, *below = levels(seed, 3, 5)
    qdd_2 = cascade(below)
    np.testing.assert_allclose(inserted(T_sca, np.zeros(3), below, qdd_2), qdd_2, atol=1e-6)
    assert slack(T_sca, inserted(T_sca, np.ones(3), below, qdd_2)) < 1e-7
    B = np.array([0.2, 0.2, 0.7])
    wanted = B * T_sca.b + (1.0 - B) * (T_sca.J @ qdd_2)
    np.testing.assert_allclose(T_sca.J @ inserted(T_sca, B, below, qdd_2), wanted, atol=1e-7)


def test_hierarchy_without_finite_solution_is_nan(
    robot: RobotModel, border_data: BorderData
) -> None:
    controller = Controller(robot, border_data, Config(), name="hqp")
    w = controller.step(at_rest(robot, np.array(robot.description.arm.ready_position)))
    assert w.solved
    w.M[-1, -1] = np.nan
    assert np.isnan(solved_by_hierarchy(w, Config().task)).all()


def test_guided_arm_far_away_gets_gravity_compensation_and_base_stops(
    robot: RobotModel, border_data: BorderData
) -> None:
    config = Config().replace("limit.torque_rate", 1e6)
    controller = Controller(robot, border_data, config, name="hqp")
    m = at_rest(robot, np.array(robot.description.arm.ready_position))
    w = controller.step(m._replace(base_velocity=np.array([0.1, -0.2])))
    np.testing.assert_allclose(w.u_cmd, w.u_free, atol=1e-6)
    np.testing.assert_allclose(w.a_base_cmd, config.task.base_damping * np.array([-0.1, 0.2]))


def test_choosing_dbb_after_hqp_restores_the_configured_border(
    robot: RobotModel, border_data: BorderData, monkeypatch: pytest.MonkeyPatch
) -> None:
    kinds: list[str] = []

    def noted(model: RobotModel, clouds: tuple[Cloud, ...], config: BorderConfig) -> Any:
        kinds.append(config.kind)
        return border_of(model, clouds, config)

    monkeypatch.setattr(controller_module, "border_of", noted)
    controller = Controller(robot, border_data, Config(), name="hqp")
    controller.use("dbb")
    assert kinds == ["points", "surface"]


@pytest.mark.slow
@pytest.mark.parametrize("name", ["tracking", "guiding-front"])
def test_results_of_the_paper_section_4_2(
    robot: RobotModel, border_data: BorderData, name: str
) -> None:
    """The base moves away without contact, and a tracking end-effector reaches its target."""
    # Shorter than the paper's 30 s and 8 s.
    scenario = scenario_by_name(name).changed(duration=8.0 if name == "tracking" else 4.0)
    figures = run_scenario(
        robot, border_data, scenario, Config(), controller="hqp", physics="kinematic"
    ).figures
    assert figures["min_clearance_m"] > 0.03
    assert figures["base_displacement_m"] > 0.05
    assert figures["contacts"] == 0
    if name == "tracking":
        assert figures["ee_error_final_m"] < 1e-3


def test_hqp_jumps_where_dbb_is_continuous() -> None:
    """The jump of the base's angular acceleration is 0.3 rad/s² with `hqp`, 6e-7 rad/s² with `dbb`.

    The path is one random motion of arm and base within the buffer.
    """
    jumps = {}
    for name in ("hqp", "dbb"):
        report = continuity(Options(controller=name), 1, 0.1, refined=1, first=1, kinds=TRACKING)
        jumps[name] = report.summary["jump_radps2"]
    assert jumps["hqp"] > 0.1
    assert jumps["dbb"] < 1e-4
