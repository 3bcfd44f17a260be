"""Starts in trouble: a pair inside its buffer or in penetration, without a person."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from itertools import product
from typing import TYPE_CHECKING, Literal

import numpy as np

from app.errors import ConfigError, UnreachableError
from app.simulation.scenarios.leading import Driver, Scenario, Setting, StepInput
from app.strict import Array

if TYPE_CHECKING:
    from app.border.cache import BorderData
    from app.config import Config
    from app.robot.link_pairs import LinkPairs
    from app.robot.model import RobotModel
    from app.simulation.session import Session

Begin = Literal["penetration", "buffer", "arm"]
BEGINS: tuple[Begin, ...] = ("penetration", "buffer", "arm")
"""Kinds of starts: a pair in penetration; a pair of L_m inside its buffer, none in penetration;
a pair of L_m^c inside its buffer, none in penetration."""

DEEPEST = 0.05  # [m] deepest penetration of a start
_FLOOR_MARGIN = 0.01  # [m] between arm and floor
_FROM_ABOVE = 0.7  # [-] |n_z| from which a pair of L_m meets from above
_TRIES = 20_000  # most random configurations for a kind of start


@dataclass(frozen=True)
class WayOutScenario(Scenario):
    """The arm starts in a forbidden posture, random by the seed, without a person."""

    name: str = "way-out"
    duration: float = 3.0
    about: str = "a start inside a buffer or in penetration that the robot has to leave"
    begin: Begin = "penetration"
    """Kind of the start."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.begin not in BEGINS:
            raise ConfigError(f"--begin: {self.begin!r} is none of {', '.join(BEGINS)}")

    def setting(self, model: RobotModel, data: BorderData, config: Config, seed: int) -> Setting:
        starts = TroubledStarts(model, data.pairs, config.border.d_b)
        return Setting(model, data, np.zeros(3), starts.draw(self.begin, seed), config)

    def driver(self, session: Session) -> Driver:
        del session
        return lambda _: StepInput()


class TroubledStarts:
    """Random arm configurations in trouble, with the base at the origin.

    The pair is chosen first, and for a pair of L_m also whether the arm meets the base
    from above or from the side: some of these hardly occur among uniform configurations.
    """

    def __init__(self, model: RobotModel, pairs: LinkPairs, d_b: float) -> None:
        """Prepare for a robot and a buffer distance [m]."""
        # Imported here: scipy would delay the start of every command.
        from app.simulation.scenarios.posture import PostureSearch

        self._pairs, self._search = pairs, PostureSearch(model, pairs, d_b)

    def draw(self, begin: Begin, seed: int) -> Array:
        """(n_m,) an arm configuration of that kind, the same for the same seed.

        Raises:
            UnreachableError: No configuration was found.
        """
        search, mobile = self._search, len(self._pairs.mobile)
        model, rng = search.model, np.random.default_rng([seed, BEGINS.index(begin)])
        depth = (-DEEPEST, 0.0) if begin == "penetration" else (0.0, search.d_b)
        kinds: list[tuple[int, bool | None]] = []  # which pair, and whether it meets from above
        if begin != "arm":
            kinds += product(range(mobile), (True, False))
        if begin != "buffer":
            kinds += [(i, None) for i in range(mobile, len(self._pairs.all))]
        for k in rng.permutation(len(kinds)):
            guesses = (rng.uniform(model.q_lower, model.q_upper) for _ in range(_TRIES))
            judge = partial(self._judge, *kinds[k], depth)
            if (q_m := search.best(guesses, judge, enough=1.0).q_m) is not None:
                return q_m
        raise UnreachableError(
            f"no configuration of the arm starts with {begin!r} in {_TRIES} tries a pair"
        )

    def _judge(self, i: int, above: bool | None, depth: tuple[float, float], _: Array) -> float:
        """Whether pair i is the nearest one, its distance within `depth`, from above or not.

        An arm that is nearer to the floor than a margin does not count.
        """
        closest = self._search.monitor.find_closest_points()
        pair = closest[i]
        if not depth[0] <= pair.d <= depth[1] or pair.d > min(c.d for c in closest):
            return 0.0
        if above is not None and (abs(pair.n[2]) > _FROM_ABOVE) != above:
            return 0.0
        return float(self._search.above_floor() > _FLOOR_MARGIN)
