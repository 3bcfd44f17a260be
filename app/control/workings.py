"""What a control step kept of its way to the answer, so that it can be explained afterwards."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from app.avoidance.task import TaskRows
from app.control.hqp import Limits, Solution
from app.control.tasks import Stack

Array = np.ndarray


class ArmSolve(NamedTuple):
    """The problem (29) for the arm's torques and its solution, kept by reference.

    Attributes:
        rows: Rows of the first level: those that give the base's acceleration, then the method's
            against the base, then those between links; their slacks are the solution's first.
        stack: The stack below them, its levels strict or not.
        limits: What holds at every level.
        solution: q̈ and the slacks.
        u_a: (n_m,) [N m or N] torques that it asks for.
    """

    rows: tuple[TaskRows, ...]
    stack: Stack
    limits: Limits
    solution: Solution
    u_a: Array


class Workings(NamedTuple):
    """How a control step came to its answer; what explains it is made from this, when asked for.

    Attributes:
        base_wanted: (n_b,) [m/s² or rad/s²] of (29) before the base's acceleration limits, and
            before what is kept of it where the arm cannot hold the hand.
        base_given: (2,) the same that the base really has, with which the arm's part is solved.
        arm: The arm's part.
    """

    base_wanted: Array
    base_given: Array
    arm: ArmSolve
