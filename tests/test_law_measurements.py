"""The benchmark measurements of the control law give correct numbers."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable

import numpy as np
import pytest

from app.config import Config
from app.robot.link_pairs import PairDistances
from benchmarks.law import paths, release, wander
from benchmarks.law.__main__ import MEASUREMENTS, main
from benchmarks.law.continuity import Kind, continuity, jumps_of
from benchmarks.law.curves import Curve
from benchmarks.law.draws import named_pull, random_pull, side
from benchmarks.law.motions import random_motion
from benchmarks.law.options import Options
from benchmarks.law.postures import posture_in_buffer
from benchmarks.law.robot import load
from benchmarks.law.starts import posture
from benchmarks.law.work import played
from tests.finite_differences import derivative

ROBOT = "husky_panda"
CURVES = (
    Curve("towards", (0.3, 0.7, 0.3), (0.35, 0.5, 0.4), None, 2.0),
    Curve("arc", (0.3, 0.7, 0.3), (0.8, 0.2, 0.4), (0.0, 0.0), 2.0),
)


def test_a_motions_velocities_and_accelerations_are_its_derivatives() -> None:
    robot, rng = load(ROBOT), np.random.default_rng(0)
    motion = random_motion(robot.model, posture_in_buffer(robot, rng), 0.3, rng, 1.0)
    at, vd, qdd = motion.at(0.4)
    np.testing.assert_allclose(derivative(lambda h: motion.at(0.4 + h)[0].q_m), at.qd_m, atol=1e-8)
    np.testing.assert_allclose(derivative(lambda h: motion.at(0.4 + h)[0].qd_m), qdd, atol=1e-8)
    np.testing.assert_allclose(
        derivative(lambda h: motion.at(0.4 + h)[0].base_velocity), vd, atol=1e-8
    )


def test_a_motion_passes_its_posture_at_half_its_time() -> None:
    robot, rng = load(ROBOT), np.random.default_rng(1)
    q = posture_in_buffer(robot, rng)
    motion = random_motion(robot.model, q, 0.3, rng, 0.6)
    np.testing.assert_allclose(motion.at(0.3)[0].q_m, q, atol=1e-12)


def test_posture_in_the_buffer_is_inside_of_it_without_contact() -> None:
    robot = load(ROBOT)
    reader = PairDistances(robot.model, robot.data.pairs.all)
    for seed in range(5):
        q = posture_in_buffer(robot, np.random.default_rng(seed))
        reader.update(robot.model.configuration((0.0, 0.0, 0.0), q))
        d = reader.distances()
        assert min(d) > 0.0
        assert min(d[: robot.n_mobile]) < Config().border.d_b


@pytest.mark.parametrize("curve", CURVES, ids=lambda curve: curve.kind)
def test_velocity_and_acceleration_of_a_curve_are_its_derivatives(curve: Curve) -> None:
    at = curve.reference(0.7, np.eye(3))
    v = derivative(lambda h: curve.reference(0.7 + h, np.eye(3)).pose.translation)
    a = derivative(lambda h: curve.reference(0.7 + h, np.eye(3)).velocity)
    np.testing.assert_allclose(at.velocity[:3], v, atol=1e-8)
    np.testing.assert_allclose(at.acceleration, a, atol=1e-8)
    np.testing.assert_allclose(
        curve.reference(curve.duration, np.eye(3)).pose.translation, curve.end, atol=1e-12
    )


def test_jump_is_the_extrapolation_to_a_step_of_zero() -> None:
    slope, jump = 20.0, 0.3  # [1/s] and [-]
    steps = np.array([1.0, 0.5, 0.25, 0.125]) * 1e-3
    found = jumps_of(np.array([slope * steps, jump + slope * steps, jump + 0.0 * steps]))
    np.testing.assert_allclose(found, [0.0, jump, jump], atol=1e-12)


def test_random_pull_depends_on_seed_and_number_only() -> None:
    def drawn(number: int) -> object:
        rng = np.random.default_rng([3, number])
        return random_pull(Options(), number, rng, f_max=(30.0, 100.0), stiffness=(300.0, 3000.0))

    first = drawn(4)
    drawn(1)
    assert drawn(4) == first
    assert drawn(5) != first


def test_sides_are_those_of_the_bases_box() -> None:
    places = {
        (0.9, 0.1, 0.3): "front",
        (0.0, -0.7, 0.3): "side",
        (-0.9, 0.0, 0.3): "back",
        (0.9, 0.7, 0.3): "front corner",
        (0.0, 0.0, 0.6): "above",
    }
    assert {p: side(p, ROBOT) for p in places} == places


def test_several_processes_return_rows_in_the_order_of_their_cases() -> None:
    assert played(abs, [-3, -1, -2], 2, "numbers") == [3, 1, 2]


def test_path_after_a_release_begins_at_the_release() -> None:
    case = _released(inside_s=0.1, after_s=0.0)
    row = release.play(case)
    assert row["d_release_m"] < Config().border.d_b
    assert row["path_m"] == pytest.approx(0.0, abs=1e-3)  # one step at 0.5 m/s


def test_two_people_who_pull_at_random_cause_no_contact() -> None:
    """They enter the buffer, and after both have released the arm the base comes to rest."""
    row = wander.play(wander.Walk(Options(), 0, 50.0))
    assert 0.0 < row["least_distance_m"] < Config().border.d_b
    assert row["contact_steps"] + row["arm_contact_steps"] + row["failures"] == 0
    assert row["base_speed_final_mps"] < 1e-3


def test_pull_that_never_enters_the_buffer_has_no_release() -> None:
    case = _released(inside_s=0.1, after_s=0.0)
    away = case._replace(pull=case.pull._replace(move=(0.0, 0.02, 0.0), lead_s=0.2))
    assert release.play(away)["path_m"] is None


def test_end_effector_far_from_the_base_stays_on_its_target() -> None:
    row = paths.follow(
        Options(), Curve("towards", (0.3, 0.75, 0.3), (0.3, 0.74, 0.3), None, 0.5), _posture()
    )
    assert not row["leaves"]
    assert row["end_off_mm"] < 0.1


@pytest.mark.parametrize(
    ("name", "arguments"),
    [
        ("curvature", ["--count", "20"]),
        ("energy", ["--count", "1", "--seconds", "0.05"]),
        ("continuity", ["--count", "1", "--first", "1", "--duration", "0.02", "--refined", "1"]),
    ],
)
def test_a_measurement_prints_one_json_object(
    name: str,
    arguments: list[str],
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setattr(sys, "argv", ["law", name, *arguments, "--json"])
    main()
    result = json.loads(capsys.readouterr().out)
    assert result["measurement"] == name
    assert result["rows"]
    assert result["summary"]


def test_every_measurement_has_a_docstring() -> None:
    measures: dict[str, Callable[..., object]] = dict(MEASUREMENTS)
    assert all(measure.__doc__ for measure in measures.values())


def _posture() -> tuple[float, ...]:
    q = posture(ROBOT, (0.3, 0.75, 0.3))
    assert q is not None
    return tuple(q.tolist())


def _released(inside_s: float, after_s: float) -> release.Release:
    pull = named_pull(Options(), "lateral", (0.30, 0.72, 0.30), (0.0, -0.25, 0.0), 0.8, 300.0, 40.0)
    return release.Release(pull, inside_s, after_s)


@pytest.mark.parametrize("motion", [13, 62])
def test_command_of_a_tracking_base_is_continuous_as_links_enter_a_buffer(
    motion: int,
) -> None:
    """The base avoids links outside their buffer too, with closest points that must be blended."""
    summary = continuity(Options(), 1, first=motion, kinds=("tracking",)).summary
    assert summary["jump_mps2"] < 1e-4  # 0.05 with the library's own points beyond the buffer
    assert summary["jump_radps2"] < 1e-3


@pytest.mark.parametrize(
    ("kind", "motion"), [("guided", 51), ("guided", 659), ("tracking", 851), ("tracking", 924)]
)
def test_steepest_of_a_thousand_motions_are_within_the_limits(kind: Kind, motion: int) -> None:
    """The cloud has gaps near these motions; with such gaps in the border the change was larger."""
    summary = continuity(Options(), 1, first=motion, refined=1, kinds=(kind,)).summary
    assert summary["away_from_limits_mps2"] < 0.02
    assert summary["away_from_limits_radps2"] < 0.05
