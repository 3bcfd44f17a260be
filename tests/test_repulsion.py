"""The repulsive rows, (20) to (23)."""

from typing import NamedTuple

import numpy as np
import pinocchio as pin
import pytest
from finite_differences import jacobian

from app.avoidance.closest_points import ClosestPoints, DistanceMonitor
from app.border.cache import BorderData
from app.config import RepulsionConfig
from app.control.tasks import generate_rep_acc
from app.robot.link_pairs import PairDistances, candidate_pairs
from app.robot.model import RobotModel
from app.robot.state import Measurement, RobotState
from tests.nearest import SmoothMonitor

CONFIG = RepulsionConfig(k_p=60.0, k_v=30.0)


class Motion(NamedTuple):
    """Derivatives of a distance: ḋ = J q̇, d̈ = J q̈ + J̇ q̇."""

    J: np.ndarray
    Jdqd: float
    d_dot: float

    @property
    def xdd(self) -> float:
        """[m/s²] desired acceleration (20) of the distance; a positive one separates the pair."""
        return generate_rep_acc(self.d_dot, CONFIG.k_p, CONFIG.k_v)


def motion_of(state: RobotState, closest: ClosestPoints) -> Motion:
    """Derivatives of the distance of a pair."""
    joints = np.array([[state.model.body_joints[body] for body in closest.pair]])
    J, Jdqd, d_dot = state.distance_motions(joints, closest.core[None], closest.n[None])
    return Motion(J[0], float(Jdqd[0]), float(d_dot[0]))


class Moving:
    """A robot in a random state, the start of each integration."""

    def __init__(self, robot: RobotModel, seed: int) -> None:
        rng = np.random.default_rng(seed)
        self.model = robot
        self.state = RobotState(robot)
        span = robot.q_upper - robot.q_lower
        self.pose = rng.normal(size=3)
        self.q_m = robot.q_lower + span * rng.uniform(0.2, 0.8, size=robot.n_m)
        self.qd = rng.normal(size=robot.n)
        self.monitor = DistanceMonitor(self.state, candidate_pairs(robot))
        self.at(0.0, self.qd)

    def at(self, t: float, qd: np.ndarray) -> list[ClosestPoints]:
        """Move along `qd` for t [s] from the initial state; returns the pairs there."""
        q = self.model.configuration(self.pose, self.q_m)
        q = pin.integrate(self.model.pin, q, self.model.S @ (qd * t))
        pose = np.array([q[0], q[1], np.arctan2(q[3], q[2])])
        measurement = Measurement(pose, self.model.J_m @ qd[:2], q[4:], qd[2:])
        self.state.update(measurement)
        return self.monitor.find_closest_points()

    def motion(self, closest: ClosestPoints) -> Motion:
        """Derivatives of the distance of a pair in the current state."""
        return motion_of(self.state, closest)


@pytest.mark.parametrize("seed", range(6))
def test_J_r_is_the_gradient_of_the_distance(robot: RobotModel, seed: int) -> None:
    moving = Moving(robot, seed)
    for i, closest in enumerate(moving.at(0.0, moving.qd)):
        row = moving.motion(closest)
        numeric = jacobian(lambda qd, i=i: moving.at(1.0, qd)[i].d, robot.n)
        moving.at(0.0, moving.qd)
        np.testing.assert_allclose(row.J, numeric, atol=2e-5)


@pytest.mark.parametrize("seed", range(6))
def test_distances_within_the_robot_do_not_depend_on_the_base(robot: RobotModel, seed: int) -> None:
    moving = Moving(robot, seed)
    for closest in moving.at(0.0, moving.qd):
        row = moving.motion(closest)
        np.testing.assert_allclose(row.J[:2], 0.0, atol=1e-12)


