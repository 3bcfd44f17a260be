"""One strictly convex QP a step: tasks by weight, limits that give in where they contradict.

Its solution is continuous in its data, whatever enters or leaves: nothing in it can jump.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from proxsuite import proxqp

from app.control.linear_algebra import holds, minimum, nearest_within

Array = np.ndarray

_EPS = 1e-10  # by which limits may be missed
_ENOUGH = 1e-6  # accuracy of ProxQP


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
        softness: (m,) [-] ε of each row; one of 0 holds whatever the others ask.
    """

    C: Array
    l: Array
    u: Array
    softness: Array


class NoSolutionError(Exception):
    """The QP has no solution: what it is given is not finite, or its solver failed."""


class TaskQP:
    """Finds the least of an objective within limits.

    Where no limit is met the least is known in closed form. Else, with H = L Lᵀ and z = Lᵀ (q̈ -
    q̈*) from the free optimum q̈*, the answer is the z nearest to 0 that keeps the limits. A soft
    limit i has a slack that costs 1/(ε_i C_i H⁻¹ C_iᵀ): so it gives in by ε_i of what the tasks
    alone would have asked beyond it, and no soft limit, nor two that contradict each other, can
    leave the problem without an answer. Where active sets do not settle on it, ProxQP finds it.
    """

    def solve(self, objective: Objective, limits: Limits) -> Array:
        """The optimum q̈, (n,).

        Args:
            objective: What is to be least.
            limits: Of q̈.

        Raises:
            NoSolutionError: The data are not finite, or the hard limits contradict each other.
        """
        x, L = minimum(*objective)
        if not np.isfinite(x).all():
            raise NoSolutionError("the tasks are not finite")
        if holds(*limits[:3], x, _EPS):
            return x
        qdd, found = nearest_within(x, L, *limits)
        return qdd if found and np.isfinite(qdd).all() else _by_proxqp(x, L, limits)


def _by_proxqp(x: Array, L: Array, limits: Limits) -> Array:
    """The same by ProxQP, for where the active sets do not settle; its v is z and slacks."""
    C, l, u, softness = limits
    if not (np.isfinite(C).all() and (l < np.inf).all() and (u > -np.inf).all()):
        raise NoSolutionError("the limits are not finite")
    a, reached = np.linalg.solve(L, C.T).T, C @ x
    length = np.sqrt((a**2).sum(axis=1)) + 1e-12
    A = np.hstack([a / length[:, None], np.diag(np.sqrt(softness))[:, softness > 0.0]])
    l, u = (l - reached) / length, (u - reached) / length
    far = max(l.max(), -u.min())  # in units of the farthest bound from 0
    m, n = A.shape
    qp = proxqp.dense.QP(n, 0, m)
    qp.settings.eps_abs, qp.settings.eps_rel = _EPS, 0.0
    qp.settings.eps_primal_inf = 1e-12  # the default calls feasible problems infeasible
    qp.settings.max_iter = 1000
    qp.init(np.eye(n), np.zeros(n), None, None, A, l / far, u / far)
    qp.solve()
    info = qp.results.info
    if info.status != proxqp.PROXQP_SOLVED and not max(info.pri_res, info.dua_res) < _ENOUGH:
        raise NoSolutionError(f"ProxQP ended with {info.status.name}")
    return x + np.linalg.solve(L.T, far * qp.results.x[: len(x)])
