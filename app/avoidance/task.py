"""GenerateAvoidanceTask: the rows of T_sca, each with its activation (§3.3)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from app.avoidance.repulsion import RepulsiveRow

Array = np.ndarray


class TaskRows(NamedTuple):
    """Rows that enter the stack together under one activation parameter.

    They ask for J q̈ + J̇ q̇ = ẍ.

    Attributes:
        J: (k, n) Jacobian.
        Jdqd: (k,) J̇ q̇.
        xdd: (k,) desired acceleration.
        beta: [-] activation parameter in [0, 1].
    """

    J: Array
    Jdqd: Array
    xdd: Array
    beta: float

    @property
    def b(self) -> Array:
        """(k,) right-hand side of J q̈ = ẍ - J̇ q̇."""
        return self.xdd - self.Jdqd


def mobile_rows(J_m: Array, n: int, xdd_m: Array, beta_m: float) -> TaskRows:
    """The rows of the base, one an axis, [J_m O] q̈ = ẍ_m; J̇_m = 0.

    Paper: Eq. (16), (19).
    """
    n_b = len(J_m)
    J = np.zeros((n_b, n))
    J[:, :n_b] = J_m
    return TaskRows(J, np.zeros(n_b), np.asarray(xdd_m, dtype=float), beta_m)


def repulsive_rows(row: RepulsiveRow, beta: float) -> TaskRows:
    """One row of (22) and (23) with its own activation."""
    return TaskRows(row.J_r[None, :], np.array([row.Jdqd]), np.array([row.xdd_r]), beta)


def generate_avoidance_task(rows: Sequence[TaskRows]) -> tuple[Array, Array, Array]:
    """Stack the rows of T_sca.

    Paper: Eq. (22), (23), (24), (25), (27).

    Returns:
        ẍ_sca - J̇_sca q̇ (n_b + k,), J_sca (n_b + k, n), and the diagonal of B (n_b + k,),
        in which the rows of the base share β_m.
    """
    return (
        np.concatenate([r.b for r in rows]),
        np.vstack([r.J for r in rows]),
        np.concatenate([np.full(len(r.xdd), r.beta) for r in rows]),
    )
