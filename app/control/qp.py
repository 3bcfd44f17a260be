"""Linear algebra of small matrices, and a strictly convex QP with soft limits.

For matrices of ten rows the overhead of LAPACK exceeds the computation. The active-set search of
the QP ends without a solution after ten passes per row, if hard rows seem infeasible, or if the
data are not finite. Then ProxQP, which is slower, is the last resort.
"""

import math

import numpy as np
from proxsuite import proxqp

from app.compiled import compiled
from app.strict import Array

_EPS = 1e-12  # [-] relative tolerance of a bound in the search
_PROXQP_DESIRED, _PROXQP_REQUIRED = 1e-10, 1e-6  # accuracies of ProxQP
_MISSED = 1e-10  # tolerance of the limits, in their own units


@compiled()
def put(into: Array, values: Array | tuple[float, ...]) -> None:
    """Copy values into an array; ``into[:] = values`` compiles to far more code."""
    for i in range(len(into)):
        into[i] = values[i]


@compiled()
def put_rows(into: Array, values: Array) -> None:
    """Copy rows of values (k, n) into the first k rows of an array."""
    for i in range(len(values)):
        for j in range(values.shape[1]):
            into[i, j] = values[i, j]


@compiled()
def fill(into: Array, value: float) -> None:
    """Set all entries of an array to a value."""
    for i in range(len(into)):
        into[i] = value


@compiled()
def clip(values: Array, low: Array, high: Array) -> Array:
    """The values (k,), limited to the bounds `low` and `high` (k,)."""
    found = np.empty_like(values)
    for i in range(len(values)):
        found[i] = min(max(values[i], low[i]), high[i])
    return found


@compiled()
def cholesky(H: Array) -> Array:
    """L, lower triangular, with H = L Lᵀ; NaN if H is not positive definite."""
    L = np.zeros(H.shape)
    for j in range(len(H)):
        for i in range(j, len(H)):
            value = H[i, j]
            for l in range(j):
                value -= L[i, l] * L[j, l]
            if i > j:
                L[i, j] = value / L[j, j]
            else:
                L[i, j] = math.sqrt(value) if value > 0.0 else math.nan
    return L


@compiled()
def forward(L: Array, b: Array) -> Array:
    """L⁻¹ b."""
    x = b.copy()
    for i in range(len(x)):
        for l in range(i):
            x[i] -= L[i, l] * x[l]
        x[i] /= L[i, i]
    return x


@compiled()
def backward(L: Array, b: Array) -> Array:
    """L⁻ᵀ b."""
    x = b.copy()
    for i in range(len(x) - 1, -1, -1):
        for l in range(i + 1, len(x)):
            x[i] -= L[l, i] * x[l]
        x[i] /= L[i, i]
    return x


@compiled()
def inverse_diagonal(L: Array) -> Array:
    """The diagonal (n,) of H⁻¹ with H = L Lᵀ."""
    n = len(L)
    found, x = np.zeros(n), np.empty(n)
    for i in range(n):  # the column L⁻¹ e_i starts at its i-th entry
        for j in range(i, n):
            value = 1.0 if j == i else 0.0
            for l in range(i, j):
                value -= L[j, l] * x[l]
            x[j] = value / L[j, j]
            found[i] += x[j] ** 2
    return found


@compiled()
def solved(L: Array, b: Array) -> Array:
    """H⁻¹ b with H = L Lᵀ."""
    return backward(L, forward(L, b))


@compiled()
def dot(a: Array, b: Array) -> float:
    """aᵀ b."""
    total = 0.0
    for i in range(len(a)):
        total += a[i] * b[i]
    return total


@compiled()
def times(A: Array, x: Array) -> Array:
    """A x, with sums in a fixed order; the order of BLAS depends on memory addresses."""
    found = np.empty(len(A))
    for i in range(len(A)):
        found[i] = dot(A[i], x)
    return found


@compiled()
def _holds(C: Array, l: Array, u: Array, x: Array, tolerance: float) -> bool:
    """Whether l ≤ C x ≤ u within a tolerance; false for NaN."""
    for i in range(len(l)):
        reached = dot(C[i], x)
        if not (l[i] - reached <= tolerance and reached - u[i] <= tolerance):
            return False
    return True


@compiled()
def _within(K: Array, active: Array, r: Array) -> Array:
    """The solution y of K y = r over the active rows and columns."""
    size = len(active)
    W = np.empty((size, size))
    for i in range(size):
        for j in range(size):
            W[i, j] = K[active[i], active[j]]
    return solved(cholesky(W), r)


