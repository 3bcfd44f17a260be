"""The motion of a base in the plane of the floor."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

Array = np.ndarray


def world_twist(twist: Sequence[float], heading: float, dt: float) -> list[float]:
    """A base's twist in the world that moves it as it moves in its own frame, for one step.

    The direction is that of the middle of the step, which is exact on a circle.

    Args:
        twist: (3,) v_x, v_y [m/s] and ω [rad/s] in the base's frame.
        heading: [rad] of the base at the step's begin.
        dt: [s] the step.

    Returns:
        (3,) [m/s, m/s, rad/s] in the world.
    """
    x, y, w = twist
    phi = heading + 0.5 * w * dt
    c, s = math.cos(phi), math.sin(phi)
    return [x * c - y * s, x * s + y * c, w]


def base_twist(velocity: Sequence[float], heading: float) -> list[float]:
    """(3,) v_x, v_y [m/s] and ω [rad/s] in the base's frame, from those in the world (3,)."""
    c, s = math.cos(heading), math.sin(heading)
    x, y, w = velocity
    return [c * x + s * y, c * y - s * x, w]


def reduced_dynamics(S: Array, M: Array, h: Array, v: Array) -> tuple[Array, Array]:
    """M (n, n) and C q̇ + g (n,) of (26), from those of a robot on the world's x, y and yaw.

    Args:
        S: (3 + n_m, n) from q̇ to the velocity in the base's own axes.
        M: (3 + n_m, 3 + n_m) mass matrix where the base faces +x.
        h: (3 + n_m,) bias forces there.
        v: (3 + n_m,) velocity there.
    """
    # The world's axes stand still while the base turns: v̇ = S q̈ + (-ω v_y, ω v_x, 0).
    turning = np.zeros(len(v))
    turning[0], turning[1] = -v[2] * v[1], v[2] * v[0]
    return S.T @ M @ S, S.T @ (h + M @ turning)
