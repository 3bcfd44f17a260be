"""The motion of a base in the plane of the floor."""

from __future__ import annotations

import math
from collections.abc import Sequence


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
