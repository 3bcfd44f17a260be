"""What others exert on the arm, learnt from how it moves."""

from __future__ import annotations

import numpy as np

from app.robot.state import RobotState

Array = np.ndarray


class PushObserver:
    """An observer of first order: ṙ = k (M_a q̈ + h_a - u_a - r), from velocities alone.

    It is the generalised-momentum observer of De Luca et al. (2006) with M taken as constant
    within a step. Tasks never see r: a guided hand stays free. Barriers do, so that
    a distance is kept while a person pulls.

    Attributes:
        r: (n_m,) [N m or N] torques that others exert on the arm's joints.
    """

    def __init__(self, n_m: int) -> None:
        self._n_m = n_m
        self.reset()

    def reset(self) -> None:
        """Nobody touches the robot."""
        self.r = np.zeros(self._n_m)
        self._qd: Array | None = None

    def pause(self) -> None:
        """Skip a period of which nothing is known."""
        self._qd = None

    def update(self, state: RobotState, u_a: Array, rate: float, dt: float) -> None:
        """Learn from one period.

        Args:
            state: The robot's state at its end.
            u_a: (n_m,) [N m or N] torques given within it.
            rate: [1/s] k.
            dt: [s] the period.
        """
        if self._qd is not None:
            n_b = state.model.n_b
            momentum = state.M[n_b:] @ (state.qd - self._qd)
            self.r = self.r + rate * (momentum + (state.h[n_b:] - u_a - self.r) * dt)
        self._qd = state.qd
