"""The last resort for a QP whose active-set search ends without a solution: ProxQP.

The search has no solution after ten passes for each row, if hard rows seem infeasible, or if the
data are not finite. This is rare; ProxQP takes a millisecond. The compared method `hqp` uses ProxQP
in every step (`app.control.hqp`).
"""

from typing import NamedTuple

import numpy as np
from proxsuite import proxqp

from app.control.qp import compliances
from app.strict import Array

_EPS = 1e-10  # desired accuracy of ProxQP
_ENOUGH = 1e-6  # required accuracy of ProxQP


class OpenQP(NamedTuple):
    """min ½ xᵀ H x + cᵀ x subject to l ≤ C x ≤ u, as in `qp.solve_qp`."""

    H: Array
    c: Array
    C: Array
    l: Array
    u: Array
    softness: Array
    fixed: Array


def solved_by_proxqp(qp: OpenQP) -> Array:
    """The solution (n,) of a QP; all entries are NaN if there is none or ProxQP finds none."""
    k, x = len(qp.fixed), _without_limits(qp)
    moved = qp.C[:, :k] @ qp.fixed
    C, l, u = qp.C[:, k:], qp.l - moved, qp.u - moved
    finite = np.isfinite(x).all() and np.isfinite(C).all()
    if not (finite and (l < np.inf).all() and (u > -np.inf).all()):
        return np.full(len(qp.c), np.nan)
    L = np.linalg.cholesky(qp.H[k:, k:])
    a, reached = np.linalg.solve(L, C.T).T, C @ x
    length = np.sqrt((a**2).sum(axis=1)) + 1e-12
    slack = np.diag(np.sqrt(compliances(qp.softness, length)))[:, qp.softness > 0.0]
    A = np.hstack([a / length[:, None], slack])  # the unknowns are Lᵀ (x − x*) and the slacks
    l, u = (l - reached) / length, (u - reached) / length
    z = _nearest_to_zero(A, l, u)
    found = np.concatenate([qp.fixed, x + np.linalg.solve(L.T, z[: len(x)])])
    return found if np.isfinite(found).all() else np.full(len(qp.c), np.nan)


def changed_by_proxqp(qp: OpenQP) -> Array:
    """The solution (n,) as by `qp.solve_qp_step`; NaN in the cases of `solved_by_proxqp`."""
    free = np.concatenate([qp.fixed, _without_limits(qp)])
    return solved_by_proxqp(qp._replace(c=-qp.H @ free, fixed=qp.fixed[:0]))


def _without_limits(qp: OpenQP) -> Array:
    k = len(qp.fixed)
    try:
        L = np.linalg.cholesky(qp.H[k:, k:])
    except np.linalg.LinAlgError:  # not positive definite
        return np.full(len(qp.c) - k, np.nan)
    return np.linalg.solve(L.T, np.linalg.solve(L, -(qp.c[k:] + qp.H[k:, :k] @ qp.fixed)))


def _nearest_to_zero(A: Array, l: Array, u: Array) -> Array:
    """The z of smallest norm with l ≤ A z ≤ u, or NaN."""
    far = max(l.max(), -u.min())  # in units of the farthest bound from 0
    if far <= 0.0:
        return np.zeros(A.shape[1])
    m, n = A.shape
    qp = proxqp.dense.QP(n, 0, m)
    qp.settings.eps_abs, qp.settings.eps_rel = _EPS, 0.0
    qp.settings.eps_primal_inf = 1e-12  # the default calls feasible problems infeasible
    qp.settings.max_iter = 1000
    qp.init(np.eye(n), np.zeros(n), None, None, A, l / far, u / far)
    qp.solve()
    info = qp.results.info
    if info.status != proxqp.PROXQP_SOLVED and not max(info.pri_res, info.dua_res) < _ENOUGH:
        return np.full(n, np.nan)
    return far * qp.results.x
