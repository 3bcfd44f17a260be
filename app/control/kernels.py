"""Kernels of the control step: on matrices of ten rows LAPACK's calls cost more than the sums."""

import math

import numpy as np

from app.compiled import compiled
from app.strict import Array

_EPS = 1e-12  # of a bound, by which it may be missed
_MISSED = 1e-10  # by which limits may be


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


@compiled()
def _backward(L: Array, b: Array) -> Array:
    """L⁻ᵀ b."""
    x = b.copy()
    for i in range(len(x) - 1, -1, -1):
        for l in range(i + 1, len(x)):
            x[i] -= L[l, i] * x[l]
        x[i] /= L[i, i]
    return x


@compiled()
def _minimum(L: Array, c: Array) -> Array:
    """-H⁻¹ c (n,) with H = L Lᵀ."""
    return _backward(L, _forward(L, -c))


@compiled()
def _times(A: Array, x: Array) -> Array:
    """A x, its sums in a fixed order: those of BLAS depend on where the memory lies."""
    found = np.zeros(len(A))
    for i in range(len(A)):
        for j in range(len(x)):
            found[i] += A[i, j] * x[j]
    return found


@compiled("f8[:,::1](f8[:], f8[:], f8[:,:], f8)")
def position_bounds(q: Array, qd: Array, limits: Array, rate: float) -> Array:
    """(2, n_m) λ² (q_limit - q) - 2 λ q̇, towards the lower and the upper limit."""
    return rate**2 * (limits - q) - 2 * rate * qd


@compiled("f8[:,::1](f8[:], f8[:,:], f8)")
def velocity_bounds(qd: Array, limits: Array, rate: float) -> Array:
    """(2, n_m) κ (q̇_limit - q̇), towards the lower and the upper limit."""
    return rate * (limits - qd)


@compiled("f8[:,::1](f8[:], f8[:], f8[:,:], f8[:,:], f8, f8)")
def joint_bounds(
    q: Array, qd: Array, q_limits: Array, qd_limits: Array, position_rate: float, speed_rate: float
) -> Array:
    """(2, n_m) the lower and the upper one on q̈_m: the tighter of position and velocity."""
    position = position_bounds(q, qd, q_limits, position_rate)
    velocity = velocity_bounds(qd, qd_limits, speed_rate)
    found = np.empty_like(position)
    for i in range(len(q)):
        lower = max(position[0, i], velocity[0, i])
        upper = min(position[1, i], velocity[1, i])
        found[0, i], found[1, i] = min(lower, upper), max(lower, upper)
    return found


@compiled()
def _in_reach(
    M: Array, h: Array, torque: Array, bounds: Array, qdd_b: Array, pushed: Array
) -> Array:
    """M_aa⁻¹ r (n_m,); the bounds (2, n_m) on q̈_m are brought in reach of each joint's own torque.

    No joint asks for more than its own torque gives in this step while the others' are in the
    middle of what they may be. If it asked for all at once, the torques of all others would swing
    from end to end for it, each too late, and throw an arm that is overpowered about.
    """
    n_b, n_m, (low, high) = len(qdd_b), len(pushed), (torque[0], torque[1])
    L, acting = _cholesky(M[n_b:, n_b:]), 0.5 * (low + high) + pushed - h[n_b:]
    qdd = _backward(L, _forward(L, acting - _times(M[n_b:, :n_b], qdd_b)))
    for i in range(n_m):
        unit = np.zeros(n_m)
        unit[i] = 1.0
        own = 0.5 * (_forward(L, unit) ** 2).sum() * (high[i] - low[i])
        bounds[0, i] = min(bounds[0, i], qdd[i] + own)
        bounds[1, i] = max(bounds[1, i], qdd[i] - own)
    return _backward(L, _forward(L, pushed))


