"""Laws of the continuous task transition (29)."""

import gc

import numpy as np
import pytest
from app.control.hqp import EqualityTask, HierarchicalQP, Limits, Objective

from app.avoidance.task import TaskRows, generate_avoidance_task
from app.control.transition import TaskTransition

N, M = 9, 4
WIDE = Limits(np.eye(N)[:M], np.full(M, -1e6), np.full(M, 1e6))


class Problem:
    """A random stack and random avoidance rows: two of the base, then one by one."""

    def __init__(self, seed: int, singles: int = 3, limits: Limits = WIDE) -> None:
        rng = np.random.default_rng(seed)
        A = rng.normal(size=(N, N))
        self.levels = [EqualityTask(rng.normal(size=(3, N)), rng.normal(size=3))]
        self.objective = Objective(A @ A.T + np.eye(N), rng.normal(size=N))
        self.groups = [
            (rng.normal(size=(k, N)), rng.normal(size=k), rng.normal(size=k))
            for k in (2, *[1] * singles)
        ]
        self.limits = limits
        self.transition = TaskTransition(HierarchicalQP(N))

    def rows(self, betas: list[float]) -> list[TaskRows]:
        return [
            TaskRows(J, Jdqd, xdd, beta)
            for (J, Jdqd, xdd), beta in zip(self.groups, betas, strict=True)
        ]

    def solve(self, betas: list[float]) -> np.ndarray:
        rows = self.rows(betas)
        return self.transition.solve(rows, self.levels, self.objective, self.limits).qdd

    def without_rows(self) -> np.ndarray:
        return self.transition.solve([], self.levels, self.objective, self.limits).qdd


@pytest.mark.parametrize("seed", range(10))
def test_at_B_zero_the_solution_is_that_of_26(seed: int) -> None:
    problem = Problem(seed)
    np.testing.assert_allclose(problem.solve([0.0] * 4), problem.without_rows(), atol=1e-7)


@pytest.mark.parametrize("seed", range(10))
def test_at_B_identity_the_avoidance_task_is_met_strictly(seed: int) -> None:
    problem = Problem(seed)
    b, J, B = generate_avoidance_task(problem.rows([1.0] * 4))
    np.testing.assert_array_equal(B, np.ones(5))
    np.testing.assert_allclose(J @ problem.solve([1.0] * 4), b, atol=1e-6)


@pytest.mark.parametrize("seed", range(10))
def test_each_row_is_blended_with_the_solution_without_it(seed: int) -> None:
    """(29) row by row, with the right-hand side computed outside the code under test."""
    problem, betas = Problem(seed), [0.4, 0.7, 0.0, 1.0]
    qdd = problem.solve(betas)
    for i, (J, Jdqd, xdd) in enumerate(problem.groups):
        others = [0.0 if j == i else beta for j, beta in enumerate(betas)]
        expected = betas[i] * (xdd - Jdqd) + (1 - betas[i]) * (J @ problem.solve(others))
        np.testing.assert_allclose(J @ qdd, expected, atol=1e-6)


@pytest.mark.parametrize("seed", range(10))
def test_rows_enter_and_leave_one_after_the_other_without_a_jump(seed: int) -> None:
    problem = Problem(seed)
    for betas, i in (
        ([0.5, 0.0, 0.0, 0.0], 1),
        ([0.5, 0.3, 0.0, 0.0], 2),
        ([0.0, 0.3, 0.6, 1.0], 0),
    ):
        entering = [1e-7 if j == i else beta for j, beta in enumerate(betas)]
        jump = problem.solve(entering) - problem.solve(betas)
        assert np.abs(jump).max() < 1e-4


@pytest.mark.parametrize("seed", range(5))
def test_between_zero_and_one_the_solution_changes_in_proportion_to_the_change_of_beta(
    seed: int,
) -> None:
    problem = Problem(seed)
    path = [[s, s**2, 1 - s, 0.5] for s in np.linspace(0, 1, 101)]
    coarse = [problem.solve(b) for b in path[::2]]
    fine = [problem.solve(b) for b in path]
    largest_coarse = np.abs(np.diff(coarse, axis=0)).max()
    largest_fine = np.abs(np.diff(fine, axis=0)).max()
    assert largest_fine < 0.6 * largest_coarse


@pytest.mark.parametrize("seed", range(10))
def test_blending_all_rows_with_the_solution_of_26_would_jump(seed: int) -> None:
    """Why the rows are treated one by one: the paper's reference is continuous only at B = 0."""
    problem = Problem(seed)
    without = problem.without_rows()

    def printed(betas: list[float]) -> np.ndarray:
        rows = [r for r in problem.rows(betas) if r.beta > 0]
        b, J, B = generate_avoidance_task(rows)
        target = B * b + (1 - B) * (J @ without)
        solver = HierarchicalQP(N)
        return solver.solve([EqualityTask(J, target), *problem.levels], problem.objective, WIDE).qdd

    jump = printed([0.5, 1e-9, 0.0, 0.0]) - printed([0.5, 0.0, 0.0, 0.0])
    assert np.abs(jump).max() > 1e-3


@pytest.mark.parametrize("seed", range(10))
def test_limits_hold_whatever_the_rows_ask(seed: int) -> None:
    limits = Limits(np.eye(N)[:M], np.full(M, -0.1), np.full(M, 0.1))
    problem = Problem(seed, limits=limits)
    qdd = problem.solve([0.5, 1.0, 0.2, 1.0])
    assert np.abs(qdd[:M]).max() <= 0.1 + 1e-6


def test_B_repeats_beta_m_for_the_two_rows_of_the_base() -> None:
    """The diagonal of (27): β_m, β_m, β_r,1, …, β_r,k."""
    b, J, B = generate_avoidance_task(Problem(0).rows([0.3, 0.1, 0.9, 0.0]))
    np.testing.assert_array_equal(B, [0.3, 0.3, 0.1, 0.9, 0.0])
    assert J.shape == (5, N)
    assert b.shape == (5,)


def test_nothing_is_left_to_the_garbage_collector() -> None:
    """At 1 kHz what only the collector frees becomes pauses of many milliseconds."""
    problem = Problem(0)
    problem.solve([0.4, 0.7, 0.3, 1.0])
    gc.collect()
    gc.disable()
    try:
        problem.solve([0.4, 0.7, 0.3, 1.0])
        assert gc.collect() == 0
    finally:
        gc.enable()
