"""One strictly convex QP a step: tasks by weight, limits that give in where they contradict.

Its solution is continuous in its data, whatever enters or leaves: nothing in it can jump.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from app.control.linear_algebra import holds, minimum, nearest_within

Array = np.ndarray

_EPS = 1e-10  # by which limits may be missed


class Objective(NamedTuple):
    """min ½ q̈ᵀ H q̈ + cᵀ q̈, strictly convex.

    Attributes:
        H: (n, n) symmetric positive definite.
        c: (n,).
    """

    H: Array
    c: Array


class Limits(NamedTuple):
    """l ≤ C q̈ ≤ u.

    Attributes:
        C: (m, n).
        l: (m,) lower bounds.
        u: (m,) upper bounds.
        softness: (m,) [-] ε of each row; one of 0 holds whatever the others ask.
    """

    C: Array
    l: Array
    u: Array
    softness: Array


class NoSolutionError(Exception):
    """The QP has no solution: what it is given is not finite, or its solver failed."""


class TaskQP:
    """Finds the least of an objective within limits.

    Where no limit is met the least is known in closed form. Else, with H = L Lᵀ and z = Lᵀ (q̈ -
    q̈*) from the free optimum q̈*, the answer is the z nearest to 0 that keeps the limits. A soft
    limit i has a slack that costs 1/(ε_i C_i H⁻¹ C_iᵀ): so it gives in by ε_i of what the tasks
    alone would have asked beyond it, and no soft limit, nor two that contradict each other, can
    leave the problem without an answer.
    """

    def solve(self, objective: Objective, limits: Limits) -> Array:
        """The optimum q̈, (n,).

        Args:
            objective: What is to be least.
            limits: Of q̈.

        Raises:
            NoSolutionError: The data are not finite, or the hard limits contradict each other.
        """
        x, L = minimum(*objective)
        if not np.isfinite(x).all():
            raise NoSolutionError("the tasks are not finite")
        if holds(*limits[:3], x, _EPS):
            return x
        qdd, found = nearest_within(x, L, *limits)
        if not found:
            raise NoSolutionError("the limits are not finite, or contradict each other")
        return qdd
