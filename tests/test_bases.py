"""Properties of every kind of base, and of each kind alone."""

from __future__ import annotations

import math

import numpy as np
import pytest

from app.avoidance.acting_point import resultant_force
from app.border.score import ScoreField, field_at
from app.config import AdmittanceConfig
from app.control.inputs import largest_command
from app.robot.bases.car_like import CarLikeBase, nearest_in_cone
from app.robot.bases.kind import planar
from app.robot.state import RobotState
from app.simulation.plants import make_physics
from app.simulation.plants.interface import Drive
from tests.admittance import RunningAdmittance
from tests.bases import KINDS, base_of, robot_on
from tests.finite_differences import jacobian

KAPPA, RADIUS = 0.7, 0.5  # [1/m] largest curvature, [m] radius of gyration of a car


def car() -> CarLikeBase:
    base = base_of("car-like")
    assert isinstance(base, CarLikeBase)
    return base


@pytest.mark.parametrize("kind", KINDS)
def test_axis_twists_are_orthonormal_and_the_jacobian_is_invertible(kind: str) -> None:
    base = base_of(kind)
    np.testing.assert_allclose(base.T.T @ base.T, np.eye(base.n_b), atol=1e-15)
    assert np.linalg.matrix_rank(base.J_m) == base.n_b == len(base.max_velocity)
    for axis, twist in zip(base.axes, base.T.T, strict=True):
        assert planar((axis,), [1.0]) == tuple(twist)


@pytest.mark.parametrize("kind", KINDS)
def test_score_gradient_agrees_with_finite_differences(kind: str) -> None:
    field = ScoreField.of(robot_on(kind), "lEE")
    p = np.random.default_rng(0).uniform([-1, -0.8, 0], [1, 0.8, 1.2], (200, 3))
    numeric = jacobian(lambda step: field.score(p + step), 3)
    np.testing.assert_allclose(field.gradient(p), numeric, atol=1e-7 * np.abs(numeric).max())
    for point, S, gradient in zip(p, field.score(p), field.gradient(p), strict=True):
        _, at, by_point = field_at(field.coefficients(), point)
        assert at == pytest.approx(S, rel=1e-12)
        np.testing.assert_allclose(by_point, gradient, rtol=1e-9, atol=1e-9 * abs(S))


def test_the_score_on_a_holonomic_base_is_the_reachability() -> None:
    field = ScoreField.of(robot_on("holonomic"), "lEE")
    p = np.random.default_rng(0).uniform(-1, 1, (100, 3))
    np.testing.assert_array_equal(field.score(p), field.reachability(p))


@pytest.mark.parametrize("kind", KINDS)
def test_force_does_no_negative_work_along_its_acceleration(kind: str) -> None:
    base, rng = base_of(kind), np.random.default_rng(0)
    for _ in range(50):
        p, f = rng.uniform(-1, 1, 3), np.append(rng.normal(size=2), 0.0)
        x, y, w = base.T @ base.A_b @ resultant_force(f[None], p[None])
        assert f[0] * (x - w * p[1]) + f[1] * (y + w * p[0]) >= 0.0


def test_a_holonomic_base_moves_along_any_force() -> None:
    base = base_of("holonomic")
    np.testing.assert_allclose(base.A_b @ [6.0, -12.0, 8.0], [0.1, -0.2, 0.5])


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("plant", ["kinematic", "planar", "mujoco"])
def test_plant_follows_its_drive_and_measures_the_motion(kind: str, plant: str) -> None:
    model, command = robot_on(kind), np.array([0.2, 0.15, -0.3])[-robot_on(kind).n_b :]
    physics, u_a = make_physics(plant, model), RobotState(model).g[model.n_b :]
    drive = Drive(model.description.base, 0.001)
    start = physics.measure().base_pose
    way = np.zeros(3)
    for _ in range(300):
        velocity = drive.step(command)
        x, y, w = model.description.base.T @ velocity
        phi = way[2] + 0.5e-3 * w
        way += 1e-3 * np.array(
            [x * np.cos(phi) - y * np.sin(phi), x * np.sin(phi) + y * np.cos(phi), w]
        )
        physics.step(u_a, command, np.zeros(3))
    measured = physics.measure()
    physics.close()
    np.testing.assert_allclose(measured.base_pose - start, way, atol=2e-4)
    np.testing.assert_allclose(measured.base_velocity, velocity, atol=2e-3)
    np.testing.assert_allclose(measured.drive, drive.state, atol=1e-12)


