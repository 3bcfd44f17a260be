"""Continuous task transition (§3.4): a strictly convex QP in the place of strict levels.

Rows of T_sca join the tasks below by their activations, limits give in where they contradict each
other. The solution is continuous in its data, whatever enters or leaves: nothing in it can jump.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from proxsuite import proxqp

from app.avoidance.task import TaskRows, generate_avoidance_task
from app.control.active_sets import change_within, compliances, least_within, with_rows
from app.strict import Array

_EPS = 1e-10  # by which ProxQP may miss limits
_ENOUGH = 1e-6  # accuracy of ProxQP
_NONE = np.zeros(0)  # of q̈ is given


class Objective(NamedTuple):
    """min ½ q̈ᵀ H q̈ + cᵀ q̈, strictly convex."""

    H: Array
    """(n, n) symmetric positive definite."""
    c: Array
    """(n,)."""


class Limits(NamedTuple):
    """l ≤ C q̈ ≤ u."""

    C: Array
    """(m, n)."""
    l: Array
    """(m,) lower bounds."""
    u: Array
    """(m,) upper bounds."""
    softness: Array
    """(m,) [-] ε of each row; one of 0 holds whatever the others ask, and all others are in one
    unit."""

    def and_also(self, others: Limits) -> Limits:
        """These and others."""
        return Limits(*map(np.concatenate, zip(self, others, strict=True)))


class NoSolutionError(Exception):
    """The QP has no solution: what it is given is not finite, or its solver failed."""


def insert_rows(
    objective: Objective, rows: Sequence[TaskRows], softness: float, given: int = 0
) -> Objective:
    """The tasks below with the rows of T_sca above them, each as far as its own activation says.

    Row i joins as a spring between J_i q̈ and b_i = ẍ_i - J̇_i q̇ whose compliance is (1 - β_i)/β_i
    times that of the tasks below, J_i H⁻¹ J_iᵀ. Alone it then yields

        J_i q̈ = β_i b_i + (1 - β_i) J_i q̈_2*,

    the blend of (29). With others, at β_i = 0 it is not there, whatever the others do, and at
    β_i = 1 it holds but for the softness [-], the least share of a row's compliance: the printed
    blend of all rows with the one solution without any of them jumps where a row enters beside
    another one. A row costs the same whether it is the first or the tenth. The first entries of q̈
    may be given, so many: J_i H⁻¹ J_iᵀ is of the others.

    Paper: Eq. (29).
    """
    active = [row for row in rows if row.beta > 0.0]
    if not active:
        return objective
    b, J, beta = generate_avoidance_task(active)
    return Objective(*with_rows(*objective, J, b, beta, softness, given))


class TaskQP:
    """Finds the least of an objective within limits.

    Where no limit is met the least is known in closed form. Else, with H = L Lᵀ and z = Lᵀ (q̈ -
    q̈*) from the free optimum q̈*, the answer is the z nearest to 0 that keeps the limits. A soft
    limit has a slack that costs 1/(ε c), with c the least C_j H⁻¹ C_jᵀ of the soft ones: so it
    gives in by ε at most of what the tasks alone would have asked beyond it, and no soft limit, nor
    two that contradict each other, can leave the problem without an answer. Where active sets do
    not settle on it, ProxQP finds it.
    """

    def solve(self, objective: Objective, limits: Limits, given: Array = _NONE) -> Array:
        """The q̈ (n,) of the least objective within limits, its first entries (k,) given.

        Raises:
            NoSolutionError: The data are not finite, or the hard limits contradict each other.
        """
        qdd, found = least_within(*objective, *limits, given)
        return qdd if found else _by_proxqp(objective, limits, given)

    def change(self, objective: Objective, limits: Limits, given: Array) -> Array:
        """The change (k,) of what is given of q̈ that costs least with all within limits.

        It is counted from the least objective with what is given and without limits.

        Raises:
            NoSolutionError: As `solve`.
        """
        change, found = change_within(*objective, *limits, given)
        if found:
            return change
        H, free = objective.H, _without_limits(objective, limits, given)
        return self.solve(Objective(H, -H @ free), limits)[: len(given)] - given


def _without_limits(objective: Objective, limits: Limits, given: Array) -> Array:
    none = Limits(*(each[:0] for each in limits))
    return least_within(*objective, *none, given)[0]


def _by_proxqp(objective: Objective, limits: Limits, given: Array) -> Array:
    """The same by ProxQP, for where the active sets do not settle; its v is z and slacks."""
    x, k = _without_limits(objective, limits, given)[len(given) :], len(given)
    if not np.isfinite(x).all():
        raise NoSolutionError("the tasks are not finite")
    L, there = np.linalg.cholesky(objective.H[k:, k:]), limits.C[:, :k] @ given
    limits = Limits(limits.C[:, k:], limits.l - there, limits.u - there, limits.softness)
    C, l, u, softness = limits
    if not (np.isfinite(C).all() and (l < np.inf).all() and (u > -np.inf).all()):
        raise NoSolutionError("the limits are not finite")
    a, reached = np.linalg.solve(L, C.T).T, C @ x
    length = np.sqrt((a**2).sum(axis=1)) + 1e-12
    slack = np.diag(np.sqrt(compliances(softness, length)))[:, softness > 0.0]
    A = np.hstack([a / length[:, None], slack])
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
    return np.concatenate([given, x + np.linalg.solve(L.T, far * qp.results.x[: len(x)])])
