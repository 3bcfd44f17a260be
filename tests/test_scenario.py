"""The leading point's motion: where it begins and ends, and that its derivatives are its own."""

from __future__ import annotations

import numpy as np
import pytest

from app.border.cache import BorderData
from app.config import Config
from app.errors import ConfigError, TargetError, UnknownNameError
from app.robot.model import RobotModel
from app.simulation.line import LineScenario
from app.simulation.run import run_scenario
from app.simulation.scenario import LINES, SCENARIOS, scenario_by_name


@pytest.fixture(params=LINES)
def scenario(request) -> LineScenario:
    return LINES[request.param]


def test_the_names_are_those_of_the_issue():
    assert set(SCENARIOS) == {
        "guiding-lateral", "guiding-front", "guiding-above", "guiding-fold", "tracking",
        "refrigerator", "way-out",
    }  # fmt: skip
    assert all(name == each.name for name, each in SCENARIOS.items())
    assert {n for n, each in LINES.items() if each.mode == "tracking"} == {"tracking"}


def test_tracking_is_the_papers_line(scenario):
    """0.2 m along -y in 30 s."""
    tracking = LINES["tracking"]
    assert tracking.move == (0.0, -0.2, 0.0)
    assert tracking.duration * tracking.moving == 30.0


def test_it_leads_from_start_to_start_plus_move_and_holds(scenario):
    start, move = np.array(scenario.start), np.array(scenario.move)
    moving = scenario.duration * scenario.moving
    np.testing.assert_allclose(scenario.position(0.0)[0], start)
    np.testing.assert_allclose(scenario.position(moving / 2)[0], start + move / 2)
    for t in (moving, scenario.duration, 2 * scenario.duration):
        np.testing.assert_allclose(scenario.position(t)[0], start + move)
    for t in (0.0, moving, moving + 0.1):
        np.testing.assert_allclose(scenario.position(t)[1], 0.0, atol=1e-12)


def test_velocity_and_acceleration_are_the_derivatives_of_the_position(scenario):
    h = 1e-4  # [s]
    moving = scenario.duration * scenario.moving
    for t in np.linspace(0.01, 0.99, 23) * moving:
        before, at, after = (scenario.position(t + k * h) for k in (-1, 0, 1))
        np.testing.assert_allclose((after[0] - before[0]) / (2 * h), at[1], atol=1e-7)
        np.testing.assert_allclose((after[1] - before[1]) / (2 * h), at[2], atol=1e-7)


def test_the_reference_holds_the_orientation_and_has_the_points_motion(scenario):
    R = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])
    reference = scenario.reference(1.3, R)
    p, v, a = scenario.position(1.3)
    np.testing.assert_array_equal(reference.pose.rotation, R)
    np.testing.assert_array_equal(reference.pose.translation, p)
    np.testing.assert_array_equal(reference.velocity, [*v, 0, 0, 0])
    np.testing.assert_array_equal(reference.acceleration, [*a, 0, 0, 0])


def test_a_change_keeps_the_rest(scenario):
    changed = scenario.changed(move=(0.1, 0.0, 0.0), duration=2.0)
    assert changed == LineScenario(
        scenario.name, 2.0, scenario.about, scenario.mode, scenario.start, (0.1, 0.0, 0.0),
        scenario.moving,
    )  # fmt: skip
    assert scenario.changed() == scenario
    assert scenario.changed(start=(1.0, 0.0, 0.5)).start == (1.0, 0.0, 0.5)


def test_a_change_of_what_a_scenario_does_not_have_lists_what_it_has(scenario):
    with pytest.raises(ConfigError, match=r"--door-width: .*duration, .*move"):
        scenario.changed(door_width=0.5)
    with pytest.raises(ConfigError, match=r"--move: .*door-width"):
        SCENARIOS["refrigerator"].changed(move=(0.1, 0.0, 0.0))


def test_an_unknown_name_lists_those_that_exist():
    with pytest.raises(UnknownNameError, match="tracking") as caught:
        scenario_by_name("trackin")
    assert caught.value.choices == sorted(SCENARIOS)
    assert "did you mean 'tracking'" in str(caught.value)


@pytest.mark.parametrize("name", ["tracking", "guiding-front"])
def test_a_path_that_ends_below_the_floor_is_refused_before_anything_moves(
    robot: RobotModel, border_data: BorderData, name: str
):
    below = SCENARIOS[name].changed(move=(0.0, 0.0, -0.5))
    times: list[float] = []
    with pytest.raises(TargetError, match="below the floor"):
        run_scenario(
            robot, border_data, below, Config(), physics="kinematic", on_progress=times.append
        )
    assert times == []
