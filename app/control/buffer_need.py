"""How large d_b must be, so that the base is out of the way before an approaching hand is there.

A hand comes towards the base along -n at a constant speed v, whatever the base does. How near does
it get? Three things hold the base back:

- Dead time t_0 = period + delay + τ. What the controller asks is averaged over a command's period
  and reaches the drive later by the delay; the drive's lag of first order delays by another τ.
- The law asks the more the deeper the hand is. At the distance d it accelerates the base along -n,
  in each of its channels k (v and ω of a differential one), by
  a_k = β(d) f_max (1 - d/d_b) (1 - n_z²) J_k (J · u)_k / m_k, with J = (n_x, n_y x - n_x y) at the
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

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from app.config import AdmittanceConfig, Config
from app.robot.bases.kind import BaseKind, Channel

Array = np.ndarray

RESERVE = 0.02  # [m] that shall be left between arm and base
_LEVER = 0.25  # [m] that ω has at least at the flank
_LONGEST = 100.0  # [s] time constant that stands for no damping
_DEPTHS = np.linspace(0.04, 1.0, 25)  # [-] where d_* is tried, as a share of d_b from the border on
_SIZES = np.geomspace(0.05, 2.0, 25)  # [m] d_b tried


class Approach(NamedTuple):
    """How the arm comes towards the base.

    Attributes:
        v: [m/s] speed of the arm's closest point over the ground, along -n.
        n: (3,) unit normal of the pair from the base to the arm, in the base's frame.
        p_b: (3,) [m] closest point on the arm, in the base's frame.
    """

    v: float
    n: Array
    p_b: Array


def buffer_need(approach: Approach, base: BaseKind, config: Config) -> float:
    """[m] the smallest d_b for which the arm stays away from the base by the reserve.

    See the module for what is assumed. The delay and the slip are those of the configuration.

    Args:
        approach: Speed, direction and place.
        base: Mass, inertia, limits and time constant of the base.
        config: Law, admittance and disturbances; its own d_b has no part in it.

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
    """How near the arm comes at most, by the bound of the module.

    Args:
        d_b: (k,) [m] buffer distances, above d_full.
        approach: Speed, direction and place.
        base: See `buffer_need`.
        config: See `buffer_need`.

    Returns:
        (k,) [m], minus infinity where the base does not reach the speed at all.
    """
    ways = [_least_distance(d_b, approach, base, way, config) for way in base.retreats()]
    return np.max(ways, axis=0)


def _least_distance(
    d_b: Array, approach: Approach, base: BaseKind, way: Sequence[Channel], config: Config
) -> Array:
    """The same for one of the base's ways to give way."""
    d_b = np.asarray(d_b, dtype=float)[:, None]
    d = d_b * (1.0 - _DEPTHS)  # (k, depths)
    a, w = _retreat(d, d_b, approach, base, way, config)
    T = _time_constants(way, config)
    v = approach.v - w.clip(max=0.0).sum(axis=0)  # a channel that goes the wrong way adds to it
    share, total = w.clip(min=0.0), w.clip(min=0.0).sum(axis=0)
    fast = total > v
    v_k = share * np.where(fast, v / np.where(fast, total, 1.0), 0.0)
    late = dead_time(base, config) + max(channel.delay for channel in way)
    gained = approach.v * late + _gain(v_k, a, T).sum(axis=0)
    return np.where(fast, d - gained, -np.inf).max(axis=1)


def dead_time(base: BaseKind, config: Config) -> float:
    """[s] from a demand of the controller to the base's motion."""
    return config.admittance.period + config.disturbance.base_delay + base.drive_time_constant_s


def _retreat(
    d: Array, d_b: Array, approach: Approach, base: BaseKind, way: Sequence[Channel], config: Config
) -> tuple[Array, Array]:
    """(c, k, depths) acceleration [m/s²] and final speed [m/s] along n, of each channel."""
    admittance, kept = config.admittance, 1.0 - config.disturbance.slip
    n, p = approach.n, approach.p_b
    flat = float(np.hypot(n[0], n[1]))
    if flat < 1e-6:
        return np.zeros((len(way), *d.shape)), np.zeros((len(way), *d.shape))
    lever = n[1] * p[0] - n[0] * p[1]
    lever = np.copysign(max(abs(lever), _LEVER * abs(n[1])), lever)
    twists = np.array([channel.twist for channel in way])
    J = (twists @ [n[0], n[1], lever])[:, None, None]
    J_t = (twists @ [-n[1], n[0], n[0] * p[0] + n[1] * p[1]])[:, None, None]
    below = d_b - d
    aside = np.hypot(below, config.force.alpha_min)
    c, s = below / aside, config.force.alpha_min / aside
    rise = (below / (d_b - config.activation.d_full)).clip(0.0, 1.0)
    beta = rise * rise * (3.0 - 2.0 * rise)
    f = beta * config.force.f_max * (1.0 - d / d_b) * flat
    mass = _by_channel(way, base.mass_kg, base.inertia_kgm2)
    a_max = np.array([channel.a_max for channel in way])[:, None, None] * np.abs(J)
    w_max = np.array([_top(channel, admittance) for channel in way])[:, None, None] * np.abs(J)
    T = _time_constants(way, config)
    found = []
    for side in (1.0, -1.0):
        a = kept * (f * J / mass * (c * J + side * s * J_t)).clip(-a_max, a_max)
        found.append((a, (a * T).clip(-kept * w_max, kept * w_max)))
    worse = found[0][1].sum(axis=0) < found[1][1].sum(axis=0)
    (a1, w1), (a2, w2) = found
    return np.where(worse, a1, a2), np.where(worse, w1, w2)


def _time_constants(way: Sequence[Channel], config: Config) -> Array:
    """(c, 1, 1) [s] M_a / D_a of the admittance law."""
    c = config.admittance
    mass, damping = (
        _by_channel(way, c.mass, c.inertia),
        _by_channel(way, c.damping, c.angular_damping),
    )
    return np.minimum(mass / np.maximum(damping, 1e-9), _LONGEST)


def _by_channel(way: Sequence[Channel], linear: float, angular: float) -> Array:
    """(c, 1, 1) what resists each channel, from what resists a linear and an angular motion."""
    squares = np.square([channel.twist for channel in way])
    return (squares @ [linear, linear, angular])[:, None, None]


def _top(channel: Channel, config: AdmittanceConfig) -> float:
    """[m/s or rad/s] the largest speed of a channel that the law commands."""
    x, y, turn = channel.twist
    linear, angular = math.hypot(x, y), abs(turn)
    return min(
        channel.v_max,
        config.v_max / linear if linear > 0.0 else math.inf,
        config.omega_max / angular if angular > 0.0 else math.inf,
    )


def _gain(v: Array, a: Array, T: Array) -> Array:
    """[m] by how much a point of speed v gets ahead of one that starts with a and reaches a T."""
    final = np.maximum(a * T, 1e-12)
    ratio = np.minimum(v / final, 1.0 - 1e-9)
    return v * T + (final - v).clip(min=0.0) * T * np.log1p(-ratio)