@compiled(
    "Tuple((f8[:,::1], f8[::1], f8[::1]))"
    "(f8[:,:], f8[:], f8[:,:], f8[:,:], f8[:], f8[:], f8[:], f8[:,:], f8[:])"
)
def limit_rows(
    M: Array,
    h: Array,
    torque: Array,
    bounds: Array,
    unit: Array,
    qdd_b: Array,
    pushed: Array,
    J: Array,
    least: Array,
) -> tuple[Array, Array, Array]:
    """C (m, n), l (m,) and u (m,) of torques, joints and distances.

    Args:
        M: (n, n) of (26).
        h: (n,) of (26).
        torque: (2, n_m) the least and the largest ones.
        bounds: (2, n_m) on q̈_m.
        unit: (n_m,) in which they are counted.
        qdd_b: (n_b,) of the base, or (0,) where it is open.
        pushed: (n_m,) torques of those who push, where the base's q̈ is given.
        J: (k, n) of the distances.
        least: (k,) of J q̈.
    """
    n, n_m, k = len(M), len(unit), len(least)
    n_b, m, bounds, others = n - n_m, 2 * n_m + k, bounds.copy(), np.zeros(n_m)
    if len(qdd_b) > 0:
        others = _in_reach(M, h, torque, bounds, qdd_b, pushed)
    C, l, u = np.zeros((m, n)), np.empty(m), np.full(m, np.inf)
    for i in range(n_m):
        joint, row = n_b + i, n_m + i
        C[i] = M[joint]
        l[i], u[i] = torque[0, i] - h[joint], torque[1, i] - h[joint]
        C[row, joint] = 1.0 / unit[i]
        l[row], u[row] = (bounds[0, i] - others[i]) / unit[i], (bounds[1, i] - others[i]) / unit[i]
    for i in range(k):
        C[2 * n_m + i] = J[i]
        l[2 * n_m + i] = least[i] - (J[i, n_b:] * others).sum()
    return C, l, u


@compiled("f8[::1](f8[:], f8[:,:], f8, f8)")
def reaction(d: Array, J: Array, f: float, d_b: float) -> Array:
    """Jᵀ f (1 - d/d_b) [N m or N] (n_m,) of the distances d (k,) within d_b; J (k, n_m)."""
    u_a = np.zeros(J.shape[1])
    for i in range(len(d)):
        share = f * min(max(1.0 - d[i] / d_b, 0.0), 1.0)
        for j in range(len(u_a)):
            u_a[j] += share * J[i, j]
    return u_a


@compiled("f8[::1](f8[:], f8[:,:], f8[:], f8[:], f8[:], f8, f8[:], f8)")
def observed(
    r: Array, M: Array, h: Array, then: Array, now: Array, dt: float, u_a: Array, share: float
) -> Array:
    """(n_m,) r + share (M_a q̈ + h_a - u_a - r), of `app.control.limits.PushObserver`.

    With the q̈ that took the velocity `then` to `now`, (n,), within dt [s].
    """
    n_b, found = len(now) - len(r), r.copy()
    for i in range(len(r)):
        missing = h[n_b + i] - u_a[i] - r[i]
        for j in range(len(now)):
            missing += M[n_b + i, j] * (now[j] - then[j]) / dt
        found[i] += share * missing
    return found


@compiled("f8[::1](f8[:], f8[:], f8[:])")
def clipped(values: Array, low: Array, high: Array) -> Array:
    """Values within bounds; `np.clip` costs twice as much on so few."""
    found = np.empty_like(values)
    for i in range(len(values)):
        found[i] = min(max(values[i], low[i]), high[i])
    return found


@compiled("f8[:,::1](f8[:], f8[:], f8)")
def torque_range(last: Array, most: Array, change: float) -> Array:
    """(2, n_m) the smallest and the largest torque, `change` from the last one at most."""
    found = np.empty((2, len(last)))
    for i in range(len(last)):
        at = min(max(last[i], -most[i]), most[i])
        found[0, i], found[1, i] = max(at - change, -most[i]), min(at + change, most[i])
    return found


@compiled("f8[::1](f8[:], f8[:], f8[:], f8[:,:], f8, f8, f8)")
def towards_posture(
    q: Array, qd: Array, posture: Array, limits: Array, pull: float, drag: float, centring: float
) -> Array:
    """(n_m,) c_m of `app.control.tasks.posture_objective`."""
    c = np.empty(len(q))
    for i in range(len(q)):
        half = 0.5 * (limits[1, i] - limits[0, i])
        out = (q[i] - limits[0, i]) / half - 1.0
        c[i] = drag * qd[i] - pull * (posture[i] - q[i]) + centring * half * out**5
    return c


