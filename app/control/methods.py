"""The compared methods: what each of them puts above the stack of tasks, or among its limits."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from app.avoidance.closest_points import ClosestPoints
from app.avoidance.self_collision import Avoidance
from app.avoidance.task import Distances, TaskRows
from app.config import Config, RepulsionConfig
from app.control import CONTROLLERS
from app.control.kernels import reaction
from app.robot.state import RobotState
from app.strict import Array


class Inserted(NamedTuple):
    """What a method adds to the stack in one control step."""

    rows_m: TaskRows | None = None
    """Rows that fix the base's acceleration, or None."""
    rows_arm: tuple[TaskRows, ...] = ()
    """The arm's rows against the base."""
    rows_links: tuple[TaskRows, ...] = ()
    """Rows between the arm's links."""
    kept: Distances | None = None
    """What is left of the distances that the arm keeps while the other tasks give in."""
    ahead: Distances | None = None
    """The same of those for which the base makes room in time: between links their buffers too."""
    base_too: bool = False
    """Whether the base takes part in keeping them."""
    n_b: int = 2
    """How many velocity axes the base has."""
    u_a: Array | float = 0.0
    """(n_m,) [N m or N] torques besides those of a guided arm by itself."""

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


Method = Callable[[RobotState, Avoidance, Config], Inserted]
"""One of the compared methods: what it adds to the stack."""


def dbb(state: RobotState, avoidance: Avoidance, config: Config) -> Inserted:
    """The paper's method: the base gives way, links of the arm part.

    Where the base cannot help, from above, or is not yet out of the way, the arm keeps a distance
    of its own from the base: our extension.

    Paper: Algorithm 2, line 14 (UpdateSoT).
    """
    near, every, n_b = avoidance.near, avoidance.convex, state.model.n_b
    least = np.full(len(every.d), avoidance.d_b)
    least[: avoidance.n_convex] = config.barrier.d_min
    ahead = every.beyond(least)
    return Inserted(
        avoidance.rows_m,
        rows_links=avoidance.rows_links,
        kept=ahead.of(slice(avoidance.n_convex)),
        ahead=ahead,
        n_b=n_b,
        u_a=reaction(near.d, near.J[:, n_b:], config.force.f_arm, avoidance.d_b),
    )


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
    return Inserted(rows_arm=rows, rows_links=avoidance.rows_links, n_b=state.model.n_b)


def generate_rep_force_acc(
    state: RobotState, closest: ClosestPoints, config: RepulsionConfig, beta: float
) -> TaskRows:
    """T_rep ∈ ℝ³, the compared method: the arm's closest point is pushed away from the base.

    ẍ_rep = k_p u - k_v (ṗ_b - ṗ_a), realised by the arm alone: the base's columns are zero. §4.2.1
    names the method; its force on the closest point and its damping are Dietrich's. `closest` is of
    a pair of L_m with the activation β [-]; the rows are in axes of the world.
    """
    joint = state.model.body_joints[closest.pair.b]
    J = state.point_jacobian(joint, closest.p_b)
    J[:, : state.model.n_b] = 0.0
    velocity = J @ state.qd  # relative to the base
    return TaskRows(
        J,
        state.point_bias(joint, closest.p_b),
        config.k_p * closest.n - config.k_v * velocity,
        beta,
    )


def barrier(state: RobotState, avoidance: Avoidance, config: Config) -> Inserted:
    """What today's libraries do: each distance an inequality of control-barrier type.

    The base takes part in all of it.
    """
    kept = avoidance.convex.beyond(config.barrier.d_min)
    return Inserted(kept=kept, base_too=True, n_b=state.model.n_b)


def none(state: RobotState, avoidance: Avoidance, config: Config) -> Inserted:
    """The same stack without avoidance."""
    del avoidance, config
    return Inserted(n_b=state.model.n_b)


METHODS: dict[str, Method] = dict(zip(CONTROLLERS, (dbb, repulsive, barrier, none), strict=True))
"""By the controller's name."""
