"""Jumps of the base's commanded acceleration along smooth motions inside the buffer.

The change of the acceleration in one step is large if the acceleration is steep, or if it jumps. A
smaller step reduces the change of a steep acceleration, but not that of a jump. Therefore the
motion is evaluated with smaller steps around the places with the largest changes. The change,
extrapolated to a step of zero, is the jump.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from typing import Any, Literal, NamedTuple

import numpy as np
import pinocchio as pin

from app.control.controller import Controller
from app.control.tasks import Reference
from app.robot.model import RobotModel
from app.robot.state import RobotState
from benchmarks.law.motions import Motion, one_joint_motion, random_motion
from benchmarks.law.options import Options
from benchmarks.law.postures import posture_in_buffer
from benchmarks.law.report import Report, largest
from benchmarks.law.robot import load
from benchmarks.law.work import played

Array = np.ndarray

_FIXED = 1.15216, 1.65208, 0.78478, -1.35999, 2.19699, 3.33947, -0.46618
"""(7,) [rad] joint positions of the paper's robot in the fixed state."""
_FIXED_SPEED = 0.2  # [rad/s] speed of the moving joint in this state
_STEP = 0.001  # [s] time between two evaluations
_FINER = 0.5, 0.25, 0.125  # [-] refined steps, as shares of `_STEP`
_WINDOW = 2  # [-] number of steps of `_STEP` before and after the worst one that are refined
_OFF = np.array([0.003, -0.002, 0.001])  # [m] offset of the reference from the end-effector
_ASKED = 0.02, 0.05  # [m/s²] and [rad/s²] largest accepted change in one step
Kind = Literal["guided", "tracking", "tracking-limited"]
KINDS: dict[Kind, tuple[str, str]] = {
    "guided": ("guided", "robot"),
    "tracking": ("tracking", "wide"),
    "tracking-limited": ("tracking", "robot"),
}
"""Modes of the law: with or without a reference, and the limits of the robot.

The arm's limits do not act on the base of a guided robot. The last kind includes changes of active
limits, so it has no bound.
"""


class Path(NamedTuple):
    """A motion and the mode of the law along it.

    Attributes:
        options: Robot, controller and seed.
        number: Number of the random motion; with a negative number, one joint of the fixed state
            moves.
        mode: `tracking` with a reference, `guided` without one.
        limits: `robot` for the robot's limits, `wide` for limits that no motion reaches.
        duration: [s] duration of the motion.
        speed: [m/s] largest speed of the end-effector.
    """

    options: Options
    number: int
    mode: str
    limits: str
    duration: float
    speed: float


class Refinement(NamedTuple):
    """Place of a path that is evaluated with smaller steps, around the time t [s]."""

    path: Path
    t: float


def continuity(
    options: Options,
    count: int = 1000,
    duration: float = 0.2,
    speed: float = 0.25,
    refined: int = 12,
    first: int = 0,
    kinds: tuple[Kind, ...] = tuple(KINDS),
) -> Report:
    """Evaluate smooth random motions of arm and base inside the buffer, in steps of 1 ms.

    Args:
        options: See `Options`.
        count: Number of random motions.
        duration: [s] duration of each motion.
        speed: [m/s] largest speed of the end-effector.
        refined: Number of motions that are refined at their largest change, and of motions that are
            refined at their largest kink, for each mode and for linear and angular acceleration.
        first: Number of the first motion. With 0, the paper's robot also has motions from a fixed
            state, one for each joint.
        kinds: Modes of the law: see `KINDS`.
    """
    fixed = load(options.robot).model.n_m if options.robot == "husky_panda" and first == 0 else 0
    own = range(first - fixed, first + count)
    rows = []
    for kind in kinds:
        paths = [Path(options, k, *KINDS[kind], duration, speed) for k in own]
        rows.append(_row(kind, paths, refined, options.jobs))
    judged = [row for row in rows if row["kind"] != "tracking-limited"]
    summary = {
        "paths": count,
        "hand_speed_mps": speed,
        "asked_mps2": _ASKED[0],
        "asked_radps2": _ASKED[1],
        "away_from_limits_mps2": largest(judged, "linear_mps2_per_ms"),
        "away_from_limits_radps2": largest(judged, "angular_radps2_per_ms"),
        "jump_mps2": largest(judged, "linear_jump_mps2"),
        "jump_radps2": largest(judged, "angular_jump_radps2"),
    }
    return Report("continuity", rows, summary)


def _row(kind: str, paths: list[Path], refined: int, jobs: int) -> dict[str, Any]:
    """Row of one mode: the largest changes of the acceleration in a step, and the largest jumps."""
    worst = played(_worst, paths, jobs, kind)
    found: dict[str, Any] = {"kind": kind}
    for axis, (name, unit) in enumerate((("linear", "mps2"), ("angular", "radps2"))):
        change = np.array([each[axis].change for each in worst])
        kink = np.array([each[axis].kink for each in worst])
        # At a jump the change is large, and differs from the changes before and after it (kink).
        chosen = {(int(k), worst[k][axis].t) for k in np.argsort(-change)[:refined]}
        chosen |= {(int(k), worst[k][axis].t_kink) for k in np.argsort(-kink)[:refined]}
        places = [Refinement(paths[k], t) for k, t in sorted(chosen)]
        by_step = np.array(played(_refined, places, jobs, f"{kind}: refined"))[:, :, axis]
        jumps = jumps_of(by_step)
        steepest, jump = int(np.argmax(by_step[:, 0])), int(np.argmax(jumps))
        found |= {
            f"{name}_{unit}_per_ms": float(change.max()),
            f"{name}_median_{unit}_per_ms": float(np.median(change)),
            f"paths_over_{name}": int((change > _ASKED[axis]).sum()),
            f"{name}_jump_{unit}": float(jumps[jump]),
            f"{name}_steepest": _place(places[steepest], by_step[steepest]),
            f"{name}_at_jump": _place(places[jump], by_step[jump]),
        }
    return found


