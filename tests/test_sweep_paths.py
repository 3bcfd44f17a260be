"""Paths of the end-effector towards the base, and their start postures."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from app.avoidance.closest_points import DistanceMonitor
from app.border.cache import BorderData
from app.border.mobile import MobileBody
from app.robot.model import RobotModel
from app.robot.state import Measurement, RobotState
from app.studies.sweep import sweep
from app.studies.sweep.plan import (
    AXIS_OFFSETS,
    Approach,
    Kind,
    Start,
    SweepPlan,
    exit_distance,
)
from app.studies.sweep.sweep import StartFinder

D_B, DISTANCE = 0.15, 0.17  # [m]


@pytest.fixture(scope="module")
def finder(robot: RobotModel, border_data: BorderData) -> StartFinder:
    return StartFinder(robot, border_data, D_B)


def paths(robot: RobotModel, kind: Kind, **plan: Any) -> list[Approach]:
    """The paths of one kind in a plan."""
    return [path for path in SweepPlan(**plan).approaches(robot) if path.kind == kind]


@pytest.fixture(scope="module")
def axis_starts(finder: StartFinder) -> list[Start]:
    return [finder.find(path, DISTANCE) for path in paths(finder.model, "wheel_axis")]


def at(robot: RobotModel, start: Start) -> RobotState:
    state = RobotState(robot)
    zero = np.zeros(robot.n_m)
    state.update(Measurement(np.zeros(3), np.zeros(2), np.array(start.q_m), zero))
    return state


@given(step=st.sampled_from([0.5, 1.0, 5.0, 15.0, 90.0]))
def test_a_ring_has_each_direction_once_at_each_height(robot: RobotModel, step: float) -> None:
    found = paths(robot, "side", heights=(0.2, 0.4), step=step)
    assert len(set(found)) == len(found) == 2 * round(360.0 / step)
    for approach in found:
        angle = np.radians(approach.direction_deg)
        np.testing.assert_allclose(
            approach.inwards, [-np.cos(angle), -np.sin(angle), 0.0], atol=1e-12
        )


@given(st.floats(0.0, 2 * np.pi), st.floats(0.1, 2.0), st.floats(0.1, 2.0))
def test_exit_distance_ends_on_the_outline_of_the_rectangle(
    angle: float, a: float, b: float
) -> None:
    half = np.array([a, b])
    direction = np.array([np.cos(angle), np.sin(angle)])
    within = np.array([0.3 * a, -0.2 * b])
    r = exit_distance(within, direction, -half, half)
    assert np.max(np.abs(within + r * direction) / half) == pytest.approx(1.0)


@given(st.floats(0.05, 0.9))
def test_the_grid_from_above_spans_the_footprint_within_the_spacing(
    robot: RobotModel, spacing: float
) -> None:
    found, body = paths(robot, "above", above=True, above_spacing=spacing), MobileBody(robot)
    places = np.array([path.place for path in found])
    np.testing.assert_allclose(places.min(axis=0), body.lower[:2], atol=1e-6)
    np.testing.assert_allclose(places.max(axis=0), body.upper[:2], atol=1e-6)
    for values in places.T:
        assert np.diff(np.unique(values)).max() <= spacing + 1e-6


def test_paths_along_the_wheel_axis_are_mirrored(robot: RobotModel) -> None:
    found = paths(robot, "wheel_axis")
    left, right = ([path for path in found if path.direction_deg == d] for d in (90.0, 270.0))
    assert [a.offset for a in left] == [a.offset for a in right] == list(AXIS_OFFSETS)
    np.testing.assert_array_equal(left[0].inwards, [0.0, -1.0, 0.0])
    np.testing.assert_array_equal(right[0].inwards, [0.0, 1.0, 0.0])


@pytest.mark.parametrize("direction", [0.0, 90.0, 345.0])
def test_a_start_is_clear_and_at_the_requested_distance_on_its_ray(
    finder: StartFinder, robot: RobotModel, border_data: BorderData, direction: float
) -> None:
    start = finder.find(Approach("side", 0.3, direction), DISTANCE)
    assert start.reason == ""
    state, pairs = at(robot, start), border_data.pairs
    found = DistanceMonitor(state, [*pairs.mobile, *pairs.manipulator]).find_closest_points()
    assert min(c.d for c in found) > D_B
    least = min(c.d for c in found[: len(pairs.mobile)])
    assert least == pytest.approx(start.clearance, abs=1e-6)
    assert least == pytest.approx(DISTANCE, abs=2e-4)
    p_ee = state.T_world_ee.translation
    np.testing.assert_allclose(p_ee, start.p_ee, atol=1e-9)
    bearing = np.degrees(np.arctan2(p_ee[1], p_ee[0])) % 360.0
    assert (bearing - direction + 180.0) % 360.0 - 180.0 == pytest.approx(0.0, abs=0.01)
    assert p_ee[2] == pytest.approx(0.3, abs=1e-5)
    assert ((robot.q_lower < start.q_m) & (start.q_m < robot.q_upper)).all()


@pytest.mark.slow
def test_on_the_wheel_axis_p_b_starts_at_the_requested_offset(
    axis_starts: list[Start], robot: RobotModel, border_data: BorderData
) -> None:
    assert all(start.reason == "" for start in axis_starts)
    for start in axis_starts:
        monitor = DistanceMonitor(at(robot, start), border_data.pairs.mobile)
        closest = min(monitor.find_closest_points(), key=lambda c: c.d)
        assert closest.p_b[0] == pytest.approx(start.approach.offset, abs=1e-6)
        assert np.sign(closest.p_b[1]) == (1.0 if start.approach.direction_deg == 90.0 else -1.0)
        assert closest.d > D_B


def test_a_start_does_not_depend_on_earlier_searches(
    axis_starts: list[Start], robot: RobotModel, border_data: BorderData
) -> None:
    last = axis_starts[6]
    assert StartFinder(robot, border_data, D_B).find(last.approach, DISTANCE) == last


def test_a_start_from_above_is_over_its_place_and_outside_the_buffer(
    finder: StartFinder, robot: RobotModel
) -> None:
    start = finder.find(Approach("above", place=(-0.2, 0.2)), DISTANCE)
    assert start.reason == ""
    np.testing.assert_allclose(start.p_ee[:2], (-0.2, 0.2), atol=1e-5)
    assert start.p_ee[2] > MobileBody(robot).upper[2]
    assert start.clearance >= D_B


@pytest.mark.slow
def test_an_impossible_start_has_a_reason(
    finder: StartFinder, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sweep, "_SEARCHES", ((0.0, 0),))
    behind = finder.find(Approach("side", 0.3, 180.0), DISTANCE)
    assert "out of the arm's reach" in behind.reason
    assert behind.q_m == ()
    column = finder.find(Approach("above", place=(0.3, 0.0)), DISTANCE)
    assert "inside its buffer" in column.reason
