"""Algorithm 1: the border as a selection from P_i."""

from __future__ import annotations

import time

import numpy as np
import pytest

from app.border.dbb import Cloud, construct_dbb, make_cloud, quantise_distances, quantise_points


def ball_cloud(count: int, seed: int = 0) -> Cloud:
    """Points outside a ball of radius 0.3 m that stands for l_m."""
    rng = np.random.default_rng(seed)
    points = quantise_points(rng.uniform(-0.7, 0.7, (count, 3)))
    distances = np.linalg.norm(points * 1e-4, axis=1) - 0.3
    outside = distances > 0
    return make_cloud("lm-x", points[outside], quantise_distances(distances[outside]))


@pytest.mark.parametrize("d_b", [0.06, 0.1, 0.15, 0.2, 0.3])
@pytest.mark.parametrize("eps", [0.002, 0.01, 0.02])
def test_3_border_contains_exactly_the_points_within_eps_of_d_b(d_b, eps):
    cloud = ball_cloud(200_000)
    border = construct_dbb(cloud, d_b, eps)
    measured = np.linalg.norm(border.points, axis=1) - 0.3
    assert (np.abs(measured - d_b) <= eps).all()
    all_measured = np.linalg.norm(cloud.points_m, axis=1) - 0.3
    surely = np.abs(all_measured - d_b) <= eps - 2e-5  # two quantisation steps of the distances
    assert surely.sum() <= len(border) <= (np.abs(all_measured - d_b) <= eps).sum()
    assert len(border) > 0


def test_border_is_sorted_by_height_and_read_only():
    border = construct_dbb(ball_cloud(50_000), 0.15, 0.01)
    assert (np.diff(border.points[:, 2]) >= 0).all()
    np.testing.assert_array_equal(border.heights, border.points[:, 2])
    with pytest.raises(ValueError, match="read-only"):
        border.points[0, 0] = 1.0


@pytest.mark.parametrize("half", [0.001, 0.005, 0.05])
def test_same_height_returns_the_points_of_the_slice_without_a_copy(half):
    border = construct_dbb(ball_cloud(50_000), 0.15, 0.01)
    for z in np.linspace(-0.6, 0.6, 41):
        chosen = border.same_height(z, half)
        inside = (border.heights >= z - half) & (border.heights <= z + half)
        np.testing.assert_array_equal(chosen, border.points[inside])
        assert len(chosen) == 0 or np.shares_memory(chosen, border.points)


def test_cloud_without_points_gives_an_empty_border():
    border = construct_dbb(
        make_cloud("lm-x", np.empty((0, 3), np.int16), np.empty(0, np.uint16)), 0.15, 0.01
    )
    assert len(border) == 0
    assert border.same_height(0.2).shape == (0, 3)


def test_cloud_does_not_depend_on_the_order_of_its_points():
    cloud = ball_cloud(5_000)
    mixed = np.random.default_rng(1).permutation(len(cloud))
    again = make_cloud("lm-x", cloud.points[mixed], cloud.distances[mixed])
    np.testing.assert_array_equal(cloud.points, again.points)
    np.testing.assert_array_equal(cloud.distances, again.distances)


def test_quantisation_error_is_at_most_half_a_step():
    rng = np.random.default_rng(2)
    p, d = rng.uniform(-3, 3, (1000, 3)), rng.uniform(0, 0.6, 1000)
    assert np.abs(quantise_points(p) * 1e-4 - p).max() <= 0.5001e-4
    assert np.abs(quantise_distances(d) * 1e-5 - d).max() <= 0.5001e-5


def test_selection_from_a_million_points_takes_less_than_50_ms():
    cloud = ball_cloud(1_200_000)
    least = min(_timed(lambda: construct_dbb(cloud, 0.15, 0.01)) for _ in range(5))
    assert least < 0.05  # [s]


def _timed(work) -> float:
    """[s] processor time of this process, without other processes."""
    start = time.process_time()
    work()
    return time.process_time() - start
