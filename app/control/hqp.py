"""A hierarchy of least-squares tasks under limits that hold at every level.

Level p minimises ‖w_p‖² with J_p q̈ + w_p = b_p, where the limits hold and the levels above keep
what they reached; the last level minimises a strictly convex objective. The dynamics and the slacks
are substituted, so that q̈ alone is the unknown, and each level moves only in the null space of
those above: its QP has no equality rows, and standing still is always a feasible answer to it.
Where no limit is active the level's optimum is known in closed form; else ProxQP finds it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import NamedTuple

import numpy as np
from proxsuite import proxqp

from app.control.least_squares import holds, lowest_level, next_level, optimum

Array = np.ndarray

_EPS_ABS = 1e-8  # accuracy of the QPs, in the units of acceleration and torque
_GOOD_ENOUGH = 1e-5  # violation of limits with which an answer is still taken, as the above

_ACTIVE = 1e-7  # multiplier from which on a bound is met
_NO_WORSE = 1e-6  # relative rise of the cost that a polished answer may have


class EqualityTask(NamedTuple):
    """J q̈ + w = b, to be met as closely as the levels above allow.

    Attributes:
        J: (k, n).
        b: (k,) desired acceleration less J̇ q̇.
    """

    J: Array
    b: Array


class Objective(NamedTuple):
    """min ½ q̈ᵀ H q̈ + cᵀ q̈, strictly convex.

    Attributes:
        H: (n, n) symmetric positive definite.
        c: (n,).
    """

    H: Array
    c: Array


class Limits(NamedTuple):
    """l ≤ C q̈ ≤ u.

    Attributes:
        C: (m, n).
        l: (m,) lower bounds.
        u: (m,) upper bounds.
    """

    C: Array
    l: Array
    u: Array


class Solution(NamedTuple):
    """Result of a hierarchy.

    Attributes:
        qdd: (n,) q̈*.
        slacks: w_p* of each equality level.
    """

    qdd: Array
    slacks: tuple[Array, ...]


class NoSolutionError(Exception):
    """A QP has no solution or its solver failed.

    Attributes:
        level: Index of the level whose QP failed.
        status: What the solver said.
    """

    def __init__(self, level: int, status: object) -> None:
        self.level, self.status = level, status
        super().__init__(f"QP of level {level}: {status}")


class HierarchicalQP:
    """Solves hierarchies of n unknowns, each QP warm-started from the last of its size.

    Attributes:
        given_up: QPs of lower levels without an answer so far; what the levels above reached stays.
    """

    def __init__(self, n: int) -> None:
        """Prepare for n unknowns."""
        self._n = n
        self.given_up = 0
        self._qps: dict[tuple[str, int, int, int], proxqp.dense.QP] = {}

    def solve(
        self,
        levels: Sequence[EqualityTask],
        objective: Objective,
        limits: Limits,
        *,
        slot: str = "",
    ) -> Solution:
        """The lexicographic optimum.

        Args:
            levels: Equality tasks, highest priority first.
            objective: What decides where they leave freedom.
            limits: Hold at every level.
            slot: Calls with the same slot share their warm starts.

        Raises:
            NoSolutionError: The limits contradict each other, or the solver failed.
        """
        H, c = objective
        J, b, ends = _stacked(levels, self._n)
        x = optimum(J, b, ends, H, c)
        if not _holds(limits, x):
            x = self._within_limits(levels, objective, limits, slot)
        if not np.isfinite(x).all():
            raise NoSolutionError(len(levels), "not a number")
        return Solution(x, tuple(b - J @ x for J, b in levels))

    def _within_limits(
        self, levels: Sequence[EqualityTask], objective: Objective, limits: Limits, slot: str
    ) -> Array:
        """The optimum level by level, (n,)."""
        x, Z = np.zeros(self._n), np.eye(self._n)
        for p, (J, b) in enumerate(levels):
            candidate, left, JZ, residual = next_level(J, b, x, Z)
            if not _holds(limits, candidate):
                H, c = JZ.T @ JZ, -(JZ.T @ residual)
                found = self._solve_qp(slot, p, H, c, x, Z, limits)
                candidate = x + Z @ found.polished(partial(_least_squares, JZ, residual))
            x, Z = candidate, left
        if not Z.shape[1]:
            return x
        candidate, H, c = lowest_level(*objective, x, Z)
        if _holds(limits, candidate):
            return candidate
        found = self._solve_qp(slot, len(levels), H, c, x, Z, limits)
        return x + Z @ found.polished(partial(_minimum, H, c))

    def _solve_qp(
        self, slot: str, level: int, H: Array, c: Array, x: Array, Z: Array, limits: Limits
    ) -> _Answer:
        """Min ½ yᵀ H y + cᵀ y where x + Z y keeps the limits."""
        C, reached = limits.C @ Z, limits.C @ x
        l, u = limits.l - reached, limits.u - reached
        if level > 0:  # the levels above kept the limits but for the solver's accuracy
            l, u = np.minimum(l, 0.0), np.maximum(u, 0.0)
        key = (slot, level, *C.shape)
        found = self._run(key, H, c, C, l, u)
        if found is None:  # once more, cold: a warm start can lead astray
            found = self._run(key, H, c, C, l, u)
        if found is not None:
            return _Answer(*found, H, c, Limits(C, l, u))
        if level > 0:  # what the levels above reached is kept
            self.given_up += 1
            return _Answer(np.zeros(Z.shape[1]), np.zeros(len(l)), H, c, Limits(C, l, u))
        raise NoSolutionError(level, "no accelerations keep all limits, or the solver failed")

    def _run(
        self, key: tuple[str, int, int, int], H: Array, c: Array, C: Array, l: Array, u: Array
    ) -> tuple[Array, Array] | None:
        """ProxQP's y and multipliers, from where it ended last time under this key, if any."""
        qp = self._qps.get(key)
        if qp is None:
            qp = self._qps[key] = _make_qp(len(c), len(l))
            qp.init(H, c, None, None, C, l, u)
        else:
            qp.update(H=H, g=c, C=C, l=l, u=u)
        qp.solve()
        if _is_answer(qp):
            return qp.results.x.copy(), qp.results.z.copy()
        del self._qps[key]  # a failed run is no start for the next one
        return None


