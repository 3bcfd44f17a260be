"""The motion of a scenario's target: its start, its end and consistent derivatives."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest

from app.border.cache import BorderData
from app.config import Config
from app.errors import ConfigError, TargetError, UnknownNameError
from app.robot.model import RobotModel
from app.simulation.run import run_scenario
from app.simulation.scenarios import LINES, SCENARIOS, scenario_by_name
from app.simulation.scenarios.line import LineScenario


@pytest.fixture(params=LINES)
def scenario(request) -> LineScenario:
    return LINES[request.param]


def test_each_scenario_has_its_own_name():
    assert all(name == each.name for name, each in SCENARIOS.items())
    assert {n for n, each in LINES.items() if each.mode == "tracking"} == {"tracking"}


def motion_of(scenario: LineScenario, t: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    reference = scenario.reference(t, np.eye(3))
    return reference.pose.translation, reference.velocity[:3], reference.acceleration[:3]


def test_tracking_is_the_papers_line():
    """0.2 m along -y in 30 s."""
    tracking = LINES["tracking"]
    assert tracking.move == (0.0, -0.2, 0.0)
    assert tracking.duration * tracking.moving == 30.0


def test_motion_goes_from_start_by_move_and_then_rests(scenario):
    start, move = np.array(scenario.start), np.array(scenario.move)
    moving = scenario.duration * scenario.moving
    np.testing.assert_allclose(scenario.place(0.0), start)
    np.testing.assert_allclose(scenario.place(moving / 2), start + move / 2)
    for t in (moving, scenario.duration, 2 * scenario.duration):
        np.testing.assert_allclose(scenario.place(t), start + move)
    for t in (0.0, moving, moving + 0.1):
        np.testing.assert_allclose(motion_of(scenario, t)[1], 0.0, atol=1e-12)


def test_velocity_and_acceleration_are_the_derivatives_of_the_position(scenario):
    h = 1e-4  # [s]
    moving = scenario.duration * scenario.moving
    for t in np.linspace(0.01, 0.99, 23) * moving:
        before, at, after = (motion_of(scenario, t + k * h) for k in (-1, 0, 1))
        np.testing.assert_allclose((after[0] - before[0]) / (2 * h), at[1], atol=1e-7)
        np.testing.assert_allclose((after[1] - before[1]) / (2 * h), at[2], atol=1e-7)


def test_reference_has_a_constant_orientation_and_the_points_motion(scenario):
    R = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])
    reference = scenario.reference(1.3, R)
    p, v, a = motion_of(scenario, 1.3)
    np.testing.assert_array_equal(reference.pose.rotation, R)
    np.testing.assert_array_equal(reference.pose.translation, p)
    np.testing.assert_array_equal(reference.velocity, [*v, 0, 0, 0])
    np.testing.assert_array_equal(reference.acceleration, [*a, 0, 0, 0])


def test_changed_scenario_differs_in_the_changed_fields_only(scenario):
    changed = scenario.changed(move=(0.1, 0.0, 0.0), duration=2.0)
    assert changed == LineScenario(
        scenario.name,
        2.0,
        scenario.about,
        scenario.mode,
        scenario.start,
        (0.1, 0.0, 0.0),
        scenario.moving,
    )
    assert scenario.changed() == scenario
    assert scenario.changed(start=(1.0, 0.0, 0.5)).start == (1.0, 0.0, 0.5)


def test_unknown_option_is_refused_with_the_valid_options(scenario):
    with pytest.raises(ConfigError, match=r"--door-width: .*duration, .*move"):
        scenario.changed(door_width=0.5)
    with pytest.raises(ConfigError, match=r"--move: .*door-width"):
        SCENARIOS["refrigerator"].changed(move=(0.1, 0.0, 0.0))


GUIDING = [name for name, each in LINES.items() if each.mode == "guiding"]


@pytest.mark.parametrize("name", GUIDING)
@pytest.mark.parametrize("duration", [3.0, 25.0])
def test_motion_with_a_release_does_not_depend_on_the_duration(name, duration):
    own = LINES[name]
    released = own.changed(release_at=2.0, duration=duration)
    assert released.duration == duration
    for t in np.linspace(0.0, 8.0, 41):
        for of_one, of_other in zip(motion_of(released, t), motion_of(own, t), strict=True):
            np.testing.assert_allclose(of_one, of_other, atol=1e-12)
    np.testing.assert_allclose(own.changed(duration=16.0).place(4.0), own.place(2.0))


def test_nobody_pulls_between_release_and_regrasp():
    line = LINES["guiding-front"].changed(release_at=2.0, regrasp_at=3.5)
    for t, grasped in [
        (0.0, True),
        (1.999, True),
        (2.0, False),
        (3.4, False),
        (3.5, True),
        (7.9, True),
    ]:
        assert line.holds(t) == grasped, t
        lead = line.driver(_Stands(t))(_Stands(t))
        assert (lead.pull is not None) == grasped
        assert lead.reference is None
    assert LINES["guiding-front"].holds(7.9)


class _Stands:
    """The part of a session that a driver reads."""

    def __init__(self, t: float) -> None:
        self.t, self.T_world_ee = t, pin.SE3.Identity()


@pytest.mark.parametrize(
    ("name", "changes", "words"),
    [
        ("guiding-front", {"release_at": 8.0}, "--release-at: 8 s is not after .* end, 8 s"),
        ("guiding-front", {"release_at": 6.0, "duration": 5.0}, "--release-at: 6 s .* end, 5 s"),
        ("guiding-front", {"release_at": 0.0}, "--release-at: 0 s is not after .* 0 s"),
        ("guiding-front", {"release_at": float("nan")}, "--release-at: nan s"),
        (
            "guiding-front",
            {"release_at": 2.0, "regrasp_at": 1.0},
            "--regrasp-at: 1 s .* 2 s, .* 8 s",
        ),
        ("guiding-front", {"moving": 1.5}, "--moving: 1.5 .* above 1 without a release"),
        ("guiding-front", {"moving": float("inf"), "release_at": 2.0}, "--moving: inf .* finite"),
        ("guiding-front", {"regrasp_at": 1.0}, "--regrasp-at: there is no release"),
        ("tracking", {"release_at": 1.0}, "--release-at: no person pulls in tracking"),
        ("tracking", {"regrasp_at": 1.0}, "--regrasp-at: no person pulls in tracking"),
        ("way-out", {"release_at": 1.0}, "--release-at: the scenario way-out has no such option"),
        (
            "refrigerator",
            {"release_at": 1.0},
            "--release-at: the scenario refrigerator has no such option",
        ),
    ],
)
def test_invalid_release_is_refused_in_one_line(name, changes, words):
    with pytest.raises(ConfigError, match=words) as caught:
        SCENARIOS[name].changed(**changes)
    assert "\n" not in str(caught.value)


def test_unknown_scenario_is_refused_with_the_valid_names():
    with pytest.raises(UnknownNameError, match="tracking") as caught:
        scenario_by_name("trackin")
    assert caught.value.choices == sorted(SCENARIOS)
    assert "did you mean 'tracking'" in str(caught.value)


@pytest.mark.parametrize("name", ["tracking", "guiding-front"])
def test_path_that_ends_below_the_floor_is_refused_before_the_run(
    robot: RobotModel, border_data: BorderData, name: str
):
    below = SCENARIOS[name].changed(move=(0.0, 0.0, -0.5))
    times: list[float] = []
    with pytest.raises(TargetError, match=r"--move: the line ends at z = .* below the floor"):
        run_scenario(
            robot, border_data, below, Config(), physics="kinematic", on_progress=times.append
        )
    assert times == []
