"""Continuous task transition: rows enter and leave one by one without a jump (§3.4)."""

from __future__ import annotations

from collections.abc import Sequence

from app.avoidance.task import TaskRows, generate_avoidance_task
from app.control.linear_algebra import with_rows
from app.control.qp import Objective


def insert_rows(objective: Objective, rows: Sequence[TaskRows], softness: float) -> Objective:
    """The tasks below with the rows of T_sca above them, each as far as its own activation says.

    Row i joins as a spring between J_i q̈ and b_i = ẍ_i - J̇_i q̇ whose compliance is (1 - β_i)/β_i
    times that of the tasks below, J_i H⁻¹ J_iᵀ. Alone it then yields

        J_i q̈ = β_i b_i + (1 - β_i) J_i q̈_2*,

    the blend of (29). With others, at β_i = 0 it is not there, whatever the others do, and at
    β_i = 1 it holds but for the softness: the printed blend of all rows with the one solution
    without any of them jumps where a row enters beside another one. A row costs the same whether
    it is the first or the tenth.

    Paper: Eq. (29).

    Args:
        objective: The tasks below.
        rows: Rows of T_sca; those with β = 0 do nothing.
        softness: [-] least share of a row's compliance, in full force.
    """
    active = [row for row in rows if row.beta > 0.0]
    if not active:
        return objective
    b, J, beta = generate_avoidance_task(active)
    return Objective(*with_rows(*objective, J, b, beta, softness))
