"""The base's velocity command: an admittance law at the base's own slow rate (§4.1)."""

from __future__ import annotations

import numpy as np

from app.config import AdmittanceConfig
from app.robot.description import BaseDescription

Array = np.ndarray


class AdmittanceLaw:
    """M_a v̇ + D_a v = F, solved from one command to the next; F = M_a q̈_b.

    The input is the desired acceleration times the virtual mass, not the base's part of u, which is
    not zero at q̈_b = 0 and would let the base drift. It is averaged over a command's period, so
    that nothing that the 1 kHz controller asks is lost between two commands.

    Attributes:
        command: (2,) v [m/s] and ω [rad/s], as last sent.
    """

    def __init__(self, base: BaseDescription, config: AdmittanceConfig) -> None:
        self._v_max = np.array(base.max_velocity)
        self._a_max = np.array(base.max_acceleration)
        self.config = config
        self.reset()

    def reset(self) -> None:
        """Command rest and forget what was asked."""
        self.command = np.zeros(2)
        self._sum = np.zeros(2)
        self._time = 0.0

    def update(self, acceleration: Array, dt: float) -> Array:
        """Take the desired acceleration of one control step; renew the command when it is due.

        Args:
            acceleration: (2,) v̇ [m/s²] and ω̇ [rad/s²] of the controller.
            dt: [s] control step.

        Returns:
            (2,) the velocity command in force.
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
        mass = np.array([c.mass, c.inertia])
        damping = np.array([c.damping, c.angular_damping])
        decay = damping / mass * period
        # (1 - e^{-x}) / x, which is 1 at x = 0
        gain = np.where(decay > 1e-12, -np.expm1(-decay) / np.maximum(decay, 1e-12), 1.0)
        F = mass * acceleration
        change = gain * (F - damping * self.command) / mass * period
        change = np.clip(change, -self._a_max * period, self._a_max * period)
        v_max = np.minimum(self._v_max, [c.v_max, c.omega_max])
        return np.clip(self.command + change, -v_max, v_max)
