"""A hierarchy of least-squares tasks under limits that hold at every level.

Level p minimises ‖w_p‖² with J_p q̈ + w_p = b_p, where the limits hold and the levels above keep
what they reached; the last level minimises a strictly convex objective. The dynamics and the slacks
are substituted, so that q̈ alone is the unknown, and each level moves only in the null space of
those above: its QP has no equality rows, and standing still is always a feasible answer to it.
Where no limit is active the level's optimum is known in closed form; else ProxQP finds it.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from proxsuite import proxqp

from app.control import least_squares

Array = np.ndarray

_EPS_ABS = 1e-8  # accuracy of the QPs, in the units of acceleration and torque
_GOOD_ENOUGH = 1e-5  # violation of limits with which an answer is still taken, as the above


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
    """Solves hierarchies of n unknowns, each QP warm-started from the last of its size."""

    def __init__(self, n: int) -> None:
        """Prepare for n unknowns."""
        self._n = n
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
        x = least_squares.optimum(J, b, ends, H, c)
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
            candidate, left, JZ, residual = least_squares.next_level(J, b, x, Z)
            if not _holds(limits, candidate):
                y = self._solve_qp(slot, p, JZ.T @ JZ, -(JZ.T @ residual), x, Z, limits)
                candidate = x + Z @ y
            x, Z = candidate, left
        if not Z.shape[1]:
            return x
        candidate, H, c = least_squares.lowest_level(*objective, x, Z)
        if _holds(limits, candidate):
            return candidate
        return x + Z @ self._solve_qp(slot, len(levels), H, c, x, Z, limits)

    def _solve_qp(
        self, slot: str, level: int, H: Array, c: Array, x: Array, Z: Array, limits: Limits
    ) -> Array:
        """Min ½ yᵀ H y + cᵀ y where x + Z y keeps the limits."""
        C, reached = limits.C @ Z, limits.C @ x
        l, u = limits.l - reached, limits.u - reached
        if level > 0:  # the levels above kept the limits but for the solver's accuracy
            l, u = np.minimum(l, 0.0), np.maximum(u, 0.0)
        key = (slot, level, *C.shape)
        y = self._run(key, H, c, C, l, u)
        if y is None:  # once more, cold: a warm start can lead astray
            y = self._run(key, H, c, C, l, u)
        if y is not None:
            return y
        if level > 0:
            return np.zeros(Z.shape[1])  # what the levels above reached is kept
        raise NoSolutionError(level, "no accelerations keep all limits, or the solver failed")

    def _run(
        self, key: tuple[str, int, int, int], H: Array, c: Array, C: Array, l: Array, u: Array
    ) -> Array | None:
        """ProxQP's answer, from where it ended last time under this key; None if it has none."""
        qp = self._qps.get(key)
        if qp is None:
            qp = self._qps[key] = _make_qp(len(c), len(l))
            qp.init(H, c, None, None, C, l, u)
        else:
            qp.update(H=H, g=c, C=C, l=l, u=u)
        qp.solve()
        if _is_answer(qp):
            return qp.results.x.copy()
        del self._qps[key]  # a failed run is no start for the next one
        return None


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
    return least_squares.holds(*limits, x, _EPS_ABS)


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
