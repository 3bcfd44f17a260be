"""What changes from one control step to the next: the base's place, torques, accelerations."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from app.robot.bases.kind import BaseKind
from app.simulation.session import Step

Array = np.ndarray

_DEAD_BAND = 0.01  # [m/s², rad/s²] within which an acceleration has no sign


class Changes:
    """Adds up over control steps.

    Attributes:
        path: [m] way of the base's centre.
        torque_jump: [N m] largest change of a torque of the arm in one step.
    """

    def __init__(self) -> None:
        self.path = self.torque_jump = 0.0
        self._last: Step | None = None

    def add(self, step: Step) -> None:
        """Take one control step."""
        if self._last is not None:
            jump = step.output.u_a - self._last.output.u_a
            self.torque_jump = max(self.torque_jump, *map(abs, jump.tolist()))
            x, y, _ = (step.truth.base_pose - self._last.truth.base_pose).tolist()
            self.path += math.hypot(x, y)
        self._last = step


class Smoothness:
    """Largest change a step and number of sign changes of an acceleration of the base.

    A sign counts once the acceleration has left the dead band of ±0.01 m/s² and ±0.01 rad/s². Of
    several axes of a kind, linear or angular, the worst one counts.
    """

    def __init__(self, base: BaseKind) -> None:
        self._angular = [axis.angular for axis in base.axes]
        self._last: list[float] | None = None
        self._sign = [0.0] * base.n_b
        self._jump = [0.0] * base.n_b
        self._changes = [0] * base.n_b

    def add(self, now: Array) -> None:
        """Take one control step's acceleration (n_b,)."""
        values = now.tolist()
        last = values if self._last is None else self._last
        for i, value in enumerate(values):
            jump = abs(value - last[i])
            if jump > self._jump[i]:
                self._jump[i] = jump
            if not -_DEAD_BAND <= value <= _DEAD_BAND:
                sign = math.copysign(1.0, value)
                self._changes[i] += sign * self._sign[i] < 0
                self._sign[i] = sign
        self._last = values

    @property
    def jumps(self) -> tuple[float, float]:
        """[m/s²] and [rad/s²] largest change in one step."""
        return self._worst(self._jump, angular=False), self._worst(self._jump, angular=True)

    def _worst(self, values: Sequence[float], *, angular: bool) -> float:
        sides = zip(values, self._angular, strict=True)
        return max((value for value, turns in sides if turns == angular), default=0.0)

    def figures(self, name: str) -> dict[str, object]:
        """Both, by linear and angular part."""
        return {
            f"{name}_jump_max": {
                "linear_mps2": self.jumps[0],
                "angular_radps2": self.jumps[1],
            },
            f"{name}_sign_changes": {
                "linear": int(self._worst(self._changes, angular=False)),
                "angular": int(self._worst(self._changes, angular=True)),
            },
        }
