"""Curves beside the base that an end-effector tracks with constant orientation."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import pinocchio as pin

from app.control.tasks import Reference

Array = np.ndarray
Point = tuple[float, float, float]


class Curve(NamedTuple):
    """A line, or an arc about a vertical axis; a cubic in time from rest to rest, then a hold.

    Attributes:
        kind: `towards`, `diagonal` or `arc`.
        start: (3,) [m] start in the initial frame of the base.
        end: (3,) [m] end in that frame.
        centre: (2,) [m] centre of an arc, whose angle and radius change from start to end; None for
            a line.
        duration: [s] duration of the motion, without the hold.
    """

    kind: str
    start: Point
    end: Point
    centre: tuple[float, float] | None
    duration: float

    def place(self, s: float) -> tuple[Array, Array, Array]:
        """The point (3,) [m] at the share s of the curve, and its first two derivatives by s."""
        start, end = np.array(self.start), np.array(self.end)
        if self.centre is None:
            return start + s * (end - start), end - start, np.zeros(3)
        centre = np.array([*self.centre, 0.0])
        (r, angle), (r_end, angle_end) = _polar(start - centre), _polar(end - centre)
        turn = math.remainder(angle_end - angle, 2 * math.pi)
        dr, dz = r_end - r, end[2] - start[2]
        r, angle = r + s * dr, angle + s * turn
        out = np.array([math.cos(angle), math.sin(angle), 0.0])
        across = np.array([-out[1], out[0], 0.0])
        up = np.array([0.0, 0.0, 1.0])
        return (
            centre + r * out + (start[2] + s * dz) * up,
            dr * out + r * turn * across + dz * up,
            2 * dr * turn * across - r * turn**2 * out,
        )

    def reference(self, t: float, orientation: Array) -> Reference:
        """The reference of the end-effector at time t [s], with the orientation (3, 3)."""
        u = min(max(t / self.duration, 0.0), 1.0)
        rate = 6 * u * (1 - u) / self.duration
        change = 6 * (1 - 2 * u) / self.duration**2 if 0.0 < u < 1.0 else 0.0
        p, along, bend = self.place(u * u * (3 - 2 * u))
        velocity, acceleration = np.zeros(6), np.zeros(6)
        velocity[:3] = rate * along
        acceleration[:3] = change * along + rate**2 * bend
        return Reference(pin.SE3(orientation, p), velocity, acceleration)


def _polar(p: Array) -> tuple[float, float]:
    return math.hypot(p[0], p[1]), math.atan2(p[1], p[0])