def steps_of(drive: Drive, command: tuple[float, float], count: int) -> np.ndarray:
    """(count, 2) [m/s, rad/s] velocities of the drive in the next `count` steps with a command."""
    return np.array([drive.step(command) for _ in range(count)])


def test_a_small_command_is_followed_exponentially_with_the_time_constant() -> None:
    """The acceleration limit acts only on commands above v = a_max τ."""
    base, dt, small = base_of("differential"), 0.001, np.array([0.05, 0.1])
    t = dt * np.arange(1, 301)[:, None]
    expected = small * (1 - np.exp(-t / base.drive_time_constant_s))
    np.testing.assert_allclose(steps_of(Drive(base, dt), (0.05, 0.1), 300), expected, rtol=1e-9)


@pytest.mark.parametrize("dt", [0.0001, 0.001, 0.01, 0.1, 1.0])
def test_drive_overshoots_at_no_period(dt: float) -> None:
    v = steps_of(Drive(base_of("differential"), dt), (1.0, -2.0), max(20, int(3 / dt)))
    assert np.all(np.diff(v[:, 0]) >= 0)
    assert np.all(np.diff(v[:, 1]) <= 0)
    np.testing.assert_allclose(v[-1], (1.0, -2.0), rtol=1e-6)


def test_drive_uses_its_whole_velocity_and_acceleration() -> None:
    base, rng = base_of("differential"), np.random.default_rng(0)
    drive = Drive(base, 0.001)
    v = np.vstack([steps_of(drive, tuple(rng.normal(0, 10, 2)), 200) for _ in range(30)])
    limits = base.max_linear_acceleration_mps2, base.max_angular_acceleration_radps2
    np.testing.assert_allclose(np.abs(np.diff(v, axis=0)).max(axis=0) / 0.001, limits, rtol=1e-9)
    fastest = np.abs(v).max(axis=0)
    assert (fastest <= base.max_velocity).all()
    assert fastest[0] > 0.9 * base.max_linear_velocity_mps


@pytest.mark.parametrize("kind", KINDS)
def test_reset_brings_the_drive_to_rest(kind: str) -> None:
    base = base_of(kind)
    drive = Drive(base, 0.001)
    for _ in range(10):
        drive.step(np.full(base.n_b, 0.05))
    assert np.abs(drive.velocity).max() > 0.0
    drive.reset()
    np.testing.assert_array_equal(drive.velocity, np.zeros(base.n_b))
    np.testing.assert_array_equal(drive.state, Drive(base, 0.001).state)


@pytest.mark.parametrize("kind", KINDS)
def test_drive_acceleration_predicts_the_next_step_of_the_drive(kind: str) -> None:
    base, dt, rng = base_of(kind), 1e-5, np.random.default_rng(1)
    drive = Drive(base, dt)
    for _ in range(30):
        command, before = rng.normal(0, 0.6, base.n_b), drive.velocity
        expected = base.drive_acceleration(before, drive.state, command)
        np.testing.assert_allclose(
            np.subtract(drive.step(command), before) / dt, expected, rtol=1e-3, atol=2e-3
        )
        for _ in range(300):
            drive.step(command)


@pytest.mark.parametrize("kind", KINDS)
def test_command_and_drive_are_finite_and_limited_for_any_acceleration(kind: str) -> None:
    base, rng = base_of(kind), np.random.default_rng(2)
    config = AdmittanceConfig()
    law, drive = RunningAdmittance(base, config), Drive(base, 0.01)
    top = np.array(base.max_velocity) + 1e-9
    for k in range(3000):
        size = rng.choice([0.0, 1e-300, 1e-12, 1e-3, 1.0, 1e3])
        if k % 7 == 0:
            demanded = size * rng.normal(size=base.n_b) * rng.integers(0, 2, base.n_b)
        command = law.update(demanded, 0.01)
        before = drive.velocity
        after = drive.step(command)
        assert np.isfinite(command).all()
        assert np.isfinite(after).all()
        assert (np.abs(command) <= largest_command(base, config) + 1e-9).all()
        assert (np.abs(after) <= top).all()
        assert np.abs(after[0] - before[0]) <= 0.01 * base.max_linear_acceleration_mps2 + 1e-9


