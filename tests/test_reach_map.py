"""The reachability map: the mean number of inverse kinematics solutions, and its scale."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pinocchio as pin
import pytest

from app.border.reach import (
    FINE_SAMPLES,
    FINE_SPACING,
    Chain,
    ReachMap,
    fit_reachability,
    free_joints,
    lattice,
    reach_bodies,
    sample_reach_map,
)
from app.border.score import radial_profile
from app.errors import ConfigError
from app.robot import assets
from app.robot.description import load_robot
from app.robot.link_pairs import PairDistances, candidate_pairs
from app.robot.model import RobotModel
from app.robot.state import Measurement, RobotState
from tests.finite_differences import jacobian
from tests.robots import husky_panda

BODIES = ["lEE", "l3"]


@pytest.fixture(scope="module")
def maps(robot: RobotModel) -> dict[str, ReachMap]:
    """Maps of the paper's robot, by body."""
    return {body: sample_reach_map(robot, body, spacing=0.1) for body in BODIES}


@pytest.fixture
def changed(tmp_path, monkeypatch):
    """Return a function that makes variants of the paper's robot."""

    def make(edit: Callable[[str], str], joints: int = 7) -> RobotModel:
        description = load_robot("husky_panda")
        urdf = (assets.ASSETS / "husky_panda" / "robot.urdf").read_text(encoding="utf-8")
        root = tmp_path / "robot_assets" / "husky_panda"
        root.mkdir(parents=True)
        (root / "robot.urdf").write_text(edit(urdf), encoding="utf-8")
        arm = description.arm
        several = {
            name: getattr(arm, name)[:joints]
            for name in (
                "joints",
                "max_velocity",
                "max_effort",
                "ready_position",
                "joint_damping",
                "position_lower",
                "position_upper",
            )
        }
        if edit(urdf) != urdf:  # a changed joint has its limits in the URDF
            several["position_lower"] = several["position_upper"] = None
            several["ready_position"] = (0.0, -0.7854, 0.0, -2.3562, 0.0, 1.5708, 0.7854)
        monkeypatch.setattr(assets, "ASSETS", tmp_path / "robot_assets")
        new = description.model_copy(update={"arm": arm.model_copy(update=several)})
        return RobotModel(new)

    return make


def slide(urdf: str) -> str:
    """The URDF with the third joint as a prismatic joint of ±0.2 m."""
    head, tail = urdf.split('<joint name="panda_joint3" type="revolute">')
    tail = tail.replace('lower="-2.8973" upper="2.8973"', 'lower="-0.2" upper="0.2"', 1)
    return f'{head}<joint name="panda_joint3" type="prismatic">{tail}'


