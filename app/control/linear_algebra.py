"""Kernels of the QP: on matrices of ten rows a call of LAPACK costs more than the arithmetic."""

from __future__ import annotations

import math

import numpy as np

from app.compiled import compiled

Array = np.ndarray


@compiled()
def _cholesky(H: Array) -> Array:
    """L, lower triangular, with H = L Lᵀ; not a number if H is not positive definite."""
    L = np.zeros(H.shape)
    for j in range(len(H)):
        for i in range(j, len(H)):
            value = H[i, j]
            for l in range(j):
                value -= L[i, l] * L[j, l]
            L[i, j] = math.sqrt(value) if i == j else value / L[j, j]
    return L


@compiled()
def _forward(L: Array, b: Array) -> Array:
    """L⁻¹ b."""
    x = b.copy()
    for i in range(len(x)):
        for l in range(i):
            x[i] -= L[i, l] * x[l]
        x[i] /= L[i, i]
    return x


@compiled("Tuple((f8[::1], f8[:,::1]))(f8[:,:], f8[:])")
def minimum(H: Array, c: Array) -> tuple[Array, Array]:
    """-H⁻¹ c (n,), and L (n, n) with H = L Lᵀ; not a number if H is not positive definite."""
    L = _cholesky(H)
    x = _forward(L, -c)
    for i in range(len(x) - 1, -1, -1):
        for l in range(i + 1, len(x)):
            x[i] -= L[l, i] * x[l]
        x[i] /= L[i, i]
    return x, L


@compiled("b1(f8[:,:], f8[:], f8[:], f8[:], f8)")
def holds(C: Array, l: Array, u: Array, x: Array, tolerance: float) -> bool:
    """Whether l ≤ C x ≤ u within a tolerance; never for what is not a number."""
    for i in range(len(l)):
        reached = 0.0
        for j in range(len(x)):
            reached += C[i, j] * x[j]
        if not l[i] - tolerance <= reached <= u[i] + tolerance:
            return False
    return True


@compiled("Tuple((f8[:,::1], f8[::1], f8[::1]))(f8[:,:], f8[:,:], f8[:], f8[:], f8[:], i8, f8)")
def scaled_rows(
    L: Array, C: Array, l: Array, u: Array, x: Array, hard: int, softness: float
) -> tuple[Array, Array, Array]:
    """The limits of z = Lᵀ (q̈ - x) as rows of length one, each soft one with a slack.

    Args:
        L: (n, n) of the objective.
        C: (m, n) rows of the limits.
        l: (m,)
        u: (m,)
        x: (n,) the free optimum.
        hard: How many rows, the first, have no slack.
        softness: [-] compliance of a slack against that of its row.

    Returns:
        (m, n + m - hard) rows over z and the slacks, and their bounds (m,).
    """
    n, m = len(x), len(l)
    A, below, above = np.zeros((m, n + m - hard)), np.empty(m), np.empty(m)
    for i in range(m):
        a = _forward(L, C[i])
        reached = length = 0.0
        for j in range(n):
            reached += C[i, j] * x[j]
            length += a[j] ** 2
        length = math.sqrt(length) + 1e-12
        for j in range(n):
            A[i, j] = a[j] / length
        if i >= hard:
            A[i, n + i - hard] = math.sqrt(softness)
        below[i], above[i] = (l[i] - reached) / length, (u[i] - reached) / length
    return A, below, above


@compiled("Tuple((f8[:,::1], f8[::1]))(f8[:,:], f8[:], f8[:,:], f8[:], f8[:], f8)")
def with_rows(
    H: Array, c: Array, J: Array, b: Array, beta: Array, least: float
) -> tuple[Array, Array]:
    """H + Σ w_i J_iᵀ J_i and c - Σ w_i b_i J_iᵀ with w_i = β_i / ((1 - β_i + least) J_i H⁻¹ J_iᵀ).

    Args:
        H: (n, n)
        c: (n,)
        J: (k, n) rows.
        b: (k,) what they ask of J q̈.
        beta: (k,) [-] their activations.
        least: [-] what is left of a row's compliance in full force.
    """
    L, H, c = _cholesky(H), H.copy(), c.copy()
    for i in range(len(b)):
        a = _forward(L, J[i])
        compliance = 1e-12
        for j in range(len(a)):
            compliance += a[j] ** 2
        w = beta[i] / ((1.0 - beta[i] + least) * compliance)
        for j in range(len(c)):
            c[j] -= w * b[i] * J[i, j]
            for l in range(len(c)):
                H[j, l] += w * J[i, j] * J[i, l]
    return H, c