@pytest.mark.parametrize("kind", KINDS)
def test_zero_acceleration_gives_the_command_zero(kind: str) -> None:
    base = base_of(kind)
    law = RunningAdmittance(base, AdmittanceConfig())
    for _ in range(300):
        np.testing.assert_array_equal(law.update(np.zeros(base.n_b), 0.001), np.zeros(base.n_b))


def test_car_measure_is_the_squared_area_between_its_tightest_arcs() -> None:
    base, rng = car(), np.random.default_rng(0)
    for x, y, _ in rng.uniform(-1, 1, (50, 3)):
        w = math.tan(base.steering_limit_rad) / base.wheelbase_m  # [rad/s] at 1 m/s
        right, left = (1.0 + w * y, -w * x), (1.0 - w * y, w * x)
        area = right[0] * left[1] - right[1] * left[0]
        assert base.measure.at(x) == pytest.approx(np.sign(x) * area**2, rel=1e-9, abs=1e-15)


def test_nearest_velocity_in_the_cone_agrees_with_a_dense_search() -> None:
    rng = np.random.default_rng(0)
    speeds = np.linspace(-3, 3, 6001)
    for v, w in rng.normal(size=(200, 2)):
        found = nearest_in_cone(v, w, KAPPA, RADIUS, 0.0)
        assert abs(found[1]) <= KAPPA * abs(found[0]) + 1e-12
        cost = (found[0] - v) ** 2 + RADIUS**2 * (found[1] - w) ** 2
        edges = [(speeds - v) ** 2 + RADIUS**2 * (s * KAPPA * speeds - w) ** 2 for s in (1, -1)]
        inside = abs(w) <= KAPPA * abs(v)
        assert cost <= (0.0 if inside else np.min(edges)) + 1e-6


def test_projection_to_the_cone_is_idempotent_and_mirror_symmetric() -> None:
    rng = np.random.default_rng(1)
    for v, w, before in rng.normal(size=(300, 3)):
        found = nearest_in_cone(v, w, KAPPA, RADIUS, before)
        np.testing.assert_allclose(nearest_in_cone(*found, KAPPA, RADIUS, before), found)
        left = nearest_in_cone(v, -w, KAPPA, RADIUS, before)
        np.testing.assert_allclose(left, (found[0], -found[1]))


@pytest.mark.parametrize("before", [0.2, -0.2])
def test_moving_car_does_not_reverse_for_a_small_advantage(before: float) -> None:
    for v in (-0.01, 0.0, 0.01):
        found, _ = nearest_in_cone(v, 1.0, KAPPA, RADIUS, before)
        assert np.sign(found) == np.sign(before)


@pytest.mark.parametrize("w_dot", [1.0, -1.0])
def test_demanded_turn_on_the_spot_moves_a_car_along_its_tightest_arc(w_dot: float) -> None:
    """A pure torque causes neither a deadlock nor chattering."""
    base = car()
    law, drive = RunningAdmittance(base, AdmittanceConfig()), Drive(base, 0.001)
    noise, commands = np.random.default_rng(0), []
    turned = 0.0
    for _ in range(3000):
        demanded = np.array([1e-3 * noise.normal(), w_dot])
        commands.append(law.update(demanded, 0.001))
        turned += 0.001 * drive.step(commands[-1])[1]
    v, w = np.array(commands).T
    assert turned * np.sign(w_dot) > 0.05
    assert len(set(np.sign(v[v != 0.0]))) == 1
    assert (np.diff(np.abs(w)) >= -1e-3).all()
    assert abs(w[-1]) == pytest.approx(base.curvature_max * abs(v[-1]))


def test_car_steers_before_it_reverses() -> None:
    """From forward-left to backward-left motion, it must not turn right in between."""
    base = car()
    drive = Drive(base, 0.001)
    arc = np.array([0.3, 0.3 * base.curvature_max])
    for _ in range(1500):
        drive.step(arc)
    right = 0.0
    for _ in range(1500):
        right -= 0.001 * min(drive.step(arc * [-1.0, 1.0])[1], 0.0)
    assert right < 0.02  # [rad]
    np.testing.assert_allclose(drive.velocity, arc * [-1.0, 1.0], rtol=1e-3)


def test_a_car_steers_at_standstill() -> None:
    base = car()
    drive = Drive(base, 0.001)
    creeping = np.array([0.006, 0.006 * base.curvature_max])
    for _ in range(1000):
        drive.step(creeping)
    assert drive.state[0] == pytest.approx(base.steering_limit_rad, abs=1e-3)
