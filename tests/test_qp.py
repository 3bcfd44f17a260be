"""Properties of the QP of a control step: its optimum, hard and soft limits, robustness."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import nnls

from app.border.cache import BorderData
from app.config import Config
from app.control.controller import Controller
from app.control.qp import changed_by_proxqp, solve_qp, solve_qp_step, solved_by_proxqp
from app.control.tasks import Reference
from app.robot.model import RobotModel
from tests.qps import NONE, Limits, NoSolutionError, Objective, solved
from tests.robots import random_measurement

Array = np.ndarray

N, M = 9, 12
SOFT = 1e-3


def random_objective(rng: np.random.Generator) -> Objective:
    A = rng.normal(size=(N, N))
    return Objective(A @ A.T + 0.1 * np.eye(N), rng.normal(size=N))


def random_limits(rng: np.random.Generator, width: float, hard: int) -> Limits:
    """Limits that are satisfied at a random q̈, which is far from the unconstrained optimum."""
    C, x = rng.normal(size=(M, N)), rng.normal(size=N)
    l, u = C @ x - width * rng.random(M), C @ x + width * rng.random(M)
    u[rng.random(M) < 0.3] = np.inf  # one-sided, like barriers
    return Limits(C, l, u, softness_of(hard))


def softness_of(hard: int, softness: float = SOFT, m: int = M) -> Array:
    """(m,) softness of `hard` hard rows, followed by soft rows."""
    return np.repeat([0.0, softness], [hard, m - hard])


def by_least_distance(objective: Objective, limits: Limits) -> Array:
    """The optimum by Lawson and Hanson's reduction to non-negative least squares.

    The shortest v with G v ≥ h is -r[:-1] / r[-1] with r = E w - f. Here E is Gᵀ above hᵀ,
    f = (0, …, 0, 1), and w ≥ 0 minimises ‖E w - f‖. Each soft limit adds a component of v, which
    relaxes it by ε √κ times its value; κ is the least C_i H⁻¹ C_iᵀ of all soft limits, and ε² is
    the row's softness.
    """
    (H, c), (C, l, u, softness) = objective, limits
    L, free = np.linalg.cholesky(H), -np.linalg.solve(H, c)
    own = np.einsum("ij,ji->i", C, np.linalg.solve(H, C.T))
    least = own[softness > 0.0].min(initial=np.inf)
    slack = np.diag(np.sqrt(softness) * np.sqrt(least))[:, softness > 0.0]
    A = np.hstack([np.linalg.solve(L, C.T).T, slack])
    G, h = np.vstack([A, -A]), np.concatenate([l - C @ free, C @ free - u])
    kept = np.isfinite(h)
    G, h = G[kept], h[kept] / np.abs(h[kept]).max()
    E = np.vstack([G.T, h])
    f = np.eye(len(E))[-1]
    r = E @ nnls(E, f)[0] - f
    v = -r[:-1] / r[-1] * np.abs(np.concatenate([l - C @ free, C @ free - u])[kept]).max()
    return free + np.linalg.solve(L.T, v[:N])


def misses(limits: Limits, qdd: Array) -> Array:
    """(m,) violation of each limit."""
    reached = limits.C @ qdd
    return np.maximum(np.maximum(limits.l - reached, reached - limits.u), 0.0)


@pytest.mark.parametrize("seed", range(20))
def test_optimum_within_all_limits_is_the_unconstrained_one(seed: int) -> None:
    rng = np.random.default_rng(seed)
    objective = random_objective(rng)
    wide = Limits(rng.normal(size=(M, N)), np.full(M, -1e6), np.full(M, 1e6), softness_of(3))
    expected = np.linalg.solve(objective.H, -objective.c)
    np.testing.assert_allclose(solved(objective, wide), expected, rtol=1e-9)


@pytest.mark.parametrize("hard", [0, 5])
@pytest.mark.parametrize("seed", range(30))
def test_another_solver_finds_the_same_optimum(seed: int, hard: int) -> None:
    rng = np.random.default_rng(seed)
    objective, limits = random_objective(rng), random_limits(rng, (0.1, 1.0, 3.0)[seed % 3], hard)
    expected = by_least_distance(objective, limits)
    qdd = solved(objective, limits)
    np.testing.assert_allclose(qdd, expected, atol=3e-6)
    far = misses(limits, np.linalg.solve(objective.H, -objective.c))
    assert far.max() > 0.1  # otherwise no limit would be active


@pytest.mark.parametrize("hard", [0, 5])
@pytest.mark.parametrize("seed", range(30))
def test_proxqp_finds_the_optimum_of_the_active_set_solver(seed: int, hard: int) -> None:
    rng = np.random.default_rng(seed)
    objective, limits = random_objective(rng), random_limits(rng, (0.1, 1.0, 3.0)[seed % 3], hard)
    problem = *objective, *limits
    expected, found = solve_qp(*problem, NONE)
    assert found
    some = expected[:2] + 0.01  # fixed, or to be changed
    for by_active_sets, by_proxqp, fixed in (
        (solve_qp, solved_by_proxqp, NONE),
        (solve_qp, solved_by_proxqp, some),
        (solve_qp_step, changed_by_proxqp, some),
    ):
        x, found = by_active_sets(*problem, fixed)
        assert found
        np.testing.assert_allclose(by_proxqp(*problem, fixed), x, atol=3e-6)
    for spoiled in (limits._replace(l=limits.l * np.nan), limits._replace(C=limits.C * np.inf)):
        assert np.isnan(solved_by_proxqp(*objective, *spoiled, NONE)).all()


class Turning:
    """A problem whose objective and rows change smoothly with s from 0 to 1."""

    def __init__(self, seed: int) -> None:
        rng = np.random.default_rng(seed)
        self.objective, self.limits = random_objective(rng), random_limits(rng, 0.5, 4)
        self.turn, self.push = 0.3 * rng.normal(size=(M, N)), 5.0 * rng.normal(size=N)

    def at(self, s: float) -> tuple[Objective, Limits]:
        (H, c), C = self.objective, self.limits.C
        moved = Objective(H, c + np.sin(6.0 * s) * self.push)
        return moved, self.limits._replace(C=C + s * self.turn)


def test_proxqp_returns_only_nan_without_a_solution() -> None:
    """A finite first entry would pass as a solution: the fixed entries are known before."""
    C, far = np.array([[0.0, 1.0, 0.0], [0.0, 1.0, 0.0]]), np.array([-np.inf, 1.0])
    limits = C, far, np.array([-1.0, np.inf]), np.zeros(2)
    x = solved_by_proxqp(np.eye(3), np.zeros(3), *limits, np.array([2.0]))
    assert np.isnan(x).all()


@pytest.mark.parametrize("seed", range(12))
def test_solution_does_not_depend_on_earlier_problems(seed: int) -> None:
    turning = Turning(seed)
    for s in np.linspace(0.0, 1.0, 201):
        problem = turning.at(s)
        found = solved(*problem)
        np.testing.assert_allclose(found, by_least_distance(*problem), atol=1e-5)


@pytest.mark.parametrize("seed", range(20))
def test_soft_limit_yields_by_its_share_of_the_demanded_violation(seed: int) -> None:
    rng = np.random.default_rng(seed)
    objective, C = random_objective(rng), rng.normal(size=(1, N))
    demanded = float(C[0] @ np.linalg.solve(objective.H, -objective.c))
    bound = demanded - rng.uniform(0.1, 5.0)
    for softness in (1e-3, 1e-2, 0.1):
        limits = Limits(C, np.array([-np.inf]), np.array([bound]), np.array([softness]))
        beyond = float(C[0] @ solved(objective, limits)) - bound
        share = softness / (1.0 + softness)
        assert beyond == pytest.approx(share * (demanded - bound), rel=1e-4)


def test_light_joint_is_not_accelerated_to_brake_a_heavy_one() -> None:
    """A shoulder cannot brake as its limit demands; the reaction of a wrist could help."""
    M = np.array([[2.0, 0.02], [0.02, 0.02]])
    C = np.vstack([M, np.eye(2)])
    l, u = np.array([-1.0, -5.0, -np.inf, -1.0]), np.array([1.0, 5.0, -10.0, 1.0])
    limits = Limits(C, l, u, np.repeat([0.0, 1e-6], 2))
    missed = misses(limits, solved(Objective(M, np.zeros(2)), limits))
    assert missed[2] > 9.0
    assert missed[3] < 0.02 * missed[2]


@pytest.mark.parametrize("seed", range(20))
def test_contradictory_soft_limits_do_not_violate_hard_ones(
    seed: int,
) -> None:
    rng = np.random.default_rng(seed)
    objective, limits = random_objective(rng), random_limits(rng, 1.0, 5)
    C, l, u, _ = limits
    apart = np.abs(rng.normal(size=3)) + 0.5
    C = np.vstack([C, C[:3], C[-3:]])  # against hard ones and against soft ones
    l = np.concatenate([l, np.where(np.isfinite(u[:3]), u[:3], l[:3]) + apart, l[-3:] - 50.0])
    u = np.concatenate([u, np.full(3, np.inf), l[-6:-3] - apart])
    limits = Limits(C, l, u, softness_of(5, m=len(C)))
    qdd = solved(objective, limits)
    missed = misses(limits, qdd)
    assert missed[:5].max() <= 1e-6
    assert missed[5:].max() > 0.1


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(4))
def test_solution_is_continuous_as_limits_become_active(seed: int) -> None:
    """Steps four times finer reduce the largest change to less than 30 %."""

    def largest_change(steps: int) -> tuple[float, int]:
        turning, found, met = Turning(seed), [], set()
        for s in np.linspace(0.0, 1.0, steps + 1):
            objective, limits = turning.at(s)
            found.append(solved(objective, limits))
            reached = limits.C @ found[-1]
            met.add(tuple((reached > limits.u - 1e-4) | (reached < limits.l + 1e-4)))
        return float(np.abs(np.diff(found, axis=0)).max()), len(met)

    coarse, _ = largest_change(800)
    fine, sets = largest_change(3200)
    assert sets > 3
    assert fine < 0.3 * coarse


def test_contradictory_hard_limits_raise_and_the_next_call_succeeds() -> None:
    C = np.vstack([np.eye(N)[0], np.eye(N)[0]])
    both = Limits(C, np.array([1.0, -2.0]), np.array([2.0, -1.0]), np.zeros(2))
    objective = Objective(np.eye(N), np.zeros(N))
    with pytest.raises(NoSolutionError):
        solved(objective, both)
    one = Limits(C, np.array([1.0, -2.0]), np.array([2.0, 3.0]), np.zeros(2))
    assert solved(objective, one)[0] == pytest.approx(1.0, abs=1e-6)


@pytest.mark.parametrize(
    ("where", "value"), [(w, v) for w in ("H", "c", "C") for v in (np.nan, -np.inf)]
)
def test_data_that_are_not_finite_raise_and_the_next_call_succeeds(
    where: str, value: float
) -> None:
    rng = np.random.default_rng(0)
    objective, limits = random_objective(rng), random_limits(rng, 1.0, 4)
    good = solved(objective, limits)
    H, c, C = objective.H.copy(), objective.c.copy(), limits.C.copy()
    {"H": H, "c": c, "C": C}[where].flat[0] = value
    with pytest.raises(NoSolutionError):
        solved(Objective(H, c), limits._replace(C=C))
    np.testing.assert_allclose(solved(objective, limits), good, atol=1e-5)


@pytest.mark.slow
def test_qp_is_solved_within_the_torque_limits_in_random_states(
    robot: RobotModel, border_data: BorderData
) -> None:
    """1,200 random states, many in contact, fast or at limits, with two limits of torque rate."""
    rng, room = np.random.default_rng(1), 1e-9  # [N m]
    counts = {"limited": 0, "near": 0}
    controllers = [
        Controller(robot, border_data, Config().replace("limit.torque_rate", rate), name=name)
        for rate in (1000.0, 1e6)
        for name in ("dbb", "barrier")
    ]
    for i in range(1200):
        controller, m = controllers[i % 4], random_measurement(rng)
        m = m._replace(qd_m=rng.uniform(-1, 1) * rng.uniform(-1, 1, robot.n_m) * robot.qd_max)
        reference = None
        if i % 8 > 3:
            controller.state.update(m)
            at = controller.state.T_world_ee.copy()
            at.translation += 0.2 * rng.normal(size=3)
            velocity = np.clip(rng.normal(size=6), -3.0, 3.0)  # below the bound of a reference
            reference = Reference(at, velocity, rng.normal(size=6))
        output = controller.step(m, reference, base_acceleration=rng.uniform(-1, 1, 2))
        output.contradiction[...] = 0.0  # random states jump in each step
        assert output.solved
        limits = Limits.of(output)
        missed = misses(limits, output.qdd)
        assert missed[limits.softness == 0.0].max() <= room
        u_a = output.M[2:] @ output.qdd + output.h[2:]
        np.testing.assert_allclose(output.u_cmd, u_a, atol=room)  # nothing is clipped afterwards
        counts["limited"] += missed.max() > 1e-6
        counts["near"] += output.beta_m > 0.0
    assert [(c.last.failures, c.last.given_up) for c in controllers] == [(0, 0)] * 4
    assert min(counts.values()) > 150, counts
