"""The d_b that the base requires to move away before an approaching end-effector arrives.

docs/method.md derives the bound ("How large must d_b be?"). The end-effector approaches the base
along -n at a constant speed v, independent of the base. While its distance is less than d_*, the
law accelerates the base in each of its channels k (v and ω of a differential base) by at least
a_k(d_*). The dead time t_0 precedes this acceleration, and w_k is the final speed of the channel.
Until the base is as fast as the end-effector, the distance decreases by at most x(d_*). Therefore
the distance never falls below the largest d_* - x(d_*).
"""

import math
from bisect import bisect_left
from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np

from app.compiled import compiled, direct
from app.config import Config
from app.control.qp import fill, put
from app.control.tasks import cubic, rise_length
from app.robot.bases.kind import BaseKind, Channel
from app.strict import Array

RESERVE = 0.02  # [m] required distance between arm and base
_LEVER = 0.25  # [m] smallest lever of a force from the side
_LONGEST = 100.0  # [s] time constant that represents no damping
_DEPTHS = np.linspace(0.04, 1.0, 25)  # [-] sampled depths d_b - d_* in the buffer, relative to d_b
_SIZES = np.geomspace(0.05, 2.0, 25)  # [m] sampled d_b


@compiled()
def _gain(v: float, a: float, T: float) -> float:
    """[m] path at speed v minus path at speed a T (1 - e^(-t/T)), until the speeds are equal."""
    final = max(a * T, 1e-12)
    return v * T + max(final - v, 0.0) * T * math.log1p(-min(v / final, 1.0 - 1e-9))


@compiled("f8(f8, f8[:,:], f8, f8, f8, f8, f8, f8)")
def _bound(
    d_b: float,
    channels: Array,
    v: float,
    late: float,
    traction: float,
    f_max: float,
    alpha_min: float,
    d_full: float,
) -> float:
    """[m] largest d_* - x(d_*); −∞ if Σ w_k exceeds v at no d_*.

    The rows of `channels` (c, 6) are those of `_channels`, `late` [s] is t_0, and `traction` the
    share of a speed that is not lost to slip. `alpha_min` and `d_full` are in m.
    """
    count = len(channels)
    found, (a, w, a_worse, w_worse) = -np.inf, np.zeros((4, count))
    for depth in _DEPTHS:
        below = d_b * depth
        aside = math.hypot(below, alpha_min)
        f = cubic(below / rise_length(d_b, d_full)) * f_max * below / d_b
        least = np.inf
        fill(a_worse, 0.0)
        fill(w_worse, 0.0)
        for side in (1.0, -1.0):
            for k in range(count):
                J, J_t, mass, a_max, w_max, T = channels[k]
                demand = f * J / mass * (below * J + side * alpha_min * J_t) / aside
                a[k] = traction * min(max(demand, -a_max), a_max)
                w[k] = min(max(a[k] * T, -traction * w_max), traction * w_max)
            if w.sum() <= least:
                least = w.sum()
                put(a_worse, a)
                put(w_worse, w)
        total = against = 0.0
        for k in range(count):
            total += max(w_worse[k], 0.0)
            against += max(-w_worse[k], 0.0)  # a channel that moves in the wrong direction
        if total > v + against:
            gained = v * late
            for k in range(count):
                share = max(w_worse[k], 0.0) * (v + against) / total
                gained += _gain(share, a_worse[k], channels[k, 5])
            found = max(found, d_b - below - gained)
    return found


_bound_once = direct(_bound)


class Approach(NamedTuple):
    """Speed, direction and place of an approach of the arm to the base."""

    v: float
    """[m/s] speed of the arm's closest point relative to the floor, along -n."""
    n: Array
    """(3,) normal of the pair from the base to the arm, length 1 or less, in the base's frame."""
    p_b: Array
    """(3,) [m] closest point on the arm, in the base's frame."""


def buffer_need(approach: Approach, base: BaseKind, config: Config) -> float:
    """[m] the smallest d_b for which the bound of the distance is at least `RESERVE`.

    The configured d_b has no influence. The result is at least 0.05 m; if v ≤ 0, it is the larger
    of `RESERVE` and d_full. It is infinite if no d_b up to 2 m suffices, for example because the
    arm is faster than the base.
    """
    least = max(RESERVE, config.activation.d_full)
    if approach.v <= 0.0:
        return least
    sizes = np.maximum(_SIZES, least + 1e-6)
    return min(_smallest(sizes, way) for way in _ways(approach, base, config))


def _smallest(sizes: Array, way: tuple[Any, ...]) -> float:
    """[m] smallest sufficient d_b for one motion of `_ways`; infinite if no size suffices.

    `sizes` (k,) [m] are ascending; the result can be between two of them. `_bound` grows with d_b.
    """

    def first(ascending: Array) -> int:
        return bisect_left(ascending, True, key=lambda d_b: _bound_once(d_b, *way) >= RESERVE)

    low = first(sizes)
    if low == len(sizes):
        return math.inf
    if low > 0:
        sizes = np.linspace(sizes[low - 1], sizes[low], 20)
        low = min(first(sizes), len(sizes) - 1)
    return float(sizes[low])


def _ways(approach: Approach, base: BaseKind, config: Config) -> Iterator[tuple[Any, ...]]:
    """The arguments of `_bound` after d_b, for each of the base's motions away from the arm."""
    lead = config.admittance.period + config.disturbance.base_delay + base.drive_time_constant_s
    force = config.force
    for way in base.retreats():
        yield (
            _channels(way, approach, base, config),
            approach.v,
            lead + max(channel.delay for channel in way),
            1.0 - config.disturbance.slip,
            force.f_max,
            force.alpha_min,
            config.activation.d_full,
        )


def _channels(way: Sequence[Channel], approach: Approach, base: BaseKind, config: Config) -> Array:
    """(c, 6) J_k(n), J_k(t), m_k [kg or kg m²], bounds of a_k and w_k along n, and T_k [s].

    `way` is a motion of the base away from the arm; t is the horizontal part of n, turned by 90°.
    """
    law, n, p = config.admittance, approach.n, approach.p_b
    lever = n[1] * p[0] - n[0] * p[1]
    lever = math.copysign(max(abs(lever), _LEVER * abs(n[1])), lever)
    rows = []
    for channel in way:
        x, y, turn = channel.twist
        linear, angular = x * x + y * y, turn * turn
        J = float(np.dot(channel.twist, [n[0], n[1], lever]))
        J_t = float(np.dot(channel.twist, [-n[1], n[0], n[0] * p[0] + n[1] * p[1]]))
        mass = linear * base.mass_kg + angular * base.inertia_kgm2
        virtual_mass = linear * law.mass + angular * law.inertia
        damping = linear * law.damping + angular * law.angular_damping
        T = min(virtual_mass / max(damping, 1e-9), _LONGEST)
        top = channel.v_max
        if linear > 0.0:
            top = min(top, law.v_max / math.hypot(x, y))
        if angular > 0.0:
            top = min(top, law.omega_max / abs(turn))
        rows.append((J, J_t, mass, channel.a_max * abs(J), top * abs(J), T))
    return np.array(rows)
