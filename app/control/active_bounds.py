"""Which of the robot's limits a control step met, by names that a person understands."""

from typing import Literal, NamedTuple

import numpy as np

from app.config import Config
from app.control.admittance import largest_command
from app.control.controller import ControlOutput, Workings
from app.control.limits import position_bounds, velocity_bounds
from app.control.qp import Limits
from app.robot.link_pairs import convex
from app.robot.model import RobotModel
from app.robot.state import RobotState
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
"""[N m, rad/s² or m/s²] how near to a bound is at it: the accuracy that the QPs are held to."""


class Bound(NamedTuple):
    """A limit that was met."""

    where: str
    """Name of a joint, "base", or a pair as in `lm-lEE`."""
    kind: BoundKind
    """What is limited."""
    upper: bool
    """Whether it is the upper of the two bounds."""


def active_bounds(
    state: RobotState, output: ControlOutput, workings: Workings, config: Config
) -> list[Bound]:
    """The limits that the controller met in a step, those of the arm first."""
    n_m = state.model.n_m
    low, high = met(workings.limits, workings.qdd)
    joints = state.model.description.arm.joints
    bounds, kept = [], convex(pair.closest for pair in output.avoidance.pairs)
    for i in np.flatnonzero(low | high).tolist():
        upper = bool(high[i])
        if i < n_m:
            at = workings.torque[int(upper), i]
            most = abs(at) >= state.model.tau_max[i] - TOLERANCE
            bounds.append(Bound(joints[i], "torque" if most else "torque rate", upper))
        elif i < 2 * n_m:
            bounds.append(Bound(joints[i - n_m], _joint_kind(state, config, i - n_m, upper), upper))
        else:
            bounds.append(Bound(kept[i - 2 * n_m].pair.name, "barrier", upper))
    return [*dict.fromkeys(bounds), *_base_bounds(state.model, output, workings)]


def admittance_bounds(model: RobotModel, config: Config, command: Array) -> list[Bound]:
    """Whether the base's velocity command (n_b,) [m/s or rad/s] is as large as it may be."""
    base = model.description.base
    largest = largest_command(base, config.admittance)
    return [
        Bound("base", "turning speed" if axis.angular else "speed", bool(value > 0))
        for axis, value, most in zip(base.axes, command, largest, strict=True)
        if abs(value) >= most - 1e-9
    ]


def met(limits: Limits, qdd: Array) -> tuple[Array, Array]:
    """(m,) whether q̈ is at the lower, and (m,) at the upper bound of each row.

    A soft row at its bound is beyond it by up to its share of what the tasks asked.
    """
    reached = limits.C @ qdd
    room = TOLERANCE + limits.softness
    return reached <= limits.l + room, reached >= limits.u - room


def _joint_kind(state: RobotState, config: Config, joint: int, upper: bool) -> BoundKind:
    """What makes the tighter bound of a joint's acceleration, its position or its velocity."""
    at = int(upper)
    position = position_bounds(state, config.limit)[at][joint]
    velocity = velocity_bounds(state, config.limit)[at][joint]
    return "position" if (position < velocity) == upper else "velocity"


def _base_bounds(model: RobotModel, output: ControlOutput, workings: Workings) -> list[Bound]:
    asked, most = output.base_acceleration, model.base_acceleration_max
    missing = workings.base_wanted - asked  # may be missing for the hand's sake, too
    at_limit = np.sign(missing) * asked > most - TOLERANCE
    return [
        Bound("base", "angular acceleration" if axis.angular else "acceleration", bool(m > 0))
        for axis, m, at in zip(model.description.base.axes, missing, at_limit, strict=True)
        if at and abs(m) > TOLERANCE
    ]
