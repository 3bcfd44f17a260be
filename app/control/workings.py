"""What a control step kept of its way to the answer, so that it can be explained afterwards."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from app.avoidance.task import TaskRows
from app.control.qp import Limits, Objective
from app.control.tasks import EqualityTask

Array = np.ndarray


class ArmSolve(NamedTuple):
    """The problem (29) for the arm's accelerations under a given motion of the base.

    Attributes:
        rows: Rows above the tasks: the method's against the base, then those between links.
        ee_task: T_ee, or None where the arm is guided.
        objective: The tasks without the rows, over q̈ (n,).
        lowest: The posture alone, or what a guided arm does by itself, over q̈ (n,).
        limits: On q̈_m, the hard torques first, then joints, then barriers.
        qdd: (n,) q̈ of base and arm.
    """

    rows: tuple[TaskRows, ...]
    ee_task: EqualityTask | None
    objective: Objective
    lowest: Objective
    limits: Limits
    qdd: Array


class Workings(NamedTuple):
    """How a control step came to its answer; what explains it is made from this, when asked for.

    Attributes:
        base_wanted: (n_b,) [m/s² or rad/s²] of (29) before the base's acceleration limits.
        base_given: (n_b,) the same that the base really has, with which the arm's part is solved.
        arm: The arm's part.
        torque: (n_m,) the smallest and (n_m,) the largest torque [N m or N] that the step allowed,
            by the limits of the torques and of their change.
    """

    base_wanted: Array
    base_given: Array
    arm: ArmSolve
    torque: tuple[Array, Array]
