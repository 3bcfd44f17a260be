"""Commands to the live loop: immutable records, valid by construction, and their mailbox.

An invalid record cannot be made: its constructor raises a ConfigError, an UnknownNameError for a
name, or a TargetError for a place; the type checker checks its types. The session refuses other
commands later, by a snapshot's `refusal`.
"""

import math
import threading
from collections.abc import Collection, Hashable
from dataclasses import dataclass

from app.config import Config
from app.control import CONTROLLERS
from app.errors import ConfigError, LoopError, TargetError, check_name
from app.simulation.people import checked_hold, checked_target
from app.simulation.scenarios.leading import Scenario
from app.strict import check_range

Point = tuple[float, float, float]

SPEEDS = 0.1, 4.0  # [-] smallest and largest multiple of real time
STEPS = 0.001, 1.0  # [s] shortest and longest single step
SAMES = ("path", "force")
"""The common input of compared robots: the path of the pulls, or their force."""
MAX_GHOSTS = 2  # robots that run beside the main one
MAX_WAITING = 64
"""Most waiting commands: far more than there are kinds, because commands of a kind replace one
another."""


class Command:
    """A command to the live loop."""


class Adjustment(Command):
    """Sets a value; of several only the newest counts, at the place of the first."""


class Beginning(Command):
    """Places the robot anew; of several kinds only the newest command counts."""


@dataclass(frozen=True)
class Pull(Command):
    """A person holds the robot and pulls it to `target`.

    Holding the end-effector ends a scenario that moves it; a pull elsewhere disturbs the scenario.
    """

    target: Point
    """[m] target, in the world."""
    link: str | None = None
    """One of the loop's `links`; None is the end-effector."""
    point: Point | None = None
    """[m] the held point, in the link's frame; None is its origin."""
    who: int = 0
    """Number of the person; each has one hand, and their forces add."""

    def __post_init__(self) -> None:
        checked_target(self.target)
        if self.point is not None:
            if self.link is None:
                raise TargetError("a point is held in the frame of a link; name the link")
            checked_hold(self.point)


@dataclass(frozen=True)
class Release(Command):
    """A person releases the robot, if they hold it; a scenario continues."""

    who: int


@dataclass(frozen=True)
class Configure(Adjustment):
    """Use this configuration from now on."""

    config: Config


@dataclass(frozen=True)
class Choose(Adjustment):
    """Use the controller of that name from now on."""

    controller: str

    def __post_init__(self) -> None:
        check_name("controller", self.controller, CONTROLLERS)


@dataclass(frozen=True)
class Pause(Adjustment):
    """Pause (True) or continue (False)."""

    paused: bool


@dataclass(frozen=True)
class Watch(Adjustment):
    """Whether a viewer is connected; without one no step is taken, and nothing changes."""

    watched: bool


@dataclass(frozen=True)
class Speed(Adjustment):
    """Run at `factor` times real time, within `SPEEDS` and the machine's ability."""

    factor: float

    def __post_init__(self) -> None:
        check_range("the speed", self.factor, *SPEEDS, "times real time")


@dataclass(frozen=True)
class StepOnce(Command):
    """Pause, and advance to the next snapshot, `seconds` [s] later, within `STEPS`."""

    seconds: float = 0.02

    def __post_init__(self) -> None:
        check_range("a step", self.seconds, *STEPS, "s")


@dataclass(frozen=True)
class Reset(Beginning):
    """Start again at the free start, or at a posture, without a scenario."""

    q_m: tuple[float, ...] = ()
    """(n_m,) [rad or m] joint positions of the arm; empty for those of the free start."""
    base_pose: Point = (0.0, 0.0, 0.0)
    """[m] [m] [rad] x, y and heading of the base."""

    def __post_init__(self) -> None:
        if not all(map(math.isfinite, (*self.q_m, *self.base_pose))):
            raise TargetError(f"a posture is of finite numbers, was {self!r}")


@dataclass(frozen=True)
class Restart(Beginning):
    """Start again at the last start: the scenario's or the free one."""


@dataclass(frozen=True)
class Play(Beginning):
    """Start a scenario; it moves the end-effector to its end, or until a person pulls it."""

    scenario: Scenario
    until: float = 0.0
    """[s] time up to which it runs as fast as possible, then pauses; 0 means no fast run."""

    def __post_init__(self) -> None:
        check_range("the time to stop at", self.until, 0.0, self.scenario.duration, "s")


@dataclass(frozen=True)
class Compare(Command):
    """Start again, at the present state or the scenario's start, with compared robots."""

    controllers: tuple[str, ...] = ()
    """Of the compared robots, at most two; empty ends the comparison, and the robot continues."""
    same: str = "path"
    """The common input of all robots: "path" of the pulls or their "force"."""

    def __post_init__(self) -> None:
        if len(self.controllers) > MAX_GHOSTS:
            raise ConfigError(f"at most {MAX_GHOSTS} controllers are compared")
        for name in self.controllers:
            check_name("controller", name, CONTROLLERS)
        check_name("comparison", self.same, SAMES)


class Mailbox:
    """Takes commands from any thread; one thread fetches them.

    The number of waiting commands is bounded, and so is the work of executing them: if commands
    replace one another, only the newest waits. A setting takes the place of the command that it
    replaces, so that a start that was sent in between uses the newest one. An event, such as a
    pull, takes its place at the end.
    """

    def __init__(self) -> None:
        self._waiting: dict[Hashable, Command] = {}
        self._lock = threading.Lock()
        self.filled = threading.Event()
        """Set while commands wait."""

    def put(self, command: Command, links: Collection[str]) -> None:
        """Add a command; the arm can be held at `links`.

        Raises:
            UnknownNameError: A pull's link is not in `links`.
            LoopError: Too many different commands wait.
        """
        if isinstance(command, Pull) and command.link is not None:
            check_name("link", str(command.link), links)  # a page may send any name
        key = _key(command)
        with self._lock:
            if len(self._waiting) >= MAX_WAITING and key not in self._waiting:
                raise LoopError(f"more than {MAX_WAITING} commands wait; send fewer at once")
            if isinstance(command, Restart) and key in self._waiting:
                return  # one restart is sufficient
            if not isinstance(command, Adjustment):
                self._waiting.pop(key, None)
            self._waiting[key] = command
            self.filled.set()

    def take(self) -> list[Command]:
        """All waiting commands, in order; the mailbox is then empty."""
        if not self._waiting:  # without the lock, because it is called a thousand times a second
            return []
        with self._lock:
            commands = list(self._waiting.values())
            self._waiting.clear()
            self.filled.clear()
        return commands


def _key(command: Command) -> Hashable:
    """Commands with equal keys replace one another."""
    if isinstance(command, (Pull, Release)):
        return Pull, command.who
    return Beginning if isinstance(command, Beginning) else type(command)
