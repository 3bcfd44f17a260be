"""A strictly convex QP with soft limits for the oracle, by non-negative least squares."""

from __future__ import annotations

import numpy as np
from scipy.optimize import nnls

Array = np.ndarray
NONE = np.zeros(0)


def solve_qp(H: Array, c: Array, limits: tuple[Array, ...], fixed: Array = NONE) -> Array | None:
    """Min ½ xᵀ H x + cᵀ x + Σ v_j²/(2 s_j m) with l ≤ C x + v ≤ u, the first entries of x fixed.

    `limits` are (C, l, u, s). v are the slacks of the soft rows (s_j > 0), and m is the smallest
    C_j H⁻¹ C_jᵀ of these. None if hard rows contradict each other.
    """
    k, (C, l, u, softness) = len(fixed), limits
    if k:
        there = C[:, :k] @ fixed
        rest = C[:, k:], l - there, u - there, softness
        x = solve_qp(H[k:, k:], c[k:] + H[k:, :k] @ fixed, rest)
        return None if x is None else np.append(fixed, x)
    return nearest_within(H, np.linalg.solve(H, -c), limits)


def nearest_within(H: Array, x: Array, limits: tuple[Array, ...]) -> Array | None:
    """The point within the limits of `solve_qp` nearest to x in the metric H; None without one."""
    C, l, u, softness = limits
    below, above = l - C @ x, u - C @ x
    if max(below.max(initial=0.0), (-above).max(initial=0.0)) <= 1e-10:
        return x
    L = np.linalg.cholesky(H)
    a = np.linalg.solve(L, C.T).T
    size = np.sum(a**2, axis=1)
    soft = softness > 0.0
    compliance = softness * size[soft].min(initial=np.inf) if soft.any() else softness
    # x and the slacks change by the least z with A z >= b.
    A = np.hstack([a, np.diag(np.sqrt(compliance))[:, soft]])
    A, b, rows = np.vstack([A, -A]), np.append(below, -above), np.tile(np.arange(len(l)), 2)
    A, b, rows = A[np.isfinite(b)], b[np.isfinite(b)], rows[np.isfinite(b)]
    active = active_rows(A, b)
    if active is None:
        return None
    # The active rows hold with equality: z = Aᵀ y with A Aᵀ y = b.
    A, b = A[active], b[active]
    y = np.linalg.lstsq(A @ A.T, b, rcond=1e-14)[0]
    z = A.T @ y
    z += A.T @ np.linalg.lstsq(A @ A.T, b - A @ z, rcond=1e-14)[0]
    return x + np.linalg.solve(L.T, z[: len(x)])


def active_rows(A: Array, b: Array) -> Array | None:
    """The active rows of min |z| with A z >= b, by Lawson and Hanson; None if infeasible."""
    length = np.linalg.norm(A, axis=1)
    A, b = A / length[:, None], b / length
    far = b.max()
    E = np.vstack([A.T, b / far])
    y, residual = nnls(E, np.eye(len(E))[-1], maxiter=30 * len(b))
    return None if residual < 1e-12 else np.flatnonzero(y > 0.0)


def change(H: Array, c: Array, limits: tuple[Array, ...], fixed: Array) -> Array | None:
    """Find the unlimited optimum with fixed first entries, then its `nearest_within` the limits."""
    k = len(fixed)
    x = np.append(fixed, np.linalg.solve(H[k:, k:], -c[k:] - H[k:, :k] @ fixed))
    return nearest_within(H, x, limits)
