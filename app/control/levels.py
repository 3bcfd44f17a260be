"""What each level of the hierarchy gave up for those above it and for the limits."""

from __future__ import annotations

from typing import Literal, NamedTuple

import numpy as np

from app.control.controller import ControlOutput
from app.control.hqp import Objective
from app.control.workings import ArmSolve, Workings

Array = np.ndarray
LevelName = Literal["base", "arm", "links", "hand", "posture", "free"]


class Level(NamedTuple):
    """The slack of one level: what it asked for less what it got.

    Attributes:
        name: "base": the base's rows of T_sca; "arm": the arm's rows against the base; "links":
            rows between links; "hand": the end-effector's task; "posture": the lowest level, or
            "free" where a person leads the arm: what it would do by itself.
        linear: [m/s²] norm of the slack, or its linear part; None if there is none. Of "base" v̇.
        angular: [rad/s²] norm of the angular part, or of the joints'; None if there is none.
    """

    name: LevelName
    linear: float | None
    angular: float | None


def level_readings(output: ControlOutput, workings: Workings) -> tuple[Level, ...]:
    """The levels that are in the stack of a step, highest priority first.

    They are w_sca* and w_2 of (29).
    """
    arm, inserted = workings.arm, output.inserted
    levels = []
    if inserted.rows_m is not None:
        v, w = np.abs(workings.base_wanted - output.base_acceleration).tolist()
        levels.append(Level("base", v, w))
    _, *avoiding = _row_slacks(arm)
    count = len(inserted.rows_arm)
    if inserted.rows_arm:
        levels.append(Level("arm", _norm(*avoiding[:count]), None))
    if inserted.rows_links:
        levels.append(Level("links", _norm(*avoiding[count:]), None))
    qdd = arm.solution.qdd
    for J, b in arm.stack.levels:
        w = b - J @ qdd
        levels.append(Level("hand", _norm(w[:3]), _norm(w[3:])))
    lowest = _norm(objective_slack(arm.stack.objective, qdd))
    return (*levels, Level("posture" if output.tracking else "free", None, lowest))


def objective_slack(objective: Objective, qdd: Array) -> Array:
    """(n_m,) [rad/s² or m/s²] the arm's q̈ less the one that the objective alone would choose.

    The base's q̈ is taken as it is.
    """
    H, c = objective
    return qdd[2:] + np.linalg.solve(H[2:, 2:], c[2:] + H[2:, :2] @ qdd[:2])


def _row_slacks(arm: ArmSolve) -> list[Array]:
    """The first level's slack, one array for each group of rows."""
    ends = np.cumsum([len(row.xdd) for row in arm.rows])
    return np.split(arm.solution.slacks[0], ends[:-1])


def _norm(*vectors: Array) -> float:
    return float(np.linalg.norm(np.concatenate(vectors)))
