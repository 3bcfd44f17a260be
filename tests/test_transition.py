"""Properties of the continuous task transition (29)."""

from __future__ import annotations

import gc
from time import perf_counter

import numpy as np
import pytest

from app.control.tasks import activation, generate_avoidance_task
from tests.qps import Objective, Rows, inserted, least

Array = np.ndarray

N = 9
SOFT = 1e-3


class Problem:
    """Random tasks and random avoidance rows: two of the base, then `singles` others."""

    def __init__(self, seed: int, singles: int = 3) -> None:
        rng = np.random.default_rng(seed)
        A = rng.normal(size=(N, N))
        self.objective = Objective(A @ A.T + np.eye(N), rng.normal(size=N))
        self.J_m, self.xdd_m = rng.normal(size=(2, N)), rng.normal(size=2)
        self.J_r, self.b_r = rng.normal(size=(singles, N)), rng.normal(size=singles)

    def rows(self, betas: list[float]) -> Rows:
        """T_sca for β_m and the β of each single row."""
        k, (beta_m, *beta_r) = 2 + len(self.b_r), betas
        rows, links = Rows(np.empty((k, N)), *np.empty((2, k))), np.array(beta_r)
        generate_avoidance_task(self.J_m, self.xdd_m, beta_m, self.J_r, self.b_r, links, *rows)
        return rows

    def solve(self, betas: list[float], softness: float = SOFT) -> Array:
        return least(inserted(self.objective, self.rows(betas), softness))

    def printed(self, betas: list[float]) -> Array:
        """The blend of (29) as printed: all active rows with one solution without them."""
        return printed_blend(self.objective, self.rows(betas))


def strictly(objective: Objective, J: Array, b: Array) -> Array:
    """The minimum with J q̈ = b, by the KKT conditions."""
    n, k = len(objective.c), len(b)
    kkt = np.block([[objective.H, J.T], [J, np.zeros((k, k))]])
    return np.linalg.lstsq(kkt, np.concatenate([-objective.c, b]), rcond=None)[0][:n]


def printed_blend(objective: Objective, rows: Rows) -> Array:
    J, b, B = rows.of(rows.beta > 0.0)
    without = least(objective)
    if not len(b):
        return without
    return strictly(objective, J, B * b + (1 - B) * (J @ without))


@pytest.mark.parametrize("seed", range(10))
def test_rows_at_beta_zero_have_no_effect(seed: int) -> None:
    problem = Problem(seed)
    np.testing.assert_array_equal(problem.solve([0.0] * 4), least(problem.objective))
    betas = [0.3, 0.8, 0.0, 1.0]
    rows = problem.rows(betas)
    alone = least(inserted(problem.objective, rows.of(rows.beta > 0.0), SOFT))
    np.testing.assert_array_equal(problem.solve(betas), alone)


@pytest.mark.parametrize("beta", [0.0, 0.01, 0.3, 0.9, 1.0])
@pytest.mark.parametrize("seed", range(10))
def test_a_row_alone_is_the_blend_of_29(seed: int, beta: float) -> None:
    """J q̈ = β b + (1 - β) J q̈_2* up to the softness, with the remaining freedom optimal."""
    problem = Problem(seed, singles=1)
    J, wanted, without = problem.J_r, problem.b_r, least(problem.objective)
    target = beta * wanted + (1 - beta) * (J @ without)
    qdd = problem.solve([0.0, beta])
    demand = float(np.abs(wanted - J @ without)[0])
    assert abs(float((J @ qdd - target)[0])) <= SOFT * demand
    np.testing.assert_allclose(qdd, strictly(problem.objective, J, J @ qdd), atol=1e-9)
    exact = problem.solve([0.0, beta], softness=1e-9)
    np.testing.assert_allclose(exact, strictly(problem.objective, J, target), atol=1e-6)


@pytest.mark.parametrize("seed", range(10))
def test_at_B_identity_the_avoidance_task_is_met_up_to_the_softness(seed: int) -> None:
    problem = Problem(seed)
    J, b, B = problem.rows([1.0] * 4)
    np.testing.assert_array_equal(B, np.ones(5))
    missing = [np.abs(J @ problem.solve([1.0] * 4, s) - b).max() for s in (1e-2, 1e-4, 1e-6)]
    assert missing[0] > 20 * missing[1] > 400 * missing[2]
    assert missing[2] < 1e-4
    np.testing.assert_allclose(
        problem.solve([1.0] * 4, 1e-9), strictly(problem.objective, J, b), atol=1e-5
    )


@pytest.mark.parametrize("seed", range(10))
def test_a_fully_active_row_holds_for_any_other_activations(seed: int) -> None:
    problem = Problem(seed)
    for others in (0.0, 0.2, 0.9):
        qdd = problem.solve([others, 1.0, others, others], 1e-7)
        np.testing.assert_allclose(problem.J_r[0] @ qdd, problem.b_r[0], atol=1e-4)


@pytest.mark.parametrize("seed", range(10))
def test_the_order_of_the_rows_does_not_matter(seed: int) -> None:
    problem = Problem(seed)
    rows = problem.rows([0.4, 0.7, 0.2, 1.0])
    expected = least(inserted(problem.objective, rows, SOFT))
    for order in ([4, 3, 2, 1, 0], [2, 4, 0, 3, 1]):
        found = least(inserted(problem.objective, rows.of(order), SOFT))
        np.testing.assert_allclose(found, expected, atol=1e-9)


