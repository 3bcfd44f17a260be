"""(26) to (29) as printed in the paper (§3.4): strict levels and their transition.

This is the compared method `hqp`; the other parts of its step are those of `dbb`
(docs/comparison.md lists them). The cascade below corrects the paper only where necessary:

- (29) has (I − B) (J_sca q̈_2* + J̇_sca q̇) on the right side: only then it is (26) at B = 0.
- (26) leaves q̈ open if T_2 has fewer rows than q̈ has entries. A lowest level completes it:
  posture and damping, with a large weight on the wheels. A guided arm has no T_2 (§4.2.2): its
  lowest levels are a base at rest, then gravity compensation with joint damping.
- The level T_sca has only the rows with β > 0, so that a pair has a row only within its buffer.

u is not an unknown here: (26) defines it as M q̈ + C q̇ + g, without a constraint on q̈.
"""

from typing import NamedTuple

import numpy as np

from app.config import TaskConfig
from app.control.quantities import ControlStep
from app.strict import Array

_DEPENDENT = 1e-9  # [-] singular value, relative to the level's norm, that counts as 0


class Task(NamedTuple):
    """A level T: J q̈ + w = b with the slack w, where b = ẍ − J̇ q̇."""

    J: Array
    """(m, n)"""
    b: Array
    """(m,)"""


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
    """The levels below T_sca: T_2 and posture, or the two levels of a guided arm."""
    if w.tracking:
        return [end_effector(w, gains), posture(w)]
    return [base_at_rest(w, gains), gravity_compensation(w)]


def end_effector(w: ControlStep, gains: TaskConfig) -> Task:
    """T_2: J_2 q̈ + J̇_2 q̇ + w_2 = ẍ_d + k_v (ẋ_d − ẋ) + k_p (x_d ⊖ x).

    Paper: Eq. (26).
    """
    xdd = w.a_ref + gains.ee_damping * (w.v_ref - w.v_ee) + gains.ee_stiffness * w.e_ee
    return Task(w.J_ee, xdd - w.Jdqd_ee)


def posture(w: ControlStep) -> Task:
    """Posture and damping, with a large weight on the wheels: the diagonal objective `w.H_low`."""
    root = np.sqrt(np.diag(w.H_low))
    return Task(np.diag(root), -w.c_low / root)


def base_at_rest(w: ControlStep, gains: TaskConfig) -> Task:
    """q̈_b = −k q̇_b: the base comes to rest."""
    return Task(np.eye(w.n_b, len(w.qd)), -gains.base_damping * w.qd[: w.n_b])


def gravity_compensation(w: ControlStep) -> Task:
    """Min (u_a − u_0)ᵀ M_aa⁻¹ (u_a − u_0), with u_a = M_a q̈ + h_a and u_0 = `w.u_free`."""
    M_a, h_a = w.M[w.n_b :], w.h[w.n_b :]
    return Task(np.linalg.solve(w.L_aa, M_a), np.linalg.solve(w.L_aa, w.u_free - h_a))


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
    least-squares problem in the null space of the higher levels.

    Raises:
        LinAlgError: A Jacobian is not finite.

    Paper: Eq. (26), (29).
    """
    qdd, N = np.zeros(levels[0].J.shape[1]), np.eye(levels[0].J.shape[1])
    for J, b in levels:
        U, s, Vt = np.linalg.svd(J @ N)
        rank = int((s > _DEPENDENT * np.linalg.norm(J)).sum())
        qdd = qdd + N @ (Vt[:rank].T @ (U[:, :rank].T @ (b - J @ qdd) / s[:rank]))
        N = N @ Vt[rank:].T
    return qdd
