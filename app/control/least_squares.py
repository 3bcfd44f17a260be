"""Kernels of least squares in levels: what a hierarchy asks for where no limit is active.

All on matrices of at most about ten rows and columns, for which a call of LAPACK costs more than
the arithmetic.
"""

from __future__ import annotations

import math

import numpy as np

from app.compiled import compiled

Array = np.ndarray

RANK_TOLERANCE = 1e-7
"""What is left of a row that is taken as a combination of the others, in its own units."""


@compiled()
def _product(A: Array, B: Array) -> Array:
    C = np.zeros((A.shape[0], B.shape[1]))
    for i in range(A.shape[0]):
        for k in range(A.shape[1]):
            for j in range(B.shape[1]):
                C[i, j] += A[i, k] * B[k, j]
    return C


@compiled()
def _reflect(row: Array, mirror: Array, start: int, scale: float) -> None:
    """Mirror a row, in place."""
    along = 0.0
    for l in range(start, len(row)):
        along += row[l] * mirror[l]
    along /= scale
    for l in range(start, len(row)):
        row[l] -= along * mirror[l]


@compiled()
def _factors(A: Array) -> tuple[Array, Array, Array, int]:
    """Q, L, order and rank r with A[order] = L Qᵀ[:r], from the largest remaining row on.

    Q (m, m) is orthogonal, L (k, r) lower triangular in its first r rows: Householder's QR with
    pivots, of Aᵀ.
    """
    k, m = A.shape
    W, Q, order = A.copy(), np.eye(m), np.arange(k)
    rank = 0
    mirror = np.empty(m)
    for j in range(min(k, m)):
        pivot, largest = j, -1.0
        for i in range(j, k):
            length = 0.0
            for l in range(j, m):
                length += W[i, l] ** 2
            if length > largest:
                pivot, largest = i, length
        if not math.sqrt(largest) > RANK_TOLERANCE:
            break
        rank += 1
        order[j], order[pivot] = order[pivot], order[j]
        for l in range(m):
            W[j, l], W[pivot, l] = W[pivot, l], W[j, l]
        length = math.copysign(math.sqrt(largest), -W[j, j])
        scale = largest - W[j, j] * length  # ½ ‖mirror‖²
        mirror[j] = W[j, j] - length
        for l in range(j + 1, m):
            mirror[l] = W[j, l]
        for i in range(j, k):
            _reflect(W[i], mirror, j, scale)
        for i in range(m):
            _reflect(Q[i], mirror, j, scale)
    return Q, W[:, :rank].copy(), order, rank


@compiled()
def _forward(L: Array, B: Array) -> Array:
    """L⁻¹ B for the lower triangle in the first rows of L."""
    X = B[: L.shape[1]].copy()
    for i in range(L.shape[1]):
        for j in range(X.shape[1]):
            for l in range(i):
                X[i, j] -= L[i, l] * X[l, j]
            X[i, j] /= L[i, i]
    return X


@compiled()
def _least(L: Array, order: Array, rank: int, B: Array) -> Array:
    """(r, j) Y with L Y as near as can be to B[order]."""
    sorted_rows = np.empty(B.shape)
    for i in range(len(order)):
        sorted_rows[i] = B[order[i]]
    if rank == len(L):
        return _forward(L, sorted_rows)
    Q, T, columns, _ = _factors(L.T)  # L = Q T'ᵀ in another order of columns: overdetermined
    right = _product(Q[:, :rank].T, sorted_rows)
    Y = np.empty((rank, B.shape[1]))
    for i in range(rank - 1, -1, -1):  # the upper triangle Tᵀ
        for j in range(B.shape[1]):
            value = right[i, j]
            for l in range(i + 1, rank):
                value -= T[l, i] * right[l, j]
            right[i, j] = value / T[i, i]
    for i in range(rank):
        Y[columns[i]] = right[i]
    return Y


@compiled("Tuple((f8[::1], f8[:,::1], f8[:,::1], f8[::1]))(f8[:,:], f8[:], f8[::1], f8[:,:])")
def next_level(J: Array, b: Array, x: Array, Z: Array) -> tuple[Array, Array, Array, Array]:
    """Come as near to J x = b as the freedom Z of the levels above allows.

    Args:
        J: (k, n).
        b: (k,).
        x: (n,) what the levels above reached.
        Z: (n, f) orthonormal, the freedom that they left.

    Returns:
        x (n,) at this level, the freedom that it leaves, and J Z and b - J x of its problem.
    """
    JZ, residual = _product(J, Z), b.copy()
    for i in range(len(b)):
        for j in range(len(x)):
            residual[i] -= J[i, j] * x[j]
    Q, L, order, rank = _factors(JZ)
    step = _product(Q[:, :rank], _least(L, order, rank, residual.reshape(-1, 1)))
    return x + _product(Z, step)[:, 0], _product(Z, Q[:, rank:]), JZ, residual


@compiled("Tuple((f8[::1], f8[:,::1], f8[::1]))(f8[:,:], f8[:], f8[::1], f8[:,:])")
def lowest_level(H: Array, c: Array, x: Array, Z: Array) -> tuple[Array, Array, Array]:
    """Minimise ½ xᵀ H x + cᵀ x in the freedom Z that is left; x, Z as in `next_level`.

    Returns:
        x (n,), and Zᵀ H Z and Zᵀ (H x + c) of its problem. Not a number if H is not positive
        definite there.
    """
    f = Z.shape[1]
    slope = c.copy().reshape(-1, 1)
    for i in range(len(c)):
        for j in range(len(c)):
            slope[i, 0] += H[i, j] * x[j]
    Hz, cz = _product(Z.T, _product(H, Z)), _product(Z.T, slope)
    L = Hz.copy()  # Cholesky's
    for j in range(f):
        for i in range(j, f):
            for l in range(j):
                L[i, j] -= L[i, l] * L[j, l]
            L[i, j] = math.sqrt(L[j, j]) if i == j else L[i, j] / L[j, j]
    y = _forward(L, cz)
    for i in range(f - 1, -1, -1):
        for l in range(i + 1, f):
            y[i, 0] -= L[l, i] * y[l, 0]
        y[i, 0] /= L[i, i]
    return x - _product(Z, y)[:, 0], Hz, cz[:, 0].copy()


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


@compiled()
def _levels(J: Array, b: Array, ends: Array) -> tuple[Array, Array]:
    x, Z, start = np.zeros(J.shape[1]), np.eye(J.shape[1]), 0
    for end in ends:
        x, Z, _, _ = next_level(J[start:end], b[start:end], x, Z)
        start = end
    return x, Z


@compiled("f8[::1](f8[:,:], f8[:], i8[:], f8[:,:], f8[:])")
def optimum(J: Array, b: Array, ends: Array, H: Array, c: Array) -> Array:
    """The optimum of all levels without limits, (n,).

    Args:
        J: (k, n) rows of all levels, the highest first.
        b: (k,) their right-hand sides.
        ends: (levels,) index after the last row of each level.
        H: (n, n) symmetric positive definite, of the lowest level.
        c: (n,).
    """
    x, Z = _levels(J, b, ends)
    return lowest_level(H, c, x, Z)[0] if Z.shape[1] else x
