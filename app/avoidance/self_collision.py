"""Lines 3 to 13 of Algorithm 2: from the robot's state to the rows of the avoidance task."""

import math
from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from app.avoidance import task
from app.avoidance.closest_points import ClosestPoints, DistanceMonitor
from app.avoidance.mobile_acceleration import (
    ActingPoint,
    ActingPointFinder,
    PairForce,
    avoidance_force,
    generate_mob_acc,
)
from app.avoidance.task import TaskRows
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


class Avoidance(NamedTuple):
    """The avoidance task of one control step."""

    pairs: tuple[PairState, ...]
    """All pairs, those of L_m first."""
    n_mobile: int
    """How many of them are of L_m."""
    xdd_m: Array
    """(n_b,) [m/s² or rad/s²] of (16), v̇_d and ω̇_d, not yet multiplied by β_m."""
    beta_m: float
    """[-] activation of the base's rows, (28)."""
    rows_m: TaskRows | None
    """The base's rows, or None while β_m = 0."""
    rows_links: tuple[TaskRows, ...]
    """The arm's active rows between its own links, (22) and (23)."""

    @property
    def mobile(self) -> tuple[PairState, ...]:
        """The pairs of L_m."""
        return self.pairs[: self.n_mobile]


_NO_FORCE = np.zeros(3)
_NO_FORCE.setflags(write=False)
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

    def update(self, dt: float = math.inf, *, ahead: bool = False) -> Avoidance:
        """The avoidance task at the state's configuration, `dt` [s] after the last one.

        Within the buffer closest points move continuously; `ahead`, where the base makes room for
        pairs before they are in it, everywhere.

        Paper: Algorithm 2, lines 3 to 13.
        """
        n_mobile, way = len(self._pairs.mobile), BUFFER_RATE * dt
        self._d_b = self.d_b + min(max(self._config.border.d_b - self.d_b, -way), way)
        closest = self._monitor.find_closest_points(
            within=math.inf if ahead else self.d_b, blend=self._config.activation.blend
        )
        pairs = tuple([self._pair(each) for each in closest])
        mobile, model = pairs[:n_mobile], self._state.model
        forces = [PairForce(p.f, p.acting.p_act) for p in mobile if p.acting is not None]
        xdd_m = generate_mob_acc(forces, model.description.base)
        beta_m = task.mobile_activation([p.beta for p in mobile])
        rows_m = None
        if beta_m > 0.0:
            rows_m = task.mobile_rows(model.base_rows, xdd_m, beta_m)
        links = [
            task.generate_rep_acc(self._state, pair.closest, self._config.repulsion, pair.beta)
            for pair in pairs[n_mobile:]
            if pair.beta > 0.0
        ]
        return Avoidance(pairs, n_mobile, xdd_m, beta_m, rows_m, tuple(links))

    def _pair(self, closest: ClosestPoints) -> PairState:
        """Lines 4 to 6 for one pair; only those of L_m have a force."""
        beta = task.activation(closest.d, self.d_b, self._config.activation.d_full)
        finder = self._finders.get(closest.pair.name) if beta > 0.0 else None
        if finder is None:
            return PairState(closest, beta, None, _NO_FORCE)
        p_b = self._state.to_base(closest.p_b)
        acting = finder.find_acting_point(p_b, closest.d, self._config.force)
        if acting is None:
            return PairState(closest, beta, None, _NO_FORCE)
        n, f_max = self._state.R_world_base.T @ closest.n, self._config.force.f_max
        f = avoidance_force(p_b, acting.p_act, closest.d, n, f_max, self.d_b)
        return PairState(closest, beta, acting, f)

    def _make_finders(self, config: Config) -> dict[str, ActingPointFinder]:
        model = self._state.model
        return {
            pair.name: ActingPointFinder(
                border_of(model, self._clouds[pair.name], config.border),
                ScoreField.of(model, pair.b),
            )
            for pair in self._pairs.mobile
        }
