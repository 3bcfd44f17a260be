"""Figures and log of a run: kept step by step, written as CSV."""

from __future__ import annotations

import csv
import math
from collections.abc import Sequence
from itertools import chain, compress
from operator import attrgetter
from pathlib import Path
from typing import NamedTuple

import numpy as np

from app.control.buffer_watch import BufferReading
from app.control.force_bound import force_bound
from app.robot.bases.kind import Axis
from app.robot.model import RobotModel
from app.robot.state import RobotState
from app.simulation.plants.interface import Contacts
from app.simulation.session import Step
from app.simulation.trace.axis_columns import acceleration_column, velocity_column
from app.simulation.trace.changes import Batch, Changes, Smoothness
from app.simulation.trace.door_record import DoorRecord, door_columns
from app.simulation.trace.stuck import find_stuck

Array = np.ndarray

NEAR = 0.01
"""[m] between two bodies that is as good as contact: the person's force counts until then."""

_LOG_EVERY = 10  # control steps per row of the log, and per look at what the arm can bear
_BETA = attrgetter("beta")


class _Taken(NamedTuple):
    """What the figures need of a control step."""

    t: float
    duration: float
    distances: tuple[float, ...]
    near: bool
    """Whether a pair is within the distance of full activation."""
    contacts: Contacts
    failed: bool
    ee_error: float
    activation: float
    hand_force: Array
    u_a: Array
    base_pose: Array
    asked: Array
    inserted: Array
    qd_m: Array
    held: bool
    """Whether anybody held the robot."""
    hand_speed: float