class _Answer(NamedTuple):
    """ProxQP's answer to min ½ yᵀ H y + cᵀ y within limits, as near as it comes.

    Attributes:
        y: (f,).
        z: (m,) multipliers: below zero at a lower bound, above zero at an upper one.
        H: (f, f).
        c: (f,).
        limits: On y.
    """

    y: Array
    z: Array
    H: Array
    c: Array
    limits: Limits

    def polished(self, optimum_from: Callable[[Array, Array], Array]) -> Array:
        """The optimum itself, if the bounds with multipliers are those that it meets.

        ProxQP ends within its accuracy of the optimum, from another side after another start. With
        its active bounds taken as equalities the optimum is known in closed form.

        Args:
            optimum_from: The optimum without limits, from a point in a freedom given by its basis.
        """
        C, l, u = self.limits
        active = np.flatnonzero(np.abs(self.z) > _ACTIVE)
        bound = np.where(self.z < 0.0, l, u)[active]
        f = len(self.y)
        at, free, _, _ = next_level(C[active], bound, np.zeros(f), np.eye(f))
        y = optimum_from(at, free) if free.shape[1] else at
        if not holds(C, l, u, y, _EPS_ABS):
            return self.y
        worse = self._cost(y) - self._cost(self.y)
        return y if worse <= _NO_WORSE * (1.0 + abs(self._cost(self.y))) else self.y

    def _cost(self, y: Array) -> float:
        return float(0.5 * (y @ self.H @ y) + self.c @ y)


def _least_squares(J: Array, b: Array, x: Array, Z: Array) -> Array:
    return next_level(J, b, x, Z)[0]


def _minimum(H: Array, c: Array, x: Array, Z: Array) -> Array:
    return lowest_level(H, c, x, Z)[0]


def _stacked(levels: Sequence[EqualityTask], n: int) -> tuple[Array, Array, Array]:
    """Rows and right-hand sides of all levels, and the index after the last row of each."""
    if len(levels) == 1:
        J, b = levels[0]
        return J, b, np.array([len(b)])
    if not levels:
        return np.empty((0, n)), np.empty(0), np.empty(0, int)
    return (
        np.concatenate([J for J, _ in levels]),
        np.concatenate([b for _, b in levels]),
        np.cumsum([len(b) for _, b in levels]),
    )


def _holds(limits: Limits, x: Array) -> bool:
    return holds(*limits, x, _EPS_ABS)


def _is_answer(qp: proxqp.dense.QP) -> bool:
    info = qp.results.info
    ended = info.status in (proxqp.PROXQP_SOLVED, proxqp.PROXQP_MAX_ITER_REACHED)
    return ended and info.pri_res < _GOOD_ENOUGH and bool(np.isfinite(qp.results.x).all())


def _make_qp(n: int, m: int) -> proxqp.dense.QP:
    qp = proxqp.dense.QP(n, 0, m)
    settings = qp.settings
    settings.eps_abs = _EPS_ABS
    settings.eps_rel = 0.0
    # The default calls feasible problems infeasible; truly infeasible ones are then ended by the
    # number of iterations.
    settings.eps_primal_inf = 1e-12
    settings.max_iter = 100
    settings.initial_guess = proxqp.InitialGuess.WARM_START_WITH_PREVIOUS_RESULT
    return qp
