"""Commands to the live loop: immutable records that are valid once they exist.

A record that can never be obeyed cannot be made, so its maker gets the error. What only the
session knows is refused later, by a snapshot's `refusal`.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass
from typing import Any, get_args

from app.config import Config
from app.control.controller import CONTROLLERS
from app.errors import ConfigError, DbbError, TargetError, UnknownNameError
from app.simulation.person import checked_hold, checked_target
from app.simulation.scenarios.leading import Scenario
from app.simulation.scenarios.names import scenario_by_name
from app.simulation.trace.comparison import MOST_GHOSTS, SAMES

Point = tuple[float, float, float]

SPEEDS = 0.1, 4.0
"""[-] slowest and fastest, in times of real time."""
STEPS = 0.001, 1.0
"""[s] shortest and longest single step."""


@dataclass(frozen=True)
class Pull:
    """A person takes the robot and pulls it to `target`; None lets go.

    Taking or letting go of the end-effector ends a scenario that leads it; a pull elsewhere
    disturbs it.

    Raises:
        TargetError: The target lies below the floor, or the point is none of a link's.
        ConfigError: `who` is no number of a person.
    """

    target: Point | None
    """[m] where to, in the world."""
    link: str | None = None
    """One of the loop's `links`; None is the end-effector."""
    point: Point | None = None
    """[m] where the person holds, in the link's frame; None is its origin."""
    who: int = 0
    """Number of the person; each has one hand, and their forces add up."""

    def __post_init__(self) -> None:
        _check_person(self.who)
        if self.target is not None:
            checked_target(self.target)
        if self.point is not None:
            if self.link is None:
                raise TargetError("a point is held in the frame of a link; name the link")
            checked_hold(self.point)


@dataclass(frozen=True)
class Release:
    """A person lets go, if he holds the robot; a scenario goes on.

    Raises:
        ConfigError: `who` is no number of a person.
    """

    who: int

    def __post_init__(self) -> None:
        _check_person(self.who)


@dataclass(frozen=True)
class Configure:
    """Use this configuration from now on.

    Raises:
        ConfigError: It is none.
    """

    config: Config

    def __post_init__(self) -> None:
        if not isinstance(self.config, Config):
            raise ConfigError(f"a configuration is a Config, was {self.config!r}")


@dataclass(frozen=True)
class Choose:
    """Use the controller of that name from now on.

    Raises:
        UnknownNameError: No controller has it.
    """

    controller: str

    def __post_init__(self) -> None:
        _check_controller(self.controller)


@dataclass(frozen=True)
class Pause:
    """Stop (True) or go on (False).

    Raises:
        ConfigError: It is neither.
    """

    paused: bool

    def __post_init__(self) -> None:
        if not isinstance(self.paused, bool):
            raise ConfigError(f"paused is True or False, was {self.paused!r}")


@dataclass(frozen=True)
class Speed:
    """Run at `factor` times real time, as far as the machine can.

    Raises:
        ConfigError: It is not within `SPEEDS`.
    """

    factor: float

    def __post_init__(self) -> None:
        _check_range("the speed", self.factor, SPEEDS, "times real time")


@dataclass(frozen=True)
class StepOnce:
    """Pause, if it runs, and advance to the next snapshot, `seconds` [s] later.

    Raises:
        ConfigError: `seconds` is not within `STEPS`.
    """

    seconds: float = 0.02

    def __post_init__(self) -> None:
        _check_range("a step", self.seconds, STEPS, "s")


@dataclass(frozen=True)
class Reset:
    """Begin anew at the free start, without a scenario."""


@dataclass(frozen=True)
class Restart:
    """Begin anew where the last beginning was: at the scenario's start, or at the free one."""


@dataclass(frozen=True)
class Play:
    """Begin anew at a scenario's start, and let it lead the hand until its end or a pull.

    Raises:
        ConfigError: It is no scenario.
    """

    scenario: Scenario

    def __post_init__(self) -> None:
        if not isinstance(self.scenario, Scenario):
            raise ConfigError(f"what is played is a Scenario, was {self.scenario!r}")

    @classmethod
    def named(cls, name: str, options: Mapping[str, Any] | None = None) -> Play:
        """Play a scenario by its name.

        Args:
            name: Of the scenario.
            options: Fields that differ from its own, as `Scenario.changed` takes them.

        Raises:
            UnknownNameError: No scenario has that name.
            ConfigError: It has no such option, or a value is out of its range.
        """
        scenario = scenario_by_name(name)
        try:
            return cls(scenario.changed(**(options or {})))
        except DbbError:
            raise
        except (TypeError, ValueError) as error:  # a text for a number, a point of two numbers
            raise ConfigError(f"options of the scenario {name}: {error}") from None


@dataclass(frozen=True)
class Compare:
    """Begin anew where the robot stands or the scenario starts, with others beside it.

    Raises:
        ConfigError: They are too many.
        UnknownNameError: No controller has one of the names, or `same` is no way to compare.
    """

    controllers: tuple[str, ...] = ()
    """Of the others, at most two; none ends the comparison, and the robot just goes on."""
    same: str = "path"
    """What people have in common at all of them: "path", where they pull to, or "force"."""

    def __post_init__(self) -> None:
        names = self.controllers
        if not isinstance(names, (tuple, list)) or len(names) > MOST_GHOSTS:
            raise ConfigError(f"at most {MOST_GHOSTS} controllers are compared, was {names!r}")
        for name in names:
            _check_controller(name)
        if self.same not in SAMES:
            raise UnknownNameError("comparison", str(self.same), SAMES)


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
    | Compare
)
_COMMANDS = get_args(Command)


def check_command(command: Command, links: Collection[str]) -> None:
    """A loop can take a command: it is one, and a pull's link is one of the loop's.

    Raises:
        ConfigError: It is no command.
        UnknownNameError: There is no such link; lists those that there are.
    """
    if not isinstance(command, _COMMANDS):
        raise ConfigError(f"{command!r} is no command")
    if isinstance(command, Pull) and command.link is not None and command.link not in links:
        raise UnknownNameError("link", str(command.link), links)


def _check_person(who: Any) -> None:
    if not isinstance(who, int) or isinstance(who, bool) or who < 0:
        raise ConfigError(f"a person's number is 0 or a larger whole number, was {who!r}")


def _check_controller(name: Any) -> None:
    if not isinstance(name, str) or name not in CONTROLLERS:
        raise UnknownNameError("controller", str(name), CONTROLLERS)


def _check_range(what: str, value: Any, limits: tuple[float, float], unit: str) -> None:
    low, high = limits
    number = isinstance(value, (int, float)) and not isinstance(value, bool)
    if not (number and low <= value <= high):
        raise ConfigError(f"{what} is {low:g} to {high:g} {unit}, was {value!r}")
