"""The start solver: properties of all its starts, and its errors."""

from __future__ import annotations

import itertools
from collections import Counter

import numpy as np
import pinocchio as pin
import pytest

from app.border.cache import BorderData
from app.config import Config
from app.errors import AssetError, UnreachableError
from app.robot.description import load_robot
from app.robot.link_pairs import PairDistances, find_link_pairs
from app.robot.model import RobotModel
from app.simulation.scenarios import LINES
from app.simulation.scenarios.start import Found, PostureSearch, StartSolver, find_start

D_B = Config().border.d_b
PLACES = {
    **{name: scenario.start for name, scenario in LINES.items()},
    "right side": (0.30, -0.72, 0.30),
    "behind": (-0.50, 0.30, 0.70),
    "far in front": (1.0, 0.0, 0.5),
    "high": (0.6, 0.2, 1.1),
    "front left": (0.80, 0.40, 0.25),
}


@pytest.fixture(scope="module")
def solver(robot: RobotModel, border_data: BorderData) -> StartSolver:
    return StartSolver(robot, border_data.pairs, D_B)


@pytest.fixture(scope="module", params=PLACES)
def solved(request, solver):
    """A place and the posture for it."""
    return np.array(PLACES[request.param]), solver.solve(PLACES[request.param])


def end_effector(robot: RobotModel, q_m: np.ndarray) -> pin.SE3:
    """The pose directly from pinocchio, with the base at the origin."""
    data = robot.pin.createData()
    pin.framesForwardKinematics(robot.pin, data, robot.configuration((0, 0, 0), q_m))
    return data.oMf[robot.ee_frame]


@pytest.mark.slow
def test_the_end_effector_is_at_the_requested_place(robot, solved):
    place, q_m = solved
    np.testing.assert_allclose(end_effector(robot, q_m).translation, place, atol=1e-5)


def test_every_pair_is_outside_its_buffer(robot, border_data, solved):
    distances = PairDistances(robot, border_data.pairs.all)
    distances.update(robot.configuration((0, 0, 0), solved[1]))
    assert min(distances.distances()) > D_B


def test_joints_are_away_from_their_limits(robot, solved):
    left = np.minimum(solved[1] - robot.q_lower, robot.q_upper - solved[1])
    assert (left >= 0.029 * (robot.q_upper - robot.q_lower)).all()


def test_the_arm_is_above_the_floor(robot, solved):
    """The lowest point of a capsule is the lower end of its axis minus its radius."""
    data = robot.pin.createData()
    geometry = pin.GeometryData(robot.geometry)
    q = robot.configuration((0, 0, 0), solved[1])
    pin.updateGeometryPlacements(robot.pin, data, robot.geometry, geometry, q)
    for name in robot.body_names[1:]:
        for i in robot.shape_ids[name]:
            capsule, at = robot.geometry.geometryObjects[i].geometry, geometry.oMg[i]
            sag = abs(at.rotation[2, 2]) * capsule.halfLength + capsule.radius
            assert at.translation[2] - sag > 0.0


def test_the_end_effector_points_away_from_the_mount_and_not_upwards(robot, solved):
    place, q_m = solved
    pointing = end_effector(robot, q_m).rotation[:, 2]
    outwards = (place - robot.p_base())[:2]
    assert pointing[:2] @ outwards > -1e-6  # straight down is neutral
    across = pointing[0] * outwards[1] - pointing[1] * outwards[0]
    assert abs(across) < 0.03 * np.linalg.norm(outwards)
    assert pointing[2] < 0.03


def test_the_end_effector_points_down_by_45_degrees_in_free_space(robot, solver):
    pointing = end_effector(robot, solver.solve((0.85, 0.30, 0.40))).rotation[:, 2]
    assert -pointing[2] == pytest.approx(np.sin(np.pi / 4), abs=0.03)


@pytest.mark.parametrize(
    ("lean", "any_direction"), [(0.0, False), (0.3, False), (1.2, True), (3.1, False)]
)
def test_only_a_sideways_mounted_arm_may_point_in_any_direction(
    robot, border_data, lean, any_direction
):
    """An Alicia-D on a Jackal, tilted by 69°, cannot point away and down."""
    model = RobotModel(robot.description)
    model.pin.jointPlacements[2] = model.pin.jointPlacements[2] * pin.SE3(
        pin.utils.rotate("x", lean), np.zeros(3)
    )
    solver, tried = StartSolver(model, border_data.pairs, D_B), []
    solver._try = lambda target, *_: tried.append(target.z) or Found(None, 0.0, Counter())
    with pytest.raises(UnreachableError):
        solver.solve((0.3, 0.7, 0.3))
    assert [each for each in tried if each is None] == ([None] if any_direction else [])


@pytest.mark.parametrize(("followed", "any_direction"), [(0, True), (1, True), (2, False)])
def test_any_direction_is_tried_only_if_no_posture_follows_the_whole_path(
    robot, border_data, monkeypatch, followed, any_direction
):
    solver, tried = StartSolver(robot, border_data.pairs, D_B), []
    found = Found(np.zeros(7), followed + 0.3, Counter())
    monkeypatch.setattr(solver, "_points_anywhere", False)
    monkeypatch.setattr(solver, "_try", lambda target, *_: tried.append(target.z) or found)
    solver.solve((0.3, 0.7, 0.3), along=[np.array([0.3, y, 0.3]) for y in (0.6, 0.5)])
    assert any(each is None for each in tried) == any_direction