class Recorder:
    """Takes every control step of a run; gives its figures and its log, both about the truth."""

    def __init__(self, model: RobotModel, *, log: bool = True) -> None:
        """Nothing is recorded.

        Args:
            model: The robot.
            log: Whether to keep rows for the log, or figures only.
        """
        self._model = model
        self._mobile_body = model.description.mobile_body.name
        self._axes = model.description.base.axes
        self._columns: list[str] = []
        self._log: list[list[float]] = []
        self._until_row = 0 if log else -1  # control steps; below zero no row follows
        self._first: Step | None = None
        self._last: Step | None = None
        self._batch: Batch[_Taken] = Batch(self._take)
        self._names: list[str] = []
        self._least: list[float] = []
        self._mobile: list[bool] = []
        self._contacts = self._arm_contacts = self._floor_contacts = 0
        self._ee_error_max = self._activation_max = 0.0
        self._changes = Changes()
        self._asked, self._inserted = (Smoothness(model.description.base) for _ in range(2))
        self._door: DoorRecord | None = None
        self._hand_force_max = self._hand_force_clear_max = self._hand_speed_max = 0.0
        self._clear = self._finite = True
        self._failures = 0
        self._joint_speed_share = 0.0
        self._state = RobotState(model)
        self._until_look = 0  # control steps
        self._force_bound = math.inf
        self._released_path: float | None = None  # [m] of the base when the hand was last held
        self._near_until: float | None = None
        self._durations: list[float] = []

    def add(self, step: Step) -> None:
        """Take one control step."""
        if self._first is None:
            self._begin(step)
        self._last = step
        if self._until_row == 0:
            values = _values(step)
            assert len(values) == len(self._columns), "pairs and doors stay those of the first step"
            self._log.append(values)
            self._until_row = _LOG_EVERY
        self._until_row -= 1
        if self._until_look == 0:
            self._look_at_bound(step)
            self._until_look = _LOG_EVERY
        self._until_look -= 1
        if step.door is not None:
            self._door = self._door or DoorRecord()
            self._door.add(step)
        out = step.output
        self._batch.add(
            _Taken(
                step.t,
                step.duration,
                step.distances,
                max(map(_BETA, out.avoidance.pairs), default=0.0) >= 1.0,
                step.contacts,
                not out.solved,
                step.ee_error,
                out.activation,
                step.hand_force,
                out.u_a,
                step.truth.base_pose,
                out.base_acceleration,
                out.inserted.base_acceleration,
                step.truth.qd_m,
                bool(step.pulls),
                step.hand_speed,
            )
        )

    def _look_at_bound(self, step: Step) -> None:
        """What the arm can bear where somebody holds it inside a buffer of L_m."""
        near = [pair.closest for pair in step.output.avoidance.mobile if pair.beta > 0.0]
        if step.pulls and near:
            self._state.update(step.measurement)
            bounds = (force_bound(self._state, closest) for closest in near)
            self._force_bound = min(self._force_bound, *bounds)

    def _begin(self, step: Step) -> None:
        self._first = step
        pairs = [pair.closest.pair for pair in step.output.avoidance.pairs]
        self._names = [pair.name for pair in pairs]
        self._mobile = [pair.a == self._mobile_body for pair in pairs]
        self._least = [math.inf] * len(pairs)
        self._columns = _columns(step, self._axes)

    def _take(self, steps: Sequence[_Taken]) -> None:
        (
            times,
            durations,
            distances,
            near,
            contacts,
            failed,
            errors,
            activations,
            forces,
            torques,
            poses,
            asked,
            inserted,
            joint_speeds,
            held,
            hand_speeds,
        ) = zip(*steps, strict=True)
        self._durations += durations
        by_pair = zip(*distances, strict=True)
        self._least = [min(least, *now) for least, now in zip(self._least, by_pair, strict=True)]
        if any(near):
            *_, self._near_until = compress(times, near)
        self._contacts += sum(each.arm_base for each in contacts)
        self._arm_contacts += sum(each.arm_arm for each in contacts)
        self._floor_contacts += sum(each.arm_floor for each in contacts)
        self._failures += sum(failed)
        self._ee_error_max = max(self._ee_error_max, *errors)
        self._activation_max = max(self._activation_max, *activations)
        hand_force = np.linalg.norm(forces, axis=1)
        self._hand_force_max = max(self._hand_force_max, float(hand_force.max()))
        self._hand_speed_max = max(self._hand_speed_max, *hand_speeds)
        self._take_clear(np.array(distances), hand_force)
        self._finite &= bool(np.isfinite(torques).all() and np.isfinite(poses).all())
        shares = np.abs(joint_speeds) / self._model.qd_max
        self._joint_speed_share = max(self._joint_speed_share, float(shares.max()))
        self._take_path(np.array(torques), np.array(poses), held)
        self._asked.add(np.array(asked))
        self._inserted.add(np.array(inserted))

    def _take_clear(self, distances: Array, forces: Array) -> None:
        """The person's force, until the first step in which two bodies are near."""
        if not self._clear:
            return
        near = np.flatnonzero((distances < NEAR).any(axis=1))
        self._clear = not len(near)
        clear = forces if self._clear else forces[: near[0] + 1]
        self._hand_force_clear_max = max(self._hand_force_clear_max, float(clear.max()))

    def _take_path(self, torques: Array, poses: Array, held: Sequence[bool]) -> None:
        """Add to the base's path, in two parts where the hand was last held in between."""
        if not any(held):
            self._changes.add(torques, poses)
            return
        last = max(k for k, is_held in enumerate(held) if is_held) + 1
        self._changes.add(torques[:last], poses[:last])
        self._released_path = self._changes.path
        if last < len(held):
            self._changes.add(torques[last:], poses[last:])

    @property
    def finite(self) -> bool:
        """Whether all torques and poses of the base so far are numbers."""
        self._batch.flush()
        return self._finite

    @property
    def rows(self) -> list[dict[str, float]]:
        """The log, one row a hundredth of a second."""
        return [dict(zip(self._columns, values, strict=True)) for values in self._log]

    @property
    def buffer(self) -> BufferReading:
        """Whether d_b was enough."""
        assert self._last is not None, "no step was recorded"
        return self._last.buffer

    def figures(self) -> dict[str, object]:
        """The figures of the run so far; keys end in their unit.

        `buffer_needed_m` is None where no d_b suffices; `clear_since_s`, since when no pair has
        been within the distance of full activation, is None if one still is;
        `base_path_after_release_m`, since anybody last held the robot, if nobody does at the end;
        `hand_force_max_n` is the person's on the end-effector, or that on a door that it holds,
        `hand_force_clear_max_n` the same until two bodies first came nearer than 10 mm;
        `force_bound_min_n`, the least force of a person that the arm's torques could bear while
        somebody held it inside a buffer of L_m, is None if nobody did;
        `stuck` says where and why a tracked hand stops short of a resting target, or is None.
        """
        assert self._first is not None, "no step was recorded"
        assert self._last is not None
        self._batch.flush()
        begin, end = self._first.truth.base_pose, self._last.truth.base_pose
        durations = np.array(self._durations) * 1e6
        needed = self.buffer.needed_max
        stuck = find_stuck(self._model, self._last)
        with_base = list(zip(self._least, self._mobile, strict=True))
        return {
            "min_distance_m": dict(zip(self._names, self._least, strict=True)),
            "min_clearance_m": min((d for d, mobile in with_base if mobile), default=None),
            "contacts": self._contacts,
            "arm_min_clearance_m": min((d for d, mobile in with_base if not mobile), default=None),
            "arm_contacts": self._arm_contacts,
            "floor_contacts": self._floor_contacts,
            "ee_error_max_m": self._ee_error_max,
            "ee_error_final_m": self._last.ee_error,
            "base_displacement_m": float(np.hypot(*(end - begin)[:2])),
            "base_path_m": self._changes.path,
            "base_path_after_release_m": self._path_after_release(),
            "base_speed_final_mps": self._speed(),
            "base_yaw_rad": float(end[2] - begin[2]),
            "activation_max": self._activation_max,
            **self._asked.figures("base_acceleration"),
            **self._inserted.figures("avoidance_acceleration"),
            "torque_jump_max_nm": self._changes.torque_jump,
            "torque_rate_sign_changes": self._changes.torque_rate_sign_changes,
            "hand_force_max_n": self._hand_force_max,
            "hand_force_clear_max_n": self._hand_force_clear_max,
            "force_bound_min_n": self._force_bound if math.isfinite(self._force_bound) else None,
            "hand_speed_max_mps": self._hand_speed_max,
            "joint_speed_share_max": self._joint_speed_share,
            "clear_since_s": self._clear_since(),
            "approach_speed_max_mps": self.buffer.approach_speed_max,
            "buffer_needed_m": needed if math.isfinite(needed) else None,
            **(self._door.figures() if self._door is not None else {}),
            "solver_failures": self._failures,
            "solver_given_up": self._last.given_up,
            "stuck": stuck and stuck.as_json(),
            "step_p50_us": float(np.percentile(durations, 50)),
            "step_p99_us": float(np.percentile(durations, 99)),
        }

    def _path_after_release(self) -> float | None:
        assert self._last is not None
        if self._released_path is None or self._last.pulls:
            return None
        return self._changes.path - self._released_path

    def _speed(self) -> float:
        """[m/s] of the base's centre at the last step."""
        assert self._last is not None
        velocity = zip(self._axes, self._last.truth.base_velocity.tolist(), strict=True)
        return math.hypot(*(v for axis, v in velocity if not axis.angular))

    def _clear_since(self) -> float | None:
        assert self._last is not None
        if self._near_until is None:
            return 0.0
        return None if self._near_until == self._last.t else self._near_until

    def write_log(self, path: Path) -> None:
        """Write the log, one row a hundredth of a second, as CSV; columns end in their unit."""
        with path.open("w", newline="", encoding="utf-8") as file:
            writer = csv.writer(file)
            writer.writerow(self._columns)
            writer.writerows(self._log)


