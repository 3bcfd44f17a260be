"""The base's velocity command: an admittance law at the base's own slow rate (§4.1)."""

from typing import NamedTuple

import numpy as np

from app.config import AdmittanceConfig
from app.robot.bases.kind import BaseKind
from app.strict import Array


class AdmittanceLaw:
    """M_a v̇ + D_a v = F, solved from one command to the next; F = M_a q̈_b.

    The input is the desired acceleration times the virtual mass, not the base's part of u, which is
    not zero at q̈_b = 0 and would let the base drift. It is averaged over a command's period, so
    that nothing that the 1 kHz controller asks is lost between two commands.
    """

    def __init__(self, base: BaseKind, config: AdmittanceConfig) -> None:
        self._base = base
        self._a_max = np.array(base.max_acceleration)
        self.config = config
        self.reset()

    def reset(self) -> None:
        """Command rest and forget what was asked."""
        self.command = np.zeros(self._base.n_b)
        """(n_b,) [m/s or rad/s] along the base's axes, as last sent."""
        self._sum = np.zeros(self._base.n_b)
        self._time = 0.0

    def update(self, acceleration: Array, dt: float) -> Array:
        """Take the acceleration (n_b,) [m/s² or rad/s²] that one control step of dt [s] asks for.

        Returns:
            (n_b,) the velocity command in force, renewed when it is due.
        """
        self._sum += acceleration * dt
        self._time += dt
        if self._time >= self.config.period - dt / 2:
            self.command = self._next_command(self._sum / self._time, self._time)
            self._sum[:] = 0.0
            self._time = 0.0
        return self.command

    def _next_command(self, acceleration: Array, period: float) -> Array:
        """The law's exact solution after one period of constant F, within the base's limits."""
        c = self.config
        mass = by_axis(self._base, c.mass, c.inertia)
        damping = by_axis(self._base, c.damping, c.angular_damping)
        gain = _gain(damping / mass * period)
        F = mass * acceleration
        change = gain * (F - damping * self.command) / mass * period
        change = np.clip(change, -self._a_max * period, self._a_max * period)
        v_max = largest_command(self._base, c)
        wanted = np.clip(self.command + change, -v_max, v_max)
        found = self._base.admissible(wanted, self.command)
        # A base whose axes depend on each other may get more of one; its direction stays.
        over = float(np.max(np.abs(found) / v_max))
        return found / over if over > 1.0 else found


class Response(NamedTuple):
    """Of an acceleration a the law makes gain (a - drag ν) on average, ν being the velocity."""

    gain: Array
    """(n_b,) [-]"""
    drag: Array
    """(n_b,) [1/s]"""


def response(base: BaseKind, config: AdmittanceConfig) -> Response:
    """The law's response of each axis, within its limits."""
    drag = by_axis(base, config.damping / config.mass, config.angular_damping / config.inertia)
    return Response(_gain(drag * config.period), drag)


def _gain(decay: Array) -> Array:
    """(1 - e^{-x}) / x, which is 1 at x = 0."""
    return np.where(decay > 1e-12, -np.expm1(-decay) / np.maximum(decay, 1e-12), 1.0)


def largest_command(base: BaseKind, config: AdmittanceConfig) -> Array:
    """(n_b,) [m/s or rad/s] up to which the law commands each axis."""
    return np.minimum(base.max_velocity, by_axis(base, config.v_max, config.omega_max))


def by_axis(base: BaseKind, linear: float, angular: float) -> Array:
    """(n_b,) one of two numbers for each axis of a base."""
    return np.array([angular if axis.angular else linear for axis in base.axes])
