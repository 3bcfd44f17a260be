"""The shipped border of the paper's robot, checked by code that shares nothing with its generator.

The distance to l_m is that of a box defined here; reachability is found by random sampling and by
scipy's least squares from those samples.
"""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest
from scipy.optimize import least_squares
from scipy.spatial import cKDTree

from app.border.cache import load_border_data
from app.border.dbb import construct_dbb
from tests.robots import husky_panda

pytestmark = pytest.mark.slow

HALF, CENTRE, TOP = np.array([0.495, 0.345, 0.19015]), np.array([0.0, 0.0, 0.1902]), 0.38  # [m]
PAIRS = ("lm-lEE", "lm-l3")


@pytest.fixture(scope="module")
def clouds():
    data = load_border_data(husky_panda(), progress=False)
    assert data.origin != "sampled", "the shipped file does not fit the robot"
    return data.clouds


def box_distance(p: np.ndarray) -> np.ndarray:
    return np.linalg.norm(np.maximum(np.abs(p - CENTRE) - HALF, 0), axis=-1)


@pytest.mark.parametrize("pair", PAIRS)
@pytest.mark.parametrize("d_b", [0.06, 0.10, 0.15, 0.20, 0.25, 0.30])
def test_a_border_has_fifty_thousand_points_each_within_eps(clouds, pair, d_b):
    border = construct_dbb(clouds[pair], d_b, 0.01)
    assert len(border) >= 50_000
    assert (np.abs(box_distance(border.points) - d_b) <= 0.01).all()


@pytest.mark.parametrize("pair", PAIRS)
def test_every_stored_distance_is_that_of_its_point(clouds, pair):
    np.testing.assert_allclose(clouds[pair].d_m, box_distance(clouds[pair].points_m), atol=5.1e-6)


@pytest.mark.parametrize("pair", PAIRS)
def test_cloud_is_symmetric_left_and_right(clouds, pair):
    """Each point has one near its mirror image; the robot is symmetric in y."""
    p = clouds[pair].points_m
    distance, _ = cKDTree(p).query(p[::20] * [1, -1, 1])
    assert np.quantile(distance, 0.999) < 0.010  # [m]
    assert distance.max() < 0.025