def test_a_start_from_which_the_arm_follows_more_of_the_path_is_better(robot, border_data, solver):
    """The best margins are those of a posture from which the arm reaches only one position."""
    start, move = np.array([0.72, 0.29, 0.65]), np.array([-0.34, -0.20, 0.06])
    along = [start + share * move for share in np.linspace(0.2, 1.0, 5)]
    q_m = solver.solve(tuple(start), along=along)
    R, search = end_effector(robot, q_m).rotation, PostureSearch(robot, border_data.pairs, D_B)
    for p in along[:4]:
        q_m = search.reach(pin.SE3(R, p), q_m)
        np.testing.assert_allclose(end_effector(robot, q_m).translation, p, atol=1e-3)


@pytest.mark.slow
def test_equal_seeds_give_bitwise_equal_starts(robot, border_data, solver):
    again = StartSolver(robot, border_data.pairs, D_B)
    for name in ("guiding-lateral", "guiding-fold"):
        first = solver.solve(PLACES[name], seed=4)
        np.testing.assert_array_equal(first, solver.solve(PLACES[name], seed=4))
        np.testing.assert_array_equal(first, again.solve(PLACES[name], seed=4))


def test_a_found_start_is_reused_only_for_equal_arguments(robot, border_data, solver, monkeypatch):
    model = RobotModel(robot.description)  # only for this test

    def found(d_b, place, seed):
        return find_start(model, border_data.pairs, d_b, place, seed=seed)

    arguments = (0.15, LINES["guiding-front"].start, 0)
    first = found(*arguments)
    np.testing.assert_array_equal(first, solver.solve(LINES["guiding-front"].start))
    with pytest.raises(ValueError, match="read-only"):  # all callers share it
        first[:] = np.nan
    searched = []
    monkeypatch.setattr(
        StartSolver, "solve", lambda *args, **_: searched.append(args) or np.ones(7)
    )
    assert np.isfinite(found(*arguments)).all()
    assert not searched
    for k, other in enumerate(
        [(0.16, *arguments[1:]), (0.15, (0.9, 0.1, 0.3), 0), (*arguments[:2], 1)]
    ):
        found(*other)
        assert len(searched) == k + 1


@pytest.mark.slow
def test_every_seed_reaches_the_place(robot, solver):
    for place, seed in itertools.product(("guiding-lateral", "tracking"), (1, 2, 3)):
        at = end_effector(robot, solver.solve(PLACES[place], seed=seed)).translation
        np.testing.assert_allclose(at, PLACES[place], atol=1e-5)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("place", "reason"),
    [
        ((2.5, 0.0, 0.5), "out of the arm's reach"),
        ((1.32, 0.0, 0.5), "out of the arm's reach"),  # nearer than the sum of all offsets
        ((0.2, 0.42, 0.15), "inside its buffer"),
        ((0.7, 0.1, 0.02), "touch the floor"),
        ((0.9, 0.0, -0.1), "above the floor"),
        ((0.9, 0.0, 0.0), "above the floor"),
        ((float("nan"), 0.0, 0.5), "finite position"),
    ],
)
def test_an_impossible_start_is_refused_with_its_reason(solver, place, reason):
    with pytest.raises(UnreachableError, match=reason) as caught:
        solver.solve(place)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("name", ["husky_panda", "stretch_se3"])
def test_no_posture_is_beyond_the_length_of_the_arm(name: str):
    """Farther places are refused without a search. The Stretch has five prismatic joints."""
    try:
        robot = RobotModel(load_robot(name))
    except AssetError as error:
        pytest.skip(str(error))
    pairs, rng = find_link_pairs(robot, samples=20), np.random.default_rng(0)
    search = PostureSearch(robot, pairs, D_B)
    search.stand(np.array([1.0, -2.0, 2.5]))
    reached = []
    for q_m in search.guesses(rng, 300):
        search.place(q_m)
        reached.append(search.beyond(search.state.T_world_ee.translation))
    assert max(reached) < 0.0


def test_a_start_is_outside_a_wider_buffer_too(robot, border_data):
    wide = StartSolver(robot, border_data.pairs, 0.25)
    distances = PairDistances(robot, border_data.pairs.all)
    distances.update(robot.configuration((0, 0, 0), wide.solve((0.95, 0.1, 0.45))))
    assert min(distances.distances()) > 0.25


def test_sliding_preserves_the_direction_of_the_end_effector(robot, solver):
    begin, end = (0.30, 0.72, 0.30), (0.33, 0.75, 0.30)
    q_m = solver.solve(begin)
    slid = solver.slide(end, q_m)
    before, after = end_effector(robot, q_m), end_effector(robot, slid)
    np.testing.assert_allclose(after.translation, end, atol=1e-5)
    np.testing.assert_allclose(after.rotation[:, 2], before.rotation[:, 2], atol=0.02)
    with pytest.raises(UnreachableError, match="reach"):
        solver.slide((0.30, 2.0, 0.30), q_m)


@pytest.mark.parametrize("turn", [-0.7, 0.7])
def test_a_turned_end_effector_points_to_the_left_by_the_angle(robot, solver, turn):
    place = (0.80, 0.10, 0.40)
    straight, turned = (end_effector(robot, solver.solve(place, turn=t)) for t in (0.0, turn))
    x, y, _ = straight.rotation[:, 2]
    u, v, _ = turned.rotation[:, 2]
    between = np.arctan2(x * v - y * u, x * u + y * v)
    assert between == pytest.approx(
        turn, abs=0.08
    )  # pitches differ; the tolerance of directions is 0.02


def test_solved_places_are_in_reach_and_distant_ones_are_not(solver):
    assert all(solver.reaches(place) for place in PLACES.values())
    assert not solver.reaches((0.30, 1.6, 0.30))
    assert not solver.reaches((-0.9, 0.0, 0.30))
