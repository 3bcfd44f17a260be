"""Bodies enclose all their points with little additional volume."""

from __future__ import annotations

import sys

import numpy as np
import pinocchio as pin
import pytest
import trimesh
from scipy.spatial import ConvexHull

from app.onboarding.fit import bodies
from app.onboarding.fit.bodies import swept
from app.onboarding.fit.convex import (
    PointHull,
    convex_pieces,
    fit_best,
    fit_box,
    fit_capsule,
    fit_hull,
    hull,
    lean_corners,
    support,
    volume_of,
)
from app.onboarding.read.links import LinkShape
from app.robot.model import RobotModel
from app.robot.shapes import hull_mesh, shape_mesh
from tests.robots import husky_panda

FITS = {"capsule": fit_capsule, "box": fit_box, "hull": fit_hull}


def cloud(seed: int, stretch: tuple[float, float, float] = (0.3, 0.1, 0.05)) -> np.ndarray:
    """Points in a rotated ellipsoid with a random centre."""
    rng = np.random.default_rng(seed)
    turn = pin.Quaternion(*(q / np.linalg.norm(q) for q in [rng.normal(size=4)])).matrix()
    points = rng.normal(size=(300, 3))
    points *= rng.uniform(0, 1, (300, 1)) / np.linalg.norm(points, axis=1)[:, None]
    return points * stretch @ turn.T + rng.uniform(-0.5, 0.5, 3)


def distance(shape, points: np.ndarray) -> np.ndarray:
    """(N,) [m] signed distances from the collision library."""
    import coal

    geometry, T = shape.coal_geometry(), shape.placement()
    at = coal.Transform3s(T.rotation, T.translation)
    request, result = coal.DistanceRequest(), coal.DistanceResult()
    found = []
    for p in points:
        result.clear()
        dot = coal.Transform3s(np.eye(3), p)
        found.append(coal.distance(geometry, at, coal.Sphere(0.0), dot, request, result))
    return np.array(found)


@pytest.mark.parametrize("kind", FITS)
@pytest.mark.parametrize("seed", range(3))
def test_body_encloses_all_its_points(kind: str, seed: int) -> None:
    points = cloud(seed)
    assert distance(FITS[kind](points), points).max() < 2e-4  # [m]


@pytest.mark.parametrize("kind", FITS)
def test_volume_and_support_match_the_drawn_mesh(kind: str) -> None:
    """Compared with trimesh, whose polyhedral spheres deviate by up to 1 %."""
    shape = FITS[kind](cloud(3))
    mesh = shape_mesh(shape).copy().apply_transform(shape.placement().homogeneous)
    assert volume_of(shape) == pytest.approx(mesh.volume, rel=0.015)
    D = np.random.default_rng(0).normal(size=(50, 3))
    D /= np.linalg.norm(D, axis=1)[:, None]
    np.testing.assert_allclose(support(shape, D), (D @ mesh.vertices.T).max(axis=1), atol=2e-3)


def test_capsule_fit_recovers_a_known_capsule() -> None:
    rng = np.random.default_rng(0)
    D = rng.normal(size=(2000, 3))
    D /= np.linalg.norm(D, axis=1)[:, None]
    a, b, r = np.array([0.1, 0.2, 0.3]), np.array([0.3, 0.1, 0.7]), 0.06
    points = np.where((D @ (b - a) > 0)[:, None], b, a) + r * D
    fit = fit_capsule(points)
    true = np.pi * r**2 * (np.linalg.norm(b - a) + 4 / 3 * r)
    assert volume_of(fit) == pytest.approx(true, rel=0.03)
    assert fit.radius_m == pytest.approx(r, rel=0.03)


def test_box_fit_recovers_a_rotated_box() -> None:
    corners = np.array(np.meshgrid([-1, 1], [-1, 1], [-1, 1])).reshape(3, -1).T * [0.2, 0.1, 0.05]
    turned = corners @ pin.rpy.rpyToMatrix(0.0, 0.0, 0.6).T + [0.3, 0.0, 0.1]
    assert volume_of(fit_box(turned)) == pytest.approx(0.4 * 0.2 * 0.1, rel=0.02)


def test_least_weighted_volume_wins_and_is_compared_with_the_hull() -> None:
    points = cloud(5)
    fit = fit_best(hull(points), {"capsule": 1.0, "box": 1.0, "hull": 1.0})
    assert fit.volume == min(volume_of(f(hull(points).corners)) for f in FITS.values())
    assert fit.over_cover == pytest.approx(fit.volume / hull(points).volume)
    assert fit.over_cover >= 1.0
    heavy = fit_best(hull(points), {"capsule": 1.0, "box": 1e6, "hull": 1e6})
    assert heavy.shape.type == "capsule"


