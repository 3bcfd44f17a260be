"""The base's drive: its response to a velocity command.

Every plant and the controller use the same model; the controller assumes no more about the drive
than `expected_acceleration`.
"""

from collections.abc import Sequence

import numpy as np

from app.robot.bases.kind import BaseKind
from app.strict import Array


class Drive:
    """The drive of a base; the kind of base defines the response to commands.

    The drive of a differential base has a first-order response to the commanded (v, ω), with limits
    of velocity and acceleration.
    """

    def __init__(self, base: BaseKind, dt: float) -> None:
        """A drive at rest; `dt` [s] is the period of `step`."""
        self._base, self._follow = base, base.follower(dt)
        self._at_rest = base.drive_at_rest()
        self.reset()

    def reset(self) -> None:
        """Stand still."""
        self.velocity = [0.0] * self._base.n_b
        """[m/s or rad/s] the n_b present velocities of the drive, along the base's axes."""
        self.state = self._at_rest
        """(n_d,) further states of the drive, such as a steering angle [rad]."""

    def step(self, v_cmd: Sequence[float] | Array) -> list[float]:
        """(n_b,) the velocity after one period of a command (n_b,), clamped to the limits."""
        command = np.asarray(v_cmd).tolist()
        self.velocity, self.state = self._follow(self.velocity, self.state, command)
        return self.velocity

    def expected_acceleration(
        self, v_cmd: Sequence[float] | Array, v: Sequence[float] | Array, state: Array | None = None
    ) -> Array:
        """(n_b,) [m/s² or rad/s²] present response of the drive to a command at a measured
        velocity.

        `v_cmd` and `v` are (n_b,). If `state` (n_d,), the drive's states other than the velocity,
        is None or empty, its value at rest is used.
        """
        known = self._at_rest if state is None or not len(state) else state
        return self._base.drive_acceleration(v, known, v_cmd)