def curvature_errors(robot: RobotModel, data: BorderData, count: int) -> np.ndarray:
    """(N, 2) [m/s²] error of d̈ = J q̈ + J̇ q̇, and the error with |v_⊥|²/d added.

    Compared with central differences of the library's distance along exact motions, for the pairs
    with the base in the buffer, where closest points do not change to another side of a body.
    """
    rng, state = np.random.default_rng(0), RobotState(robot)
    monitor, reader = (
        SmoothMonitor(state, data.pairs.mobile),
        PairDistances(robot, list(data.pairs.mobile)),
    )
    errors, h = [], 1e-4
    while len(errors) < count:
        q_m = rng.uniform(robot.q_lower, robot.q_upper)
        q = robot.configuration(np.zeros(3), q_m)
        reader.update(q)
        if not 0.02 < min(reader.distances()) < 0.14:
            continue
        qd, qdd = 0.3 * rng.normal(size=(2, robot.n))
        qd[:2] = 0.0  # a driving base does not move the bodies fixed to it
        qdd[:2] = 0.0

        def distances(t: float, q=q, qd=qd, qdd=qdd) -> np.ndarray:
            v = robot.S @ (qd * t + 0.5 * qdd * t * t)
            reader.update(pin.integrate(robot.pin, q, v))
            return np.array(reader.distances())

        here = distances(0.0)
        second, wide = (
            (distances(step) - 2 * here + distances(-step)) / step**2 for step in (h, 2 * h)
        )
        state.update(Measurement(np.zeros(3), np.zeros(2), q_m, qd[2:]))
        nearest = monitor.find_nearest(0.005)
        for i, (true, again) in enumerate(zip(second, wide, strict=True)):
            found = nearest.closest(i)
            if not 0.02 < found.d < 0.15 or abs(true - again) > 0.02 * (1.0 + abs(true)):
                continue  # d has a kink there
            J, Jdqd, _ = motion_of(state, found)
            across = _across(state, found)
            error = float(J @ qdd) + Jdqd - float(true)
            errors.append((error, error + across / found.d))
    return np.abs(errors)


def _across(state: RobotState, closest: ClosestPoints) -> float:
    """|v_⊥|² [m²/s²] of the two closest points, fixed to their bodies."""
    a, b = (state.model.body_joints[body] for body in closest.pair)
    v = state.point_velocity(b, closest.p_b) - state.point_velocity(a, closest.p_a)
    v -= (closest.n @ v) * closest.n
    return float(v @ v)


@pytest.mark.slow
def test_second_derivative_of_the_distance_matches_the_library(
    robot: RobotModel, border_data: BorderData
) -> None:
    """Adding the curvature term of two fixed points makes the error several times larger."""
    own, with_curvature = curvature_errors(robot, border_data, 300).T
    assert np.median(own) < 0.05
    assert np.quantile(own, 0.95) < 0.5
    assert np.quantile(with_curvature, 0.95) > 3.0 * np.quantile(own, 0.95)
    assert np.median(with_curvature) > 3.0 * np.median(own)


def test_links_at_rest_are_separated_and_separating_links_are_damped(robot: RobotModel) -> None:
    moving = Moving(robot, 3)
    moving.at(0.0, np.zeros(robot.n))
    closest = moving.monitor.find_closest_points()[-1]
    assert moving.motion(closest).xdd == pytest.approx(60.0)
    J = moving.motion(closest).J
    moving.at(0.0, J / np.linalg.norm(J) ** 2)  # distance grows by 1 m/s
    assert moving.motion(closest).xdd == pytest.approx(30.0)


def test_normal_separates_overlapping_links(robot: RobotModel) -> None:
    """Closest points of overlapping links change sides."""
    rng = np.random.default_rng(0)
    moving = Moving(robot, 0)
    found = 0
    while found < 20:
        moving.q_m = rng.uniform(robot.q_lower, robot.q_upper)
        for i, closest in enumerate(moving.at(0.0, np.zeros(robot.n))):
            if not -0.05 < closest.d < -0.005:
                continue
            found += 1
            J = moving.motion(closest).J
            along = J / np.linalg.norm(J) ** 2 * 1e-3
            assert moving.at(1.0, along)[i].d > closest.d
            moving.at(0.0, np.zeros(robot.n))


@pytest.mark.parametrize("seed", range(6))
def test_distance_rate_is_the_jacobian_times_velocity(robot: RobotModel, seed: int) -> None:
    moving = Moving(robot, seed)
    for closest in moving.at(0.0, moving.qd):
        J, _, speed = moving.motion(closest)
        assert speed == pytest.approx(float(J @ moving.qd))
