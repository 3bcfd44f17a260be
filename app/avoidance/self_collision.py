"""Lines 3 to 13 of Algorithm 2: from the robot's state to the rows of the avoidance task."""

import math
from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from app.avoidance import task
from app.avoidance.closest_points import ClosestPoints, DistanceMonitor, Nearest
from app.avoidance.mobile_acceleration import (
    ActingPoint,
    ActingPointFinder,
    PairForce,
    avoidance_force,
    generate_mob_acc,
)
from app.avoidance.task import Distances, TaskRows
from app.border.dbb import Cloud
from app.border.nearest import border_of
from app.border.score import ScoreField
from app.config import Config
from app.robot.link_pairs import LinkPairs
from app.robot.state import RobotState
from app.strict import Array


class PairState(NamedTuple):
    """Distance and activation of one pair, and for an active pair of L_m where its force acts."""

    closest: ClosestPoints
    """Closest points, in the world."""
    beta: float
    """[-] activation parameter."""
    acting: ActingPoint | None
    """Acting point in the base's frame, or None outside the buffer."""
    f: Array
    """(3,) [N] force f_m,i in the base's frame."""


class Push(NamedTuple):
    """What an active pair of L_m does to the base, in the base's frame."""

    acting: ActingPoint
    """Acting point."""
    f: Array
    """(3,) [N] force f_m,i."""


_NO_FORCE = np.zeros(3)
_NO_FORCE.setflags(write=False)
_NO_PUSH = (None, _NO_FORCE)


class Avoidance(NamedTuple):
    """The avoidance task of one control step."""

    nearest: Nearest
    """Closest points of all pairs, those of L_m first."""
    n_mobile: int
    """How many of them are of L_m."""
    beta: tuple[float, ...]
    """[-] activation parameter of each pair."""
    pushes: Mapping[int, Push]
    """By the pairs of L_m that have one."""
    xdd_m: Array
    """(n_b,) [m/s² or rad/s²] of (16), v̇_d and ω̇_d, not yet multiplied by β_m."""
    beta_m: float
    """[-] activation of the base's rows, (28)."""
    rows_m: TaskRows | None
    """The base's rows, or None while β_m = 0."""
    rows_links: tuple[TaskRows, ...]
    """The arm's active rows between its own links, (22) and (23)."""
    near: Distances
    """How far the pairs of L_m are."""
    convex: Distances
    """The same of all pairs, of each convex part of a body by itself: of L_m, then of L_m^c."""
    n_convex: int
    """How many of these are of L_m."""
    d_b: float
    """[m] the buffer distance in force."""

    @property
    def pairs(self) -> tuple[PairState, ...]:
        """All pairs, those of L_m first; made when they are asked for."""
        return tuple(map(self._pair, range(len(self.beta))))

    @property
    def mobile(self) -> tuple[PairState, ...]:
        """The pairs of L_m."""
        return tuple(map(self._pair, range(self.n_mobile)))

    def _pair(self, i: int) -> PairState:
        return PairState(self.nearest.closest(i), self.beta[i], *self.pushes.get(i, _NO_PUSH))


BUFFER_RATE = 0.1  # [m/s] at which the buffer takes on another d_b


class SelfCollisionAvoidance:
    """Builds the avoidance task of each control step; holds the borders for d_b and ε."""

    def __init__(
        self, state: RobotState, pairs: LinkPairs, clouds: Mapping[str, Cloud], config: Config
    ) -> None:
        """Prepare distances and borders.

        The state is read at each `update`; `pairs` are L_m and L_m^c, `clouds` P_i of each pair of
        L_m by its name. `configure` changes the parameters.
        """
        self._state = state
        self._pairs = pairs
        self._clouds = clouds
        self._monitor = DistanceMonitor(state, [*pairs.mobile, *pairs.manipulator])
        rows = [parts or [whole] for whole, *parts in self._monitor.rows]  # with a convex body
        self._n_convex = sum(map(len, rows[: len(pairs.mobile)]))
        several = any(len(parts) > 1 for parts in rows)
        self._convex = np.concatenate(rows) if several else None
        self._config = config
        self._d_b: float | None = None  # none in force before the first step
        self._finders = self._make_finders(config)

    def reset(self) -> None:
        """Let the configured buffer distance hold from the next step on."""
        self._d_b = None

    @property
    def d_b(self) -> float:
        """[m] the buffer distance in force."""
        return self._config.border.d_b if self._d_b is None else self._d_b

    def configure(self, config: Config) -> None:
        """Use other parameters; another d_b or ε selects other borders from the same clouds.

        The buffer itself grows or shrinks to it by `BUFFER_RATE`: an arm inside of it would be
        thrown aside.
        """
        if config.border != self._config.border:
            self._finders = self._make_finders(config)
        self._config = config

    def field(self, pair: str) -> ScoreField:
        """The score by which a pair of L_m chooses its acting points, by the pair's name."""
        return self._finders[pair].field

    def update(self, dt: float = math.inf) -> Avoidance:
        """The avoidance task at the state's configuration, `dt` [s] after the last one.

        Paper: Algorithm 2, lines 3 to 13.
        """
        n_mobile, way = len(self._pairs.mobile), BUFFER_RATE * dt
        self._d_b = self.d_b + min(max(self._config.border.d_b - self.d_b, -way), way)
        nearest = self._monitor.find_nearest(self._config.activation.blend)
        distances = task.distances_of(self._state, nearest)
        d_full, model = self._config.activation.d_full, self._state.model
        d = nearest.d[: len(nearest.pairs)].tolist()
        beta = tuple([task.activation(each, self.d_b, d_full) for each in d])
        pushes: dict[int, Push] = {}
        for i in range(n_mobile):
            if beta[i] > 0.0 and (push := self._push(nearest, i)) is not None:
                pushes[i] = push
        forces = [PairForce(push.f, push.acting.p_act) for push in pushes.values()]
        xdd_m = generate_mob_acc(forces, model.description.base)
        beta_m = task.mobile_activation(beta[:n_mobile])
        rows_m = None
        if beta_m > 0.0:
            rows_m = task.mobile_rows(model.base_rows, xdd_m, beta_m)
        links = [
            task.generate_rep_acc(distances.of(slice(i, i + 1)), self._config.repulsion, beta[i])
            for i in range(n_mobile, len(beta))
            if beta[i] > 0.0
        ]
        return Avoidance(
            nearest,
            n_mobile,
            beta,
            pushes,
            xdd_m,
            beta_m,
            rows_m,
            tuple(links),
            distances.of(slice(n_mobile)),
            distances if self._convex is None else distances.of(self._convex),
            self._n_convex,
            self.d_b,
        )

    def _push(self, nearest: Nearest, i: int) -> Push | None:
        """Lines 5 and 6 for a pair of L_m; None if l_m has no border at all."""
        (_, p_b, n, _), d, force = nearest.points[i], nearest.d.item(i), self._config.force
        p_b, n = self._state.to_base(p_b), self._state.R_world_base.T @ n
        acting = self._finders[nearest.pairs[i].name].find_acting_point(p_b, d, force)
        if acting is None:
            return None
        f = avoidance_force(p_b, acting.p_act, d, n, force.f_max, self.d_b)
        return Push(acting, f)

    def _make_finders(self, config: Config) -> dict[str, ActingPointFinder]:
        model = self._state.model
        return {
            pair.name: ActingPointFinder(
                border_of(model, self._clouds[pair.name], config.border),
                ScoreField.of(model, pair.b),
            )
            for pair in self._pairs.mobile
        }
