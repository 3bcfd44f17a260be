"""Hulls of points without volume get a small thickness and do not crash the library."""

from __future__ import annotations

import coal
import numpy as np
import pinocchio as pin
import pytest

from app.robot.shapes import Hull, convex_hull

Array = np.ndarray

THIN = 1e-4  # [m] minimum thickness of a hull
SQUARE = np.array([[x, y, 0.0] for x in (-0.02, 0.02) for y in (-0.02, 0.02)])
"""(4, 3) [m] a flat marker, as on a Stretch."""
LINE = np.linspace(0.0, 0.3, 5)[:, None] * np.array([1.0, 2.0, -2.0]) / 3.0
POINT = np.zeros((1, 3))
TURNED = pin.SE3(pin.rpy.rpyToMatrix(0.3, -1.1, 2.0), np.array([0.4, -0.2, 1.3]))


def thickness(points: Array, axis: Array) -> float:
    return float(np.ptp(points @ axis))


@pytest.mark.parametrize("T", [pin.SE3.Identity(), TURNED], ids=["straight", "turned"])
@pytest.mark.parametrize("flat", [SQUARE, LINE, POINT], ids=["square", "line", "point"])
def test_hull_without_volume_is_a_tenth_of_a_millimetre_thick(flat: Array, T: pin.SE3) -> None:
    """The hull encloses its points and exceeds them by at most 2 THIN in each direction."""
    points = flat @ T.rotation.T + T.translation
    corners = convex_hull(points).points()
    for axis in np.vstack([np.eye(3), np.random.default_rng(0).normal(size=(20, 3))]):
        axis = T.rotation @ axis / np.linalg.norm(axis)
        assert thickness(corners, axis) >= max(THIN - 1e-9, thickness(points, axis))
        assert thickness(corners, axis) <= thickness(points, axis) + 2 * THIN


@pytest.mark.parametrize("flat", [SQUARE, LINE, POINT], ids=["square", "line", "point"])
def test_distance_to_a_flat_hull_is_the_distance_to_its_points(flat: Array) -> None:
    hull, ball = convex_hull(flat), coal.Sphere(0.01)
    result = coal.DistanceResult()
    away = coal.Transform3s(np.eye(3), flat.mean(axis=0) + np.array([0.0, 0.0, 1.0]))
    d = coal.distance(hull, coal.Transform3s(), ball, away, coal.DistanceRequest(), result)
    z = np.linspace(flat, flat[::-1], 101).reshape(-1, 3)  # the square's centre, all of the line
    nearest = np.linalg.norm(z - away.getTranslation(), axis=1).min()
    assert d == pytest.approx(nearest - 0.01, abs=THIN)


def test_hull_with_volume_keeps_its_corners() -> None:
    cube = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)]) * 2 * THIN
    corners = convex_hull(cube).points()
    assert {tuple(p) for p in corners.round(9)} == {tuple(p) for p in cube.round(9)}


def test_hulls_with_more_neighbours_than_coal_allows_are_simplified() -> None:
    """In coal a corner may have at most 254 neighbours."""
    t = np.linspace(0.0, 2 * np.pi, 1000, endpoint=False)
    rim = 0.1 * np.column_stack([np.cos(t), np.sin(t), np.zeros_like(t)])
    for points, volume in (
        (np.vstack([rim, rim + np.array([0.0, 0.0, 0.02])]), 0.02 * np.pi * 0.1**2),
        (np.vstack([rim, [(0.0, 0.0, 0.1)]]), 0.1 / 3 * np.pi * 0.1**2),
    ):
        hull = convex_hull(points)
        assert hull.computeVolume() == pytest.approx(volume, rel=0.01)
        corners = np.array([hull.point(k) for k in range(hull.num_points)])
        assert np.abs(corners).max() <= 0.101  # [m]


def test_description_may_have_a_flat_hull() -> None:
    vertices = tuple((float(x), float(y), float(z)) for x, y, z in SQUARE)
    geometry = Hull(type="hull", vertices_m=vertices).coal_geometry()
    geometry.computeLocalAABB()
    assert geometry.aabb_local.depth() >= THIN - 1e-9
