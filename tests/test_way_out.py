"""Starts in a buffer or in penetration have the requested kind; the robot leaves them gently."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from app.avoidance.closest_points import ClosestPoints, DistanceMonitor
from app.border.cache import BorderData
from app.config import Config
from app.errors import ConfigError
from app.robot.model import RobotModel
from app.robot.state import Measurement, RobotState
from app.simulation.run import run_scenario
from app.simulation.scenarios.way_out import BEGINS, DEEPEST, Begin, WayOutScenario
from app.simulation.session import DT, Session

pytestmark = pytest.mark.slow

D_B = Config().border.d_b
Draw = Callable[[Begin, int], np.ndarray]


@pytest.fixture(scope="module")
def drawn(robot: RobotModel, border_data: BorderData) -> Draw:
    """The posture of the arm at a start, by kind and seed."""
    return lambda begin, seed: (
        WayOutScenario(begin=begin).setting(robot, border_data, Config(), seed).q_m
    )


def closest_at(robot: RobotModel, data: BorderData, q_m: np.ndarray) -> list[ClosestPoints]:
    state = RobotState(robot)
    state.update(Measurement(np.zeros(3), np.zeros(2), q_m, np.zeros(robot.n_m)))
    return DistanceMonitor(
        state, [*data.pairs.mobile, *data.pairs.manipulator]
    ).find_closest_points()


@pytest.mark.parametrize("begin", BEGINS)
def test_starts_have_their_stated_kind(
    robot: RobotModel, border_data: BorderData, drawn: Draw, begin
) -> None:
    ranges = {"penetration": (-DEEPEST, 0.0), "buffer": (0.0, D_B), "arm": (0.0, D_B)}
    low, high = ranges[begin]
    for seed in range(12):
        worst = min(closest_at(robot, border_data, drawn(begin, seed)), key=lambda c: c.d)
        assert low <= worst.d <= high
        if begin != "penetration":
            assert (worst.pair.a == "lm") == (begin == "buffer")


def test_starts_cover_every_pair_and_the_side_of_the_base(
    robot: RobotModel, border_data: BorderData, drawn: Draw
) -> None:
    found, from_side = set(), 0
    for seed in range(40):
        q_m = drawn("penetration", seed)
        worst = min(closest_at(robot, border_data, q_m), key=lambda c: c.d)
        found.add(worst.pair.name)
        from_side += worst.pair.a == "lm" and abs(worst.n[2]) < 0.5
    assert found >= {"lm-lEE", "lm-l3", "l1-lEE", "l1-l3"}
    assert from_side >= 3


def test_equal_seeds_draw_equal_starts(drawn: Draw) -> None:
    for begin in BEGINS:
        np.testing.assert_array_equal(drawn(begin, 5), drawn(begin, 5))
    assert (drawn("buffer", 5) != drawn("buffer", 6)).all()


def test_an_unknown_kind_of_start_is_refused() -> None:
    with pytest.raises(
        ConfigError, match="--begin: 'outside' is not one of penetration, buffer, arm"
    ):
        WayOutScenario(begin="outside")  # pyright: ignore[reportArgumentType]


@pytest.mark.parametrize("begin", BEGINS)
@pytest.mark.parametrize("seed", [100, 105])
def test_the_robot_leaves_the_inner_buffer_and_stays_outside(
    robot: RobotModel, border_data: BorderData, begin, seed: int
) -> None:
    figures = run_scenario(
        robot, border_data, WayOutScenario(begin=begin), Config(), physics="kinematic", seed=seed
    ).figures
    assert figures["clear_since_s"] is not None
    assert figures["solver_failures"] == 0


@pytest.mark.parametrize("seed", range(3))
def test_the_first_torques_are_near_gravity_compensation(
    robot: RobotModel, border_data: BorderData, drawn: Draw, seed: int
) -> None:
    """No start causes a jump of the torques, at any depth of penetration."""
    session = Session(robot, border_data, Config(), physics="kinematic")
    session.reset(drawn("penetration", seed))
    step = session.step()
    g = session.controller.state.g[2:]
    assert np.abs(step.control.u_cmd - g).max() <= Config().limit.torque_rate * DT + 1e-6
