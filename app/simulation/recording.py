"""Figures and log of a run: kept step by step, written as CSV."""

from __future__ import annotations

import csv
import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from app.control.buffer_watch import BufferReading
from app.robot.bases.kind import Axis
from app.robot.model import RobotModel
from app.simulation.changes import Batch, Changes, Smoothness
from app.simulation.door_record import DoorRecord, door_columns
from app.simulation.session import Step

Array = np.ndarray

_LOG_EVERY = 10  # control steps per row of the log


class Recorder:
    """Takes every control step of a run; gives its figures and its log, both about the truth."""

    def __init__(self, model: RobotModel) -> None:
        self._mobile_body = model.description.mobile_body.name
        self._rows: list[dict[str, float]] = []
        self._first: Step | None = None
        self._last: Step | None = None
        self._batch = Batch(self._take)
        self._names: list[str] = []
        self._least: list[float] = []
        self._mobile: list[bool] = []
        self._contacts = self._arm_contacts = self._floor_contacts = 0
        self._ee_error_max = self._activation_max = 0.0
        self._changes = Changes()
        self._axes = model.description.base.axes
        self._asked, self._inserted = (Smoothness(model.description.base) for _ in range(2))
        self._door: DoorRecord | None = None
        self._hand_force_max = 0.0
        self._failures = 0
        self._near_until: float | None = None
        self._durations: list[float] = []

    def add(self, step: Step) -> None:
        """Take one control step."""
        if self._first is None:
            self._first = step
            pairs = [pair.closest.pair for pair in step.output.avoidance.pairs]
            self._names = [pair.name for pair in pairs]
            self._mobile = [pair.a == self._mobile_body for pair in pairs]
            self._least = [math.inf] * len(pairs)
        self._last = step
        self._batch.add(step)

    def _take(self, steps: Sequence[Step]) -> None:
        outputs = [step.output for step in steps]
        until_row = -len(self._durations) % _LOG_EVERY
        self._rows += [_log_row(step, self._axes) for step in steps[until_row::_LOG_EVERY]]
        self._durations += [step.duration for step in steps]
        by_pair = zip(*(step.distances for step in steps), strict=True)
        self._least = [min(least, *now) for least, now in zip(self._least, by_pair, strict=True)]
        for step in steps:
            if any(pair.beta >= 1.0 for pair in step.output.avoidance.pairs):
                self._near_until = step.t
        self._contacts += sum(step.contacts.arm_base for step in steps)
        self._arm_contacts += sum(step.contacts.arm_arm for step in steps)
        self._floor_contacts += sum(step.contacts.arm_floor for step in steps)
        self._failures += sum(not output.solved for output in outputs)
        self._ee_error_max = max(self._ee_error_max, *(step.ee_error for step in steps))
        self._activation_max = max(self._activation_max, *(out.activation for out in outputs))
        forces = np.linalg.norm([step.hand_force for step in steps], axis=1)
        self._hand_force_max = max(self._hand_force_max, float(forces.max()))
        self._changes.add(steps)
        self._asked.add(np.array([out.base_acceleration for out in outputs]))
        self._inserted.add(np.array([out.inserted.base_acceleration for out in outputs]))
        for step in steps:
            if step.door is not None:
                self._door = self._door or DoorRecord()
                self._door.add(step)

    @property
    def rows(self) -> list[dict[str, float]]:
        """The log, one row a hundredth of a second; read it only."""
        self._batch.flush()
        return self._rows

    @property
    def buffer(self) -> BufferReading:
        """Whether d_b was enough."""
        assert self._last is not None, "no step was recorded"
        return self._last.buffer

    def figures(self) -> dict[str, object]:
        """The figures of the run so far; keys end in their unit.

        `buffer_needed_m` is None where no d_b suffices; `clear_since_s`, since when no pair has
        been within the distance of full activation, is None if one still is.
        """
        assert self._first is not None, "no step was recorded"
        assert self._last is not None
        self._batch.flush()
        begin, end = self._first.truth.base_pose, self._last.truth.base_pose
        durations = np.array(self._durations) * 1e6
        needed = self.buffer.needed_max
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
            "base_yaw_rad": float(end[2] - begin[2]),
            "activation_max": self._activation_max,
            **self._asked.figures("base_acceleration"),
            **self._inserted.figures("avoidance_acceleration"),
            "torque_jump_max_nm": self._changes.torque_jump,
            "hand_force_max_n": self._hand_force_max,
            "clear_since_s": self._clear_since(),
            "approach_speed_max_mps": self.buffer.approach_speed_max,
            "buffer_needed_m": needed if math.isfinite(needed) else None,
            **(self._door.figures() if self._door is not None else {}),
            "solver_failures": self._failures,
            "step_p50_us": float(np.percentile(durations, 50)),
            "step_p99_us": float(np.percentile(durations, 99)),
        }

    def _clear_since(self) -> float | None:
        assert self._last is not None
        if self._near_until is None:
            return 0.0
        return None if self._near_until == self._last.t else self._near_until

    def write_log(self, path: Path) -> None:
        """Write the log, one row a hundredth of a second, as CSV; columns end in their unit."""
        with path.open("w", newline="", encoding="utf-8") as file:
            writer = csv.DictWriter(file, fieldnames=list(self.rows[0]))
            writer.writeheader()
            writer.writerows(self.rows)


def _log_row(step: Step, axes: Sequence[Axis]) -> dict[str, float]:
    m, out = step.truth, step.output
    row: dict[str, float] = {"t_s": step.t}
    row |= dict(zip(("base_x_m", "base_y_m", "base_yaw_rad"), m.base_pose.tolist(), strict=True))
    for name, values in (("base", m.base_velocity), ("command", step.base_command)):
        at = zip(axes, values.tolist(), strict=True)
        row |= {f"{name}_{axis.velocity}": value for axis, value in at}
    row |= {f"q{i}_rad": float(q) for i, q in enumerate(m.q_m, start=1)}
    row |= {f"qd{i}_radps": float(q) for i, q in enumerate(m.qd_m, start=1)}
    row |= {f"u{i}_nm": float(u) for i, u in enumerate(out.u_a, start=1)}
    for pair, d in zip(out.avoidance.pairs, step.distances, strict=True):
        name = pair.closest.pair.name
        row |= {f"d_{name}_m": d, f"beta_{name}": pair.beta}
    row["beta_m"] = out.avoidance.beta_m
    asked, avoid = out.base_acceleration, out.inserted.base_acceleration
    for name, values in (("base", asked), ("avoidance", avoid)):
        at = zip(axes, values.tolist(), strict=True)
        row |= {f"{name}_{axis.acceleration}": value for axis, value in at}
    force = step.hand_force.tolist()
    row |= dict(zip(("hand_fx_n", "hand_fy_n", "hand_fz_n"), force, strict=True))
    row["ee_error_m"] = step.ee_error
    row |= {"contact": int(step.contacts.arm_base), "arm_contact": int(step.contacts.arm_arm)}
    if step.door is not None:
        row |= door_columns(step)
    return row