@compiled()
def _activate_row(
    p: int, side: float, miss: float, K: Array, y: Array, kept: Array, size: int
) -> tuple[int, bool]:
    """Change y and the active rows, the first `size` of `kept`, until row p is at its bound.

    `side` is 1 if row p is below its lower bound, −1 if above its upper one, `miss` the distance
    from this bound; K and y are those of `_nearest_within`. Returns the number of active rows, and
    whether row p is at its bound; if not, the hard rows seem infeasible.
    """
    m = len(y)
    while True:
        active, turn = kept[:size], np.zeros(m)
        if size > 0:
            found = _within(K, active, K[active, p])
            for k in range(size):
                turn[active[k]] = -side * found[k]
        turn[p] = side
        rise = side * dot(K[p], turn)  # towards the bound, per unit of y_p
        step = miss / rise if rise > _EPS * K[p, p] else np.inf
        blocking = -1
        for k in range(size):
            i = active[k]
            if y[i] * turn[i] < 0.0 and -y[i] / turn[i] < step:
                step, blocking = float(-y[i] / turn[i]), k
        if not step < np.inf:
            return size, False
        y += step * turn
        if blocking < 0:
            kept[size] = p
            return size + 1, True
        miss -= step * rise
        y[active[blocking]] = 0.0
        size -= 1
        for k in range(blocking, size):
            kept[k] = kept[k + 1]


@compiled()
def compliances(softness: Array, length: Array) -> Array:
    """(m,) compliances of the rows after their scaling to unit length; 0 for hard rows.

    Before this scaling, a row with the softness ε² > 0 has the compliance ε² κ: a slack s costs
    ½ s² / (ε² κ). κ is the squared length of the shortest soft row, for all rows. If κ depended on
    the row, a light wrist would accelerate strongly to brake a heavy shoulder. `softness` (m,) has
    ε² of each row, and `length` (m,) its length √(C_i H⁻¹ C_iᵀ) before the scaling.
    """
    ratio = np.where(softness > 0.0, length, np.inf).min() / length
    return np.where(softness > 0.0, softness * (ratio * ratio), 0.0)


@compiled()
def _most_violated(s: Array, below: Array, above: Array, active: Array) -> tuple[int, float]:
    """The row whose value s is farthest outside of its bounds, and its distance from the bound.

    The distance is negative inside the bounds, and 0 for an active row. NaN counts as the largest.
    """
    miss = np.empty(len(s))
    for i in range(len(s)):
        low, high = below[i] - s[i], s[i] - above[i]
        miss[i] = high if high > low or math.isnan(high) else low
    for i in active:
        miss[i] = 0.0
    p = 0
    for i in range(len(miss)):
        if miss[i] > miss[p] or (math.isnan(miss[i]) and not math.isnan(miss[p])):
            p = i
    return p, float(miss[p])


@compiled()
def _nearest_within(
    x: Array, L: Array, C: Array, l: Array, u: Array, softness: Array
) -> tuple[Array, bool]:
    """The constrained optimum (n,), by the dual active-set method of Goldfarb and Idnani (1983).

    x (n,) is the free optimum, and L (n, n) the Cholesky factor of H. The optimum q̈ follows from
    z = Lᵀ (q̈ - x) = Σ y_i a_i, with the rows a_i = L⁻¹ C_iᵀ of a, scaled to length one. The bounds
    b_l and b_u are l - C x and u - C x in the same scale. The multipliers y solve b_l ≤ K y ≤ b_u,
    K = a aᵀ + diag(compliances); y_i ≥ 0 at a lower bound, ≤ 0 at an upper one, 0 between. A pass
    brings the most violated row to its bound; each active row stays at its bound or becomes
    inactive. The second result is whether the optimum was found.
    """
    if _holds(C, l, u, x, _MISSED):
        return x, True
    n, m = len(x), len(l)
    a, below, above, length = np.empty((m, n)), np.empty(m), np.empty(m), np.empty(m)
    for i in range(m):
        put(a[i], forward(L, C[i]))
        length[i] = math.sqrt(dot(a[i], a[i])) + 1e-12
        for j in range(n):
            a[i, j] /= length[i]
        reached = dot(C[i], x)
        below[i], above[i] = (l[i] - reached) / length[i], (u[i] - reached) / length[i]
    K, compliance = np.empty((m, m)), compliances(softness, length)
    for i in range(m):
        for j in range(m):
            K[i, j] = dot(a[i], a[j])
        K[i, i] += compliance[i]
    y, kept, size, found = np.zeros(m), np.empty(m, np.int64), 0, False
    for _ in range(10 * m):
        s = times(K, y)
        p, miss = _most_violated(s, below, above, kept[:size])
        if not miss > _EPS * (1.0 + abs(s[p])):
            found = math.isfinite(miss)
            break
        side = 1.0 if s[p] < below[p] else -1.0
        size, reached_it = _activate_row(p, side, miss, K, y, kept, size)
        if not reached_it:
            break
    z = times(a.T, y)
    # The multipliers of soft rows, of order 1 / softness, cause rounding errors in those of
    # hard rows. Therefore correct z until the active hard rows are exactly at their bounds.
    hard = kept[:size][softness[kept[:size]] == 0.0]
    missed = np.empty(len(hard))
    for k in range(len(hard)):
        i = hard[k]
        missed[k] = (below[i] if y[i] > 0.0 else above[i]) - dot(a[i], z)
    z += times(a[hard].T, _within(K, hard, missed))
    found_x = x + backward(L, z)
    return found_x, bool(found and np.isfinite(found_x).all())