@compiled("Tuple((f8[::1], f8))(f8[:], f8[:], f8[:], f8, f8, f8)")
def to_reference(
    pose: Array, velocity: Array, acceleration: Array, k_p: float, k_v: float, most: float
) -> tuple[Array, float]:
    """(6,) acceleration + k_v velocity + k_p pose of an end-effector's error, and the pull's way.

    The linear and the angular part of the pull k_p pose are at most `most`; its way [m²] is
    ‖pull / k_p‖².
    """
    b, left = acceleration + k_v * velocity, 0.0
    for part in (slice(0, 3), slice(3, 6)):
        pull = k_p * pose[part]
        pull *= min(1.0, most / max(math.sqrt((pull**2).sum()), 1e-12))
        b[part] += pull
        left += (pull**2).sum()
    return b, left / max(k_p, 1e-12) ** 2


@compiled("Tuple((f8[:,::1], f8[::1]))(f8[:,:], f8[:], f8[:,:], f8[:], f8, f8[:], f8)")
def with_task(
    H: Array, c: Array, J: Array, b: Array, give: float, drag: Array, weight: float
) -> tuple[Array, Array]:
    """(1 + w λ) H + w Jᵀ J and c + w (λ H drag - Jᵀ b)."""
    n, (k, _) = len(c), J.shape
    H_all, c_all = np.empty((n, n)), np.empty(n)
    for i in range(n):
        dragged = asked = 0.0
        for j in range(n):
            both = 0.0
            for l in range(k):
                both += J[l, i] * J[l, j]
            H_all[i, j] = H[i, j] + weight * (give * H[i, j] + both)
            dragged += H[i, j] * drag[j]
        for l in range(k):
            asked += J[l, i] * b[l]
        c_all[i] = c[i] + weight * (give * dragged - asked)
    return H_all, c_all


@compiled()
def _holds(C: Array, l: Array, u: Array, x: Array, tolerance: float) -> bool:
    """Whether l ≤ C x ≤ u within a tolerance; never for what is not a number."""
    reached = _times(C, x)
    return bool((np.maximum(l - reached, reached - u) <= tolerance).all())


@compiled()
def _within(K: Array, active: Array, r: Array) -> Array:
    """The y of K y = r over some of its rows and columns."""
    size = len(active)
    W = np.empty((size, size))
    for i in range(size):
        for j in range(size):
            W[i, j] = K[active[i], active[j]]
    factor = _cholesky(W)
    return _backward(factor, _forward(factor, r))


@compiled()
def _bring(
    p: int, side: float, miss: float, K: Array, y: Array, kept: Array, size: int
) -> tuple[int, bool]:
    """Bring row p to its bound, changing y and the rows that are kept there.

    Returns:
        How many rows are kept, and whether it came there; else the hard rows contradict each other.
    """
    m = len(y)
    while True:
        active, turn = kept[:size], np.zeros(m)
        if size > 0:
            turn[active] = -side * _within(K, active, K[active, p])
        turn[p] = side
        rise = side * (K[p] * turn).sum()  # towards the bound, for each unit of y_p
        step = miss / rise if rise > _EPS * K[p, p] else np.inf
        blocking = -1
        for k in range(size):
            i = active[k]
            if y[i] * turn[i] < 0.0 and -y[i] / turn[i] < step:
                step, blocking = -y[i] / turn[i], k
        if not step < np.inf:
            return size, False
        y += step * turn
        if blocking < 0:
            kept[size] = p
            return size + 1, True
        miss -= step * rise
        y[active[blocking]] = 0.0
        kept[blocking : size - 1] = kept[blocking + 1 : size].copy()
        size -= 1


@compiled("f8[::1](f8[:], f8[:])")
def compliances(softness: Array, length: Array) -> Array:
    """(m,) those of rows of length one: of all that are soft, each as for the stiffest.

    A slack s then costs s² times the same for all of them. If each cost what its own row weighs, a
    light wrist would be thrown about to brake a heavy shoulder.

    Args:
        softness: (m,) [-] ε.
        length: (m,) √(C_i H⁻¹ C_iᵀ).
    """
    least = np.inf
    for i in range(len(softness)):
        if softness[i] > 0.0:
            least = min(least, length[i])
    found = np.zeros(len(softness))
    for i in range(len(softness)):
        if softness[i] > 0.0:
            found[i] = softness[i] * (least / length[i]) ** 2
    return found


