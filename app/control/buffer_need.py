"""How large d_b must be, so that the base is out of the way before an approaching hand is there.

A hand comes towards the base along -n at a constant speed v, whatever the base does. How near does
it get? Three things hold the base back:

- Dead time t_0 = period + delay + τ. What the controller asks is averaged over a command's period
  and reaches the drive later by the delay; the drive's lag of first order delays by another τ.
- The law asks the more the deeper the hand is. At the distance d it accelerates the base along -n,
  in each of its channels k (v and ω of a differential one), by
  a_k = β(d) f_max (1 - d/d_b) ‖n_xy‖ J_k (J · u)_k / m_k, with J = (n_x, n_y x - n_x y) at the
  hand's place (x, y) and m_k = m, I. The force comes from the acting point, which stands aside by
  α_min while the hand is d_b - d inside the border: u lies between the normal and the tangent with
  tan = α_min / (d_b - d), on the worse side.
- The admittance law makes a speed of it: w_k(t) = a_k T_k (1 - e^(-t/T_k)), T_k = M_a/D_a, with a_k
  within the base's acceleration limit and w_k within its largest speed.

Once the hand is at some d_*, the law asks for at least a_k(d_*) as long as the hand is nearer. So
after t_0 each channel reaches its share v_k of v in t_k = -T_k ln(1 - v_k/(a_k T_k)), and until
then the hand has gained on the base no more than

    x(d_*) = v t_0 + Σ_k [ v_k T_k - (a_k T_k - v_k) t_k ],   Σ_k v_k = v

(without damping v_k²/(2 a_k)). The least distance is therefore no smaller than the largest
d_* - x(d_*). That grows with d_b, and the need is the smallest d_b at which it is the reserve.
Where the speeds a_k T_k together stay below v at every d_*, no d_b suffices.

Two things are taken as simpler than they are. The place does not move along the base, and the lever
of ω at the flank is never below 0.25 m: near the wheel axis the tangential part of the force first
drives the base along its own flank, until there is a lever.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from app.compiled import compiled
from app.config import AdmittanceConfig, Config
from app.robot.bases.kind import BaseKind, Channel
from app.strict import Array

RESERVE = 0.02  # [m] that shall be left between arm and base
_LEVER = 0.25  # [m] that ω has at least at the flank
_LONGEST = 100.0  # [s] time constant that stands for no damping
_DEPTHS = np.linspace(0.04, 1.0, 25)  # [-] where d_* is tried, as a share of d_b from the border on
_SIZES = np.geomspace(0.05, 2.0, 25)  # [m] d_b tried


@compiled()
def _gain(v: float, a: float, T: float) -> float:
    """[m] by how much a point of speed v gets ahead of one that starts with a and reaches a T."""
    final = max(a * T, 1e-12)
    return v * T + max(final - v, 0.0) * T * math.log1p(-min(v / final, 1.0 - 1e-9))


@compiled("f8[::1](f8[:], f8[:,:], f8, f8, f8, f8, f8, f8)")
def _least_distance(
    d_b: Array,
    channels: Array,
    v: float,
    late: float,
    kept: float,
    f_max: float,
    alpha_min: float,
    d_full: float,
) -> Array:
    """[m] the largest d_* - x(d_*) of the module for each d_b (k,); minus infinity without any.

    Args:
        d_b: (k,) [m]
        channels: (c, 6) J · n and J · t, with the horizontal part of n and t at right angles to it
            no longer, m_k [kg], a_k and w_k at most, along n, and T_k [s].
        v: [m/s] of the approach.
        late: [s] t_0.
        kept: [-] of a speed that does not slip.
        f_max: [N]
        alpha_min: [m]
        d_full: [m] distance of full activation.
    """
    count = len(channels)
    found = np.full(len(d_b), -np.inf)
    a, w, a_worse, w_worse = np.zeros(count), np.zeros(count), np.zeros(count), np.zeros(count)
    for i in range(len(d_b)):
        for depth in _DEPTHS:
            below = d_b[i] * depth
            aside = math.hypot(below, alpha_min)
            rise = min(max(below / (d_b[i] - d_full), 0.0), 1.0)
            f = rise * rise * (3.0 - 2.0 * rise) * f_max * below / d_b[i]
            least = np.inf
            a_worse[:], w_worse[:] = 0.0, 0.0
            for side in (1.0, -1.0):
                for k in range(count):
                    J, J_t, mass, a_max, w_max, T = channels[k]
                    asked = f * J / mass * (below * J + side * alpha_min * J_t) / aside
                    a[k] = kept * min(max(asked, -a_max), a_max)
                    w[k] = min(max(a[k] * T, -kept * w_max), kept * w_max)
                if w.sum() <= least:
                    least = w.sum()
                    a_worse[:], w_worse[:] = a, w
            total = against = 0.0
            for k in range(count):
                total += max(w_worse[k], 0.0)
                against += max(-w_worse[k], 0.0)  # a channel that goes the wrong way
            if total > v + against:
                gained = v * late
                for k in range(count):
                    share = max(w_worse[k], 0.0) * (v + against) / total
                    gained += _gain(share, a_worse[k], channels[k, 5])
                found[i] = max(found[i], d_b[i] - below - gained)
    return found


class Approach(NamedTuple):
    """How the arm comes towards the base."""

    v: float
    """[m/s] speed of the arm's closest point over the ground, along -n."""
    n: Array
    """(3,) unit normal of the pair from the base to the arm, in the base's frame."""
    p_b: Array
    """(3,) [m] closest point on the arm, in the base's frame."""


