"""How far the arm holds its hand where it is while the base moves under it.

The method moves the base and leaves the hand to the arm. An arm that lacks a joint for it, or has
it at its limit, or stands at full stretch, does not hold the hand: the base takes it along, the
distance stays what it was, and the base would drive on with the hand before it. Our extension.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from app.avoidance.activation import cubic
from app.compiled import compiled
from app.robot.state import RobotState

Array = np.ndarray

_NONE, _ALL = 0.5, 0.8  # [-] of the base's speed: below the first the arm does not follow it at all
_HARDEST = 1e3  # [-] weight where the arm does not follow
_STOP = 5.0  # [1/s] speed towards its limit that counts of a joint, per room left
_WEAK = 0.2**2  # [m²/s²] what the arm can hardly do says nothing of where its joints go
_LEAST = 1e-9  # [m²/s²] against 0/0 of an arm that cannot lift its hand
_SIGN = 0.02  # [-] of its largest speed from which on a joint surely goes one way


class Holding(NamedTuple):
    """What the arm can do against the base's carrying its hand along.

    Attributes:
        share: [-] how much of the worst horizontal direction the arm makes up for, 0 to 1.
        weight: (2, 2) [-] on horizontal accelerations of the hand, in axes of the world, that the
            base causes: 0 along what the arm makes up for, large along what it does not.
    """

    share: float
    weight: Array


HELD = Holding(1.0, np.zeros((2, 2)))
"""The arm holds its hand whatever the base does."""


def arm_holding(state: RobotState, v_max: float) -> Holding:
    """How far the arm keeps its hand's place while the base moves at up to `v_max`.

    A direction counts fully where the arm moves its hand along it at 0.8 v_max or faster, and not
    at all below half of v_max; a cubic between. With the share s the weight along it is
    (1 - s) / s, up to a thousand.

    Args:
        state: The robot's state.
        v_max: [m/s] largest speed of the base.
    """
    xx, xy, yy = _ellipse(state)
    if 0.5 * (xx + yy) - math.hypot(0.5 * (xx - yy), xy) >= (_ALL * v_max) ** 2:
        return HELD  # as it is nearly always, without the directions, which cost time
    speeds, along = _axes(xx, xy, yy)
    shares = [cubic((s / v_max - _NONE) / (_ALL - _NONE)) for s in speeds]
    weight = np.array([(1.0 - s) / (s + 1.0 / _HARDEST) for s in shares])
    return Holding(min(shares), (along * weight) @ along.T)


def hand_speeds(state: RobotState) -> tuple[tuple[float, float], Array]:
    """How fast the arm moves its hand in the plane, at its height, the base at rest.

    They are half the axes of the ellipse that the joints' speeds make through the hand's Jacobian.
    A joint counts with its velocity limit, near a position limit with less: with what brings it
    there in 0.2 s, if that is where it goes when it makes up for the base's present motion.

    Args:
        state: The robot's state.

    Returns:
        [m/s] the smaller and the larger one, and (2, 2) their directions as columns, in the world.
    """
    return _axes(*_ellipse(state))


def _ellipse(state: RobotState) -> tuple[float, float, float]:
    model = state.model
    return _speed_squares(state.J_ee, state.qd, state.measurement.q_m, model.q_limits, model.qd_max)


def _axes(xx: float, xy: float, yy: float) -> tuple[tuple[float, float], Array]:
    mean, half = 0.5 * (xx + yy), math.hypot(0.5 * (xx - yy), xy)
    angle = 0.5 * math.atan2(2.0 * xy, xx - yy)  # of the larger one
    c, s = math.cos(angle), math.sin(angle)
    speeds = (math.sqrt(max(mean - half, 0.0)), math.sqrt(mean + half))
    return speeds, np.array([[-s, c], [c, s]])


@compiled()
def _squares(J: Array, speeds: Array) -> tuple[float, float, float, float, float, float]:
    """J_m W² J_mᵀ of the hand's place: its entries xx, xy, yy, xz, yz and zz [m²/s²]."""
    n_b = J.shape[1] - len(speeds)
    xx = xy = yy = xz = yz = zz = 0.0
    for i in range(len(speeds)):
        x, y, z = speeds[i] * J[0, n_b + i], speeds[i] * J[1, n_b + i], speeds[i] * J[2, n_b + i]
        xx += x * x
        xy += x * y
        yy += y * y
        xz += x * z
        yz += y * z
        zz += z * z
    return xx, xy, yy, xz, yz, zz


@compiled("UniTuple(f8, 3)(f8[:,:], f8[:], f8[:], f8[:,:], f8[:])")
def _speed_squares(
    J: Array, qd: Array, q_m: Array, q_limits: Array, qd_max: Array
) -> tuple[float, float, float]:
    """Entries xx, xy and yy [m²/s²] of the ellipse's matrix; see `hand_speeds`."""
    n_m = len(q_m)
    n_b = len(qd) - n_m
    x = y = 0.0
    for i in range(n_b):
        x += J[0, i] * qd[i]
        y += J[1, i] * qd[i]
    speeds = qd_max.copy()
    xx, xy, yy, xz, yz, zz = _squares(J, speeds)
    # What makes up for the base's motion: q̇ = -W² Jᵀ (J W² Jᵀ)⁻¹ (x, y, 0), W the speeds, damped.
    zz += _LEAST
    a, b, d = xx - xz * xz / zz + _WEAK, xy - xz * yz / zz, yy - yz * yz / zz + _WEAK
    det = a * d - b * b
    l_x, l_y = (b * y - d * x) / det, (b * x - a * y) / det
    l_z = -(xz * l_x + yz * l_y) / zz
    for i in range(n_m):
        k = n_b + i
        needed = qd_max[i] * (J[0, k] * l_x + J[1, k] * l_y + J[2, k] * l_z)  # [-] of q̇_max
        up = 0.5 + 0.5 * min(max(needed / _SIGN, -1.0), 1.0)
        upper = min(max(_STOP * (q_limits[1, i] - q_m[i]), 0.0), qd_max[i])
        lower = min(max(_STOP * (q_m[i] - q_limits[0, i]), 0.0), qd_max[i])
        speeds[i] = up * upper + (1.0 - up) * lower
    xx, xy, yy, xz, yz, zz = _squares(J, speeds)
    zz += _LEAST
    return xx - xz * xz / zz, xy - xz * yz / zz, yy - yz * yz / zz