@compiled()
def _nearest_within(
    x: Array, L: Array, C: Array, l: Array, u: Array, softness: Array
) -> tuple[Array, bool]:
    """The least within limits, by the dual active-set method of Goldfarb and Idnani (1983).

    It is x itself where that keeps them. With a_i = L⁻¹ C_iᵀ, each of length one, and
    z = Lᵀ (q̈ - x), the answer is z = Σ y_i a_i. Its multipliers y solve l ≤ K y ≤ u with
    K = a aᵀ + diag(ε), y_i ≥ 0 at a lower bound, ≤ 0 at an upper one and 0 between. One row after
    the other, the most missed first, is brought to its bound, while those that are there stay,
    until one of their multipliers is 0 and it is let go.

    Args:
        x: (n,) the free optimum.
        L: (n, n) of the objective.
        C: (m, n) rows of the limits.
        l: (m,)
        u: (m,)
        softness: (m,) [-] ε of `compliances`.

    Returns:
        (n,) the least, and whether there is one.
    """
    if _holds(C, l, u, x, _MISSED):
        return x, True
    n, m = len(x), len(l)
    a, below, above, length = np.empty((m, n)), np.empty(m), np.empty(m), np.empty(m)
    for i in range(m):
        a[i] = _forward(L, C[i])
        length[i] = math.sqrt((a[i] ** 2).sum()) + 1e-12
        a[i] /= length[i]
        reached = (C[i] * x).sum()
        below[i], above[i] = (l[i] - reached) / length[i], (u[i] - reached) / length[i]
    K = np.diag(compliances(softness, length))
    for i in range(m):
        for j in range(m):
            K[i, j] += (a[i] * a[j]).sum()
    y, kept = np.zeros(m), np.empty(m, np.int64)
    size, found = 0, False
    for _ in range(10 * m):
        s = (K * y).sum(axis=1)
        miss = np.maximum(below - s, s - above)
        miss[kept[:size]] = 0.0
        p = int(miss.argmax())
        if not miss[p] > _EPS * (1.0 + abs(s[p])):
            found = math.isfinite(miss[p])
            break
        side = 1.0 if s[p] < below[p] else -1.0
        size, reached_it = _bring(p, side, miss[p], K, y, kept, size)
        if not reached_it:
            break
    z = (a.T * y).sum(axis=1)
    # Beside a soft row's multiplier, as large as 1/ε, a hard one's is lost in rounding; z is not.
    hard = kept[:size][softness[kept[:size]] == 0.0]
    bound = np.where(y > 0.0, below, above)
    z += (a[hard].T * _within(K, hard, bound[hard] - (a[hard] * z).sum(axis=1))).sum(axis=1)
    found_x = x + _backward(L, z)
    return found_x, bool(found and np.isfinite(found_x).all())


@compiled("Tuple((f8[::1], b1))(f8[:,:], f8[:], f8[:,:], f8[:], f8[:], f8[:], f8[:])")
def least_within(
    H: Array, c: Array, C: Array, l: Array, u: Array, softness: Array, given: Array
) -> tuple[Array, bool]:
    """The x (n,) of least ½ xᵀ H x + cᵀ x within limits, and whether there is one.

    Its first entries are given, (k,) or none; `softness` is (m,) [-] ε.
    """
    k = len(given)
    L, there = _cholesky(H[k:, k:]), _times(C[:, :k], given)
    free = _minimum(L, c[k:] + _times(H[k:, :k], given))
    rest, found = _nearest_within(free, L, C[:, k:], l - there, u - there, softness)
    return np.concatenate((given, rest)), found


@compiled("Tuple((f8[::1], b1))(f8[:,:], f8[:], f8[:,:], f8[:], f8[:], f8[:], f8[:])")
def change_within(
    H: Array, c: Array, C: Array, l: Array, u: Array, softness: Array, given: Array
) -> tuple[Array, bool]:
    """The change (k,) of what is given with which all x come nearest to the least with it.

    The nearest, in H, that is within limits; and whether there is one.
    """
    k = len(given)
    rest = _minimum(_cholesky(H[k:, k:]), c[k:] + _times(H[k:, :k], given))
    x = np.concatenate((given, rest))
    found, there = _nearest_within(x, _cholesky(H), C, l, u, softness)
    return found[:k] - given, there


