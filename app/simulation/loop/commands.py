"""Commands to the live loop: immutable records that are valid once they exist, and their mailbox.

A record that can never be obeyed cannot be made: its maker gets a ConfigError, for a name an
UnknownNameError, for a place a TargetError; its types are the type checker's. What only the
session knows is refused later, by a snapshot's `refusal`.
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

SPEEDS = 0.1, 4.0  # [-] slowest and fastest, in times of real time
STEPS = 0.001, 1.0  # [s] shortest and longest single step
SAMES = ("path", "force")
"""What robots that are compared have in common: where people pull to, or how strongly."""
MOST_GHOSTS = 2  # robots that run beside the one that is led
MOST = 64
"""Commands that may wait at once; as those of a kind replace one another, far more than there are
kinds."""


class Command:
    """What the live loop is asked for."""


class Adjustment(Command):
    """Something is set; of several only the newest counts, at the place of the first."""


class Beginning(Command):
    """The robot is put somewhere; of several only the newest counts, whatever their kinds."""


@dataclass(frozen=True)
class Pull(Command):
    """A person takes the robot and pulls it to `target`.

    Taking the end-effector ends a scenario that leads it; a pull elsewhere disturbs it.
    """

    target: Point
    """[m] where to, in the world."""
    link: str | None = None
    """One of the loop's `links`; None is the end-effector."""
    point: Point | None = None
    """[m] where the person holds, in the link's frame; None is its origin."""
    who: int = 0
    """Number of the person; each has one hand, and their forces add up."""

    def __post_init__(self) -> None:
        checked_target(self.target)
        if self.point is not None:
            if self.link is None:
                raise TargetError("a point is held in the frame of a link; name the link")
            checked_hold(self.point)


@dataclass(frozen=True)
class Release(Command):
    """A person lets go, if he holds the robot; a scenario goes on."""

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
    """Stop (True) or go on (False)."""

    paused: bool


@dataclass(frozen=True)
class Watch(Adjustment):
    """Somebody is there (True), or nobody: then no step is taken, and all stays as it is."""

    watched: bool


@dataclass(frozen=True)
class Speed(Adjustment):
    """Run at `factor` times real time, within `SPEEDS`, as far as the machine can."""

    factor: float

    def __post_init__(self) -> None:
        check_range("the speed", self.factor, *SPEEDS, "times real time")


@dataclass(frozen=True)
class StepOnce(Command):
    """Pause, if it runs, and advance to the next snapshot, `seconds` [s] later, within `STEPS`."""

    seconds: float = 0.02

    def __post_init__(self) -> None:
        check_range("a step", self.seconds, *STEPS, "s")


@dataclass(frozen=True)
class Reset(Beginning):
    """Begin anew at the free start, or at a posture, without a scenario."""

    q_m: tuple[float, ...] = ()
    """(n_m,) [rad or m] the arm's joints; none are the free start's."""
    base_pose: Point = (0.0, 0.0, 0.0)
    """[m] [m] [rad] x, y and heading of the base."""

    def __post_init__(self) -> None:
        if not all(map(math.isfinite, (*self.q_m, *self.base_pose))):
            raise TargetError(f"a posture is of finite numbers, was {self!r}")


@dataclass(frozen=True)
class Restart(Beginning):
    """Begin anew where the last beginning was: at the scenario's start, or at the free one."""


@dataclass(frozen=True)
class Play(Beginning):
    """Begin anew at a scenario's start, go on, and let it lead the hand to its end or a pull."""

    scenario: Scenario
    until: float = 0.0
    """[s] to which it goes on as fast as it can, and then stands still; at 0 it just begins."""

    def __post_init__(self) -> None:
        check_range("the time to stop at", self.until, 0.0, self.scenario.duration, "s")


@dataclass(frozen=True)
class Compare(Command):
    """Begin anew where the robot stands or the scenario starts, with others beside it."""

    controllers: tuple[str, ...] = ()
    """Of the others, at most two; none ends the comparison, and the robot just goes on."""
    same: str = "path"
    """What people have in common at all of them: "path", where they pull to, or "force"."""

    def __post_init__(self) -> None:
        if len(self.controllers) > MOST_GHOSTS:
            raise ConfigError(f"at most {MOST_GHOSTS} controllers are compared")
        for name in self.controllers:
            check_name("controller", name, CONTROLLERS)
        check_name("comparison", self.same, SAMES)


class Mailbox:
    """Takes commands from any thread; one thread fetches them.

    However many are sent, what waits is bounded and so is the work of obeying it: of those that
    replace one another only the newest is kept. A parameter keeps the place of the command that it
    replaces, so that a beginning sent meanwhile has the newest. What happens rather than is set,
    such as a pull, takes its place at the end.
    """

    def __init__(self) -> None:
        self._waiting: dict[Hashable, Command] = {}
        self._lock = threading.Lock()
        self.filled = threading.Event()
        """Set while something waits."""

    def put(self, command: Command, links: Collection[str]) -> None:
        """Leave a command; the arm can be held at `links`.

        Raises:
            UnknownNameError: A pull's link is none of `links`.
            LoopError: Too many different ones wait.
        """
        if isinstance(command, Pull) and command.link is not None:
            check_name("link", str(command.link), links)  # whatever a page has sent
        key = _key(command)
        with self._lock:
            if len(self._waiting) >= MOST and key not in self._waiting:
                raise LoopError(f"more than {MOST} commands wait; send fewer at once")
            if isinstance(command, Restart) and key in self._waiting:
                return  # what begins anew already would only begin once more
            if not isinstance(command, Adjustment):
                self._waiting.pop(key, None)
            self._waiting[key] = command
            self.filled.set()

    def take(self) -> list[Command]:
        """All that wait, in order; they wait no longer."""
        if not self._waiting:  # a glance without the lock: it is done a thousand times a second
            return []
        with self._lock:
            commands = list(self._waiting.values())
            self._waiting.clear()
            self.filled.clear()
        return commands


def _key(command: Command) -> Hashable:
    """Commands of equal keys replace one another."""
    if isinstance(command, (Pull, Release)):
        return Pull, command.who
    return Beginning if isinstance(command, Beginning) else type(command)
