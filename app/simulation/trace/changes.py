"""What changes from one control step to the next: the base's place, torques, accelerations."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from typing import Generic, TypeVar

import numpy as np

from app.robot.bases.kind import BaseKind

Array = np.ndarray
Taken = TypeVar("Taken")

_TOGETHER = 100  # control steps
_DEAD_BAND = 0.01  # [m/s², rad/s²] within which an acceleration has no sign
_TORQUE_BAND = 0.003  # [N m] or [N] a step, within which a torque's rate has none


class Batch(Generic[Taken]):
    """What is taken of steps waits until there is enough to look at together, which is far quicker.

    Not whole steps: each is hundreds of objects, which the garbage collector would look through.
    """

    def __init__(self, take: Callable[[Sequence[Taken]], None]) -> None:
        """Nothing waits.

        Args:
            take: Called with what waited, never nothing, in its order.
        """
        self._take = take
        self._waiting: list[Taken] = []

    def add(self, taken: Taken) -> None:
        """Take what is needed of one control step."""
        self._waiting.append(taken)
        if len(self._waiting) >= _TOGETHER:
            self.flush()

    def flush(self) -> None:
        """Nothing waits any longer."""
        if self._waiting:
            waiting, self._waiting = self._waiting, []
            self._take(waiting)


class SignChanges:
    """Counts changes of sign of each of several numbers, that leave a dead band in between.

    Attributes:
        counts: (k,) so far.
    """

    def __init__(self, count: int, band: float) -> None:
        self.counts = np.zeros(count, dtype=int)
        self._band = band
        self._signs = np.zeros(count)

    def add(self, values: Array) -> None:
        """Take the next values, (steps, k)."""
        for i, column in enumerate(values.T):
            signs = np.append(self._signs[i], np.sign(column[np.abs(column) > self._band]))
            self.counts[i] += np.count_nonzero(signs[1:] * signs[:-1] < 0.0)
            self._signs[i] = signs[-1]


class Changes:
    """Adds up over control steps.

    Attributes:
        path: [m] way of the base's centre.
        torque_jump: [N m] largest change of a torque of the arm in one step.
    """

    def __init__(self) -> None:
        self.path = self.torque_jump = 0.0
        self._reversals: SignChanges | None = None
        self._torques: Array | None = None
        self._pose: Array | None = None

    def add(self, torques: Array, poses: Array) -> None:
        """Take the arm's torques (k, n_m) and the base's poses (k, 3) of the next control steps."""
        changes = np.diff(_after(self._torques, torques), axis=0)
        self.torque_jump = _largest(np.abs(changes).ravel(), self.torque_jump)
        self._reversals = self._reversals or SignChanges(torques.shape[1], _TORQUE_BAND)
        self._reversals.add(changes)
        x, y, _ = np.diff(_after(self._pose, poses), axis=0).T
        self.path += float(np.hypot(x, y).sum())
        self._torques, self._pose = torques[-1], poses[-1]

    @property
    def torque_rate_sign_changes(self) -> int:
        """How often the rate of the most restless torque changes its sign, at 3 N m/s and more."""
        return 0 if self._reversals is None else int(self._reversals.counts.max())


class Smoothness:
    """Largest change a step and number of sign changes of an acceleration of the base.

    A sign counts once the acceleration has left the dead band of ±0.01 m/s² and ±0.01 rad/s². Of
    several axes of a kind, linear or angular, the worst one counts.
    """

    def __init__(self, base: BaseKind) -> None:
        self._angular = [axis.angular for axis in base.axes]
        self._last: Array | None = None
        self._jump = [0.0] * base.n_b
        self._signs = SignChanges(base.n_b, _DEAD_BAND)

    def add(self, values: Array) -> None:
        """Take the accelerations (k, n_b) of the next control steps."""
        changes = np.diff(_after(self._last, values), axis=0)
        self._last = values[-1]
        for i, jumps in enumerate(np.abs(changes).T):
            self._jump[i] = _largest(jumps, self._jump[i])
        self._signs.add(values)

    @property
    def jumps(self) -> tuple[float, float]:
        """[m/s²] and [rad/s²] largest change in one step."""
        return self._worst(self._jump, angular=False), self._worst(self._jump, angular=True)

    def _worst(self, values: Iterable[float], *, angular: bool) -> float:
        sides = zip(values, self._angular, strict=True)
        return max((value for value, turns in sides if turns == angular), default=0.0)

    def figures(self, name: str) -> dict[str, object]:
        """Both, by linear and angular part."""
        return {
            f"{name}_jump_max": {"linear_mps2": self.jumps[0], "angular_radps2": self.jumps[1]},
            f"{name}_sign_changes": {
                "linear": int(self._worst(self._signs.counts, angular=False)),
                "angular": int(self._worst(self._signs.counts, angular=True)),
            },
        }


def _after(last: Array | None, values: Array) -> Array:
    """Values (k, …) of control steps, below those of the step before them if there was one."""
    return values if last is None else np.vstack([last, values])


def _largest(values: Array, so_far: float) -> float:
    """What is not a number is not the largest."""
    return float(np.fmax.reduce(values, initial=so_far))
