"""The active limits of a control step, by readable names."""

from typing import Literal, NamedTuple

import numpy as np

from app.config import Config
from app.control.inputs import largest_command
from app.control.limits import position_bound, velocity_bound
from app.control.quantities import ControlStep
from app.robot.model import RobotModel
from app.strict import Array

BoundKind = Literal[
    "torque",
    "position",
    "velocity",
    "barrier",
    "torque rate",
    "acceleration",
    "angular acceleration",
    "speed",
    "turning speed",
]

TOLERANCE = 1e-5
"""Tolerance of an active bound, in the unit of its row: N m or N for a torque, 1/s for a joint (the
row is divided by the speed limit), m/s² for a distance, m/s² or rad/s² for the base."""


class Bound(NamedTuple):
    """An active limit."""

    where: str
    """Name of a joint, "base", or a pair as in `lm-lEE`."""
    kind: BoundKind
    """The limited quantity."""
    upper: bool
    """Whether it is the upper of the two bounds."""


def active_bounds(model: RobotModel, w: ControlStep, config: Config) -> list[Bound]:
    """The active limits of a step with a solution: those of the arm, then those of the base."""
    n_m = model.n_m
    low, high = met(w)
    joints = model.description.arm.joints
    bounds: list[Bound] = []
    convex = [
        pair.name for pair, rows in zip(w.pairs, w.rows, strict=True) for _ in rows[1:] or rows
    ]
    for i in np.flatnonzero(low | high).tolist():
        upper = bool(high[i])
        if i < n_m:
            at = (w.u_max if upper else w.u_min)[i]
            most = abs(at) >= model.tau_max[i] - TOLERANCE
            bounds.append(Bound(joints[i], "torque" if most else "torque rate", upper))
        elif i < 2 * n_m:
            kind = _joint_kind(model, w, config, i - n_m, upper)
            bounds.append(Bound(joints[i - n_m], kind, upper))
        else:
            bounds.append(Bound(convex[i - 2 * n_m], "barrier", upper))
    return [*dict.fromkeys(bounds), *_base_bounds(model, w)]


def admittance_bounds(model: RobotModel, config: Config, command: Array) -> list[Bound]:
    """The limits that the base's velocity command (n_b,) [m/s or rad/s] has reached."""
    base = model.description.base
    largest = largest_command(base, config.admittance)
    return [
        Bound("base", "turning speed" if axis.angular else "speed", bool(value > 0))
        for axis, value, most in zip(base.axes, command, largest, strict=True)
        if abs(value) >= most - 1e-9
    ]


def met(w: ControlStep) -> tuple[Array, Array]:
    """(m,) whether q̈ is at the lower, and (m,) at the upper limit of each row of the arm's QP.

    A row counts as at its limit if it is within `TOLERANCE` of the limit or beyond it. An active
    soft row is beyond its limit by its slack (see `solve_qp`).
    """
    m = int(w.n_limits)
    reached = w.C[:m] @ w.qdd
    return reached <= w.l[:m] + TOLERANCE, reached >= w.u[:m] - TOLERANCE


def _joint_kind(
    model: RobotModel, w: ControlStep, config: Config, joint: int, upper: bool
) -> BoundKind:
    """Whether the position limit or the speed limit causes the tighter acceleration bound."""
    at, rates = int(upper), config.limit
    q, qd = w.q_m[joint], w.qd_m[joint]
    position = position_bound(q, qd, model.q_limits[at, joint], rates.position_rate)
    velocity = velocity_bound(qd, model.qd_limits[at, joint], rates.velocity_rate)
    return "position" if (position < velocity) == upper else "velocity"


def _base_bounds(model: RobotModel, w: ControlStep) -> list[Bound]:
    asked, most = w.a_base_cmd, model.base_acceleration_max
    missing = w.a_base_des - asked  # `limit_ee_drag` and `set_up_room` also cause a difference
    at_limit = np.sign(missing) * asked > most - TOLERANCE
    return [
        Bound("base", "angular acceleration" if axis.angular else "acceleration", bool(m > 0))
        for axis, m, at in zip(model.description.base.axes, missing, at_limit, strict=True)
        if at and abs(m) > TOLERANCE
    ]
