"""QPs for tests: objectives, limits, and their solution by the controller's solver."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from typing_extensions import Self

from app.config import LimitConfig, TaskConfig
from app.control.limits import joint_bounds, joint_rows, torque_rows
from app.control.qp import changed_by_proxqp, solve_qp, solve_qp_step, solved_by_proxqp
from app.control.quantities import ControlStep
from app.control.tasks import (
    Reference,
    add_tracking,
    end_effector_task,
    insert_rows,
    pose_error,
    posture_objective,
)
from app.robot.model import RobotModel
from app.robot.state import RobotState

Array = np.ndarray

NONE = np.zeros(0)  # no fixed variable


class NoSolutionError(Exception):
    """A QP has no solution."""


class Objective(NamedTuple):
    """Min ½ q̈ᵀ H q̈ + cᵀ q̈."""

    H: Array
    c: Array


class Limits(NamedTuple):
    """l ≤ C q̈ ≤ u."""

    C: Array
    l: Array
    u: Array
    softness: Array

    @classmethod
    def of(cls, w: ControlStep) -> Self:
        """Limits of the arm's QP in a control step."""
        m = int(w.n_limits)
        return cls(w.C[:m].copy(), w.l[:m].copy(), w.u[:m].copy(), w.softness[:m].copy())

    def and_also(self, others: Limits) -> Limits:
        """These limits and others."""
        return Limits(*map(np.concatenate, zip(self, others, strict=True)))


class Rows(NamedTuple):
    """Rows of T_sca, each with its activation."""

    J: Array
    b: Array
    beta: Array

    def of(self, rows: list[int] | Array) -> Rows:
        """A selection of these rows."""
        return Rows(self.J[rows], self.b[rows], self.beta[rows])


class EeTask(NamedTuple):
    """T_2: J q̈ = b."""

    J: Array
    b: Array
    lm_damping: float


def solved(objective: Objective, limits: Limits, fixed: Array = NONE) -> Array:
    """The optimum (n,) by `solve_qp`, or by ProxQP if `solve_qp` does not converge.

    Raises:
        NoSolutionError: There is none.
    """
    x, found = solve_qp(*objective, *limits, fixed)
    return x if found else _known(solved_by_proxqp(*objective, *limits, fixed))


def stepped(objective: Objective, limits: Limits, fixed: Array) -> Array:
    """The solution (n,) of `solve_qp_step`, or of ProxQP if that method does not converge.

    Raises:
        NoSolutionError: There is none.
    """
    x, found = solve_qp_step(*objective, *limits, fixed)
    return x if found else _known(changed_by_proxqp(*objective, *limits, fixed))


def _known(x: Array) -> Array:
    if np.isnan(x).any():
        raise NoSolutionError
    return x


def least(objective: Objective) -> Array:
    """The optimum without limits."""
    return np.linalg.solve(objective.H, -objective.c)


def inserted(objective: Objective, rows: Rows, softness: float, fixed: int = 0) -> Objective:
    """The objective of the lower tasks after inserting rows of T_sca above them."""
    return Objective(*insert_rows(*objective, *rows, softness, fixed))


def ee_task(at: RobotState | ControlStep, reference: Reference, task: TaskConfig) -> EeTask:
    """T_2 for a reference, in the state `at`."""
    pose, velocity, acceleration = reference
    error = pose_error(at.p_ee, at.R_ee, pose.translation, pose.rotation)
    gains = task.ee_stiffness, task.ee_damping, task.ee_speed
    found = end_effector_task(error, velocity - at.v_ee, acceleration - at.Jdqd_ee, *gains)
    return EeTask(at.J_ee.copy(), *found)


def posture_of(
    model: RobotModel, at: RobotState | ControlStep, q_posture: Array, task: TaskConfig
) -> Objective:
    """The posture task in the state `at`, towards q_posture (n_m,) [rad or m]."""
    gains = task.posture_stiffness, task.posture_damping, task.joint_centering
    base = task.base_weight, task.base_damping
    return Objective(*posture_objective(at.qd, at.q_m, q_posture, model.q_limits, gains, base))


def with_ee(
    posture: Objective, tracking: EeTask, at: RobotState | ControlStep, task: TaskConfig
) -> Objective:
    """The objective with T_2 (`tracking`) above the posture task, in the state `at`."""
    return Objective(*add_tracking(*posture, *tracking, task.ee_damping * at.qd, task.ee_weight))


def joint_bounds_of(model: RobotModel, at: RobotState | ControlStep, limit: LimitConfig) -> Array:
    """(2, n_m) bounds on q̈_m from position and speed limits, in the state `at`."""
    limits, rates = (model.q_limits, model.qd_limits), (limit.position_rate, limit.velocity_rate)
    return joint_bounds(at.q_m, at.qd_m, *limits, *rates, np.inf)


def robot_limits(
    model: RobotModel, at: RobotState | ControlStep, limit: LimitConfig, softness: float
) -> Limits:
    """The arm's hard torque limits, and the bounds of its joints with a softness, at a state."""
    n_m = model.n_m
    C, l, u = np.zeros((2 * n_m, model.n)), np.zeros(2 * n_m), np.zeros(2 * n_m)
    torque_rows(at.M, at.h, -model.tau_max, model.tau_max, C, l, u)
    bounds, joints = joint_bounds_of(model, at, limit), slice(n_m, None)
    joint_rows(bounds, np.zeros(n_m), model.qd_max, C[joints], l[joints], u[joints])
    return Limits(C, l, u, np.repeat([0.0, softness], n_m))


def base_limits(model: RobotModel) -> Limits:
    """The limits of the base's acceleration; hard."""
    n_b, most = model.n_b, model.base_acceleration_max
    C = np.hstack([model.J_m, np.zeros((n_b, model.n_m))])
    return Limits(C, -most, most, np.zeros(n_b))
