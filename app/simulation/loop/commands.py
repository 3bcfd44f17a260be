"""Commands to the live loop: immutable records that check their values, and their mailbox.

The constructor of a command raises a DbbError for an invalid value. `Mailbox.put` checks the name
of a link, and the loop checks the limits of a posture. If the loop cannot execute a command, the
field `refusal` of the snapshots has the reason.
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
from app.simulation.scenarios.line import Point
from app.strict import check_range

SPEEDS = 0.1, 4.0  # [-] smallest and largest multiple of real time
STEPS = 0.001, 1.0  # [s] shortest and longest single step
SAMES = ("path", "force")  # common inputs of compared robots: the path of the pulls, or their force
MAX_GHOSTS = 2  # largest number of compared robots in addition to the main robot
MAX_WAITING = 64  # number of waiting commands from which on a pull that replaces none is refused


class Command:
    """A command to the live loop."""


class Adjustment(Command):
    """A command that sets a value."""


class Beginning(Command):
    """A command that starts a run."""


@dataclass(frozen=True)
class Pull(Command):
    """A person pulls a point of the robot; a pull of the end-effector ends a scenario's motion."""

    target: Point  # [m] target of the held point, in the world
    link: str | None = None  # name of one of the loop's `links`; None is the end-effector
    point: Point | None = None  # [m] the held point in the link's frame; None is the frame's origin
    who: int = 0  # number of the person; each has one hand; the forces of all people add

    def __post_init__(self) -> None:
        checked_target(self.target)
        if self.point is not None:
            if self.link is None:
                raise TargetError("a held point needs the name of its link")
            checked_hold(self.point)


@dataclass(frozen=True)
class Release(Command):
    """A person releases the robot; this neither ends nor continues a scenario."""

    who: int  # number of the person


@dataclass(frozen=True)
class Configure(Adjustment):
    """Use these parameters for all robots from now on."""

    config: Config


@dataclass(frozen=True)
class Choose(Adjustment):
    """Use this controller for the main robot from now on."""

    controller: str

    def __post_init__(self) -> None:
        check_name("controller", self.controller, CONTROLLERS)


@dataclass(frozen=True)
class Pause(Adjustment):
    """Pause the simulation (True), or continue it (False)."""

    paused: bool


@dataclass(frozen=True)
class Watch(Adjustment):
    """Report to the loop whether a viewer is connected; without a viewer the simulation pauses."""

    watched: bool


@dataclass(frozen=True)
class Speed(Adjustment):
    """Change the speed of the simulation."""

    factor: float  # [-] desired ratio of simulated to real time, within `SPEEDS`

    def __post_init__(self) -> None:
        check_range("the speed", self.factor, *SPEEDS, "times real time")


@dataclass(frozen=True)
class StepOnce(Command):
    """Pause, and advance the simulation by `seconds`."""

    seconds: float = 0.02  # [s] simulated time from the newest to the next snapshot, within `STEPS`

    def __post_init__(self) -> None:
        check_range("a step", self.seconds, *STEPS, "s")


@dataclass(frozen=True)
class Reset(Beginning):
    """Start again without a scenario, at the loop's start posture or at another posture."""

    q_m: tuple[float, ...] = ()  # (n_m,) [rad or m] posture; if empty, the start posture
    base_pose: Point = (0.0, 0.0, 0.0)  # [m, m, rad] x, y, heading; unused if `q_m` is empty

    def __post_init__(self) -> None:
        if not all(map(math.isfinite, (*self.q_m, *self.base_pose))):
            raise TargetError(f"a posture must be finite numbers, not {self!r}")


@dataclass(frozen=True)
class Restart(Beginning):
    """Start the last scenario again; if the last start had no scenario, repeat the last `Reset`."""


@dataclass(frozen=True)
class Play(Beginning):
    """Start a scenario and end a `Pause`; a pull of the end-effector ends the scenario's motion."""

    scenario: Scenario


@dataclass(frozen=True)
class Compare(Command):
    """Start a comparison of controllers, or end a comparison, as in `Ensemble.compare`."""

    controllers: tuple[str, ...] = ()  # of the compared robots; if empty, the comparison ends
    same: str = "path"  # the common input of all robots, one of `SAMES`

    def __post_init__(self) -> None:
        if len(self.controllers) > MAX_GHOSTS:
            raise ConfigError(f"a comparison has at most {MAX_GHOSTS} compared robots")
        for name in self.controllers:
            check_name("controller", name, CONTROLLERS)
        check_name("comparison", self.same, SAMES)


class Mailbox:
    """A queue of commands from any thread to one thread.
    A `Pull` or `Release` replaces a waiting pull or release of the same person. A `Beginning`
    replaces a waiting `Beginning`; but a `Restart` is dropped if a `Beginning` waits. Each other
    command replaces a waiting command of its class. An `Adjustment` takes the place of the replaced
    command, so that a later `Beginning` uses the newest value. All others go to the queue's end.
    """

    def __init__(self) -> None:
        self._waiting: dict[Hashable, Command] = {}
        self._lock = threading.Lock()
        self.filled = threading.Event()  # event that is set while commands wait

    def put(self, command: Command, links: Collection[str]) -> None:
        """Add a command; a pull whose link is not in `links` raises an UnknownNameError. While
        `MAX_WAITING` commands wait, a pull that replaces none of them raises a LoopError.
        """
        pulls = isinstance(command, Pull)
        key: Hashable = type(command)  # a command replaces a waiting command with an equal key
        if isinstance(command, (Pull, Release)):
            key = Pull, command.who
        elif isinstance(command, Beginning):
            key = Beginning
        if pulls and command.link is not None:
            check_name("link", str(command.link), links)  # a page can send any name
        with self._lock:
            if pulls and len(self._waiting) >= MAX_WAITING and key not in self._waiting:
                raise LoopError(f"{MAX_WAITING} commands already wait; send fewer at once")
            if isinstance(command, Restart) and key in self._waiting:
                return  # the waiting `Beginning` starts a run anyway
            if not isinstance(command, Adjustment):
                self._waiting.pop(key, None)
            self._waiting[key] = command
            self.filled.set()

    def take(self) -> list[Command]:
        """Remove all waiting commands, and return them in order."""
        if not self._waiting:  # without the lock, because it is called a thousand times a second
            return []
        with self._lock:
            commands = list(self._waiting.values())
            self._waiting.clear()
            self.filled.clear()
        return commands
