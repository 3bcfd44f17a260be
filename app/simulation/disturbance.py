"""What stands between the controller and the robot: noise, delay, slip (`DisturbanceConfig`).

The error of the arm's masses is none of these: it is in the controller's model (`RobotState`).
"""

from __future__ import annotations

import math
from collections import deque

import numpy as np

from app.config import DisturbanceConfig, parameter
from app.robot.state import Measurement

Array = np.ndarray

_BANDWIDTH = 250.0  # [rad/s] of the loop that makes velocities of noisy positions; about 40 Hz


class Disturbances:
    """Sensors and base commands as they are, made into those that arrive.

    Attributes:
        config: What is disturbed by how much; may be replaced at any time.
    """

    def __init__(self, config: DisturbanceConfig, dt: float, seed: int) -> None:
        """Begin like after `reset`.

        Args:
            config: What is disturbed by how much.
            dt: [s] control step.
            seed: Of the noise.
        """
        self.config = config
        self._dt = dt
        self._seed = seed
        longest = round(parameter("disturbance.base_delay").high / dt)
        self._commands: deque[Array] = deque(maxlen=longest + 1)
        self.reset()

    def reset(self) -> None:
        """Begin the noise anew and forget all commands."""
        self._rng = np.random.default_rng(self._seed)
        self._tracking: VelocityTracking | None = None
        self._commands.clear()

    def sensed(self, truth: Measurement) -> Measurement:
        """What the sensors say once a control step; the truth itself without noise.

        Each joint's position has white noise added. Its velocity is then no reading of its own: as
        on a robot with encoders only, it is made from the noisy positions by `VelocityTracking`.
        The base's sensors have no noise.
        """
        if self.config.encoder_noise == 0.0:
            self._tracking = None
            return truth
        noise = self.config.encoder_noise * self._rng.standard_normal(len(truth.q_m))
        q_m = truth.q_m + noise
        if self._tracking is None:
            self._tracking = VelocityTracking(truth.q_m, truth.qd_m, self._dt)
        return truth._replace(q_m=q_m, qd_m=self._tracking.update(q_m))

    def arriving(self, command: Array) -> Array:
        """(n_b,) [m/s or rad/s] the command that takes effect, less what slips.

        Args:
            command: (n_b,) the command in force at this control step. Before the first there was
                rest.
        """
        self._commands.append(command)
        steps = round(self.config.base_delay / self._dt)
        late = self._commands[-1 - steps] if steps < len(self._commands) else np.zeros_like(command)
        return (1.0 - self.config.slip) * late


class VelocityTracking:
    """Velocities from positions: a tracking loop, as the electronics of encoders have it.

    v̂ follows q by ω² s / (s + ω)², exactly discretised: constant velocities come out right, a
    change comes late by 2/ω = 8 ms. White noise of deviation σ on the positions becomes a deviation
    of about σ √(ω³ dt) / 2 of the velocities, 62 σ/s at 1 kHz.
    """

    def __init__(self, q: Array, qd: Array, dt: float) -> None:
        """A loop that has settled.

        Args:
            q: (n,) [rad or m] positions at the first update.
            qd: (n,) [rad/s or m/s] velocities.
            dt: [s] between two updates.
        """
        pole = math.exp(-_BANDWIDTH * dt)  # twice: critically damped
        self._gain_q, self._gain_v = 1.0 - pole**2, (1.0 - pole) ** 2 / dt
        self._q, self._qd, self._dt = q - qd * dt, qd.copy(), dt

    def update(self, q: Array) -> Array:
        """(n,) [rad/s or m/s] velocities after one more position, (n,) [rad or m]."""
        ahead = self._q + self._qd * self._dt
        error = q - ahead
        self._q = ahead + self._gain_q * error
        self._qd = self._qd + self._gain_v * error
        return self._qd.copy()
