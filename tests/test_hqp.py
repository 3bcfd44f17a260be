"""Laws of the hierarchical QP."""

import numpy as np
import pytest
from app.control.hqp import (
    EqualityTask,
    HierarchicalQP,
    Limits,
    NoSolutionError,
    Objective,
)

N, M = 9, 6
WIDE = Limits(np.eye(N)[:M], np.full(M, -1e6), np.full(M, 1e6))


def random_task(rng: np.random.Generator, k: int) -> EqualityTask:
    return EqualityTask(rng.normal(size=(k, N)), rng.normal(size=k))


def random_objective(rng: np.random.Generator) -> Objective:
    A = rng.normal(size=(N, N))
    return Objective(A @ A.T + np.eye(N), rng.normal(size=N))


@pytest.mark.parametrize("seed", range(20))
def test_without_active_limits_the_solution_satisfies_the_kkt_conditions(seed: int) -> None:
    rng = np.random.default_rng(seed)
    task, objective = random_task(rng, 4), random_objective(rng)
    qdd = HierarchicalQP(N).solve([task], objective, WIDE).qdd
    kkt = np.block([[objective.H, task.J.T], [task.J, np.zeros((4, 4))]])
    expected = np.linalg.solve(kkt, np.concatenate([-objective.c, task.b]))[:N]
    np.testing.assert_allclose(qdd, expected, atol=1e-7)


@pytest.mark.parametrize("seed", range(20))
def test_a_lower_level_never_costs_a_higher_one(seed: int) -> None:
    rng = np.random.default_rng(seed)
    first, second = random_task(rng, 6), random_task(rng, 6)
    tight = Limits(np.eye(N)[:M], np.full(M, -0.2), np.full(M, 0.2))
    alone = HierarchicalQP(N).solve([first], random_objective(rng), tight)
    both = HierarchicalQP(N).solve([first, second], random_objective(rng), tight)
    assert np.linalg.norm(both.slacks[0]) <= np.linalg.norm(alone.slacks[0]) + 1e-6


@pytest.mark.parametrize("seed", range(20))
def test_limits_hold_at_every_level(seed: int) -> None:
    rng = np.random.default_rng(seed)
    limits = Limits(rng.normal(size=(M, N)), np.full(M, -0.3), np.full(M, 0.3))
    levels = [random_task(rng, 3), random_task(rng, 6)]
    qdd = HierarchicalQP(N).solve(levels, random_objective(rng), limits).qdd
    reached = limits.C @ qdd
    assert (reached >= limits.l - 1e-6).all()
    assert (reached <= limits.u + 1e-6).all()


@pytest.mark.parametrize("seed", range(30))
def test_levels_at_once_are_the_levels_one_by_one(seed: int) -> None:
    """Also with limits so tight that a solver has to find some of the levels."""
    rng = np.random.default_rng(seed)
    solver, width = HierarchicalQP(N), (1e6, 3.0, 0.3)[seed % 3]
    for _ in range(10):
        limits = Limits(rng.normal(size=(M, N)), np.full(M, -width), np.full(M, width))
        levels, objective = [random_task(rng, 2), random_task(rng, 5)], random_objective(rng)
        qdd = solver.solve(levels, objective, limits).qdd
        expected = HierarchicalQP(N)._within_limits(levels, objective, limits, "")
        np.testing.assert_allclose(
            qdd, expected, rtol=1e-9, atol=1e-9 if width > 1e3 else 5e-4
        )  # ProxQP from another start


def test_a_task_that_limits_forbid_is_met_as_closely_as_they_allow() -> None:
    task = EqualityTask(np.eye(N)[:1], np.array([5.0]))
    limits = Limits(np.eye(N)[:M], np.full(M, -1.0), np.full(M, 1.0))
    solution = HierarchicalQP(N).solve([task], Objective(np.eye(N), np.zeros(N)), limits)
    assert solution.qdd[0] == pytest.approx(1.0, abs=1e-7)
    assert solution.slacks[0][0] == pytest.approx(4.0, abs=1e-7)


def test_dependent_rows_are_no_obstacle() -> None:
    J = np.vstack([np.eye(N)[0], np.eye(N)[0], 2 * np.eye(N)[0]])
    levels = [EqualityTask(J, np.array([1.0, 1.0, 2.0])), EqualityTask(J[:1], np.array([3.0]))]
    solution = HierarchicalQP(N).solve(levels, Objective(np.eye(N), np.zeros(N)), WIDE)
    assert solution.qdd[0] == pytest.approx(1.0, abs=1e-6)


def test_contradicting_limits_are_an_error_that_names_the_level() -> None:
    C = np.vstack([np.eye(N)[0], np.eye(N)[0], *np.eye(N)[1:5]])
    limits = Limits(C, np.array([1.0, -2.0, *[-1.0] * 4]), np.array([2.0, -1.0, *[1.0] * 4]))
    solver = HierarchicalQP(N)
    with pytest.raises(NoSolutionError, match="level 0"):
        solver.solve([], Objective(np.eye(N), np.zeros(N)), limits)
    assert solver.solve([], Objective(np.eye(N), np.ones(N)), WIDE).qdd[0] == pytest.approx(-1.0)


def test_feasible_second_levels_are_never_called_infeasible() -> None:
    """The solver's default tolerance of infeasibility refused one in six of these."""
    rng = np.random.default_rng(0)
    solver = HierarchicalQP(N)
    for _ in range(500):
        first, second = random_task(rng, 2), random_task(rng, 6)
        limits = Limits(rng.normal(size=(M, N)), np.full(M, -1.0), np.full(M, 1.0))
        solver.solve([first, second], random_objective(rng), limits)
