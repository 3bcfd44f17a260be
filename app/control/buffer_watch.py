"""Monitors the speed at which the arm approaches the base, and the d_b that this speed requires."""

import math
from collections import deque
from operator import itemgetter
from typing import NamedTuple

import numpy as np

from app.compiled import compiled, direct
from app.config import Config, parameter
from app.control.buffer_need import Approach, buffer_need
from app.control.quantities import ControlStep
from app.robot.bases.kind import BaseKind
from app.robot.link_pairs import Pair
from app.robot.state import RobotState, point_velocity
from app.strict import Array

_SAMPLE = 10  # control steps between two readings of the speed
_EVERY = 50  # control steps between two evaluations of the mean reading
_REMEMBERED = 3.0  # [s] during which an approach is recent
_SLOW = 0.005  # [m/s] smallest approach speed
_FARTHEST = parameter("border.d_b").high  # [m] largest distance of an approach


class BufferReading(NamedTuple):
    """Whether d_b is sufficient."""

    approach_speed: float
    """[m/s] speed of the approach in the last 3 s that requires the largest d_b; 0 without one."""
    needed: float
    """[m] the d_b that this approach requires; infinite if the base cannot retreat that fast; 0
    without an approach."""
    approach_speed_max: float
    """[m/s] speed of the approach since the reset that requires the largest d_b."""
    needed_max: float
    """[m] the d_b that this approach requires."""
    too_small: bool
    """Whether `needed` exceeds the present d_b; False if the controller does not move the base."""
    too_small_ever: bool
    """The same for `needed_max`."""


class BufferWatch:
    """Evaluates the pairs of L_m step by step, and computes the required d_b.

    The approach speed is the speed of the arm's closest point along −n, relative to the floor. The
    speed relative to the base would be smaller while the base retreats. An approach counts while
    the arm's motion reduces the distance, if the distance is below the present d_b or below the d_b
    that the approach requires: an end-effector that is farther away can still slow down. An
    approach from above does not count, because no motion of the base helps.
    """

    def __init__(self, config: Config) -> None:
        self.config = config
        """The parameters; a caller can replace them at any time."""
        self.reset()

    def reset(self) -> None:
        """Forget all approaches."""
        self._steps = 0
        self._recent: deque[tuple[int, float, float]] = deque()
        self._speeds: dict[str, deque[tuple[float, float]]] = {}
        self._worst = 0.0, 0.0  # largest required d_b since the reset, and its speed

    def update(
        self, state: RobotState, control: ControlStep, dt: float, *, gives_way: bool
    ) -> BufferReading:
        """Evaluate one control step of dt [s] at the robot's state.

        `gives_way` states whether the controller moves the base away.
        """
        if self._steps % _SAMPLE == 0:
            look = self._steps % _EVERY == 0
            for i in range(control.n_mob):
                self._sample(state, control, i, look=look)
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

    def _sample(self, state: RobotState, control: ControlStep, i: int, *, look: bool) -> None:
        """Record the speeds of the i-th pair.

        With `look`, compute the required d_b if the mean of the recent speeds is an approach; a
        tremor has a small mean.
        """
        pair, row = control.pairs[i], control.rows[i][0]
        speeds = self._speeds.setdefault(pair.name, deque(maxlen=_EVERY // _SAMPLE))
        d, n, p = control.d.item(row), control.normal[row], control.p_b[row]
        if d > _FARTHEST or n.item(2) ** 2 > 0.5:
            speeds.clear()
            return
        speeds.append(approach_speeds(state, pair, p, n))
        if look:
            v, closing = (sum(column) / len(speeds) for column in zip(*speeds, strict=True))
            if min(v, closing) >= _SLOW:  # neither at rest, nor moving away
                approach = Approach(v, state.R_world_base.T @ n, state.to_base(p))
                self._judge(approach, d, state.model.description.base)

    def _judge(self, approach: Approach, d: float, base: BaseKind) -> None:
        needed = buffer_need(approach, base, self.config)
        if d > self.config.border.d_b and not d <= needed < float("inf"):
            return
        self._recent.append((self._steps, needed, approach.v))
        self._worst = max(self._worst, (needed, approach.v))


def approach_speeds(state: RobotState, pair: Pair, p_b: Array, n: Array) -> tuple[float, float]:
    """Speeds of the arm's closest point of a pair of L_m towards the base.

    Args:
        state: The robot's state.
        pair: The pair.
        p_b: (3,) [m] the arm's closest point, in the world.
        n: (3,) the pair's normal, in the world.

    Returns:
        [m/s] the speed relative to the floor, and the speed relative to the base, which the arm's
        motion alone causes.
    """
    joints = state.model.body_joints
    return _speeds_once(state.twists, joints[pair.b], joints[pair.a], p_b, n)


@compiled("UniTuple(f8, 2)(f8[:,:], i8, i8, f8[::1], f8[::1])")
def _speeds(twists: Array, arm: int, base: int, p_b: Array, n: Array) -> tuple[float, float]:
    """The result of `approach_speeds`, for bodies on two joints.

    Args:
        twists: (n_j, 6) twist of the body on each joint, as in `RobotState`.
        arm: Number of the arm's joint.
        base: Number of the base's joint.
        p_b: (3,) [m] the arm's closest point, in the world.
        n: (3,) the pair's normal, in the world.
    """
    v = -np.dot(n, np.array(point_velocity(twists[arm], p_b)))
    return v, v + np.dot(n, np.array(point_velocity(twists[base], p_b)))


_speeds_once = direct(_speeds)


def needed_text(needed: float) -> str:
    """A required d_b in readable form, rounded up to whole centimetres."""
    if math.isinf(needed):
        return "no d_b suffices"
    return f"d_b of {math.ceil(needed * 100 - 1e-9) / 100:.2f} m needed"


def buffer_warning(reading: BufferReading, config: Config) -> str | None:
    """The warning after a run with a too small d_b, or None."""
    if not reading.too_small_ever:
        return None
    text = (
        f"d_b = {config.border.d_b:.2f} m is too small: the arm approached at "
        f"{reading.approach_speed_max:.2f} m/s, and the base's command is up to "
        f"{config.admittance.period + config.disturbance.base_delay:.2f} s late: "
    )
    if math.isinf(reading.needed_max):
        return text + "no d_b suffices, because the base cannot retreat that fast"
    beyond = f", {_FARTHEST:.2f} m can be set" if reading.needed_max > _FARTHEST else ""
    return text + needed_text(reading.needed_max) + beyond
