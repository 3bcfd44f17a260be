"""The border around an l_m of several shapes, compared with distances computed here."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial import cKDTree

from app.border.cache import load_border_data
from app.border.dbb import make_cloud
from app.border.mobile import MobileBody
from app.border.nearest import OffsetContours, level
from app.border.offset import offset_contours
from app.config import Config
from app.robot.model import RobotModel
from app.robot.shapes import Box, Capsule, Cylinder, Hull
from app.simulation.run import run_scenario
from app.simulation.scenarios import scenario_by_name
from tests.nearest import BorderSearch
from tests.robots import husky_panda, with_mobile_shapes

D_B = 0.15  # [m]
FLOOR = 0.1323  # [m] height of the shapes' link origin above the floor
# Centre and half sides [m] of a deck and of a tower behind the arm; position, radius and top [m]
# of a post beside the arm. In the base's frame, whose origin is on the floor.
DECK = np.array([0.0, 0.0, 0.19]), np.array([0.495, 0.345, 0.19])
TOWER = np.array([-0.37, 0.02, 0.6]), np.array([0.10, 0.20, 0.5])
POST_AT, POST_RADIUS, POST_TOP = np.array([0.15, 0.28]), 0.05, 1.0
FLATS = [0.38 + D_B, 1.1 + D_B, POST_TOP + D_B]  # [m] heights at which the offset of a shape ends


def distance(p: np.ndarray) -> np.ndarray:
    """Distances (…) [m] of points (…, 3) [m] to deck, tower and post; 0 inside."""
    out = [np.linalg.norm(np.maximum(np.abs(p - c) - h, 0.0), axis=-1) for c, h in (DECK, TOWER)]
    aside = np.maximum(np.linalg.norm(p[..., :2] - POST_AT, axis=-1) - POST_RADIUS, 0.0)
    return np.min([*out, np.hypot(aside, np.maximum(p[..., 2] - POST_TOP, 0.0))], axis=0)


def box(centre: np.ndarray, half: np.ndarray) -> Box:
    x, y, z = centre - [0.0, 0.0, FLOOR]
    a, b, c = 2 * half
    return Box(type="box", size_m=(a, b, c), xyz_m=(x, y, z))


@pytest.fixture(scope="module")
def towered() -> RobotModel:
    post = Cylinder(
        type="cylinder",
        radius_m=POST_RADIUS,
        length_m=POST_TOP,
        xyz_m=(*POST_AT, POST_TOP / 2 - FLOOR),
    )
    return with_mobile_shapes((box(*DECK), box(*TOWER), post))


@pytest.fixture(scope="module")
def offset(towered: RobotModel) -> OffsetContours:
    return offset_contours(towered, D_B)


def dense_border(z: float) -> np.ndarray:
    """(N, 2) [m] crossings of the distance D_B on the lines of a 4 mm grid at a height."""
    x, y = np.arange(-0.9, 0.9, 0.004), np.arange(-0.7, 0.7, 0.004)
    X, Y = np.meshgrid(x, y, indexing="ij")
    D = distance(np.stack([X, Y, np.full_like(X, z)], axis=-1)) - D_B
    found = []
    for low, high, d_low, d_high in (
        ((X[:-1], Y[:-1]), (X[1:], Y[1:]), D[:-1], D[1:]),
        ((X[:, :-1], Y[:, :-1]), (X[:, 1:], Y[:, 1:]), D[:, :-1], D[:, 1:]),
    ):
        at = np.sign(d_low) != np.sign(d_high)
        share = d_low[at] / (d_low[at] - d_high[at])
        found.append([a[at] + share * (b[at] - a[at]) for a, b in zip(low, high, strict=True)])
    return np.concatenate([np.transpose(each) for each in found])


@pytest.mark.parametrize("z", [0.05, 0.2, 0.41, 0.5, 0.525, 0.56, 0.9, 1.06, 1.13, 1.2])
def test_nearest_point_agrees_with_a_dense_search(offset: OffsetContours, z: float):
    """At heights with one contour, with several contours, and with the tower alone."""
    surface = BorderSearch(offset)
    border = dense_border(z)
    for p in np.random.default_rng(0).uniform([-0.8, -0.6], [0.8, 0.6], (150, 2)):
        foot = surface.nearest(np.array([*p, z]))
        away = np.linalg.norm(foot.p[:2] - p)
        assert away == pytest.approx(np.linalg.norm(border - p, axis=1).min(), abs=0.002)


def test_nearest_points_are_on_the_exact_offset(offset: OffsetContours):
    surface = BorderSearch(offset)
    rng = np.random.default_rng(1)
    points = rng.uniform([-0.8, -0.6, 0.0], [0.8, 0.6, 1.3], (3000, 3))
    feet = np.array([surface.nearest(p).p for p in points])
    feet[:, 2] = [level(offset.firsts, offset.heights, z) for z in points[:, 2]]
    assert np.abs(distance(feet) - D_B).max() < 0.001


def test_tangent_is_perpendicular_and_has_the_base_on_its_left(offset: OffsetContours):
    surface = BorderSearch(offset)
    for p in np.random.default_rng(2).uniform([-0.8, -0.6, 0.0], [0.8, 0.6, 1.2], (500, 3)):
        foot = surface.nearest(p)
        assert np.linalg.norm(foot.t) == pytest.approx(1.0)
        assert (p - foot.p) @ foot.t == pytest.approx(0.0, abs=1e-8)
        left = foot.p + 1e-3 * np.array([-foot.t[1], foot.t[0], 0.0])
        if np.abs(np.subtract(FLATS, p[2])).min() > 0.01:
            assert distance(left) < D_B + 2e-4


def test_distance_to_the_border_changes_no_faster_than_the_point_moves(offset: OffsetContours):
    """The nearest point may jump on the medial axis, but its distance may not.

    The heights avoid the horizontal pieces of the offset, where the distance may jump too.
    """
    surface = BorderSearch(offset)
    rng = np.random.default_rng(3)
    for _ in range(40):
        z = rng.choice([0.1, 0.3, 0.45, 0.52, 0.6, 1.1]) + rng.uniform(-0.004, 0.004)
        begin, end = rng.uniform([-0.7, -0.5], [0.7, 0.5], (2, 2))
        path = begin + np.linspace(0.0, 1.0, 1500)[:, None] * (end - begin)
        feet = np.array([surface.nearest(np.array([*p, z])).p[:2] for p in path])
        ways = np.linalg.norm(feet - path, axis=1)
        step = np.linalg.norm(end - begin) / 1499
        assert np.abs(np.diff(ways)).max() < 1.05 * step + 2e-6


@pytest.mark.parametrize("z", [0.2, 0.45, 0.8])
def test_foot_and_tangent_are_continuous_off_the_medial_axis(offset: OffsetContours, z: float):
    """The paths are circles: in the deck, above its front edge, and about the tower's axis.

    Where two border points are equally near, the foot jumps, but its distance does not.
    """
    surface = BorderSearch(offset)
    depth = 0.05
    outline = {0.2: None, 0.45: (0.495, 0.0), 0.8: (-0.37, 0.02)}[z]
    turn = np.linspace(0.0, 2 * np.pi, 40001)
    centre = np.array(outline) if outline is not None else np.zeros(2)
    reach = (0.06 if z == 0.45 else 0.12) if outline is not None else 0.25
    path = centre + reach * np.column_stack([np.cos(turn), np.sin(turn)])
    feet = [surface.nearest(np.array([*p, z])) for p in path]
    p = np.array([f.p[:2] for f in feet])
    t = np.array([f.t[:2] for f in feet])
    ways = np.linalg.norm(p - path, axis=1)
    moved, turned = (np.linalg.norm(np.diff(a, axis=0), axis=1) for a in (p, t))
    medial = moved > 0.01  # two nearest points
    assert medial.sum() < 8
    assert np.abs(np.diff(ways))[medial].max(initial=0.0) < 1e-4
    calm = ~medial & (ways[1:] > depth)
    assert moved[calm].max() < 40 * reach * (turn[1] - turn[0])
    assert turned[calm].max() < 40 * (turn[1] - turn[0])


def test_two_towers_give_two_contours_and_a_frame_has_an_inner_one():
    half = np.array([0.1, 0.1, 0.3])
    towers = (box(np.array([0.6, 0.0, 0.3]), half), box(np.array([-0.6, 0.0, 0.3]), half))
    offset = offset_contours(with_mobile_shapes(towers), D_B)
    assert len(offset.contours(0.2)) == 2
    for x in (0.4, -0.4):
        found = BorderSearch(offset).nearest(np.array([x, 0.0, 0.2]))
        assert found.p[:2] == pytest.approx([np.sign(x) * 0.35, 0.0], abs=1e-3)
    sides = [((0.5, 0.0), (0.05, 0.55)), ((0.0, 0.5), (0.55, 0.05))]
    frame = [
        box(np.array([*(s * np.array(c)), 0.3]), np.array([*h, 0.3]))
        for c, h in sides
        for s in (1.0, -1.0)
    ]
    offset = offset_contours(with_mobile_shapes(tuple(frame)), D_B)
    within = BorderSearch(offset).nearest(np.array([0.25, 0.1, 0.2]))
    assert within.p[:2] == pytest.approx([0.3, 0.1], abs=1e-3)  # 0.45 m less d_b
    assert within.t[:2] == pytest.approx([0.0, -1.0], abs=1e-3)


def test_offset_of_shapes_of_any_kind_is_at_the_buffer_distance():
    """The shapes are a box, a slanted capsule, a plate high above the floor and a polytope."""
    shapes = (
        Box(type="box", size_m=(0.8, 0.5, 0.3), xyz_m=(0.0, 0.0, 0.05)),
        Capsule(type="capsule", start_m=(0.3, 0.2, 0.1), end_m=(-0.4, 0.3, 1.0), radius_m=0.05),
        Box(type="box", size_m=(0.3, 0.3, 0.05), xyz_m=(-0.2, -0.3, 0.8)),
        Hull(
            type="hull",
            xyz_m=(0.5, 0.0, 0.3),
            vertices_m=((0.1, 0.0, 0.0), (-0.1, 0.1, 0.0), (-0.1, -0.1, 0.0), (0.0, 0.0, 0.4)),
        ),
    )
    model = with_mobile_shapes(shapes)
    body, offset = MobileBody(model), offset_contours(model, D_B)
    _, heights, vertices, _, visible, _ = offset
    assert len(offset.firsts) == 4 + 1
    for z, ring, shown in list(zip(heights, vertices, visible, strict=True))[::5]:
        d = body.distance(np.column_stack([ring.real, ring.imag, np.full(len(ring), z)])[::4])
        np.testing.assert_allclose(d[shown[::4] > 4e-6], D_B, atol=2e-6)
        assert (d[shown[::4] < 0.0] < D_B + 4e-6).all()
    points = np.random.default_rng(4).uniform([-0.7, -0.6, 0.0], [0.7, 0.6, 1.2], (400, 3))
    feet = [BorderSearch(offset).nearest(p) for p in points]
    lifted = np.array([foot.p for foot in feet])
    assert np.abs(body.distance(lifted) - D_B).max() < 0.002


def test_contours_are_the_pieces_of_the_rings_on_the_offset(offset: OffsetContours):
    """The contours cover the whole border; each is on the border and has its own first point."""
    for z, count in ((0.2, 1), (0.45, 2), (0.5, 4), (0.8, 2), (1.2, 1)):
        pieces = offset.contours(z)
        assert len(pieces) == count
        assert len({tuple(np.round(piece[0], 2)) for piece in pieces}) == count
        for piece in pieces:
            at = np.column_stack([piece, np.full(len(piece), z)])
            assert np.abs(distance(at) - D_B).max() < 0.001
        gaps, _ = cKDTree(np.concatenate(pieces)).query(dense_border(z))
        assert gaps.max() < 0.01  # [m] half of the longest edge of a ring


@pytest.mark.slow
@pytest.mark.parametrize("controller", ["none", "dbb"])
def test_pulled_end_effector_hits_the_tower_only_without_avoidance(controller: str):
    """The arm bends backwards over the deck, towards a tower that stands behind it."""
    tower = box(np.array([-0.42, 0.0, 0.7]), np.array([0.07, 0.15, 0.5]))
    model = with_mobile_shapes((box(*DECK), tower))
    data = load_border_data(husky_panda(), progress=False)
    nothing = {
        name: make_cloud(name, np.empty((0, 3), np.int16), np.empty(0, np.uint16))
        for name in data.clouds
    }
    data = type(data)(data.pairs, nothing, data.origin)
    line = scenario_by_name("guiding-above").changed(
        start=(0.05, 0.35, 0.95), move=(-0.45, -0.25, 0.0), duration=4.0
    )
    figures = run_scenario(model, data, line, Config(), controller=controller).figures
    clearance = figures["min_clearance_m"]
    assert isinstance(clearance, float)
    if controller == "none":
        assert clearance < 0.0
    else:
        assert clearance > 0.03
        assert figures["contacts"] == 0
        assert figures["solver_failures"] == 0
