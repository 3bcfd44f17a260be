"""Monitor of the arm's approach speed to the base, and of the d_b that this speed requires."""

import math
from collections import deque
from operator import itemgetter
from typing import NamedTuple

import numpy as np

from app.compiled import compiled, direct
from app.config import Config, parameter
from app.control.buffer_need import Approach, buffer_need
from app.control.qp import fill, put
from app.control.quantities import ControlStep
from app.robot.state import RobotState, point_velocity
from app.strict import Array

_SAMPLE = 10  # control steps between two samples of the speed
_EVERY = 50  # control steps between two evaluations of the mean speed
_REMEMBERED = 3.0  # [s] during which an approach is recent
_SLOW = 0.005  # [m/s] smallest approach speed
_FARTHEST = parameter("border.d_b").high  # [m] largest distance of an approach


class BufferReading(NamedTuple):
    """Approach speeds, the d_b that they require, and whether d_b is too small."""

    approach_speed: float
    """[m/s] speed of the approach in the last 3 s that requires the largest d_b; 0 without one."""
    needed: float
    """[m] d_b that this approach requires; infinite if 2 m do not suffice, 0 without approach."""
    approach_speed_max: float
    """[m/s] speed of the approach since the reset that requires the largest d_b."""
    needed_max: float
    """[m] the d_b that the approach of `approach_speed_max` requires."""
    too_small: bool
    """Whether `needed` exceeds the configured d_b; False for controllers outside `MOVES_BASE`."""
    too_small_ever: bool
    """The same for `needed_max`."""


class BufferWatch:
    """Evaluates the pairs of arm and base step by step, and computes the required d_b.

    The approach speed is the speed of the arm's closest point along −n, relative to the floor. The
    speed relative to the base would be smaller while the base retreats. An approach counts while
    the arm's motion reduces the distance, and the distance is at most the configured d_b, or the
    required d_b if this is finite. An approach steeper than 45°, where motion of the base hardly
    helps, or at a distance above 0.3 m, the largest valid d_b, does not count.
    """

    def __init__(self, config: Config) -> None:
        self.config = config
        """The parameters; a caller can replace them at any time."""
        self.reset()

    def reset(self) -> None:
        """Forget all approaches."""
        self._steps = 0
        self._recent: deque[tuple[int, float, float]] = deque()
        self._worst = 0.0, 0.0  # largest required d_b since the reset, and its speed

    def update(
        self, state: RobotState, control: ControlStep, dt: float, *, gives_way: bool
    ) -> BufferReading:
        """Sample every 10th control step of dt [s], evaluate every 50th; return the newest reading.

        `gives_way` states whether the controller is in `app.control.inputs.MOVES_BASE`.
        """
        if self._steps % _SAMPLE == 0:
            if self._steps == 0:
                joint_of, pairs = state.model.body_joints, control.pairs[: control.n_mob]
                joints = [joint_of[body] for pair in pairs for body in pair]
                self._joints = np.array(joints, dtype=int).reshape(-1, 2)
                self._speeds = np.full((len(pairs), _EVERY // _SAMPLE, 2), np.nan)
            seen = control.d, control.p_b, control.normal
            _sample_once(state.twists, self._joints, *seen, _FARTHEST, self._speeds)
            if self._steps % _EVERY == 0:
                self._look(state, control)
            while self._recent and (self._steps - self._recent[0][0]) * dt > _REMEMBERED:
                self._recent.popleft()
            needed, speed = max(map(itemgetter(1, 2), self._recent), default=(0.0, 0.0))
            (needed_max, speed_max), d_b = self._worst, self.config.border.d_b
            self._reading = BufferReading(
                speed,
                needed,
                speed_max,
                needed_max,
                too_small=gives_way and needed > d_b,
                too_small_ever=gives_way and needed_max > d_b,
            )
        self._steps += 1
        return self._reading

    def _look(self, state: RobotState, control: ControlStep) -> None:
        """Compute the required d_b of each pair that approaches in the mean of 50 steps."""
        for i, speeds in enumerate(self._speeds.tolist()):
            if not (known := [each for each in speeds if not math.isnan(each[0])]):
                continue
            v, closing = (sum(column) / len(known) for column in zip(*known, strict=True))
            if min(v, closing) < _SLOW:  # at rest, or moving away
                continue
            n, p = state.R_world_base.T @ control.normal[i], state.to_base(control.p_b[i])
            needed = buffer_need(Approach(v, n, p), state.model.description.base, self.config)
            d = control.d.item(i)
            if d <= self.config.border.d_b or (math.isfinite(needed) and d <= needed):
                self._recent.append((self._steps, needed, v))
                self._worst = max(self._worst, (needed, v))


@compiled("UniTuple(f8, 2)(f8[:,:], i8[:], f8[::1], f8[::1])")
def approach_speeds(twists: Array, joints: Array, p_b: Array, n: Array) -> tuple[float, float]:
    """[m/s] speeds of the arm's closest point p_b (3,) [m] of a pair towards the base.

    The first is relative to the floor, the second to the base: only the joints of the arm cause it.
    `twists` (n_j, 6) are those of `RobotState`, n (3,) the pair's normal, both in the world like
    p_b; `joints` (2,) are the joints that move the base and the arm's body.
    """
    v = -np.dot(n, np.array(point_velocity(twists[joints[1]], p_b)))
    return v, v + np.dot(n, np.array(point_velocity(twists[joints[0]], p_b)))


@compiled("void(f8[:,:], i8[:,:], f8[:], f8[:,::1], f8[:,::1], f8, f8[:,:,::1])")
def _sample(
    twists: Array, joints: Array, d: Array, p_b: Array, n: Array, farthest: float, speeds: Array
) -> None:
    """Append `approach_speeds` of each pair of L_m to the pair's last `speeds` (n_mob, k, 2).

    They become NaN while the distance exceeds `farthest` [m], or the normal is steeper than 45°.
    """
    last = speeds.shape[1] - 1
    for i in range(len(joints)):
        if d[i] > farthest or n[i, 2] ** 2 > 0.5:
            fill(speeds[i].ravel(), np.nan)
            continue
        for k in range(last):
            put(speeds[i, k], speeds[i, k + 1])
        put(speeds[i, last], approach_speeds(twists, joints[i], p_b[i], n[i]))


_sample_once = direct(_sample)


def needed_text(needed: float) -> str:
    """A text with a required d_b [m], rounded up to centimetres, or that no d_b suffices.

    If the required d_b exceeds the largest d_b that can be set, the text also has the latter.
    """
    if math.isinf(needed):
        return "no d_b suffices"
    beyond = f", at most {_FARTHEST:.2f} m can be set" if needed > _FARTHEST else ""
    return f"d_b of {math.ceil(needed * 100 - 1e-9) / 100:.2f} m needed{beyond}"


def buffer_warning(reading: BufferReading, config: Config) -> str | None:
    """The warning after a run in which d_b was too small, otherwise None."""
    if not reading.too_small_ever:
        return None
    text = (
        f"d_b = {config.border.d_b:.2f} m is too small: the arm approached at "
        f"{reading.approach_speed_max:.2f} m/s, and the base's command is up to "
        f"{config.admittance.period + config.disturbance.base_delay:.2f} s late: "
    )
    if math.isinf(reading.needed_max):
        return text + "no d_b suffices, because the base cannot retreat that fast"
    return text + needed_text(reading.needed_max)
