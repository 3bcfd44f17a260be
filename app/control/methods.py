"""The compared methods: what each of them puts above the stack of tasks, or among its limits."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from app.avoidance.barrier import BarrierRow, barrier_row
from app.avoidance.holding import HELD, Holding
from app.avoidance.repulsive_force import generate_rep_force_acc
from app.avoidance.self_collision import Avoidance
from app.avoidance.task import TaskRows
from app.config import Config
from app.robot.state import RobotState

Array = np.ndarray


class Inserted(NamedTuple):
    """What a method adds to the stack in one control step.

    Attributes:
        rows_m: Rows that fix the base's acceleration, or None.
        rows_links: The arm's rows that bear on the base's free part and on the arm's torques.
        rows_arm: The arm's rows that bear on its torques only.
        barriers: Rows that hold whatever the stack asks, for the base and the arm.
        n_b: How many velocity axes the base has.
        holding: How far the arm keeps the hand's place while the base's rows move it.
    """

    rows_m: TaskRows | None = None
    rows_links: tuple[TaskRows, ...] = ()
    rows_arm: tuple[TaskRows, ...] = ()
    barriers: tuple[BarrierRow, ...] = ()
    n_b: int = 2
    holding: Holding = HELD

    @property
    def rows(self) -> tuple[TaskRows, ...]:
        """All rows with an activation, the base's first."""
        base = () if self.rows_m is None else (self.rows_m,)
        return (*base, *self.rows_arm, *self.rows_links)

    @property
    def base_acceleration(self) -> Array:
        """(n_b,) [m/s² or rad/s²] that avoidance inserts, times its activation; 0 without rows."""
        return np.zeros(self.n_b) if self.rows_m is None else self.rows_m.beta * self.rows_m.xdd

    @property
    def activation(self) -> float:
        """[-] the largest activation among the rows, 0 without any."""
        return max((row.beta for row in self.rows), default=0.0)


class Method(NamedTuple):
    """One of the compared methods.

    Attributes:
        insert: What it adds to the stack.
        soft: Whether the stack below is weighted rather than strict.
    """

    insert: Callable[[RobotState, Avoidance, Config], Inserted]
    soft: bool = False


def dbb(state: RobotState, avoidance: Avoidance, config: Config) -> Inserted:
    """The paper's method: the base gives way, links of the arm part.

    Paper: Algorithm 2, line 14 (UpdateSoT).
    """
    del config
    return Inserted(
        avoidance.rows_m, avoidance.rows_links, avoidance.rows_arm, n_b=state.model.n_b,
        holding=avoidance.holding,
    )  # fmt: skip


def repulsive(state: RobotState, avoidance: Avoidance, config: Config) -> Inserted:
    """T_rep ∈ ℝ³ on the closest point of each pair of L_m; the base is not recruited (§4.2.1).

    With the same activations and the same transition as the paper's method, and the same rows
    between the arm's own links.
    """
    rows = tuple(
        generate_rep_force_acc(state, pair.closest, config.repulsion, pair.beta)
        for pair in avoidance.mobile
        if pair.beta > 0.0
    )
    return Inserted(None, avoidance.rows_links, rows, n_b=state.model.n_b)


def barrier(state: RobotState, avoidance: Avoidance, config: Config) -> Inserted:
    """What today's libraries do: each pair a hard inequality of control-barrier type.

    The end-effector's task is weighted against the cost of motion, as in those libraries, and the
    base takes part in all of it.
    """
    return Inserted(
        barriers=tuple(
            barrier_row(state, pair.closest, config.barrier) for pair in avoidance.pairs
        ),
        n_b=state.model.n_b,
    )


def none(state: RobotState, avoidance: Avoidance, config: Config) -> Inserted:
    """The same stack without avoidance."""
    del avoidance, config
    return Inserted(n_b=state.model.n_b)


METHODS: dict[str, Method] = {
    "dbb": Method(dbb),
    "repulsive": Method(repulsive, soft=True),
    "barrier": Method(barrier, soft=True),
    "none": Method(none),
}
"""By the controller's name."""