def jumps_of(by_step: Array) -> Array:
    """(k,) limits of changes (k, steps) for a step of zero; each step is half of the previous one.

    The change of a steep acceleration halves with the step, so its limit is 0. The change of an
    acceleration that jumps does not depend on the step.
    """
    return np.maximum(2 * by_step[:, -1] - by_step[:, -2], 0.0)


def _place(place: Refinement, by_step: Array) -> str:
    """A row: motion and time of `place`, and the changes in steps of 1, 0.5, 0.25 and 0.125 ms."""
    changes = ", ".join(f"{change:.3g}" for change in by_step)
    return f"{place.path.number} at {place.t:.3f} s: {changes}"


class Worst(NamedTuple):
    """The largest change in one step and the largest kink, with their times [s].

    A kink is the difference between a change and the mean of its two neighbours.
    """

    change: float
    t: float
    kink: float
    t_kink: float


def _worst(path: Path) -> tuple[Worst, Worst]:
    """The `Worst` of the base's linear acceleration, and that of its angular acceleration.

    The acceleration is evaluated along a path, in steps of 1 ms.
    """
    times = np.arange(0.0, path.duration, _STEP)
    changes = _changes(path, times, _STEP)
    found = []
    for change in changes.T:
        kinks = np.abs(change[1:-1] - 0.5 * (change[:-2] + change[2:]))
        k, j = int(np.argmax(change)), int(np.argmax(kinks)) + 1
        found.append(Worst(float(change[k]), float(times[k]), float(kinks[j - 1]), float(times[j])))
    return found[0], found[1]


def _refined(place: Refinement) -> list[list[float]]:
    """(steps, 2) largest changes in one step around a place, for steps of decreasing length.

    The columns are the base's linear and angular acceleration, as in `_changes`.
    """
    found = []
    for share in (1.0, *_FINER):
        h = share * _STEP
        # Each sequence of instants includes the instants of the longest step. The first instants
        # are not evaluated: they only fill the law's memory.
        begin = max(place.t - 4 * _WINDOW * _STEP, 0.0)
        times = np.arange(begin, place.t + (_WINDOW + 1) * _STEP + 0.5 * h, h)
        inside = times[1:] > place.t - _WINDOW * _STEP
        found.append(_changes(place.path, times, h)[inside].max(axis=0).tolist())
    return found


def _changes(path: Path, times: Sequence[float] | Array, h: float) -> Array:
    """(k - 1, 2) changes of the base's linear and angular acceleration between successive `times`.

    `times` (k,) [s] are h [s] apart. The commanded accelerations are limited to ±a_max. The change
    is 0 if two bodies of a pair touch, because the law need not be continuous there.
    """
    options = path.options
    controller = _controller(options.robot, options.controller, path.limits, h)
    motion, state = _motion(path), RobotState(load(options.robot).model)
    most = load(options.robot).model.base_acceleration_max
    controller.reset()
    controller.last.q_posture[:] = motion.arm.middle
    asked, touching = [], []
    for t in times:
        measured, base_acceleration, qdd = motion.at(float(t))
        reference = None
        if path.mode == "tracking":
            state.update(measured)
            qdd_all = np.concatenate([state.model.J_m_inv @ base_acceleration, qdd])
            reference = Reference(
                pin.SE3(state.T_world_ee.rotation, state.T_world_ee.translation + _OFF),
                state.v_ee.copy(),
                state.J_ee @ qdd_all + state.Jdqd_ee,
            )
        controller.last.v_last[:] = np.nan  # as after a gap: the torques do not cause this motion
        w = controller.step(measured, reference, base_acceleration=base_acceleration)
        asked.append(np.clip(w.a_base_cmd, -most, most))
        touching.append(w.d[: len(w.pairs)].min() <= 0.0)
    steps = np.diff(np.array(asked), axis=0)
    steps[np.array(touching)[1:] | np.array(touching)[:-1]] = 0.0
    return np.column_stack([np.linalg.norm(steps[:, :-1], axis=1), np.abs(steps[:, -1])])


def _motion(path: Path) -> Motion:
    robot = load(path.options.robot)
    if path.number < 0:
        joint = path.number + robot.model.n_m
        return one_joint_motion(
            robot.model, np.array(_FIXED), joint, _FIXED_SPEED, 0.5 * path.duration
        )
    rng = np.random.default_rng([path.options.seed, path.number])
    return random_motion(robot.model, posture_in_buffer(robot, rng), path.speed, rng, path.duration)


@cache
def _controller(robot: str, name: str, limits: str, h: float) -> Controller:
    found = load(robot)
    model = found.model if limits == "robot" else _wide(robot)
    return Controller(model, found.data, model.description.config, name=name, dt=h)


@cache
def _wide(robot: str) -> RobotModel:
    """The robot with limits that no motion reaches; `qd_max`, the unit of slacks, is unchanged."""
    model = RobotModel(load(robot).model.description)
    model.tau_max = 100.0 * model.tau_max
    model.qd_limits = 100.0 * model.qd_limits
    model.base_acceleration_max = 100.0 * model.base_acceleration_max
    reach = 10.0 * (model.q_upper - model.q_lower)
    model.q_lower, model.q_upper = model.q_lower - reach, model.q_upper + reach
    model.q_limits = np.array([model.q_lower, model.q_upper])
    return model
