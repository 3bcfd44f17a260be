"""The numbers printed in the paper agree with the shipped files."""

from __future__ import annotations

import numpy as np
import pytest

from app.border.cache import BorderData
from app.border.dbb import construct_dbb
from app.border.score import ScoreField
from app.config import Config
from app.control.tasks import activation
from app.robot.model import RobotModel
from app.simulation.scenarios import scenario_by_name
from app.simulation.session import DT
from tests.admittance import RunningAdmittance


def test_the_link_pairs_of_1_and_their_split_in_2(border_data: BorderData) -> None:
    pairs = border_data.pairs
    assert [pair.name for pair in pairs.mobile] == ["lm-lEE", "lm-l3"]
    assert [pair.name for pair in pairs.manipulator] == ["l1-lEE", "l1-l3", "l2-lEE"]
    assert [pair.name for pair in pairs.all] == ["lm-lEE", "lm-l3", "l1-lEE", "l1-l3", "l2-lEE"]


def test_the_second_link_never_meets_the_base(border_data: BorderData) -> None:
    """§2.1: because joint 2 is limited to ±101 degrees."""
    assert "lm-l2" in {pair.name for pair in border_data.pairs.never}
    assert border_data.pairs.least_distance_m["lm-l2"] > 0.0


def test_joint_2_turns_101_degrees_either_way(robot: RobotModel) -> None:
    limits = np.degrees([robot.q_lower[1], robot.q_upper[1]])
    np.testing.assert_allclose(limits, [-101.0, 101.0], atol=0.5)  # printed without decimals


def test_wheel_radius_and_half_track_of_2_3_1(robot: RobotModel) -> None:
    base = robot.description.base
    assert (base.wheel_radius_m, base.half_track_m) == (0.165, 0.51)
    v, w = robot.J_m @ [1.0, -1.0]  # rad/s, the wheels turn in opposite directions
    assert (v, w) == (0.0, pytest.approx(0.165 / 0.51))


def test_the_arm_has_seven_joints_and_the_robot_nine_degrees_of_freedom(robot: RobotModel) -> None:
    assert (robot.n_m, robot.n) == (7, 9)


def test_buffer_distance_and_tolerance_of_figure_3() -> None:
    assert (Config().border.d_b, Config().border.eps) == (0.15, 0.01)


def test_figure_10_by_default() -> None:
    """β is 0 from 0.15 m outwards and 1 from 0.05 m inwards, a cubic between."""
    config = Config()

    def beta(d: float) -> float:
        return activation(d, config.border.d_b, config.activation.d_full)

    assert beta(0.15) == beta(0.2) == 0.0
    assert beta(0.05) == beta(0.0) == beta(-0.1) == 1.0
    between = np.linspace(0.05, 0.15, 9)
    values = np.array([beta(d) for d in between])
    assert (np.diff(values) < 0).all()
    cubic = np.polynomial.Polynomial.fit(between, values, 3)
    np.testing.assert_allclose(cubic(between), values, atol=1e-12)


def test_A_B_C_of_2_3_2_for_the_end_effector(robot: RobotModel) -> None:
    field = ScoreField.of(robot, "lEE")
    assert (field.A, field.B, field.C) == (525.9, 0.575, 100.0)


@pytest.mark.parametrize("printed", [0.139, 1.011])
def test_9_as_printed_has_two_roots_where_the_implementation_is_positive(
    robot: RobotModel, printed: float
) -> None:
    field = ScoreField.of(robot, "lEE")
    roots = np.roots([-field.A, 2 * field.A * field.B, field.C - field.A * field.B**2])
    assert np.abs(roots - printed).min() < 0.0005  # three decimals
    p = field.p_base + np.array([0.0, 0.0, printed])
    assert 0.0 < float(field.reachability(p)) < 0.05 * field.C


def test_largest_reachability_is_c_at_b(robot: RobotModel) -> None:
    field = ScoreField.of(robot, "lEE")
    assert field.reachability(field.p_base + np.array([0.575, 0.0, 0.0])) == pytest.approx(100.0)


@pytest.mark.parametrize("pair", ["lm-lEE", "lm-l3"])
def test_a_border_has_at_least_the_50_000_points_of_4_3(border_data: BorderData, pair: str) -> None:
    config = Config().border
    assert len(construct_dbb(border_data.clouds[pair], config.d_b, config.eps)) >= 50_000


def test_the_arm_is_controlled_at_1_khz_and_the_base_at_10_hz(robot: RobotModel) -> None:
    """§4.1, counted: the command changes at every hundredth control step and at no other."""
    assert DT == 0.001
    law = RunningAdmittance(robot.description.base, Config().admittance)
    commands = [law.update(np.array([0.3, 0.0]), DT)[0] for _ in range(500)]
    renewed = [
        k
        for k, (old, new) in enumerate(zip([0.0, *commands], commands, strict=False))
        if old != new
    ]
    assert renewed == [99, 199, 299, 399, 499]


def test_tracking_goes_0_2_m_along_minus_y_in_30_s_by_a_cubic() -> None:
    """§4.2.1."""
    tracking = scenario_by_name("tracking")
    T = tracking.duration
    assert (tracking.mode, T) == ("tracking", 30.0)
    start, end, *between = (
        tracking.reference(t, np.eye(3)) for t in (0.0, T, *np.linspace(0.01, T - 0.01, 7))
    )
    way = end.pose.translation - start.pose.translation
    np.testing.assert_allclose(way, [0.0, -0.2, 0.0], atol=1e-12)
    np.testing.assert_allclose([start.velocity, end.velocity], 0.0, atol=1e-12)
    accelerations = [each.acceleration[1] for each in between]
    np.testing.assert_allclose(np.diff(accelerations, n=2), 0.0, atol=1e-12)  # linear in time


@pytest.mark.parametrize("name", ["guiding-lateral", "guiding-front"])
def test_guiding_moves_from_the_side_or_from_the_front(name: str) -> None:
    """§4.2.2: towards the base, without other tasks than avoidance."""
    scenario = scenario_by_name(name)
    axis = {"guiding-lateral": 1, "guiding-front": 0}[name]
    assert scenario.mode == "guiding"
    assert scenario.move[axis] * scenario.start[axis] < 0.0
    assert all(m == 0.0 for i, m in enumerate(scenario.move) if i != axis)
