"""Interpolation of a planner's references, which arrive in steps, at 10 or 30 Hz with jitter.

A reference whose pose leaps, in comparison with its own velocity, is a sample. At each sample a
polynomial of fifth degree starts from the present reference position, velocity and acceleration.
It ends at the sample, with the mean velocity since the previous one, after two mean intervals
of samples: a steady motion stays steady, and jitter has no effect. Without a further sample it
comes to rest at the last one. A sample that is farther away than the correction speed allows, such
as the first one after a stall, is approached at that speed. The first reference, and references
without leaps, pass unchanged: the law itself limits the correction speed towards them.
"""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from app.compiled import compiled, direct
from app.control.tasks import Reference, pose_error
from app.strict import Array

_LEAP = 10.0  # [m/s² and rad/s²] acceleration in one period above which a reference is a sample
_RATE = 0.3  # [-] weight of the newest interval in the mean time between samples
_LONGEST = 0.25  # [s] longest time between samples of one motion
_LATE = 1.75  # [-] mean intervals after which no further sample is expected
_PEAK = 1.875  # [-] ratio of largest to mean speed of the polynomial from rest to rest
_POWERS = np.arange(6)


@compiled("Tuple((f8[::1], b1))(f8[:,:], f8[:], f8[:,:], f8[:], f8[:], f8)")
def way_between(
    R_a: Array, p_a: Array, R_b: Array, p_b: Array, velocity: Array, dt: float
) -> tuple[Array, bool]:
    """The way from pose a to pose b, and whether a velocity does not explain it.

    Args:
        R_a: (3, 3) rotation of a in the world.
        p_a: (3,) [m] origin of a in the world.
        R_b: (3, 3)
        p_b: (3,)
        velocity: (6,) linear [m/s] over angular [rad/s].
        dt: [s] time in which the way is covered.

    Returns:
        (6,) linear [m] over angular [rad], in axes of the world; and whether b is a leap.
    """
    way, leaps = pose_error(p_a, R_a, p_b, R_b), False
    for i in range(6):
        leaps = leaps or abs(way[i] - dt * velocity[i]) > _LEAP * dt**2
    return way, leaps


_way_between = direct(way_between)


class References:
    """The reference of each control step, from a planner's references."""

    def __init__(self, dt: float) -> None:
        """No reference; `dt` [s] is the control period."""
        self.dt = dt
        self.reset()

    def reset(self) -> None:
        """Start again: the next reference is the first one."""
        self._raw: Reference | None = None  # the previous one that was sent
        self._way: Array | None = None  # (6, 6) coefficients of the polynomial, while it is in use
        self._since, self._interval = 0.0, 0.0

    def next(self, sent: Reference, speed: float) -> Reference:
        """The reference of this step.

        Args:
            sent: The newest one.
            speed: [m/s and rad/s] largest speed towards a sample that is far away.
        """
        last, self._raw = self._raw, sent
        self._since += self.dt
        if last is None or (last is sent and self._way is None):
            return sent
        way, leaps = _way(last.pose, sent.pose, sent.velocity, self.dt)
        if leaps:
            between, self._since = self._since, 0.0
            if self._way is None:
                self._begin(last)
            if between > _LONGEST:  # the first sample of a motion
                self._interval = 0.0
                self._aim(sent, np.zeros(6), speed)
            else:
                mean = self._interval or between
                self._interval = mean + _RATE * (between - mean)
                own = sent.velocity.any()
                self._aim(sent, sent.velocity if own else way / between, speed)
        elif self._way is None:
            return sent
        return self._now(sent, speed)

    def _begin(self, at: Reference) -> None:
        """Start a polynomial at a reference."""
        self._origin = at.pose.copy()
        self._way = np.zeros((6, 6))
        self._way[1], self._way[2] = at.velocity, at.acceleration / 2.0
        self._t, self._end, self._moves_on = 0.0, np.inf, False

    def _aim(self, sent: Reference, velocity: Array, speed: float) -> None:
        """Continue from the present reference to a sample, with the final velocity (6,)."""
        state = self._state(self._t)
        self._origin = _moved(self._origin, state[0])
        goal, _ = _way(self._origin, sent.pose, sent.velocity, self.dt)
        far = max(np.linalg.norm(goal[:3]), np.linalg.norm(goal[3:]))
        duration = max(2.0 * self._interval, 2.0 * self.dt)
        slow = _PEAK * far / speed
        if slow > 2.0 * duration or not velocity.any():
            velocity, duration = np.zeros(6), max(slow, duration)
        self._moves_on = bool(velocity.any())
        self._way = _quintic(state[1], state[2], goal, velocity, duration)
        self._t, self._end = 0.0, duration

    def _state(self, t: float) -> Array:
        """(3, 6) displacement from the origin, velocity and acceleration of the polynomial."""
        if self._way is None:
            return np.zeros((3, 6))
        p = t**_POWERS
        v = _POWERS[1:] * p[:5]
        a = _POWERS[2:] * _POWERS[1:5] * p[:4]
        return np.array([p @ self._way, v @ self._way[1:], a @ self._way[2:]])

    def _now(self, sent: Reference, speed: float) -> Reference:
        """The reference on the polynomial, which comes to rest without a further sample."""
        self._t += self.dt
        if self._moves_on and self._since > _LATE * self._interval:
            self._aim(sent, np.zeros(6), speed)
            self._t = self.dt
        if self._t > self._end:
            self._way, self._interval = None, 0.0
            return sent
        way, v, a = self._state(self._t)
        return Reference(_moved(self._origin, way), v, a)


def _way(a: pin.SE3, b: pin.SE3, velocity: Array, dt: float) -> tuple[Array, bool]:
    """`way_between` of two poses."""
    return _way_between(a.rotation, a.translation, b.rotation, b.translation, velocity, dt)


def _moved(a: pin.SE3, way: Array) -> pin.SE3:
    """The pose after a way (6,) of `way_between`."""
    return pin.SE3(pin.exp3(way[3:]) @ a.rotation, a.translation + way[:3])


def _quintic(v: Array, a: Array, goal: Array, v_end: Array, T: float) -> Array:
    """(6, 6) coefficients, by power, from 0 at velocity v and acceleration a (6,) to a goal (6,).

    It arrives after T [s] at the velocity v_end (6,), without acceleration.
    """
    rest = goal - T * v - T**2 / 2.0 * a
    slope, bend = T * (v_end - v - T * a), -(T**2) * a
    c3 = 10.0 * rest - 4.0 * slope + 0.5 * bend
    c4 = -15.0 * rest + 7.0 * slope - bend
    c5 = 6.0 * rest - 3.0 * slope + 0.5 * bend
    return np.array([np.zeros(6), v, a / 2.0, c3 / T**3, c4 / T**4, c5 / T**5])
