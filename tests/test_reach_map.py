"""The reachability map: all solutions, only those that count, and the same ones everywhere."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable

import numpy as np
import pinocchio as pin
import pytest

from app.border.config import ReachConfig
from app.border.reach.chain import AnalyticSolver, Chain, RestartSolver, make_solver, reach_bodies
from app.border.reach.map import (
    ReachMap,
    lattice,
    load_reach_map,
    reach_key,
    sample_reach_map,
)
from app.border.score import fit_reachability, radial_profile
from app.errors import ConfigError, UnknownNameError
from app.robot import assets
from app.robot.description import load_robot
from app.robot.link_pairs import PairDistances, candidate_pairs
from app.robot.model import RobotModel
from app.robot.state import Measurement, RobotState
from tests.finite_differences import jacobian
from tests.robots import husky_panda

pytest.importorskip("eaik")  # the maps here are those of formulas

TINY = ReachConfig(spacing_m=0.3, orientations=4, restart_spacing_m=0.4, restart_orientations=1)
BODIES = ["lEE", "l3"]


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """An empty cache, and nothing shipped."""
    monkeypatch.setattr(assets, "cache_folder", lambda: tmp_path / "cache")
    monkeypatch.setattr(assets, "SHIPPED_CACHE", tmp_path / "shipped")
    return tmp_path


@pytest.fixture
def changed(tmp_path, monkeypatch):
    """Makes robots of the paper's by changes to its URDF and its arm."""

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
    """The third joint as a slide of ±0.2 m."""
    head, tail = urdf.split('<joint name="panda_joint3" type="revolute">')
    tail = tail.replace('lower="-2.8973" upper="2.8973"', 'lower="-0.2" upper="0.2"', 1)
    return f'{head}<joint name="panda_joint3" type="prismatic">{tail}'


def expected_shells(
    model: RobotModel, body: str, free: tuple[int, ...], edges: np.ndarray, count: int
) -> np.ndarray:
    """Mean solutions of a pose in each shell, without any inverse kinematics.

    By the area formula: over all joint positions, the volume of poses swept is |det J|.
    """
    chain = Chain(model, body)
    k = len(chain.joints)
    solved = [i for i in range(k) if i not in free]
    rows, poses = {6: (range(6), 8 * np.pi**2), 5: (range(5), 4 * np.pi), 3: (range(3), 1.0)}[
        chain.asked
    ]
    names = model.body_names
    known = names[: names.index(body) + 1]
    pairs = [pair for pair in candidate_pairs(model) if pair.b in known]
    distances = PairDistances(model, pairs)
    rng = np.random.default_rng(5)
    rho, weight = np.empty(count), np.zeros(count)
    for i in range(count):
        q = chain.random(rng)
        at, J = chain.pose_and_jacobian(q)
        rho[i] = np.linalg.norm(at.translation - model.p_base())
        q_m = model.q_lower.copy()
        q_m[chain.joints] = q[:k]
        distances.update(model.configuration((0.0, 0.0, 0.0), q_m))
        if all(distances.distance(j) > 0 for j in range(len(pairs))):
            weight[i] = abs(np.linalg.det(J[np.ix_(list(rows), solved)]))
    width = (chain.upper - chain.lower)[solved].prod()
    swept = np.histogram(rho, edges, weights=weight)[0] / count * width / poses
    return swept / (4 / 3 * np.pi * np.diff(edges**3))


def counted_shells(found: ReachMap, edges: np.ndarray) -> np.ndarray:
    shell = np.digitize(found.rho, edges) - 1
    return np.array([found.found[shell == i].mean() / found.samples for i in range(len(edges) - 1)])


def test_the_bodies_are_those_that_three_joints_move():
    assert reach_bodies(husky_panda()) == ["lEE", "l3"]


