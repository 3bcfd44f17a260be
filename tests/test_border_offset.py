"""The exact offset of the mobile base, compared with the distance to a box defined here."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest

from app.border.mobile import MobileBody, Shapes
from app.border.nearest import OffsetContours
from app.border.offset import offset_contours
from app.robot.shapes import Box, convex_hull
from tests.nearest import BorderSearch, Placed
from tests.robots import husky_panda, with_mobile_shapes

HALF, CENTRE = np.array([0.495, 0.345, 0.19015]), np.array([0.0, 0.0, 0.1902])  # [m]
TOP = 0.38035  # [m]


def box_distance(p: np.ndarray) -> np.ndarray:
    return np.linalg.norm(np.maximum(np.abs(p - CENTRE) - HALF, 0), axis=-1)


def lifted(xy: np.ndarray, z: float) -> np.ndarray:
    return np.column_stack([xy, np.full(len(xy), z)])


@pytest.fixture(scope="module", params=[0.06, 0.15, 0.30])
def d_b(request) -> float:
    return request.param


@pytest.fixture(scope="module")
def offset(d_b: float) -> OffsetContours:
    return offset_contours(husky_panda(), d_b)


def vertices(offset: OffsetContours) -> np.ndarray:
    """(H, R + 1, 2) [m] the vertices of all rings."""
    return np.stack([offset.vertices.real, offset.vertices.imag], axis=-1)


def test_every_vertex_is_at_the_buffer_distance(offset, d_b):
    for z, ring in zip(offset.heights, vertices(offset), strict=True):
        np.testing.assert_allclose(box_distance(lifted(ring, z)), d_b, atol=2e-6)


def test_edges_at_interpolated_heights_deviate_by_at_most_a_millimetre(offset, d_b):
    rng = np.random.default_rng(0)
    for z in rng.uniform(0.0, TOP + d_b - 1e-3, 200):
        (ring,) = offset.contours(z)
        between = (ring[1:] + ring[:-1]) / 2
        np.testing.assert_allclose(box_distance(lifted(between, z)), d_b, atol=1e-3)


def test_contours_are_closed_counter_clockwise_and_symmetric(offset):
    for ring in vertices(offset):
        np.testing.assert_array_equal(ring[0], ring[-1])
        x, y = ring[:-1].T
        xn, yn = ring[1:].T
        area = (x * yn - xn * y).sum() / 2
        assert area > 0
        np.testing.assert_allclose(ring, (ring * [1, -1])[::-1], atol=5e-6)


def test_contours_above_the_top_shrink_and_end_at_the_buffer_distance(offset, d_b):
    for h in np.linspace(0.0, 0.95 * d_b, 10):
        across = np.abs(offset.contours(TOP + h)[0][:, 1]).max()
        assert across == pytest.approx(0.345 + np.sqrt(d_b**2 - h**2), abs=1e-3)
    assert offset.contours(TOP + d_b + 1e-3) == []
    assert offset.contours(-1e-3) == []


def test_nearest_point_is_as_far_as_the_polygon_within_1_5_mm(offset, d_b):
    rng = np.random.default_rng(1)
    share = np.linspace(0, 1, 200)[:, None, None]
    for _ in range(100):
        p, z = rng.uniform(-1.2, 1.2, 2), rng.uniform(0, TOP + d_b - 2e-3)
        (ring,) = offset.contours(z)
        dense = (ring[:-1] + share * (ring[1:] - ring[:-1])).reshape(-1, 2)
        least = np.linalg.norm(dense - p, axis=1).min()
        xy, tangent = nearest(offset, p, z)
        # The foot is on a smooth curve, and the polygon consists of its chords.
        assert least - 1e-5 < np.linalg.norm(xy - p) < least + 1.5e-3
        assert (p - xy) @ tangent == pytest.approx(0.0, abs=1e-9)
        assert np.linalg.norm(tangent) == pytest.approx(1.0)
        assert np.cross([*xy, 0.0], [*tangent, 0.0])[2] > 0  # counter-clockwise


def test_nearest_point_agrees_with_a_search_over_all_edges(offset, d_b):
    rng = np.random.default_rng(3)
    for _ in range(60):
        p, z = rng.uniform(-1.2, 1.2, 2), float(rng.uniform(0, TOP + d_b - 2e-3))
        found, _ = nearest(offset, p, z)
        np.testing.assert_allclose(found, nearest_by_edges(offset, p, z), rtol=1e-9, atol=1e-11)


def nearest(offset: OffsetContours, p: np.ndarray, z: float) -> tuple[np.ndarray, np.ndarray]:
    """(2,) [m] the border point nearest to p (2,) [m] at height z, and (2,) its unit tangent."""
    foot = BorderSearch(offset).nearest(np.array([*p, z]))
    assert foot is not None
    assert foot.p[2] == z
    assert foot.t[2] == 0.0
    return foot.p[:2], foot.t[:2]


def nearest_by_edges(offset: OffsetContours, p: np.ndarray, z: float) -> np.ndarray:
    """`nearest` without the tangent, by bisection on each edge with its interpolated tangent."""
    heights, rings = offset.heights, vertices(offset)
    k = min(int(np.searchsorted(heights, z, "right")) - 1, len(heights) - 2)
    share = (z - heights[k]) / (heights[k + 1] - heights[k])
    corners = (1 - share) * rings[k] + share * rings[k + 1]
    tangents = (1 - share) * vertex_tangents(rings[k]) + share * vertex_tangents(rings[k + 1])
    feet = []
    for a, b, t_a, t_b in zip(corners[:-1], corners[1:], tangents, tangents[1:], strict=False):
        if (p - a) @ t_a >= 0.0 > (p - b) @ t_b:
            low, high = 0.0, 1.0
            for _ in range(60):
                s = (low + high) / 2
                ahead = (p - a - s * (b - a)) @ (t_a + s * (t_b - t_a)) >= 0.0
                low, high = (s, high) if ahead else (low, s)
            feet.append(a + low * (b - a))
    return min(feet, key=lambda foot: float(np.linalg.norm(p - foot)))


def vertex_tangents(ring: np.ndarray) -> np.ndarray:
    edges = np.diff(ring, axis=0)
    edges /= np.linalg.norm(edges, axis=1)[:, None]
    tangents = edges + np.roll(edges, 1, axis=0)
    tangents /= np.linalg.norm(tangents, axis=1)[:, None]
    return np.concatenate([tangents, tangents[:1]])


def test_tangent_beside_a_flat_side_is_parallel_to_the_side(offset, d_b):
    xy, tangent = nearest(offset, np.array([0.1, 1.0]), 0.2)
    np.testing.assert_allclose(xy, [0.1, 0.345 + d_b], atol=1e-5)
    np.testing.assert_allclose(tangent, [-1.0, 0.0], atol=1e-5)


def test_shape_inside_another_changes_nothing():
    whole, inner = Box(type="box", size_m=(0.9, 0.6, 0.4)), Box(type="box", size_m=(0.5, 0.4, 0.4))
    one = offset_contours(with_mobile_shapes((whole,)), 0.15)
    two = offset_contours(with_mobile_shapes((inner, whole)), 0.15)
    rows = slice(two.firsts[1])  # those of the larger shape
    np.testing.assert_array_equal(vertices(one), vertices(two)[rows])
    p = np.array([0.1, 0.35])
    for a, b in zip(nearest(one, p, 0.2), nearest(two, p, 0.2), strict=True):
        np.testing.assert_array_equal(a, b)


def test_the_distance_to_l_m_is_that_of_its_box():
    p = np.random.default_rng(2).uniform(-1, 1, (2000, 3))
    outside = box_distance(p) > 0
    measured = MobileBody(husky_panda()).distance(p)
    np.testing.assert_allclose(measured[outside], box_distance(p)[outside], atol=1e-12)
    assert (measured[~outside] <= 0).all()


def distance_and_normal(shapes: Shapes, p: np.ndarray) -> tuple[float, np.ndarray]:
    d, *n = shapes.distances_and_normals(p[None])[0]
    return d, np.array(n)


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("points", [4, 12, 200])
def test_distance_to_a_hull_agrees_with_the_library(seed: int, points: int):
    """Distance and normal at points outside and inside of a rotated hull."""
    rng = np.random.default_rng(seed)
    corners = rng.normal(size=(points, 3)) * [0.3, 0.2, 0.05]
    geometry, placement = convex_hull(corners), pin.exp6(rng.normal(size=6))
    part, library = Shapes.of(geometry, placement), Placed(geometry, placement)
    signs, middle = set(), corners.mean(axis=0)
    for at in middle + rng.uniform(0.0, 2.0, (300, 1)) * (rng.choice(corners, 300) - middle):
        p = placement.act(at)
        d, n = distance_and_normal(part, p)
        known, normal = library.distance(p)
        assert d == pytest.approx(known, abs=1e-6)
        if abs(d) > 1e-3:
            np.testing.assert_allclose(p - d * n, p - known * normal, atol=2e-3 if d > 0 else 1e-5)
        signs.add(d > 0.0)
    assert signs == {False, True}


def test_flat_hull_has_a_distance_also_at_its_surface():
    geometry = convex_hull(np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [0.5, 0.5, 0]]))
    part = Shapes.of(geometry, pin.SE3.Identity())
    d, n = distance_and_normal(part, np.array([0.5, 0.5, 5e-5]))
    assert d == pytest.approx(0.0, abs=1e-9)
    np.testing.assert_allclose(n, [0.0, 0.0, 1.0], atol=1e-9)
    assert distance_and_normal(part, np.array([2.0, 2, 0]))[0] == pytest.approx(2**0.5, abs=1e-6)


@pytest.mark.parametrize("size", [0.001, 0.3, 10.0])
def test_normal_on_the_surface_of_a_hull_is_that_of_the_face(size: float):
    """Rounding gives the triangles of a face slightly different planes."""
    rng = np.random.default_rng(0)
    turned = pin.exp3(rng.normal(size=3))
    corners = size * np.array([*np.ndindex(2, 2, 2)]) @ turned.T
    part = Shapes.of(convex_hull(corners), pin.SE3.Identity())
    for axis, side in np.ndindex(3, 2):
        at = rng.uniform(0.05, 0.95, (200, 3))
        at[:, axis] = side
        for p in size * at @ turned.T:
            d, n = distance_and_normal(part, p)
            assert d == pytest.approx(0.0, abs=1e-12)
            assert n @ turned[:, axis] == pytest.approx(2 * side - 1)


@pytest.mark.parametrize("seed", range(8))
def test_corners_that_differ_by_rounding_do_not_change_a_hull(seed: int):
    """Such corners form degenerate triangles, whose planes are arbitrary."""
    rng = np.random.default_rng(seed)
    corners = rng.uniform(-0.5, 0.5, (30, 3))
    several = np.concatenate([corners + rng.normal(size=corners.shape) * 1e-14 for _ in range(3)])
    p = rng.uniform(-0.7, 0.7, (500, 3))
    once, again = (
        Shapes.of(convex_hull(each), pin.SE3.Identity()).distances_and_normals(p)[:, 0]
        for each in (corners, several)
    )
    np.testing.assert_allclose(again, once, atol=1e-9)
