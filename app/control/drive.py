"""The base's drive: how the wheels follow a velocity command.

The same model stands in every plant and in the controller, which may assume no more of the drive
than `expected_acceleration` says.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from app.robot.description import BaseDescription

Array = np.ndarray


class Drive:
    """A first-order response to the commanded (v, ω), with limits of velocity and acceleration.

    Attributes:
        velocity: (2,) the velocity that the wheels are set to now: v [m/s], ω [rad/s].
    """

    def __init__(self, base: BaseDescription, dt: float) -> None:
        """A drive at rest.

        Args:
            base: Time constant and limits.
            dt: [s] between two steps.
        """
        self._max_velocity = base.max_velocity
        self._max_acceleration = base.max_acceleration
        self._tau = base.drive_time_constant_s
        self._dt = dt
        # Exact for a command held over the step, so that any dt is stable.
        self._gain = -math.expm1(-dt / self._tau)
        self.velocity = np.zeros(2)

    def reset(self) -> None:
        """Stand still."""
        self.velocity = np.zeros(2)

    def step(self, v_cmd: Sequence[float] | Array) -> Array:
        """Follow a command for one period.

        Args:
            v_cmd: (2,) commanded v [m/s] and ω [rad/s]; clamped to the velocity limits.

        Returns:
            (2,) v [m/s] and ω [rad/s] at the end of the period.
        """
        self.velocity = np.array(
            [
                v + _clamp((_clamp(float(cmd), v_max) - v) * self._gain, a_max * self._dt)
                for v, cmd, v_max, a_max in zip(
                    self.velocity.tolist(), v_cmd, self._max_velocity, self._max_acceleration,
                    strict=True,
                )
            ]
        )  # fmt: skip
        return self.velocity

    def expected_acceleration(
        self, v_cmd: Sequence[float] | Array, v: Sequence[float] | Array
    ) -> Array:
        """What the drive does now with a command: clip((v_cmd - v)/τ, ±limits).

        Args:
            v_cmd: (2,) commanded v [m/s] and ω [rad/s].
            v: (2,) measured v [m/s] and ω [rad/s].

        Returns:
            (2,) v̇ [m/s²] and ω̇ [rad/s²].
        """
        return np.array(
            [
                _clamp((_clamp(float(cmd), v_max) - float(now)) / self._tau, a_max)
                for cmd, now, v_max, a_max in zip(
                    v_cmd, v, self._max_velocity, self._max_acceleration, strict=True
                )
            ]
        )


def _clamp(value: float, limit: float) -> float:
    return min(max(value, -limit), limit)