@pytest.mark.parametrize("body", BODIES)
def test_a_chains_jacobian_is_the_derivative_of_its_pose(body):
    chain = Chain(husky_panda(), body)
    q = chain.random(np.random.default_rng(0))
    at, J = chain.pose_and_jacobian(q)
    at = at.copy()
    numeric = jacobian(lambda step: chain.pose(q + step).translation.copy(), chain.size)
    np.testing.assert_allclose(at.rotation @ J[:3], numeric, atol=1e-7)


def test_the_hands_chain_ends_at_the_end_effector_and_the_forearms_on_its_capsules_axis():
    model = husky_panda()
    state = RobotState(model)
    hand, forearm = Chain(model, "lEE"), Chain(model, "l3")
    assert (hand.asked, hand.free, forearm.asked, forearm.free) == (6, 1, 5, 0)
    assert (len(hand.joints), len(forearm.joints)) == (7, 5)
    rng = np.random.default_rng(1)
    for _ in range(5):
        q = hand.random(rng)
        state.update(Measurement(np.zeros(3), np.zeros(2), q, np.zeros(7)))
        np.testing.assert_allclose(hand.pose(q).homogeneous, state.T_world_ee.homogeneous)
        frame = model.pin.getFrameId("panda_link5")
        link = pin.updateFramePlacement(model.pin, state.data, frame)
        shape = model.description.body("l3").shapes[0]
        start, end = link.act(np.array(shape.start_m)), link.act(np.array(shape.end_m))
        at = forearm.pose(np.append(q[:5], 0.7))
        np.testing.assert_allclose(at.translation, (start + end) / 2, atol=1e-12)
        np.testing.assert_allclose(at.rotation[:, 2], (end - start) / shape.length_m, atol=1e-9)


@pytest.mark.parametrize("body", BODIES)
def test_formulas_and_restarts_find_the_same_solutions(body):
    """Each solution found by restarts is one of the formulas', and most of those are found."""
    chain = Chain(husky_panda(), body)
    formulas = make_solver(chain, 20)
    assert isinstance(formulas, AnalyticSolver)
    restarts = RestartSolver(chain, formulas.free, 20)
    rng = np.random.default_rng(2)
    arm = len(chain.joints)
    both = total = 0
    for _ in range(12):
        q = chain.random(rng)
        target, held = chain.pose(q).copy(), q[list(formulas.free)]
        exact = formulas.solve(target, held, rng)[:, :arm]
        tried = restarts.solve(target, held, rng)[:, :arm]

        def apart(a: np.ndarray, b: np.ndarray) -> np.ndarray:
            turn = (a[:, None] - b[None] + np.pi) % (2 * np.pi) - np.pi
            return np.abs(turn).max(axis=2)

        assert apart(exact, q[None, :arm]).min() < 1e-4
        assert (apart(tried, exact).min(axis=1) < 2e-3).all()
        both, total = both + len(tried), total + len(exact)
    assert 0.75 * total < both <= total


@pytest.mark.slow
@pytest.mark.parametrize("body", BODIES)
def test_the_counts_are_those_of_the_area_formula_which_needs_no_inverse_kinematics(body, robot):
    """The maps as they ship, shell by shell."""
    solver = make_solver(Chain(robot, body), 1)
    edges = np.arange(0.25, 1.2, 0.1)
    expected = expected_shells(robot, body, solver.free, edges, 15_000)
    shipped = counted_shells(load_reach_map(robot, body, progress=False), edges)
    np.testing.assert_allclose(shipped, expected, rtol=0.1, atol=0.03 * expected.max())
    assert shipped.max() > 0.05


@pytest.mark.parametrize("body", BODIES)
def test_a_map_of_joint_positions_alone_is_the_counted_one(body, robot):
    """Means over shells, in shares of their sum."""
    counted = load_reach_map(robot, body, progress=False)
    sampled = sample_reach_map(robot, body, spacing=counted.spacing_m)
    assert sampled.free_joints == counted.free_joints
    means = [radial_profile(m.rho, m.reach, 0.1).mean[2:11] for m in (sampled, counted)]
    ours, theirs = (mean / mean.sum() for mean in means)
    np.testing.assert_allclose(ours, theirs, atol=0.02)