@compiled()
def _free_optimum(H: Array, c: Array, fixed: Array) -> tuple[Array, Array]:
    """For the entries after the fixed ones: Cholesky factor of H, and optimum without limits."""
    k = len(fixed)
    L = cholesky(H[k:, k:])
    return L, solved(L, -(c[k:] + times(H[k:, :k], fixed)))


@compiled()
def solve_qp(
    H: Array, c: Array, C: Array, l: Array, u: Array, softness: Array, fixed: Array
) -> tuple[Array, bool]:
    """Solve min ½ xᵀ H x + cᵀ x subject to l ≤ C x ≤ u, with the first entries of x fixed.

    A slack s of a soft limit costs ½ s² / (ε² κ). ε² is the limit's softness, κ the smallest
    C_j H⁻¹ C_jᵀ of the soft limits, over the entries of x that can change. If no other limit is
    active, s ≤ ε² times the violation without limits. Contradictory soft limits are feasible too.

    H (n, n) is symmetric positive definite, c (n,) the linear term. The rows C (m, n) have the
    limits l and u (m,) and the softness ε² (m,) [-]; a row with 0 is hard. `fixed` (k,) are the
    first entries of x. Returns the solution (n,), and whether the active-set search has found it.
    """
    k = len(fixed)
    L, free = _free_optimum(H, c, fixed)
    moved = times(C[:, :k], fixed)
    rest, found = _nearest_within(free, L, C[:, k:], l - moved, u - moved, softness)
    return np.concatenate((fixed, rest)), found


@compiled()
def solve_qp_step(
    H: Array, c: Array, C: Array, l: Array, u: Array, softness: Array, fixed: Array
) -> tuple[Array, bool]:
    """The x within the limits nearest to x_0, the optimum with the fixed entries without limits.

    The distance is in the metric H, and slacks cost as in `solve_qp`. All entries of x can differ
    from x_0, the fixed entries too. Arguments and results are those of `solve_qp`.
    """
    x = np.concatenate((fixed, _free_optimum(H, c, fixed)[1]))
    return _nearest_within(x, cholesky(H), C, l, u, softness)


def solved_by_proxqp(
    H: Array, c: Array, C: Array, l: Array, u: Array, softness: Array, fixed: Array
) -> Array:
    """The solution (n,) as by `solve_qp`; all entries are NaN if ProxQP finds none."""
    k, x = len(fixed), _without_limits(H, c, fixed)
    moved = C[:, :k] @ fixed
    C, l, u = C[:, k:], l - moved, u - moved
    finite = np.isfinite(x).all() and np.isfinite(C).all()
    if not (finite and (l < np.inf).all() and (u > -np.inf).all()):
        return np.full(len(c), np.nan)
    L = np.linalg.cholesky(H[k:, k:])
    a, reached = np.linalg.solve(L, C.T).T, C @ x
    length = np.sqrt((a**2).sum(axis=1)) + 1e-12
    slack = np.diag(np.sqrt(compliances(softness, length)))[:, softness > 0.0]
    A = np.hstack([a / length[:, None], slack])  # the unknowns are Lᵀ (x − x*) and the slacks
    l, u = (l - reached) / length, (u - reached) / length
    z = _nearest_to_zero(A, l, u)
    found = np.concatenate([fixed, x + np.linalg.solve(L.T, z[: len(x)])])
    return found if np.isfinite(found).all() else np.full(len(c), np.nan)


def changed_by_proxqp(
    H: Array, c: Array, C: Array, l: Array, u: Array, softness: Array, fixed: Array
) -> Array:
    """The solution (n,) as by `solve_qp_step`; all entries are NaN if ProxQP finds none."""
    free = np.concatenate([fixed, _without_limits(H, c, fixed)])
    return solved_by_proxqp(H, -H @ free, C, l, u, softness, fixed[:0])


def _without_limits(H: Array, c: Array, fixed: Array) -> Array:
    k = len(fixed)
    try:
        L = np.linalg.cholesky(H[k:, k:])
    except np.linalg.LinAlgError:  # not positive definite
        return np.full(len(c) - k, np.nan)
    return np.linalg.solve(L.T, np.linalg.solve(L, -(c[k:] + H[k:, :k] @ fixed)))


def _nearest_to_zero(A: Array, l: Array, u: Array) -> Array:
    """The z of smallest norm with l ≤ A z ≤ u, or NaN."""
    far = max(l.max(), -u.min())  # in units of the farthest bound from 0
    if far <= 0.0:
        return np.zeros(A.shape[1])
    m, n = A.shape
    qp = proxqp.dense.QP(n, 0, m)
    qp.settings.eps_abs, qp.settings.eps_rel = _PROXQP_DESIRED, 0.0
    qp.settings.eps_primal_inf = 1e-12  # the default calls feasible problems infeasible
    qp.settings.max_iter = 1000
    qp.init(np.eye(n), np.zeros(n), None, None, A, l / far, u / far)
    qp.solve()
    info = qp.results.info
    accurate = max(info.pri_res, info.dua_res) < _PROXQP_REQUIRED
    is_solved = info.status == proxqp.PROXQP_SOLVED or accurate
    return far * qp.results.x if is_solved else np.full(n, np.nan)
