"""The closest point: continuous, and equal to the library's where it is unique."""

from __future__ import annotations

import numpy as np
import pytest

from app.avoidance.closest_points import ClosestPoints, SmoothPoints
from app.border.cache import BorderData
from app.config import Config
from app.control.controller import Controller
from app.robot.link_pairs import Pair
from app.robot.model import RobotModel
from app.robot.shapes import Hull
from app.robot.state import RobotState, at_rest
from tests.nearest import SmoothMonitor, library_nearest, smooth_points
from tests.robots import husky_panda, with_mobile_shapes

Array = np.ndarray

PARALLEL = np.array([1.15216, 1.65208, 0.78478, -1.35999, 2.19699, 3.33947, -0.46618])
"""[rad] The end-effector's capsule is 0.043 m beside the base, parallel to it within 1e-5 rad."""
D_B, BLEND = Config().border.d_b, Config().activation.closest_point_smoothing


class Follower:
    """Closest points of base and end-effector along postures, smooth or from the library."""

    def __init__(self, robot: RobotModel, data: BorderData) -> None:
        self.state = RobotState(robot)
        self._monitor = SmoothMonitor(self.state, data.pairs.mobile)

    def at(self, q_m: Array, *, smooth: bool) -> ClosestPoints:
        self.state.update(at_rest(self.state.model, q_m))
        if smooth:
            return self._monitor.find_nearest(BLEND).closest(0)
        return self._monitor.find_closest_points()[0]

    def largest_step(self, direction: Array, reach: float, steps: int, *, smooth: bool) -> float:
        """[m] largest motion of p_b between neighbours of evenly spaced postures."""
        path = PARALLEL + np.linspace(-reach, reach, steps + 1)[:, None] * direction
        points = np.array([self.at(q_m, smooth=smooth).p_b for q_m in path])
        return float(np.linalg.norm(np.diff(points, axis=0), axis=1).max())


@pytest.fixture
def follower(robot: RobotModel, border_data: BorderData) -> Follower:
    return Follower(robot, border_data)


@pytest.mark.parametrize("seed", range(2))
def test_point_is_continuous_at_parallel_capsule_where_the_librarys_jumps(
    follower: Follower, seed: int
) -> None:
    """Steps of a tenth move the smooth point about a tenth as far; the library's point jumps."""
    direction = np.random.default_rng(seed).normal(size=7)
    direction /= np.abs(direction).max()
    coarse, fine = (follower.largest_step(direction, 2e-2, n, smooth=True) for n in (400, 4000))
    assert fine < 0.15 * coarse
    assert fine < 2e-4
    own = follower.largest_step(direction, 2e-2, 4000, smooth=False)
    assert own > 0.02


def test_desired_base_acceleration_does_not_jump_at_a_parallel_capsule(
    robot: RobotModel, border_data: BorderData, follower: Follower
) -> None:
    controller, desired = Controller(robot, border_data, Config()), []
    direction = np.random.default_rng(0).normal(size=7)
    for s in np.linspace(-1e-2, 1e-2, 2001):
        controller.reset()
        desired.append(controller.step(at_rest(robot, PARALLEL + s * direction)).base_avoidance)
    assert np.abs(desired).max() > 0.1
    v, w = np.abs(np.diff(desired, axis=0)).max(axis=0)
    assert v < 0.002
    assert w < 0.005


def test_smooth_point_is_the_nearest_point_where_it_is_unique(
    robot: RobotModel, follower: Follower
) -> None:
    """The capsule points towards the base or away from it."""
    rng, found = np.random.default_rng(1), 0
    while found < 60:
        q_m = rng.uniform(robot.q_lower, robot.q_upper)
        own = follower.at(q_m, smooth=False)
        if not 0.01 < own.d < D_B:
            continue
        axis = follower.state.T_world_ee.rotation[:, 2]
        if abs(axis @ own.n) < 0.9:
            continue
        found += 1
        smooth = follower.at(q_m, smooth=True)
        assert smooth.d == pytest.approx(own.d, abs=1e-12)
        assert np.linalg.norm(smooth.p_b - own.p_b) < 2e-3
        assert smooth.n @ own.n > 1.0 - 1e-4


def test_closest_points_and_core_lie_on_one_normal(robot: RobotModel, follower: Follower) -> None:
    """p_b lies between p_a and the core along n, at most a little beyond the nearest point."""
    rng, found = np.random.default_rng(2), 0
    while found < 60:
        q_m = rng.uniform(robot.q_lower, robot.q_upper)
        c = follower.at(q_m, smooth=True)
        if not 0.01 < c.d < D_B:
            continue
        found += 1
        gap = float((c.p_b - c.p_a) @ c.n)
        np.testing.assert_allclose(c.p_b - c.p_a, gap * c.n, atol=1e-9)
        assert c.d - 1e-6 <= gap < c.d + 3 * BLEND
        assert (c.core - c.p_b) @ c.n > 0.0


BENT = Hull(type="hull", vertices_m=tuple(np.random.default_rng(5).normal(0.0, 0.1, (30, 3))))


@pytest.mark.parametrize("pair", [("lm", "lEE"), ("lEE", "lm"), ("l1", "l3")])
@pytest.mark.parametrize("hull", [False, True])
def test_kernel_matches_the_librarys_closest_points(pair: tuple[str, str], hull: bool) -> None:
    """Boxes or hulls against capsules, in both orders; a face may be nearest."""
    robot = with_mobile_shapes((BENT,)) if hull else husky_panda()
    state, rng, found = RobotState(robot), np.random.default_rng(3), 0
    smooth = SmoothPoints(state.model, [Pair(*pair)])
    while found < 60:
        pose = rng.uniform(-1.0, 1.0, 3)
        state.update(at_rest(robot, rng.uniform(robot.q_lower, robot.q_upper), pose))
        (points,) = smooth_points(smooth, state, BLEND)
        if (points[1] - points[0]) @ points[2] < 0.01:
            continue
        found += 1
        expected = library_nearest(state, Pair(*pair), BLEND, slice(None))
        np.testing.assert_allclose(points, expected, atol=2e-5)
