"""The paper's hierarchy (26) to (29) of §3.4: strict levels and their transition.

This is the compared method `hqp`, without joint limits and barriers; docs/comparison.md lists the
parts that are those of `dbb`. "As printed" in docs/departures.md lists its corrections.
The level T_sca has only the rows with β > 0. u is not an unknown here, because (26) defines
u = M q̈ + C q̇ + g without a constraint on q̈.
"""

from typing import NamedTuple

import numpy as np

from app.config import TaskConfig
from app.control.quantities import ControlStep
from app.strict import Array

_DEPENDENT = 1e-9  # [-] largest singular value, relative to the norm of J, that counts as 0


class Task(NamedTuple):
    """A level T: J q̈ + w = b with J (m, n), the slack w (m,), and b = ẍ − J̇ q̇ (m,)."""

    J: Array
    b: Array


def solved_by_hierarchy(w: ControlStep, gains: TaskConfig) -> Array:
    """q̈ (n,) of a control step by the paper's hierarchy; NaN if a Jacobian is not finite."""
    below = tasks_below(w, gains)
    active = w.B > 0.0
    T_sca = Task(w.J_sca[active], w.b_sca[active])
    try:
        qdd_2 = cascade(below)
        return inserted(T_sca, w.B[active], below, qdd_2) if active.any() else qdd_2
    except np.linalg.LinAlgError:
        return np.full(len(w.qdd), np.nan)


def tasks_below(w: ControlStep, gains: TaskConfig) -> list[Task]:
    """Levels below T_sca: while tracking T_2 and posture, else base at rest, gravity compensation.

    The posture level is the diagonal objective `w.H_low`; a base at rest is q̈_b = −k q̇_b, with the
    `base_damping` k; gravity compensation minimises u_a − `w.u_free` in the metric M_aa⁻¹.
    """
    n_b = w.n_b
    if w.tracking:
        root = np.sqrt(np.diag(w.H_low))
        return [end_effector(w, gains), Task(np.diag(root), -w.c_low / root)]
    at_rest = Task(np.eye(n_b, len(w.qd)), -gains.base_damping * w.qd[:n_b])
    J, b = (np.linalg.solve(w.L_aa, each) for each in (w.M[n_b:], w.u_free - w.h[n_b:]))
    return [at_rest, Task(J, b)]


def end_effector(w: ControlStep, gains: TaskConfig) -> Task:
    """T_2: J_2 q̈ + J̇_2 q̇ + w_2 = ẍ_d + k_v (ẋ_d − ẋ) + k_p (x_d ⊖ x).

    Paper: Eq. (26).
    """
    xdd = w.a_ref + gains.ee_damping * (w.v_ref - w.v_ee) + gains.ee_stiffness * w.e_ee
    return Task(w.J_ee, xdd - w.Jdqd_ee)


def inserted(T_sca: Task, B: Array, below: list[Task], qdd_2: Array) -> Array:
    """q̈ (n,) of the hierarchy with T_sca on top; q̈_2* is the solution of the other tasks alone.

    J_sca q̈ + J̇_sca q̇ + w_sca* = B ẍ_sca + (I − B) (J_sca q̈_2* + J̇_sca q̇).

    Paper: Eq. (29).
    """
    J, b = T_sca
    return cascade([Task(J, B * b + (1.0 - B) * (J @ qdd_2)), *below])


def cascade(levels: list[Task]) -> Array:
    """q̈ (n,): min ‖w‖ level by level, without changing the slacks of higher levels.

    The first level has the highest priority. (26) and (29) have no inequality, so each level is a
    least-squares problem in the null space of the higher levels. If a Jacobian is not finite,
    numpy raises a LinAlgError.

    Paper: Eq. (26), (29).
    """
    qdd, N = np.zeros(levels[0].J.shape[1]), np.eye(levels[0].J.shape[1])
    for J, b in levels:
        U, s, Vt = np.linalg.svd(J @ N)
        rank = int((s > _DEPENDENT * np.linalg.norm(J)).sum())
        qdd = qdd + N @ (Vt[:rank].T @ (U[:, :rank].T @ (b - J @ qdd) / s[:rank]))
        N = N @ Vt[rank:].T
    return qdd