@pytest.mark.slow
@pytest.mark.parametrize(("joints", "body", "asked"), [(6, "lEE", 6), (4, "l3", 3)])
def test_with_fewer_joints_less_is_asked_for_and_counted_right(
    joints, body, asked, changed, folder
):
    model = changed(lambda urdf: urdf, joints=joints)
    chain = Chain(model, body)
    assert (chain.asked, chain.free) == (asked, len(chain.joints) - asked)
    config = ReachConfig(spacing_m=0.12, orientations=6)
    found = load_reach_map(model, body, config=config, progress=False, processes=1)
    assert found.method == "analytic"
    edges = np.array([0.3, 0.6, 0.9])
    solver = make_solver(chain, 1)
    expected = expected_shells(model, body, solver.free, edges, 4_000)
    np.testing.assert_allclose(counted_shells(found, edges), expected, rtol=0.25)


@pytest.mark.slow
def test_an_arm_with_a_slide_is_solved_by_restarts(changed, folder):
    """From configurations to their poses and back: they are among the solutions, nearly always."""
    model = changed(slide)
    chain = Chain(model, "lEE")
    assert chain.turns.tolist() == [True, True, False, True, True, True, True]
    solver = make_solver(chain, 20)
    assert (solver.method, len(solver.free)) == ("restarts", 1)
    rng = np.random.default_rng(4)
    own = 0
    for _ in range(25):
        q = chain.random(rng)
        target = chain.pose(q).copy()
        found = chain.within(solver.solve(target, q[list(solver.free)], rng))
        assert ((found >= chain.lower - 1e-6) & (found <= chain.upper + 1e-6)).all()
        for each in found:
            np.testing.assert_allclose(chain.pose(each).homogeneous, target.homogeneous, atol=1e-5)
        own += bool((np.abs(found - q).max(axis=1, initial=0.0) < 1e-3).any())
    assert own >= 23
    config = ReachConfig(restart_spacing_m=0.4, restart_orientations=1, restarts=6)
    # Other processes would read the unchanged URDF.
    found = load_reach_map(model, "lEE", config=config, progress=False, processes=1)
    assert (found.method, found.spacing_m, found.samples) == ("restarts", 0.4, 1)
    assert found.found.sum() > 0


def test_the_papers_robot_reaches_the_same_to_the_left_and_to_the_right(robot):
    found = load_reach_map(robot, "lEE", progress=False)
    y = found.points[:, 1]
    left, right = found.found[y > 1e-6].sum(), found.found[y < -1e-6].sum()
    assert left == pytest.approx(right, rel=0.02)


@pytest.mark.slow
def test_the_same_seed_gives_the_same_counts_on_any_number_of_processes(folder):
    model = husky_panda()
    maps = [
        load_reach_map(
            model, "lEE", config=TINY, recompute=True, progress=False, processes=processes
        )
        for processes in (1, 2)
    ]
    np.testing.assert_array_equal(maps[0].found, maps[1].found)
    other = TINY.model_copy(update={"seed": 1})
    third = load_reach_map(model, "lEE", config=other, progress=False, processes=1)
    assert (third.found != maps[0].found).any()


def test_the_scale_makes_the_best_shell_100(robot):
    for body in BODIES:
        found = load_reach_map(robot, body, progress=False)
        profile = radial_profile(found.rho, found.reach)
        assert profile.mean[profile.peak()] == pytest.approx(100.0)
        assert (found.reach >= 0).all()


def test_the_lattice_fills_the_ball_around_its_origin():
    steps = lattice(1.0, 0.1)
    assert len(steps) == pytest.approx(4 / 3 * np.pi * 1000, rel=0.03)
    assert len(np.unique(steps, axis=0)) == len(steps)
    assert np.linalg.norm(steps, axis=1).max() <= 10.0
    assert (steps == 0).all(axis=1).any()


def load(**options) -> ReachMap:
    return load_reach_map(husky_panda(), "l3", config=TINY, progress=False, processes=1, **options)