def largest_step(solve, path: Array) -> float:
    return float(np.abs(np.diff([solve(list(betas)) for betas in path], axis=0)).max())


def random_path(seed: int, steps: int) -> Array:
    """(steps + 1, 4) smooth β of several rows that enter and leave one after the other."""
    rng = np.random.default_rng(seed)
    s = np.linspace(0.0, 1.0, steps + 1)[:, None]
    waves = np.sin(2 * np.pi * (rng.uniform(0.5, 2.0, 4) * s + rng.random(4)))
    beta = np.clip(0.5 + 0.8 * waves, 0.0, 1.0)
    assert steps < 1000 or ((beta == 0.0).any(axis=0) & (beta > 0.0).any(axis=0)).any()
    return beta**2 * (3.0 - 2.0 * beta)


@pytest.mark.parametrize("seed", range(2))
def test_smooth_activations_cause_jumps_only_in_the_printed_blend(seed: int) -> None:
    """Ten times smaller steps change a continuous result by about a tenth; a jump remains."""
    problem = Problem(seed)
    coarse, fine = (largest_step(problem.solve, random_path(seed, n)) for n in (1000, 10_000))
    assert fine < 0.2 * coarse
    coarse, fine = (largest_step(problem.printed, random_path(seed, n)) for n in (1000, 10_000))
    assert fine > 0.5 * coarse


@pytest.mark.parametrize("seed", range(10))
def test_twice_the_rows_cost_less_than_four_times_the_time(seed: int) -> None:
    """An algorithm over combinations of 60 rows would not finish."""
    rng = np.random.default_rng(seed)
    objective = Problem(seed).objective
    rows = Rows(rng.normal(size=(60, N)), np.ones(60), np.full(60, 0.5))

    def seconds(count: int) -> float:
        times, some = [], rows.of(np.arange(count))
        for _ in range(15):
            begin = perf_counter()
            inserted(objective, some, SOFT)
            times.append(perf_counter() - begin)
        return min(times)

    seconds(60)
    assert seconds(60) < 4.0 * seconds(30)


def run_into_walls(blend, seed: int, k_v: float) -> tuple[float, float]:
    """Squared speed [m²/s²] of a point mass before and after it meets two walls at an angle.

    Their rows enter and leave one after the other. With orthogonal normals every blend would be
    the same.
    """
    rng = np.random.default_rng(seed)
    angle = rng.uniform(0.15, 0.35) * np.pi
    normals = np.array([[1.0, 0.0], [np.cos(angle), np.sin(angle)]])
    free, dt = Objective(np.eye(2), np.zeros(2)), 1e-4
    p = np.linalg.solve(normals, [0.155, rng.uniform(0.16, 0.20)])
    v = -rng.uniform(0.3, 1.0) * np.linalg.solve(normals, [1.0, rng.uniform(0.6, 1.4)])
    before = float(v @ v)
    for _ in range(40_000):
        d = normals @ p
        beta = np.array([activation(x, 0.15, 0.05) for x in d.tolist()])
        rows = Rows(normals, 60.0 - k_v * (normals @ v), beta)
        v = v + dt * blend(free, rows)
        p = p + dt * v
        if (d > 0.151).all() and (normals @ v > 0.0).all():
            break
    assert (d > 0.15).all()
    return before, float(v @ v)


def soft_blend(objective: Objective, rows: Rows) -> Array:
    return least(inserted(objective, rows, SOFT))


@pytest.mark.slow
def test_meeting_two_buffers_adds_no_energy() -> None:
    """Without damping the energy is preserved, and with damping it does not rise.

    The printed blend violates this.
    """
    ours = [run_into_walls(soft_blend, seed, 0.0) for seed in range(4)]
    printed = [run_into_walls(printed_blend, seed, 0.0) for seed in range(4)]
    changes = [max(abs(after / before - 1.0) for before, after in each) for each in (ours, printed)]
    assert changes[0] < 0.01 < 0.05 < changes[1]
    for seed in range(4):
        before, after = run_into_walls(soft_blend, seed, 30.0)
        assert after <= before


def test_B_repeats_beta_m_for_the_two_rows_of_the_base() -> None:
    """The diagonal of (27): β_m, β_m, β_r,1, …, β_r,k."""
    J, b, B = Problem(0).rows([0.3, 0.1, 0.9, 0.0])
    np.testing.assert_array_equal(B, [0.3, 0.3, 0.1, 0.9, 0.0])
    assert J.shape == (5, N)
    assert b.shape == (5,)


def test_a_solution_creates_no_reference_cycles() -> None:
    """At 1 kHz, the collection of reference cycles causes pauses of many milliseconds."""
    problem = Problem(0)
    problem.solve([0.4, 0.7, 0.3, 1.0])
    gc.collect()
    gc.disable()
    try:
        problem.solve([0.4, 0.7, 0.3, 1.0])
        assert gc.collect() == 0
    finally:
        gc.enable()
