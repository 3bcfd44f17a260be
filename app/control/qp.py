"""One strictly convex QP a step: tasks by weight, limits that give in where they contradict.

Its solution is continuous in its data, whatever enters or leaves: nothing in it can jump.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from proxsuite import proxqp

from app.control.linear_algebra import holds, minimum, scaled_rows

Array = np.ndarray

_ENOUGH = 1e-6  # accuracy with which an answer is taken, if ProxQP finds no better one
_EPS = 1e-10  # by which limits may be missed, and accuracy of ProxQP


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
        hard: How many of the rows, the first ones, hold whatever the others ask.
    """

    C: Array
    l: Array
    u: Array
    hard: int


class NoSolutionError(Exception):
    """The QP has no solution: what it is given is not finite, or its solver failed."""


class TaskQP:
    """Finds the least of an objective within limits.

    Where no limit is met the least is known in closed form. Else, with H = L Lᵀ and z = Lᵀ (q̈ -
    q̈*) from the free optimum q̈*, the answer is the z nearest to 0 that keeps the limits, and
    ProxQP finds it. A soft limit i has a slack that costs 1/(ε C_i H⁻¹ C_iᵀ): so it gives in by ε
    of what the tasks alone would have asked beyond it, and no soft limit, nor two that contradict
    each other, can leave the problem without an answer.
    """

    def __init__(self) -> None:
        self._qps: dict[tuple[int, int], proxqp.dense.QP] = {}

    def solve(self, objective: Objective, limits: Limits, softness: float) -> Array:
        """The optimum q̈, (n,).

        Args:
            objective: What is to be least.
            limits: Of q̈.
            softness: [-] ε of the soft ones.

        Raises:
            NoSolutionError: The data are not finite, the hard limits contradict each other, or the
                solver failed.
        """
        x, L = minimum(*objective)
        if not np.isfinite(x).all():
            raise NoSolutionError("the tasks are not finite")
        C, l, u, hard = limits
        if holds(C, l, u, x, _EPS):
            return x
        A, below, above = scaled_rows(L, C, l, u, x, hard, softness)
        if not np.isfinite(A).all():
            raise NoSolutionError("the limits are not finite")
        return x + np.linalg.solve(L.T, self._nearest(A, below, above)[: len(x)])

    def _nearest(self, A: Array, l: Array, u: Array) -> Array:
        """The shortest v with l ≤ A v ≤ u; ProxQP has it in units of the farthest bound from 0."""
        far = max(float(l.max()), float(-u.min()))
        qp = self._qps.get(A.shape)
        if qp is None:
            qp = self._qps[A.shape] = _make_qp(*A.shape)
        qp.update(C=A, l=l / far, u=u / far)
        qp.solve()
        info = qp.results.info
        if info.status != proxqp.PROXQP_SOLVED and not max(info.pri_res, info.dua_res) < _ENOUGH:
            raise NoSolutionError(f"ProxQP ended with {info.status.name}")
        return far * qp.results.x


def _make_qp(m: int, n: int) -> proxqp.dense.QP:
    """Min ½ ‖v‖² over v (n,) within m rows, still without their values."""
    qp = proxqp.dense.QP(n, 0, m)
    settings = qp.settings
    settings.eps_abs = _EPS
    settings.eps_rel = 0.0
    settings.eps_primal_inf = 1e-12  # the default calls feasible problems infeasible
    settings.max_iter = 1000
    settings.initial_guess = proxqp.InitialGuess.NO_INITIAL_GUESS
    rows = np.ones((m, n))
    qp.init(np.eye(n), np.zeros(n), None, None, rows, -np.ones(m), np.ones(m))
    return qp
