"""People pull the robot freely, or repeat recorded pulls."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from app.errors import CaseError, DbbError
from app.simulation.scenarios.leading import Driver, Scenario, Setting, StepInput
from app.strict import Array

if TYPE_CHECKING:
    from app.border.cache import BorderData
    from app.config import Config
    from app.robot.model import RobotModel
    from app.simulation.session import Session

Point = tuple[float, float, float]

BEGIN = "guiding-front"  # scenario whose start is also the free start of the end-effector


class PullEvent(NamedTuple):
    """A person pulls the robot from a control step on, or releases it."""

    step: int
    """Number of the control step."""
    who: int
    """Number of the person."""
    target: Point | None
    """(3,) [m] target in the world; None means that the person releases the robot."""
    link: str | None = None
    """Name of one of `held_links`; None is the end-effector."""
    point: Point = (0.0, 0.0, 0.0)
    """(3,) [m] the held point in the link's frame."""


@dataclass(frozen=True)
class PulledScenario(Scenario):
    """People pull the robot.

    With recorded pulls the scenario repeats them; without any, viewers pull as they like.

    The base starts at the origin and faces +x.
    """

    q_m: tuple[float, ...] = ()
    """(n_m,) [rad or m] joint positions of the arm at the start; empty means the free start."""
    pulls: tuple[PullEvent, ...] = ()
    """Recorded pulls, in order; empty for free pulls."""

    @property
    def open(self) -> bool:
        return not self.pulls

    def __post_init__(self) -> None:
        super().__post_init__()
        try:
            object.__setattr__(self, "pulls", tuple(map(_checked, self.pulls)))
            finite = all(map(math.isfinite, self.q_m))
        except (TypeError, ValueError, DbbError) as error:
            raise CaseError(f"{self.name}: an impossible pull: {error}") from None
        if not finite:
            raise CaseError(f"{self.name}: the joint positions {self.q_m!r} are not all finite")

    def setting(self, model: RobotModel, data: BorderData, config: Config, seed: int) -> Setting:
        from app.simulation.people import held_links

        unknown = {pull.link for pull in self.pulls} - {None, *held_links(model)}
        if unknown or (self.q_m and len(self.q_m) != model.n_m):
            raise CaseError(f"{self.name}: the case is not of the robot {model.description.name}")
        q_m = np.array(self.q_m) if self.q_m else free_start(model, data, config, None, seed)
        return Setting(model, data, np.zeros(3), q_m, config)

    def driver(self, session: Session) -> Driver:
        from app.simulation.people import Hold
        from app.simulation.session import DT

        holds: dict[int, Hold] = {}
        waiting = list(reversed(self.pulls))

        def lead(session: Session) -> StepInput:
            while waiting and waiting[-1].step <= round(session.t / DT):
                _, who, target, link, point = waiting.pop()
                if target is None:
                    holds.pop(who, None)
                else:
                    holds[who] = Hold(who, np.array(target), link, point)
            return StepInput(holds=tuple(holds.values()))

        return lead


def free_start(
    model: RobotModel, data: BorderData, config: Config, start: Sequence[float] | None, seed: int
) -> Array:
    """Find the arm's posture (n_m,) at the free start.

    Args:
        model: The robot.
        data: Its border data.
        config: All parameters.
        start: (3,) [m] position of the end-effector; None means the start of `guiding-front`, or
            the ready position if the robot has no line for that scenario.
        seed: Seed of the search.

    Raises:
        UnreachableError: The search has found no configuration.
    """
    # Imported here: scipy would delay the start of every command.
    from app.simulation.scenarios.start import find_start

    place = model.description.lines.get(BEGIN)
    at = place.start_m if start is None and place else start
    if at is None:  # the robot has no line for the scenario
        return np.array(model.description.arm.ready_position)
    x, y, z = at
    return find_start(model, data.pairs, config.border.d_b, (x, y, z), seed=seed)


def _checked(data: Sequence[object]) -> PullEvent:
    """Check the data of a pull from an untrusted file, and make the pull."""
    from app.simulation.people import checked_hold, checked_target

    pull = PullEvent(*data)  # type: ignore[arg-type]
    checked_hold(pull.point)
    if pull.target is not None:
        checked_target(pull.target)
    if not all(isinstance(number, int) and number >= 0 for number in pull[:2]):
        raise CaseError(f"a control step {pull.step!r} or a person {pull.who!r} is not a number")
    return pull


CHALLENGE = PulledScenario("make-it-collide", 30.0, "pull the robot into itself, if you can")
"""The challenge for viewers: free pulls of any part of the arm."""
