"""What each task gave up for those that weigh more and for the limits."""

from __future__ import annotations

from typing import Literal, NamedTuple

import numpy as np

from app.control.controller import ControlOutput
from app.control.qp import Objective
from app.control.workings import ArmSolve, Workings
from app.robot.bases.kind import BaseKind

Array = np.ndarray
LevelName = Literal["base", "arm", "links", "hand", "posture", "free"]


class Level(NamedTuple):
    """The slack of one task: what it asked for less what it got.

    Attributes:
        name: "base": the base's rows of T_sca; "arm": the arm's rows against the base; "links":
            rows between links; "hand": the end-effector's task; "posture": the lightest, or
            "free" where a person leads the arm: what it would do by itself.
        linear: [m/s²] norm of the slack, or its linear part; None if there is none. Of "base" v̇.
        angular: [rad/s²] norm of the angular part, or of the joints'; None if there is none.
    """

    name: LevelName
    linear: float | None
    angular: float | None


def level_readings(base: BaseKind, output: ControlOutput, workings: Workings) -> tuple[Level, ...]:
    """The tasks of a step, what weighs most first.

    They are w_sca* and w_2 of (29).

    Args:
        base: The robot's base.
        output: What the controller answered.
        workings: How it came about.
    """
    arm, inserted = workings.arm, output.inserted
    levels = []
    if inserted.rows_m is not None:
        missing = workings.base_wanted - output.base_acceleration
        levels.append(Level("base", *linear_and_angular(base, missing)))
    avoiding = _row_slacks(arm, base.n_b)
    count = len(inserted.rows_arm)
    if inserted.rows_arm:
        levels.append(Level("arm", _norm(*avoiding[:count]), None))
    if inserted.rows_links:
        levels.append(Level("links", _norm(*avoiding[count:]), None))
    qdd = arm.qdd
    if arm.ee_task is not None:
        w = arm.ee_task.b - arm.ee_task.J @ qdd
        levels.append(Level("hand", _norm(w[:3]), _norm(w[3:])))
    lowest = _norm(objective_slack(arm.lowest, qdd, base.n_b))
    return (*levels, Level("posture" if output.tracking else "free", None, lowest))


def objective_slack(objective: Objective, qdd: Array, n_b: int) -> Array:
    """(n_m,) [rad/s² or m/s²] the arm's q̈ less the one that the objective alone would choose.

    The base's q̈, the first n_b, is taken as it is.
    """
    H, c = objective
    return qdd[n_b:] + np.linalg.solve(H[n_b:, n_b:], c[n_b:] + H[n_b:, :n_b] @ qdd[:n_b])


def linear_and_angular(base: BaseKind, values: Array) -> tuple[float, float]:
    """Norms of what an axis-by-axis vector (n_b,) has along the base's linear and angular axes."""
    angular = np.array([axis.angular for axis in base.axes])
    return float(np.linalg.norm(values[~angular])), float(np.linalg.norm(values[angular]))


def _row_slacks(arm: ArmSolve, n_b: int) -> list[Array]:
    """What each group of rows asked, in the blend of (29), less what it got."""
    if not arm.rows:
        return []
    without = arm.qdd.copy()
    without[n_b:] -= objective_slack(arm.objective, arm.qdd, n_b)
    return [
        row.beta * row.b + (1.0 - row.beta) * (row.J @ without) - row.J @ arm.qdd
        for row in arm.rows
    ]


def _norm(*vectors: Array) -> float:
    return float(np.linalg.norm(np.concatenate(vectors)))
