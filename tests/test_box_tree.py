"""The tree of boxes finds what a search of every point finds."""

from __future__ import annotations

import numpy as np
import pytest

from app.border.box_tree import BoxTree

HALF = 0.005


def searched_one_by_one(points: np.ndarray, p: np.ndarray) -> float | None:
    """[m] how far in plan the nearest point of p's height is."""
    level = points[np.abs(points[:, 2] - p[2]) <= HALF]
    return float(np.hypot(*(level[:, :2] - p[:2]).T).min()) if len(level) else None


def clouds() -> dict[str, np.ndarray]:
    rng = np.random.default_rng(0)
    ring = rng.uniform(0, 2 * np.pi, 3000)
    return {
        "shell": np.column_stack([np.cos(ring), np.sin(ring), rng.uniform(0, 0.3, 3000)]),
        "ball": rng.normal(size=(2000, 3)) * 0.1,
        "line": np.column_stack([np.linspace(0, 1, 500), np.zeros(500), np.zeros(500)]),
        "one": np.zeros((1, 3)),
        "copies": np.repeat(rng.uniform(0, 0.02, (3, 3)), 200, axis=0),
        "few": rng.uniform(0, 0.01, (49, 3)),
    }


@pytest.mark.parametrize("name", list(clouds()))
def test_it_finds_the_nearest_in_plan_among_those_of_the_height(name: str) -> None:
    points = clouds()[name]
    tree = BoxTree(points)
    rng = np.random.default_rng(1)
    missed = 0
    for p in rng.uniform(-0.3, 0.5, (400, 3)) * [3, 3, 1]:
        found, least = tree.nearest(p, HALF), searched_one_by_one(points, p)
        assert (found is None) == (least is None)
        missed += found is None
        if found is not None:
            assert np.hypot(found[0] - p[0], found[1] - p[1]) == pytest.approx(least, abs=1e-12)
    assert missed < 400 or name in ("one", "few", "line", "copies")


def test_it_takes_read_only_points_and_keeps_them_in_their_order() -> None:
    points = clouds()["ball"]
    points.setflags(write=False)
    before = points.copy()
    BoxTree(points)
    np.testing.assert_array_equal(points, before)


def test_without_points_nothing_is_near() -> None:
    assert BoxTree(np.empty((0, 3))).nearest(np.zeros(3), HALF) is None