def _columns(step: Step, axes: Sequence[Axis]) -> list[str]:
    """Names of the log's columns, in the order of `_values`."""
    joints = range(1, len(step.truth.q_m) + 1)
    pairs = [pair.closest.pair.name for pair in step.output.avoidance.pairs]
    return [
        "t_s",
        "base_x_m",
        "base_y_m",
        "base_yaw_rad",
        *(f"{name}_{velocity_column(axis)}" for name in ("base", "command") for axis in axes),
        *(f"q{i}_rad" for i in joints),
        *(f"qd{i}_radps" for i in joints),
        *(f"u{i}_nm" for i in joints),
        *(column for name in pairs for column in (f"d_{name}_m", f"beta_{name}")),
        "beta_m",
        *(f"{name}_{acceleration_column(axis)}" for name in ("base", "avoidance") for axis in axes),
        "hand_fx_n",
        "hand_fy_n",
        "hand_fz_n",
        "ee_error_m",
        "contact",
        "arm_contact",
        *(() if step.door is None else door_columns(step)),
    ]


def _values(step: Step) -> list[float]:
    """A row of the log."""
    m, out = step.truth, step.output
    betas = map(_BETA, out.avoidance.pairs)
    return [
        step.t,
        *m.base_pose.tolist(),
        *m.base_velocity.tolist(),
        *step.base_command.tolist(),
        *m.q_m.tolist(),
        *m.qd_m.tolist(),
        *out.u_a.tolist(),
        *chain.from_iterable(zip(step.distances, betas, strict=True)),
        out.avoidance.beta_m,
        *out.base_acceleration.tolist(),
        *out.inserted.base_acceleration.tolist(),
        *step.hand_force.tolist(),
        step.ee_error,
        int(step.contacts.arm_base),
        int(step.contacts.arm_arm),
        *(() if step.door is None else door_columns(step).values()),
    ]
