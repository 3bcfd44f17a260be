"""What the loop is told: immutable records that may cross a process border."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from app.config import Config
from app.simulation.leading import Scenario


@dataclass(frozen=True)
class Pull:
    """The person takes the end-effector and pulls it to `target`; None lets go.

    It ends a scenario that leads the hand.
    """

    target: tuple[float, float, float] | None


@dataclass(frozen=True)
class Configure:
    """Use this configuration from now on."""

    config: Config


@dataclass(frozen=True)
class Choose:
    """Use the controller of that name from now on."""

    controller: str


@dataclass(frozen=True)
class Pause:
    """Stop (True) or go on (False)."""

    paused: bool


@dataclass(frozen=True)
class Speed:
    """Run at `factor` times real time, 0.1 to 4, as far as the machine can."""

    factor: float


@dataclass(frozen=True)
class StepOnce:
    """Pause, if it runs, and advance to the next snapshot, `seconds` [s] of 0.001 to 1 later."""

    seconds: float = 0.02


@dataclass(frozen=True)
class Reset:
    """Begin anew at the free start, without a scenario."""


@dataclass(frozen=True)
class Restart:
    """Begin anew where the last beginning was: at the scenario's start, or at the free one."""


@dataclass(frozen=True)
class Play:
    """Begin anew at a scenario's start, and let it lead the hand until its end or a pull."""

    scenario: Scenario


@dataclass(frozen=True)
class PlayScenario:
    """The same with a scenario by its name."""

    name: str
    options: Mapping[str, object] = field(default_factory=dict)
    """Fields of the scenario that differ from its own, as `Scenario.changed` takes them."""


Command = (
    Pull | Configure | Choose | Pause | Speed | StepOnce | Reset | Restart | Play | PlayScenario
)