def test_round_cloud_is_reduced_to_few_corners_that_enclose_it() -> None:
    """A cloud swept over three joints can have four million points; their hull takes seconds.

    A cloud with few corners is not changed.
    """
    D = np.random.default_rng(4).normal(size=(20_000, 3))
    D /= np.linalg.norm(D, axis=1)[:, None]
    points = D * [0.4, 0.5, 0.3] + [1.0, 0.0, 0.2]
    lean = lean_corners(points)
    assert len(lean) < 1300 < len(hull(points).corners)
    faces, ones = ConvexHull(lean).equations, np.ones(len(points))
    assert (faces @ np.column_stack([points, ones]).T).max() < 0.0
    assert 1.0 < hull(lean).volume / hull(points).volume < 1.02
    out = (lean @ D[:500].T).max(axis=0) - (points @ D[:500].T).max(axis=0)
    assert out.max() < 4e-3
    thin = lean_corners(D * [1.0, 0.02, 0.02])  # a rod of 2 m
    assert np.ptp(thin, axis=0) == pytest.approx([2.0, 0.04, 0.04], rel=0.02)
    few = cloud(6)
    np.testing.assert_array_equal(lean_corners(few), hull(few).corners)


def test_sweep_through_a_joint_is_computed_once(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Groupings with the same outer links share the result."""
    rng, computed = np.random.default_rng(2), []
    points = {j: rng.uniform(-0.08, 0.08, (40, 3)) for j in (6, 7, 8)}
    swept(husky_panda(), points)
    lean = bodies.lean_corners

    def counted(corners: np.ndarray) -> np.ndarray:
        computed.append(lean(corners))
        return computed[-1]

    monkeypatch.setattr(bodies, "lean_corners", counted)
    swept(husky_panda(), points | {5: points[6]})
    assert len(computed) == 4  # from 6 to 5 and from 5 to 8; the sweeps from 8 to 6 are stored


def test_sweep_seen_from_one_joint_equals_that_of_all_joints(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Seen from joint 7, the links are swept only through the joints between them and joint 7."""
    points = {j: np.random.default_rng(j).uniform(-0.1, 0.1, (40, 3)) for j in (5, 6, 7, 8)}
    through, computed = bodies._through, []

    def counted(model: RobotModel, data: bytes, joint: int, outwards: bool) -> np.ndarray:
        computed.append((joint, outwards))
        return through(model, data, joint, outwards)

    monkeypatch.setattr(bodies, "_through", counted)
    seen = swept(husky_panda(), points, [7])
    assert computed == [(8, True), (6, False), (7, False)]
    assert seen.keys() == {7}
    np.testing.assert_array_equal(seen[7].corners, swept(husky_panda(), points)[7].corners)


def test_sweep_encloses_the_links_in_all_positions_of_the_joints_between() -> None:
    """Points on links 5, 6 and 7 of the Panda, seen from link 6, in random postures."""
    model = husky_panda()
    rng = np.random.default_rng(1)
    points = {j: rng.uniform(-0.08, 0.08, (40, 3)) for j in (6, 7, 8)}  # joints 5, 6, 7
    corners, volume = swept(model, points)[7]
    from scipy.spatial import ConvexHull

    assert volume == pytest.approx(ConvexHull(corners).volume)
    planes = ConvexHull(corners).equations
    data = model.pin.createData()
    for q_m in rng.uniform(model.q_lower, model.q_upper, (50, model.n_m)):
        pin.forwardKinematics(model.pin, data, model.configuration((0, 0, 0), q_m))
        for joint, own in points.items():
            T = data.oMi[7].actInv(data.oMi[joint])
            seen = own @ T.rotation.T + T.translation
            assert (seen @ planes[:, :3].T + planes[:, 3]).max() < 1e-6


def test_base_parts_are_merged_with_the_least_added_volume(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """No hull is computed twice, which saves a minute for Centauro's 25 parts."""
    seen: list[bytes] = []

    def counted(points: np.ndarray) -> PointHull:
        seen.append(points.tobytes())
        return hull(points)

    monkeypatch.setattr(bodies, "hull", counted)
    rng = np.random.default_rng(0)
    places = np.repeat([[0.0, 0.0, 0.0], [3.0, 0.0, 0.0], [0.0, 3.0, 3.0]], [3, 2, 2], axis=0)
    parts = [rng.uniform(-0.1, 0.1, (20, 3)) + place for place in places]
    model = RobotModel(husky_panda().description)
    divisions = bodies._divided(model, parts)
    assert [len(groups) for groups in divisions] == [1, 2, 3, 4]
    centres = [group.corners.mean(axis=0) for group in divisions[2]]
    for place in np.unique(places, axis=0):
        assert min(np.abs(centre - place).max() for centre in centres) < 0.1
    assert len(seen) == len(set(seen)) == 7 + 21 + 5 + 4 + 3 + 2 + 1
    again = bodies._divided(model, parts[:3] + parts[4:])
    # Only the hulls with the merger of parts 3 and 4 are lost; groupings share all others.
    assert len(seen) == len(set(seen)) < 43 + 6
    alone = bodies._divided(RobotModel(model.description), parts[:3] + parts[4:])
    for ours, theirs in zip(again, alone, strict=True):
        for group, other in zip(ours, theirs, strict=True):
            np.testing.assert_array_equal(group.corners, other.corners)


def test_convex_pieces_have_little_more_volume_than_the_mesh() -> None:
    """A hull around three posts on a plate contains the space between the posts."""
    boxes = [trimesh.creation.box((0.3, 0.3, 0.1))]
    for x, y in ((-0.13, -0.13), (0.13, -0.13), (0.0, 0.13)):
        post = trimesh.creation.box((0.02, 0.02, 0.4))
        boxes.append(post.apply_translation((x, y, 0.25)))
    tower = trimesh.util.concatenate(boxes)
    assert isinstance(tower, trimesh.Trimesh)
    whole, solid = hull(tower.vertices).volume, sum(box.volume for box in boxes)
    pieces = convex_pieces(tower)
    assert whole > 2.0 * solid
    assert sum(hull(piece.vertices).volume for piece in pieces) < 1.4 * solid
    assert sum(piece.area for piece in pieces) == pytest.approx(tower.area)
    assert len(convex_pieces(boxes[0])) == 1


@pytest.mark.parametrize("turn", [0.0, 0.8])
def test_no_piece_of_a_small_fork_fills_its_slot(turn: float) -> None:
    """The link inside a fork would otherwise touch the fork in all postures."""
    gap, length = 0.03, 0.04  # [m]
    boxes = [trimesh.creation.box((0.05, gap + 0.03, 0.03))]
    for side in (-1.0, 1.0):
        prong = trimesh.creation.box((0.05, 0.015, length))
        boxes.append(prong.apply_translation((0.0, side * (gap + 0.015) / 2, 0.015 + length / 2)))
    fork = trimesh.util.concatenate(boxes)
    assert isinstance(fork, trimesh.Trimesh)
    R = pin.utils.rotate("x", turn)
    fork.apply_transform(pin.SE3(R, np.zeros(3)).homogeneous)
    axes = np.meshgrid([0.0], np.linspace(-0.35, 0.35, 7) * gap, np.linspace(0.02, 0.055, 7))
    slot = np.reshape(axes, (3, -1)).T @ R.T
    filled = np.zeros(len(slot), dtype=bool)
    for piece in convex_pieces(fork):
        mesh = hull_mesh(np.asarray(piece.vertices))
        offsets = np.einsum("ij,ij->i", mesh.face_normals, mesh.triangles[:, 0])
        filled |= (slot @ mesh.face_normals.T < offsets).all(axis=1)
    assert filled.mean() < 0.1


def test_hull_mesh_has_the_hulls_volume_and_supports_plates(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The winding of triangles without area needs networkx in trimesh."""
    monkeypatch.setitem(sys.modules, "networkx", None)
    points = np.random.default_rng(0).normal(size=(60, 3))
    assert hull_mesh(points).volume == pytest.approx(ConvexHull(points).volume)
    corners = np.array([[x, y, 0.0] for x in (0.0, 0.05) for y in (0.0, 0.05)])
    plate = hull_mesh(corners)
    np.testing.assert_allclose(plate.extents, (0.05, 0.05, 1e-4), atol=1e-9)
    turned = hull_mesh(corners @ pin.rpy.rpyToMatrix(0.3, 0.5, 0.7).T + 0.37)
    assert turned.volume == pytest.approx(plate.volume) == pytest.approx(2.5e-7)
    assert LinkShape(turned, turned, "mesh", None).volume == 0.0
    thicker = hull_mesh(np.concatenate([corners, corners + np.array([0.0, 0.0, 2e-4])]))
    assert LinkShape(thicker, thicker, "mesh", None).volume == pytest.approx(5e-7)
