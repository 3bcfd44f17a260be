"""The base's drive in a plant: its response to velocity commands.

The controller assumes the same response, as an acceleration (`BaseKind.drive_acceleration`).
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
        """A drive at rest; `dt` [s] is the duration of one `step`."""
        self._base, self._follow = base, base.follower(dt)
        self._at_rest = base.drive_at_rest()
        self.reset()

    def reset(self) -> None:
        """Set the drive to rest."""
        self.velocity = [0.0] * self._base.n_b
        """[m/s or rad/s] the n_b present velocities of the drive, along the base's axes."""
        self.state = self._at_rest
        """(n_d,) further states of the drive, such as a steering angle [rad]."""

    def step(self, v_cmd: Sequence[float] | Array) -> list[float]:
        """(n_b,) [m/s or rad/s] the velocity after one step with the velocity command (n_b,)."""
        command = np.asarray(v_cmd).tolist()
        self.velocity, self.state = self._follow(self.velocity, self.state, command)
        return self.velocity
