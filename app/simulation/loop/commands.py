"""What the loop is told: immutable records that may cross a process border."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from app.config import Config
from app.simulation.scenarios.leading import Scenario

Point = tuple[float, float, float]


@dataclass(frozen=True)
class Pull:
    """A person takes the robot and pulls it to `target`; None lets go.

    Taking or letting go of the end-effector ends a scenario that leads the hand; a pull elsewhere
    disturbs it.
    """

    target: Point | None
    """[m] where to, in the world."""
    link: str | None = None
    """One of the loop's `links`; None is the end-effector."""
    point: Point | None = None
    """[m] where the person holds, in the link's frame; None is its origin."""
    who: int = 0
    """Number of the person; each has one hand, and their forces add up."""


@dataclass(frozen=True)
class Release:
    """A person lets go, if he holds the robot; a scenario goes on."""

    who: int


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


@dataclass(frozen=True)
class Compare:
    """Begin anew where the robot stands or the scenario starts, with others beside it."""

    controllers: tuple[str, ...] = ()
    """Of the others, at most two; none ends the comparison, and the robot just goes on."""
    same: str = "path"
    """What people have in common at all of them: "path", where they pull to, or "force"."""


Command = (
    Pull
    | Release
    | Configure
    | Choose
    | Pause
    | Speed
    | StepOnce
    | Reset
    | Restart
    | Play
    | PlayScenario
    | Compare
)
