"""The base's admittance law without a controller."""

from __future__ import annotations

import numpy as np

from app.config import AdmittanceConfig
from app.control.algorithm import next_command
from app.control.controller import admissible_command
from app.control.inputs import largest_command
from app.robot.bases.kind import BaseKind

Array = np.ndarray


class RunningAdmittance:
    """Integrates the accelerations of all steps, and renews the command once per command period."""

    def __init__(self, base: BaseKind, config: AdmittanceConfig) -> None:
        """Start with the velocity command zero."""
        self._base, self._period = base, config.period
        self._M = base.by_axis(config.mass, config.inertia)
        self._D = base.by_axis(config.damping, config.angular_damping)
        self._v_max, self._a_max = largest_command(base, config), np.array(base.max_acceleration)
        self._sum, self._t = np.zeros(base.n_b), 0.0
        self.command = np.zeros(base.n_b)
        """(n_b,) [m/s or rad/s] the present velocity command."""

    def update(self, acceleration: Array, dt: float) -> Array:
        """The command (n_b,) after a step of dt [s] with an acceleration (n_b,)."""
        self._sum, self._t = self._sum + acceleration * dt, self._t + dt
        if self._t >= self._period - dt / 2:
            mean, before = self._sum / self._t, self.command
            law = self._t, self._M, self._D, self._a_max, self._v_max
            command = next_command(mean, before, *law)
            self.command = admissible_command(self._base, command, before, self._v_max)
            self._sum, self._t = np.zeros(len(mean)), 0.0
        return self.command