def buffer_need(approach: Approach, base: BaseKind, config: Config) -> float:
    """[m] the smallest d_b for which the arm stays away from the base by the reserve.

    See the module for what is assumed. The delay and the slip are those of the configuration; its
    own d_b has no part in it.

    Returns:
        At least d_full, from which on β has room to rise; infinite if the base cannot retreat as
        fast, or not with a d_b of less than 2 m.
    """
    least = max(RESERVE, config.activation.d_full)
    if approach.v <= 0.0:
        return least
    sizes = np.maximum(_SIZES, least + 1e-6)
    low = int(np.searchsorted(least_distance(sizes, approach, base, config) >= RESERVE, True))
    if low == len(sizes):
        return float("inf")
    if low > 0:
        sizes = np.linspace(sizes[low - 1], sizes[low], 20)
        low = int(np.searchsorted(least_distance(sizes, approach, base, config) >= RESERVE, True))
    return float(sizes[min(low, len(sizes) - 1)])


def least_distance(d_b: Array, approach: Approach, base: BaseKind, config: Config) -> Array:
    """(k,) [m] how near the arm comes at most, by the module's bound, for d_b (k,) [m] above
    d_full.

    It is minus infinity where the base does not reach the speed at all.
    """
    lead, force = dead_time(base, config), config.force
    ways = [
        _least_distance(
            d_b,
            _channels(way, approach, base, config),
            approach.v,
            lead + max(channel.delay for channel in way),
            1.0 - config.disturbance.slip,
            force.f_max,
            force.alpha_min,
            config.activation.d_full,
        )
        for way in base.retreats()
    ]
    return np.max(ways, axis=0)


def dead_time(base: BaseKind, config: Config) -> float:
    """[s] from a demand of the controller to the base's motion."""
    return config.admittance.period + config.disturbance.base_delay + base.drive_time_constant_s


def _channels(way: Sequence[Channel], approach: Approach, base: BaseKind, config: Config) -> Array:
    """(c, 6) of one of the base's ways to give way, as `_least_distance` takes them."""
    admittance, n, p = config.admittance, approach.n, approach.p_b
    lever = n[1] * p[0] - n[0] * p[1]
    lever = math.copysign(max(abs(lever), _LEVER * abs(n[1])), lever)
    rows = []
    for channel in way:
        J = float(np.dot(channel.twist, [n[0], n[1], lever]))
        J_t = float(np.dot(channel.twist, [-n[1], n[0], n[0] * p[0] + n[1] * p[1]]))
        mass = _resisting(channel, base.mass_kg, base.inertia_kgm2)
        virtual = _resisting(channel, admittance.mass, admittance.inertia)
        damping = _resisting(channel, admittance.damping, admittance.angular_damping)
        T = min(virtual / max(damping, 1e-9), _LONGEST)
        top = _top(channel, admittance)
        rows.append((J, J_t, mass, channel.a_max * abs(J), top * abs(J), T))
    return np.array(rows)


def _resisting(channel: Channel, linear: float, angular: float) -> float:
    """What resists a channel, from what resists a linear and an angular motion."""
    x, y, turn = channel.twist
    return (x * x + y * y) * linear + turn * turn * angular


def _top(channel: Channel, config: AdmittanceConfig) -> float:
    """[m/s or rad/s] the largest speed of a channel that the law commands."""
    x, y, turn = channel.twist
    linear, angular = math.hypot(x, y), abs(turn)
    return min(
        channel.v_max,
        config.v_max / linear if linear > 0.0 else math.inf,
        config.omega_max / angular if angular > 0.0 else math.inf,
    )
