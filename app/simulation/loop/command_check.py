"""Commands are checked where they enter, so that what is wrong is its sender's error."""

from __future__ import annotations

from collections.abc import Collection
from typing import Any, get_args

from app.config import Config
from app.control.names import CONTROLLERS
from app.errors import ConfigError, DbbError, TargetError, UnknownNameError
from app.simulation.loop.commands import (
    Choose,
    Command,
    Compare,
    Configure,
    Pause,
    Play,
    PlayScenario,
    Pull,
    Release,
    Speed,
    StepOnce,
)
from app.simulation.person import checked_hold, checked_target
from app.simulation.scenarios.leading import Scenario
from app.simulation.scenarios.names import scenario_by_name
from app.simulation.trace.comparison import MOST_GHOSTS, SAMES

COMMANDS = get_args(Command)
SPEEDS = 0.1, 4.0
"""[-] slowest and fastest, in times of real time."""
STEPS = 0.001, 1.0
"""[s] shortest and longest single step."""


def checked(command: Command, links: Collection[str] = ()) -> Command:
    """The command, if it can be obeyed as far as can be told without the session.

    Args:
        command: What was sent.
        links: Where the arm can be held.

    Returns:
        The same, or the `Play` of a `PlayScenario`.

    Raises:
        TargetError: The person's hand would be below the floor, or holds nothing of the link.
        UnknownNameError: No controller, scenario or link has that name.
        ConfigError: It is no command, a scenario has no such option, or a value is out of its
            range.
    """
    if not isinstance(command, COMMANDS):
        raise ConfigError(f"{command!r} is no command")
    if isinstance(command, (Pull, Release)):
        _check_person(command, links)
    elif isinstance(command, Choose):
        checked_controller(command.controller)
    elif isinstance(command, Compare):
        _check_comparison(command)
    elif isinstance(command, Configure) and not isinstance(command.config, Config):
        raise ConfigError(f"a configuration is a Config, was {command.config!r}")
    elif isinstance(command, Pause) and not isinstance(command.paused, bool):
        raise ConfigError(f"paused is True or False, was {command.paused!r}")
    elif isinstance(command, Speed):
        _check_range("the speed", command.factor, SPEEDS, "times real time")
    elif isinstance(command, StepOnce):
        _check_range("a step", command.seconds, STEPS, "s")
    elif isinstance(command, Play) and not isinstance(command.scenario, Scenario):
        raise ConfigError(f"what is played is a Scenario, was {command.scenario!r}")
    elif isinstance(command, PlayScenario):
        return Play(_scenario(command))
    return command


def checked_controller(name: str) -> str:
    """The name, if a controller has it.

    Raises:
        UnknownNameError: Lists those that exist.
    """
    if not isinstance(name, str) or name not in CONTROLLERS:
        raise UnknownNameError("controller", str(name), CONTROLLERS)
    return name


def _check_person(command: Pull | Release, links: Collection[str]) -> None:
    if not isinstance(command.who, int) or isinstance(command.who, bool) or command.who < 0:
        raise ConfigError(f"a person's number is 0 or a larger whole number, was {command.who!r}")
    if isinstance(command, Release):
        return
    if command.target is not None:
        checked_target(command.target)
    if command.link is not None and command.link not in links:
        raise UnknownNameError("link", str(command.link), links)
    if command.point is not None:
        if command.link is None:
            raise TargetError("a point is held in the frame of a link; name the link")
        checked_hold(command.point)


def _check_comparison(command: Compare) -> None:
    names = command.controllers
    if not isinstance(names, (tuple, list)) or len(names) > MOST_GHOSTS:
        raise ConfigError(f"at most {MOST_GHOSTS} controllers are compared, was {names!r}")
    for name in names:
        checked_controller(name)
    if command.same not in SAMES:
        raise UnknownNameError("comparison", str(command.same), SAMES)


def _check_range(what: str, value: Any, limits: tuple[float, float], unit: str) -> None:
    low, high = limits
    number = isinstance(value, (int, float)) and not isinstance(value, bool)
    if not (number and low <= value <= high):
        raise ConfigError(f"{what} is {low:g} to {high:g} {unit}, was {value!r}")


def _scenario(command: PlayScenario) -> Scenario:
    scenario = scenario_by_name(command.name)
    try:
        return scenario.changed(**command.options)
    except DbbError:
        raise
    except (TypeError, ValueError) as error:  # a text for a number, a point of two numbers
        raise ConfigError(f"options of the scenario {command.name}: {error}") from None
