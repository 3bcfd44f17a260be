"""The scenario way-out: a start with a pair inside its buffer or in penetration, and no person."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from itertools import product
from typing import TYPE_CHECKING, Literal, get_args

import numpy as np

from app.errors import UnreachableError
from app.simulation.scenarios.leading import Driver, Scenario, Setting, StepInput
from app.strict import Array

if TYPE_CHECKING:
    from app.border.cache import BorderData
    from app.config import Config
    from app.robot.model import RobotModel
    from app.simulation.scenarios.start import PostureSearch
    from app.simulation.session import Session

Begin = Literal["penetration", "buffer", "arm"]
BEGINS: tuple[Begin, ...] = get_args(Begin)  # `WayOutScenario.begin` describes them
DEEPEST = 0.05  # [m] deepest penetration of a start
_FLOOR_MARGIN = 0.01  # [m] smallest distance between arm and floor
_FROM_ABOVE = 0.7  # [-] smallest |n_z| of a pair of L_m whose arm is above the base
_TRIES = 20_000  # [-] random postures for each pair and direction


@dataclass(frozen=True)
class WayOutScenario(Scenario):
    """The run starts in a random posture with a pair inside its buffer or in penetration."""

    name: str = "way-out"
    duration: float = 3.0
    about: str = "the robot starts inside a buffer or in penetration, and has to leave it"
    begin: Begin = "penetration"
    """Kind of the start: any pair in penetration, a pair of arm and base inside its buffer, or a
    pair within the arm inside its buffer."""

    def setting(self, model: RobotModel, data: BorderData, config: Config, seed: int) -> Setting:
        """A random posture, with the base at the origin; equal seeds give equal postures.
        A pair is drawn first, because the bodies of some pairs are rarely near each other. For a
        pair of arm and base, it is also drawn whether the arm is above the base or beside it. Then
        random postures are tried until one fits; if all fail, there is another draw. If all draws
        fail, this raises an UnreachableError; without pairs of L_m, it raises a DescriptionError.
        """
        # Imported here: scipy would delay the start of every command.
        from app.simulation.scenarios.start import PostureSearch
        from app.simulation.session import check_avoidance

        check_avoidance(model, data)
        pairs, d_b = data.pairs, config.border.d_b
        search, mobile = PostureSearch(model, pairs, d_b), len(pairs.mobile)
        rng = np.random.default_rng([seed, BEGINS.index(self.begin)])
        depth = (-DEEPEST, 0.0) if self.begin == "penetration" else (0.0, d_b)
        cases: list[tuple[int, bool | None]] = []  # index of the pair; whether the arm is above
        if self.begin != "arm":
            cases += product(range(mobile), (True, False))
        if self.begin != "buffer":
            cases += [(i, None) for i in range(mobile, len(pairs.all))]
        if not cases:
            why = f"no monitored bodies within the arm of {model.description.name} can meet"
            helps = "choose --begin buffer or penetration"
            raise UnreachableError(f"--begin {self.begin}: {why}; {helps}")
        for k in rng.permutation(len(cases)):
            guesses = (rng.uniform(model.q_lower, model.q_upper) for _ in range(_TRIES))
            judge = partial(_judge, search, *cases[k], depth)
            if (q_m := search.best(guesses, judge, enough=1.0).q_m) is not None:
                return Setting(model, data, np.zeros(3), q_m, config)
        why = f"no start of the kind {self.begin!r} is among {_TRIES} random postures of the arm"
        raise UnreachableError(f"{why} for each pair; choose another --begin")

    def driver(self, session: Session) -> Driver:
        del session
        return lambda _: StepInput()


def _judge(
    search: PostureSearch, i: int, above: bool | None, depth: tuple[float, float], _: Array
) -> float:
    """1 for a valid start, otherwise 0: pair i is the nearest, its distance is within `depth` [m],
    and the arm is off the floor. With `above` True the arm is above the base, with False beside it.
    """
    closest = search.monitor.find_closest_points()
    pair = closest[i]
    if not depth[0] <= pair.d <= depth[1] or pair.d > min(c.d for c in closest):
        return 0.0
    if above is not None and (abs(pair.n[2]) > _FROM_ABOVE) != above:
        return 0.0
    return float(search.above_floor() > _FLOOR_MARGIN)