class Arm:
    """The closest point of a body to l_m, by pinocchio alone."""

    def __init__(self, body: str) -> None:
        self.model = husky_panda()
        self._geometry = self.model.geometry.copy()
        self._geometry.removeAllCollisionPairs()
        ids = self.model.shape_ids
        self._geometry.addCollisionPair(pin.CollisionPair(ids["lm"][0], ids[body][0]))
        self._placed = pin.GeometryData(self._geometry)
        self._data = self.model.pin.createData()

    def witness(self, q_m: np.ndarray) -> tuple[float, np.ndarray]:
        q = self.model.configuration((0, 0, 0), q_m)
        pin.updateGeometryPlacements(self.model.pin, self._data, self._geometry, self._placed, q)
        pin.computeDistances(self._geometry, self._placed)
        result = self._placed.distanceResults[0]
        return result.min_distance, np.array(result.getNearestPoint2())

    def beside(self, samples: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
        """Points beside the base and their postures, by plain random sampling."""
        rng = np.random.default_rng(seed)
        points, postures = [], []
        for q_m in rng.uniform(self.model.q_lower, self.model.q_upper, (samples, 7)):
            d, p = self.witness(q_m)
            if 0.04 < d < 0.31 and 0 < p[2] < TOP:
                points.append(p)
                postures.append(q_m)
        return np.array(points), np.array(postures)

    def reach(self, target: np.ndarray, starts: np.ndarray) -> float:
        """[m] the smallest distance of the closest point to a target that least squares finds."""
        lower, upper, best = self.model.q_lower, self.model.q_upper, np.inf
        for start in starts:
            found = least_squares(
                lambda q_m: self.witness(q_m)[1] - target,
                np.clip(start, lower + 1e-6, upper - 1e-6),
                bounds=(lower, upper),
                diff_step=1e-6,
                max_nfev=40,
            )
            d, p = self.witness(found.x)
            if d > 0.03:
                best = min(best, float(np.linalg.norm(p - target)))
            if best < 0.003:
                break
        return best


@pytest.fixture(scope="module", params=PAIRS)
def sampled(request, clouds):
    arm = Arm(request.param.split("-")[1])
    return request.param, clouds[request.param], arm, *arm.beside(500_000, seed=12345)


def test_every_randomly_reached_point_is_near_a_point_of_the_cloud(sampled):
    _, cloud, _, points, _ = sampled
    assert len(points) > 300
    distance, _ = cKDTree(cloud.points_m).query(points)
    assert distance.max() < 0.010  # [m]


def contour(d_b: float, step: float = 0.005) -> np.ndarray:
    """(N, 2) [m] points every `step` [m] of the contour at `d_b` [m] around l_m's box."""
    angle = np.linspace(0, 2 * np.pi, 20_001)[:-1]
    # The outline of a rounded box: its corner in that direction, plus d_b along the normal.
    normal = np.column_stack([np.cos(angle), np.sin(angle)])
    round_ = np.sign(normal) * HALF[:2] + d_b * normal
    closed = np.concatenate([round_, round_[:1]])
    along = np.concatenate([[0], np.linalg.norm(np.diff(closed, axis=0), axis=1).cumsum()])
    at = np.arange(0, along[-1], step)
    return np.column_stack([np.interp(at, along, closed[:, i]) for i in range(2)])


@pytest.mark.parametrize("d_b", [0.06, 0.15, 0.25])
def test_border_has_no_gap_over_20_mm_where_a_contour_is_reachable(sampled, d_b):
    """An optimiser reaches no point of the contour without a point of the border within 10 mm."""
    pair, cloud, arm, points, postures = sampled
    border, ring = construct_dbb(cloud, d_b, 0.01), contour(d_b)
    rng, tree = np.random.default_rng(1), cKDTree(points)
    covered, bare = [], []  # points of the border, and of the contour in its gaps
    for z in np.arange(0.01, TOP, 0.02):
        points_there = border.same_height(z)
        far = np.full(len(ring), np.inf)
        if len(points_there):
            far = cKDTree(points_there[:, :2]).query(ring)[0]
        near_edge = np.zeros(len(ring), dtype=bool)
        for shift in range(-8, 9):  # within 40 mm of the covered range
            near_edge |= np.roll(far <= 0.0101, shift)
        targets = np.column_stack([ring, np.full(len(ring), z)])
        covered += list(points_there)
        bare += list(targets[(far > 0.0101) & near_edge])
    if not covered:
        assert (pair, d_b) == ("lm-l3", 0.25)  # the forearm does not reach so low
        return
    reached = [_reach(arm, target, tree, postures) for target in rng.permutation(bare)[:20]]
    assert min(reached) > 0.003, "reachable, but without a point of the border"
    control = [_reach(arm, target, tree, postures) for target in rng.permutation(covered)[:10]]
    assert np.mean(np.array(control) < 0.003) >= 0.8, "the optimiser of this test is too weak"


def _reach(arm: Arm, target: np.ndarray, tree: cKDTree, postures: np.ndarray) -> float:
    return arm.reach(target, postures[tree.query(target, k=6)[1]])


def test_the_wheel_axis_is_covered_on_both_sides(clouds):
    """Above 0.21 m the end-effector reaches the axis x = 0 beside the base."""
    border = construct_dbb(clouds["lm-lEE"], 0.15, 0.01)
    for z in np.arange(0.21, TOP, 0.01):
        for y in (-0.495, 0.495):
            near = np.linalg.norm(border.same_height(z)[:, :2] - [0.0, y], axis=1)
            assert near.min() < 0.008  # [m]
