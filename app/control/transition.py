"""Continuous task transition: rows enter and leave a hierarchy one by one without a jump (§3.4)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from app.avoidance.task import TaskRows, generate_avoidance_task
from app.control.hqp import EqualityTask, HierarchicalQP, Limits, Objective, Solution

Array = np.ndarray


class TaskTransition:
    """Inserts the avoidance task's rows above a stack of tasks, each by its own activation.

    The paper blends all rows with the solution of the stack without any of them. That is continuous
    only where B = 0 as a whole: a row that enters while another is half active makes the torque
    jump. Here the inactive reference of row i is J_i q̈ of the solution *without row i*, in which
    the other rows stand with the activations they have; at β_i = 0 the solution is then the one
    without row i, whatever the others do.
    """

    def __init__(self, solver: HierarchicalQP) -> None:
        self._solver = solver

    def solve(
        self,
        rows: Sequence[TaskRows],
        levels: Sequence[EqualityTask],
        objective: Objective,
        limits: Limits,
        *,
        slot: str = "",
    ) -> Solution:
        """The solution of (29): rows above `levels` above `objective`, under `limits`.

        J_i q̈ + w_i* = β_i (ẍ_i - J̇_i q̇) + (1 - β_i) J_i q̈_{without i}

        Paper: Eq. (29), with the blend on the right-hand side (on the left, as printed, B = 0 does
        not return the solution of (26)); with no rows it is (26).

        Args:
            rows: Rows of T_sca; those with β = 0 do nothing.
            levels: The stack below, highest priority first; T_2 of the paper.
            objective: The lowest level.
            limits: Hold at every level.
            slot: Calls with the same slot share their warm starts.

        Returns:
            The solution; its first slack is w_sca* if any row is active.

        Raises:
            NoSolutionError: A QP has no solution.
        """
        active = tuple(row for row in rows if row.beta > 0.0)
        subsets = _Subsets(self._solver, active, levels, objective, limits, slot)
        return subsets.solution((1 << len(active)) - 1)


class _Subsets:
    """The solutions with some of the active rows, each subset solved once.

    No nested function: one that calls itself would be left to the garbage collector at each step.
    """

    def __init__(
        self, solver: HierarchicalQP, rows: Sequence[TaskRows], levels: Sequence[EqualityTask],
        objective: Objective, limits: Limits, slot: str,
    ) -> None:  # fmt: skip
        self._solver, self._rows, self._levels = solver, rows, levels
        self._objective, self._limits, self._slot = objective, limits, slot
        self._solved: dict[int, Solution] = {}

    def solution(self, members: int) -> Solution:
        """The solution with the rows whose bit is set in `members`."""
        if members not in self._solved:
            chosen = [i for i in range(len(self._rows)) if members >> i & 1]
            above = [self._blended(chosen, members)] if chosen else []
            self._solved[members] = self._solver.solve(
                [*above, *self._levels], self._objective, self._limits,
                slot=f"{self._slot}/{members}",
            )  # fmt: skip
        return self._solved[members]

    def _blended(self, chosen: Sequence[int], members: int) -> EqualityTask:
        """B (ẍ_sca - J̇_sca q̇) + (I - B) J_i q̈_{without i} for the chosen rows, stacked."""
        rows = self._rows
        if len(chosen) == 1 and rows[chosen[0]].beta >= 1.0:  # such as the base's given motion
            return EqualityTask(rows[chosen[0]].J, rows[chosen[0]].b)
        b, J, B = generate_avoidance_task([rows[i] for i in chosen])
        inactive = [
            # A row in full force has no need of the solution without it.
            row.b if row.beta >= 1.0 else row.J @ self.solution(members & ~(1 << i)).qdd
            for i, row in ((i, rows[i]) for i in chosen)
        ]
        return EqualityTask(J, B * b + (1.0 - B) * np.concatenate(inactive))