def test_a_second_call_reads_what_the_first_one_kept(folder, monkeypatch):
    first = load()
    assert first.origin == "counted"
    second = load()
    assert second.origin == "cache"
    np.testing.assert_array_equal(first.found, second.found)
    np.testing.assert_array_equal(first.points, second.points)
    assert (first.samples, first.seed, first.method) == (4, 0, "analytic")
    assert load(recompute=True).origin == "counted"
    (folder / "cache").rename(folder / "shipped")
    assert load().origin == "shipped"


@pytest.mark.parametrize("damage", [b"", b"not a zip", b"PK\x03\x04" + bytes(200)])
def test_a_damaged_file_is_counted_anew_with_one_line_of_warning(folder, damage, caplog):
    load()
    (path,) = (folder / "cache").iterdir()
    path.write_bytes(damage)
    caplog.clear()
    with caplog.at_level(logging.WARNING):
        assert load().origin == "counted"
    assert len(caplog.records) == 1
    assert str(path) in caplog.text
    assert load().origin == "cache"


def test_a_file_of_other_content_under_the_right_name_is_not_believed(folder, caplog):
    load()
    (path,) = (folder / "cache").iterdir()
    other = TINY.model_copy(update={"orientations": 3})
    load_reach_map(husky_panda(), "l3", config=other, progress=False, processes=1)
    (foreign,) = set((folder / "cache").iterdir()) - {path}
    path.write_bytes(foreign.read_bytes())
    assert load().origin == "counted"
    assert "another robot" in caplog.text


def test_a_cache_that_cannot_be_written_is_only_a_warning(folder, caplog):
    (folder / "cache").write_text("a file where the folder should be")
    assert load().origin == "counted"
    assert "cannot be kept" in caplog.text


def test_the_key_changes_with_what_the_map_depends_on_and_not_with_the_coefficients():
    description = husky_panda().description
    key = reach_key(description, "lEE", TINY)
    assert reach_key(description, "l3", TINY) != key
    assert reach_key(description, "lEE", TINY.model_copy(update={"seed": 1})) != key
    longer = description.arm.model_copy(update={"end_effector_xyz_m": (0.0, 0.0, 0.2)})
    assert reach_key(description.model_copy(update={"arm": longer}), "lEE", TINY) != key
    without = description.model_copy(update={"reachability": {}, "title": "x"})
    assert reach_key(without, "lEE", TINY) == key


def test_bodies_that_cannot_be_asked_for_are_refused_with_those_that_can():
    with pytest.raises(UnknownNameError, match="l3, lEE"):
        load_reach_map(husky_panda(), "l1")
    with pytest.raises(ConfigError, match="only 2 of the arm's joints move it"):
        Chain(husky_panda(), "l2")


def test_the_papers_robot_ships_with_its_maps_small_and_quick_to_load(robot, monkeypatch):
    for body in BODIES:
        key = reach_key(robot.description, body, ReachConfig())
        path = assets.SHIPPED_CACHE / f"husky_panda-reach-{body}-{key}.npz"
        assert path.is_file(), "run `dbb reach`, then commit the new files of dbb_cache/"
        assert path.stat().st_size < 0.5e6
        ignored = (assets.SHIPPED_CACHE.parent / ".gitignore").read_text(encoding="utf-8")
        assert f"!dbb_cache/{path.name}" in ignored.splitlines()
        start = time.process_time()
        found = load_reach_map(robot, body)
        assert time.process_time() - start < 1.0  # [s]
        assert found.origin in ("cache", "shipped")


def test_the_forearms_coefficients_are_those_of_its_map(robot):
    """As `dbb reach --body l3` prints them, rounded."""
    fit = fit_reachability(load_reach_map(robot, "l3"))
    used = robot.description.reachability["l3"]
    assert pytest.approx(fit.A_per_m2, rel=0.01) == used.A_per_m2
    assert pytest.approx(fit.B_m, abs=0.002) == used.B_m
    assert pytest.approx(fit.C, rel=0.01) == used.C
