"""Random tracking paths beside the base: errors of the end-effector, and their causes."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence
from contextlib import closing
from typing import Any, NamedTuple

import numpy as np

from app.config import Config
from app.simulation.loop.pacing import gc_frozen
from app.simulation.session import Session, Step
from benchmarks.law.curves import Curve
from benchmarks.law.draw_curves import task_of
from benchmarks.law.options import Options
from benchmarks.law.pull import joint_share
from benchmarks.law.report import Report, largest, least
from benchmarks.law.robot import load
from benchmarks.law.work import played

Array = np.ndarray

_LEAVES = 1.0  # [mm] error above which the end-effector has left the path
_AFTER = 3.0  # [s] duration of the rest after the motion
_AT_POSITION = 0.02  # [rad or m] distance from a limit below which a joint is at this limit
_AT_SPEED, _AT_TORQUE = 0.98, 0.999  # [-] shares of the limits from which a joint is at a limit


class Tracking(NamedTuple):
    """The number of a path, with the options."""

    options: Options
    number: int


def paths(options: Options, count: int = 300, first: int = 0) -> Report:
    """Track random curves: towards the base, across its corners, around it.

    Args:
        options: See `Options`.
        count: Number of curves.
        first: Number of the first curve.
    """
    cases = [Tracking(options, first + k) for k in range(count)]
    rows = played(play, cases, options.jobs, "paths")
    return Report("paths", rows, _summary(rows))


def play(case: Tracking) -> dict[str, Any]:
    """The row of one path."""
    task = task_of(case.options, case.number)
    return {"number": case.number, **follow(case.options, task.curve, task.q_m)}


def follow(options: Options, curve: Curve, q_m: Sequence[float]) -> dict[str, Any]:
    """The result of tracking a curve from a posture (n_m,) of the arm."""
    robot = load(options.robot)
    session = Session(robot.model, robot.data, robot.config, controller=options.controller)
    n = robot.n_mobile
    worst, worst_t, at_limits, end = 0.0, 0.0, "", 0.0
    nearest, links, contacts = math.inf, math.inf, 0
    shares: list[float] = []
    with gc_frozen(), closing(session):
        session.reset(np.array(q_m))
        orientation = session.T_world_ee.rotation.copy()
        while session.t < curve.duration + _AFTER:
            step = session.step(curve.reference(session.t, orientation))
            end = 1e3 * step.ee_error
            if end > worst:
                worst, worst_t, at_limits = end, step.t, _limits_met(robot.model, step)
            nearest = min(nearest, *step.distances[:n])
            links = min((links, *step.distances[n:]))
            contacts += step.contacts.arm_base or step.contacts.arm_arm
            shares.append(joint_share(step, robot.model))
        failures = int(session.controller.last.failures)
    return {
        "kind": curve.kind,
        "duration_s": curve.duration,
        "error_max_mm": worst,
        "at_s": worst_t,
        "leaves": worst > _LEAVES,
        "at_limits": at_limits if worst > _LEAVES else "",
        "end_off_mm": end,
        "ends_off": end > _LEAVES,
        "least_distance_m": nearest,
        "least_between_links_m": links,
        "contact_steps": contacts,
        "joint_speed_share": max(shares),
        "steps": len(shares),
        "steps_over_1": sum(s > 1.0 for s in shares),
        "steps_over_1.01": sum(s > 1.01 for s in shares),
        "failures": failures,
    }


def _limits_met(model: Any, step: Step) -> str:
    """The joints at a limit of position (q), speed (v) or torque (u), such as `q4 q6 v1 u2`."""
    q, qd = step.truth.q_m, step.truth.qd_m
    left = np.minimum(q - model.q_lower, model.q_upper - q)
    met = {
        "q": left < _AT_POSITION,
        "v": np.abs(qd) > _AT_SPEED * model.qd_max,
        "u": np.abs(step.control.u_cmd) > _AT_TORQUE * model.tau_max,
    }
    return " ".join(f"{what}{i + 1}" for what, at in met.items() for i in np.flatnonzero(at))


def _summary(rows: list[dict[str, Any]]) -> dict[str, Any]:
    left = [row for row in rows if row["leaves"]]
    errors = [row["error_max_mm"] for row in left]
    limits = Counter(name for row in left for name in row["at_limits"].split() or ["none"])
    return {
        "paths": len(rows),
        "leave": len(left),
        "leave_share": len(left) / len(rows),
        "leave_by_kind": dict(Counter(row["kind"] for row in left)),
        "leave_median_mm": float(np.median(errors)) if left else None,
        "leave_max_mm": max(errors, default=None),
        "ends_off": sum(row["ends_off"] for row in rows),
        "end_off_max_mm": largest(rows, "end_off_mm"),
        "limits_met_when_left": dict(limits.most_common()),
        "entered_the_buffer": sum(row["least_distance_m"] < Config().border.d_b for row in rows),
        "least_distance_m": least(rows, "least_distance_m"),
        "with_contact": sum(row["contact_steps"] > 0 for row in rows),
        "joint_speed_share_max": largest(rows, "joint_speed_share"),
        "joint_speed_over_1.01": sum(row["steps_over_1.01"] > 0 for row in rows),
        "failures": sum(row["failures"] for row in rows),
    }