@compiled("Tuple((f8[:,::1], f8[::1]))(f8[:,:], f8[:], f8[:,:], f8[:], f8[:], f8, i8)")
def with_rows(
    H: Array, c: Array, J: Array, b: Array, beta: Array, least: float, given: int
) -> tuple[Array, Array]:
    """H + Σ w_i J_iᵀ J_i and c - Σ w_i b_i J_iᵀ with w_i = β_i / ((1 - β_i + least) J_i H⁻¹ J_iᵀ).

    What is given has no part in J_i H⁻¹ J_iᵀ.

    Args:
        H: (n, n)
        c: (n,)
        J: (k, n) rows.
        b: (k,) what they ask of J q̈.
        beta: (k,) [-] their activations.
        least: [-] what is left of a row's compliance in full force.
        given: How many entries of x are, from the first on.
    """
    L, H, c = _cholesky(H[given:, given:]), H.copy(), c.copy()
    for i in range(len(b)):
        a = _forward(L, J[i, given:])
        compliance = 1e-12
        for j in range(len(a)):
            compliance += a[j] ** 2
        w = beta[i] / ((1.0 - beta[i] + least) * compliance)
        for j in range(len(c)):
            c[j] -= w * b[i] * J[i, j]
            for l in range(len(c)):
                H[j, l] += w * J[i, j] * J[i, l]
    return H, c


@compiled("UniTuple(f8[::1], 3)(f8[:], f8[:], f8, f8[:], f8[:], f8[:], f8[:], f8[:])")
def base_blend(
    free: Array,
    xdd: Array,
    beta: float,
    low: Array,
    high: Array,
    gain: Array,
    drag: Array,
    velocity: Array,
) -> tuple[Array, Array, Array]:
    """β ẍ + (1 - β) ẍ_free of (29); the same within low and high; what is asked for ẍ_free.

    All (n_b,). Of an acceleration a the admittance law makes gain (a - drag ν), so that a base that
    is to have ẍ_free is asked ẍ_free / gain + drag ν.
    """
    wanted, asked = np.empty(len(free)), np.empty(len(free))
    for i in range(len(free)):
        wanted[i] = beta * xdd[i] + (1.0 - beta) * free[i]
        asked[i] = free[i] / gain[i] + drag[i] * velocity[i]
    return wanted, clipped(wanted, low, high), asked


@compiled("f8[:,::1](f8[:,:], f8[:], f8[:,:], f8)")
def carried(J_ee: Array, qd_max: Array, J_m_inv: Array, speed: float) -> Array:
    """R (3, n_b) of `app.control.tasks.carried`."""
    n_b, n_m = len(J_m_inv), len(qd_max)
    follows = np.zeros((3, 3))
    for i in range(3):
        for j in range(3):
            for k in range(n_m):
                follows[i, j] += J_ee[i, n_b + k] * J_ee[j, n_b + k] * (qd_max[k] / speed) ** 2
    left, moved = np.eye(3), np.zeros((3, n_b))
    for i in range(3):
        for j in range(3):
            for k in range(3):
                left[i, j] += follows[i, k] * follows[k, j]
        for j in range(n_b):
            for k in range(n_b):
                moved[i, j] += J_ee[i, k] * J_m_inv[k, j]
    L, found = _cholesky(left), np.empty_like(moved)
    for j in range(n_b):
        found[:, j] = _backward(L, _forward(L, moved[:, j]))
    return found


@compiled("f8[::1](f8[:], f8[:], f8[:], f8, f8[:,:])")
def with_hand(wanted: Array, held: Array, inertia: Array, mass: float, taken: Array) -> Array:
    """The least (n_b,) of (a - a_wanted)ᵀ I (a - a_wanted) + mass ‖taken (a - a_held)‖²."""
    n_b = len(inertia)
    hung, right = np.diag(inertia), np.empty(n_b)
    for i in range(n_b):
        right[i] = inertia[i] * (wanted[i] - held[i])
        for j in range(n_b):
            for k in range(len(taken)):
                hung[i, j] += mass * taken[k, i] * taken[k, j]
    L = _cholesky(hung)
    return held + _backward(L, _forward(L, right))