def places(chain: Chain, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(N, 4, 4) T_base_point at joint positions (N, k), and its Jacobian (N, 6, k) in base axes.

    All joints must turn about their z axes.
    """
    first, data = np.zeros(q.shape[1]), chain.pin.createData()
    pin.forwardKinematics(chain.pin, data, first)
    point = data.oMi[q.shape[1]].actInv(chain.pose_and_jacobian(first)[0]).homogeneous
    T, axes, origins = np.tile(np.eye(4), (len(q), 1, 1)), [], []
    for angle, placement in zip(q.T, list(chain.pin.jointPlacements)[1:], strict=True):
        T = T @ placement.homogeneous
        axes.append(T[:, :3, 2])
        origins.append(T[:, :3, 3])
        turn = np.tile(np.eye(4), (len(q), 1, 1))
        turn[:, 0, 0] = turn[:, 1, 1] = np.cos(angle)
        turn[:, 1, 0] = np.sin(angle)
        turn[:, 0, 1] = -np.sin(angle)
        T = T @ turn
    T = T @ point
    columns = [
        np.hstack([np.cross(z, T[:, :3, 3] - o), z]) for z, o in zip(axes, origins, strict=True)
    ]
    return T, np.stack(columns, axis=-1)


def misses(T: np.ndarray, targets: np.ndarray) -> np.ndarray:
    """(N, 6) [m] and [rad] errors of poses relative to targets (N, 4, 4), in axes of the base."""
    E = T[:, :3, :3] @ targets[:, :3, :3].transpose(0, 2, 1)
    twice = np.stack([E[:, 2, 1] - E[:, 1, 2], E[:, 0, 2] - E[:, 2, 0], E[:, 1, 0] - E[:, 0, 1]])
    sine = np.linalg.norm(twice, axis=0) / 2
    angle = np.arctan2(sine, (np.trace(E, axis1=1, axis2=2) - 1) / 2)
    turned = (twice / 2 * angle / np.maximum(sine, 1e-300)).T
    return np.hstack([T[:, :3, 3] - targets[:, :3, 3], turned])


def found_by_newton(
    chain: Chain, targets: np.ndarray, q: np.ndarray, sought: list[int]
) -> np.ndarray:
    """(N,) whether Newton's method brings q (N, k), which it changes, to the targets (N, 4, 4)."""
    left = np.arange(len(q))
    for _ in range(30):
        T, J = places(chain, q[left])
        e = misses(T, targets[left])[:, : chain.coordinates]
        far = np.abs(e).max(axis=1) > 1e-8
        left, e, J = left[far], e[far], J[far][:, : chain.coordinates, sought]
        JJ = J @ J.transpose(0, 2, 1) + 1e-9 * np.eye(chain.coordinates)
        step = (J.transpose(0, 2, 1) @ np.linalg.solve(JJ, e[:, :, None]))[:, :, 0]
        step /= np.maximum(np.abs(step).max(axis=1, initial=0.0), 1.0)[:, None]
        q[np.ix_(left, sought)] -= step
    last = misses(places(chain, q)[0], targets)[:, : chain.coordinates]
    return np.abs(last).max(axis=1) < 1e-6


def solutions(
    model: RobotModel, chain: Chain, targets: list[pin.SE3], rng: np.random.Generator
) -> list[int]:
    """Number of distinct solutions that a search from 40 random postures finds per pose.

    The free joints have random positions. Only solutions within the joint limits and without
    self-collision count.
    """
    tries, free = 40, list(free_joints(chain))
    sought = [i for i in range(len(chain.joints)) if i not in free]
    q = np.array([[chain.random(rng) for _ in range(tries)] for _ in targets])
    q[:, :, free] = q[:, :1, free]
    q = q.reshape(-1, q.shape[-1])
    poses = np.repeat([target.homogeneous for target in targets], tries, axis=0)
    there = found_by_newton(chain, poses, q, sought)
    low, high = chain.lower, chain.upper
    own = low + (q - low) % (2 * np.pi)
    there &= (own <= high).all(axis=1)
    names = model.body_names
    known = names[: names.index(chain.body) + 1]
    distances = PairDistances(model, [p for p in candidate_pairs(model) if p.b in known])
    found: list[list[np.ndarray]] = [[] for _ in targets]
    for k in np.flatnonzero(there):
        others = found[k // tries]
        if any(np.abs(own[k] - each).max() <= 1e-3 for each in others):
            continue
        q_m = model.q_lower.copy()
        q_m[chain.joints] = own[k]
        distances.update(model.configuration((0.0, 0.0, 0.0), q_m))
        if min(distances.distances()) > 0.0:
            others.append(own[k])
    return [len(each) for each in found]


def test_bodies_with_a_map_are_moved_by_enough_joints():
    assert reach_bodies(husky_panda()) == ["lEE", "l3"]


@pytest.mark.parametrize("body", BODIES)
def test_a_chains_jacobian_is_the_derivative_of_its_pose(body):
    chain = Chain(husky_panda(), body)
    q = chain.random(np.random.default_rng(0))
    at, J = chain.pose_and_jacobian(q)
    at = at.copy()

    def place(step: np.ndarray) -> np.ndarray:
        return chain.pose_and_jacobian(q + step)[0].translation.copy()

    numeric = jacobian(place, len(q))
    np.testing.assert_allclose(at.rotation @ J[:3], numeric, atol=1e-7)


def test_chains_end_at_the_end_effector_and_on_the_forearms_axis():
    model = husky_panda()
    state = RobotState(model)
    end_effector, forearm = Chain(model, "lEE"), Chain(model, "l3")
    assert (end_effector.coordinates, end_effector.free, forearm.coordinates, forearm.free) == (
        6,
        1,
        5,
        0,
    )
    assert (len(end_effector.joints), len(forearm.joints)) == (7, 5)
    rng = np.random.default_rng(1)
    for _ in range(5):
        q = end_effector.random(rng)
        state.update(Measurement(np.zeros(3), np.zeros(2), q, np.zeros(7)))
        at, _ = end_effector.pose_and_jacobian(q)
        np.testing.assert_allclose(at.homogeneous, state.T_world_ee.homogeneous)
        frame = model.pin.getFrameId("panda_link5")
        link = pin.updateFramePlacement(model.pin, state.data, frame)
        shape = model.description.body("l3").shapes[0]
        start, end = link.act(np.array(shape.start_m)), link.act(np.array(shape.end_m))
        at, _ = forearm.pose_and_jacobian(q[:5])
        np.testing.assert_allclose(at.translation, (start + end) / 2, atol=1e-12)
        np.testing.assert_allclose(at.rotation[:, 2], (end - start) / shape.length_m, atol=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize(("joints", "body", "expected"), [(6, "lEE", 6), (4, "l3", 3)])
def test_the_map_is_the_mean_number_of_solutions_that_a_search_finds(
    joints, body, expected, changed
):
    """The poses are at distances with many solutions."""
    model = changed(lambda urdf: urdf, joints=joints)
    chain = Chain(model, body)
    assert (chain.coordinates, chain.free) == (expected, len(chain.joints) - expected)
    found = sample_reach_map(model, body, samples=40_000)
    band = (found.rho > 0.3) & (found.rho < 0.6)
    rng, targets = np.random.default_rng(3), []
    for p in rng.choice(found.points[band], 300):
        q = rng.standard_normal(4)
        turn = pin.Quaternion(q / np.linalg.norm(q)).matrix()
        near = p + found.spacing_m * rng.uniform(-0.5, 0.5, 3)
        targets.append(pin.SE3(turn, near))
    counted = solutions(model, chain, targets, rng)
    error = np.std(counted) / np.sqrt(len(counted))
    assert np.mean(counted) > 5 * error
    assert np.mean(counted) == pytest.approx(found.found[band].mean(), abs=3 * error)


def test_arm_with_a_prismatic_joint_has_a_map(changed):
    model = changed(slide)
    assert Chain(model, "lEE").turns.tolist() == [True, True, False, True, True, True, True]
    found = sample_reach_map(model, "lEE", samples=2_000)
    assert len(found.free_joints) == 1
    assert found.found.sum() > 0


def test_map_is_symmetric_left_and_right(maps):
    found = maps["lEE"]
    y = found.points[:, 1]
    left, right = found.found[y > 1e-6].sum(), found.found[y < -1e-6].sum()
    assert left == pytest.approx(right, rel=0.05)


def test_same_seed_gives_the_same_map_and_another_seed_a_similar_one(robot, maps):
    same, other = (sample_reach_map(robot, "l3", spacing=0.1, seed=seed) for seed in (0, 1))
    np.testing.assert_array_equal(same.found, maps["l3"].found)
    assert (other.found != same.found).any()
    assert other.found.mean() == pytest.approx(same.found.mean(), rel=0.03)


def test_scale_gives_the_best_shell_the_value_100(maps):
    for found in maps.values():
        profile = radial_profile(found.rho, found.reach)
        assert profile.mean[profile.peak()] == pytest.approx(100.0)
        assert (found.reach >= 0).all()


def test_the_lattice_fills_the_ball_around_its_origin():
    steps = lattice(1.0, 0.1)
    assert len(steps) == pytest.approx(4 / 3 * np.pi * 1000, rel=0.03)
    assert len(np.unique(steps, axis=0)) == len(steps)
    assert np.linalg.norm(steps, axis=1).max() <= 10.0
    assert (steps == 0).all(axis=1).any()


def test_body_with_too_few_joints_is_refused_with_the_valid_bodies():
    with pytest.raises(ConfigError, match=r"only 2 of the arm's joints move this body.*lEE, l3"):
        Chain(husky_panda(), "l2")


@pytest.mark.slow
def test_the_forearms_coefficients_are_those_of_its_map(robot):
    """A map with a quarter of the samples reproduces them."""
    fit = fit_reachability(
        sample_reach_map(robot, "l3", samples=FINE_SAMPLES // 4, spacing=FINE_SPACING)
    )
    used = robot.description.reachability["l3"]
    assert pytest.approx(fit.A_per_m2, rel=0.05) == used.A_per_m2
    assert pytest.approx(fit.B_m, abs=0.01) == used.B_m
    assert pytest.approx(fit.C, rel=0.05) == used.C
