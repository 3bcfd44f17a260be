"""The kernels of least squares in levels agree with numpy's decompositions."""

from __future__ import annotations

import numpy as np
import pytest
from app.control.least_squares import holds, lowest_level, next_level, optimum

SHAPES = [(2, 9, 2), (6, 9, 6), (6, 9, 4), (9, 4, 4), (9, 4, 2), (3, 9, 0), (8, 9, 5), (1, 1, 1)]


def of_rank(k: int, m: int, rank: int, rng: np.random.Generator) -> np.ndarray:
    return rng.normal(size=(k, rank)) @ rng.normal(size=(rank, m))


@pytest.mark.parametrize(("k", "m", "rank"), SHAPES)
@pytest.mark.parametrize("seed", range(5))
def test_a_level_is_the_least_squares_solution_of_least_norm(k, m, rank, seed) -> None:
    rng = np.random.default_rng(seed)
    J, b = of_rank(k, m, rank, rng), rng.normal(size=k)
    x, Z, JZ, residual = next_level(J, b, np.zeros(m), np.eye(m))
    expected = np.linalg.pinv(J, rcond=1e-10) @ b
    np.testing.assert_allclose(x, expected, atol=1e-9 * max(1.0, float(np.abs(expected).max())))
    assert Z.shape == (m, m - rank)
    np.testing.assert_allclose(Z.T @ Z, np.eye(m - rank), atol=1e-12)
    np.testing.assert_allclose(J @ Z, 0.0, atol=1e-10)
    np.testing.assert_allclose(JZ, J)
    np.testing.assert_allclose(residual, b)


@pytest.mark.parametrize("seed", range(20))
def test_a_lower_level_does_not_disturb_the_one_above(seed: int) -> None:
    rng = np.random.default_rng(seed)
    n, above = 9, of_rank(3, 9, 3, rng)
    below = of_rank(6, n, int(rng.integers(1, 7)), rng)
    below[0] = above[0]  # in conflict with the level above
    b_above, b_below = rng.normal(size=3), rng.normal(size=6)
    H = np.diag(rng.uniform(0.1, 300.0, n))
    c = rng.normal(size=n)
    x = optimum(
        np.vstack([above, below]), np.concatenate([b_above, b_below]), np.array([3, 9]), H, c
    )
    np.testing.assert_allclose(above @ x, b_above, atol=1e-9)
    N = np.linalg.svd(above)[2][3:].T
    start = np.linalg.pinv(above) @ b_above
    best = np.linalg.lstsq(below @ N, b_below - below @ start, rcond=1e-10)[0]
    reached = below @ (start + N @ best)
    np.testing.assert_allclose(below @ x, reached, atol=1e-8)
    free = N @ np.linalg.svd(below @ N)[2][np.linalg.matrix_rank(below @ N, tol=1e-9) :].T
    np.testing.assert_allclose(free.T @ (H @ x + c), 0.0, atol=1e-6)


@pytest.mark.parametrize("freedom", range(1, 10))
def test_the_lowest_level_is_where_the_gradient_vanishes_in_its_freedom(freedom: int) -> None:
    rng = np.random.default_rng(freedom)
    A = rng.normal(size=(9, 9))
    H, c, x = A @ A.T + np.eye(9), rng.normal(size=9), rng.normal(size=9)
    Z = np.linalg.qr(rng.normal(size=(9, freedom)))[0]
    y, Hz, cz = lowest_level(H, c, x, Z)
    np.testing.assert_allclose(Z.T @ (H @ y + c), 0.0, atol=1e-9)
    np.testing.assert_allclose(y - x, Z @ (Z.T @ (y - x)), atol=1e-12)
    np.testing.assert_allclose(Hz, Z.T @ H @ Z, atol=1e-12)
    np.testing.assert_allclose(cz, Z.T @ (H @ x + c), atol=1e-12)


def test_what_is_not_positive_definite_gives_no_number() -> None:
    x, _, _ = lowest_level(-np.eye(2), np.ones(2), np.zeros(2), np.eye(2))
    assert np.isnan(x).any()


@pytest.mark.parametrize(
    ("x", "expected"), [(1.0, True), (1.0 + 1e-9, True), (1.1, False), (np.nan, False)]
)
def test_limits_hold_within_a_tolerance_and_never_for_what_is_no_number(x, expected) -> None:
    C, l, u = np.eye(1), np.array([-1.0]), np.array([1.0])
    assert holds(C, l, u, np.array([x]), 1e-8) is expected
