"""Another robot on the dashboard: made ready beside the running one, which it then replaces."""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import NamedTuple, Protocol, runtime_checkable

from app.border.cache import BorderData, kept_border_data, load_border_data
from app.border.cloud import Cloud
from app.config import Config
from app.dashboard.memory import give_back
from app.dashboard.robots.robot_list import RobotEntry, robot_entries
from app.dashboard.scene.robot import RobotParts
from app.errors import ConfigError, DbbError
from app.jobs.background import Stopped, Tell, cores, run_apart
from app.robot.assets import load_robot
from app.robot.model import RobotModel
from app.simulation.loop.loop import LoopHandle

logger = logging.getLogger(__name__)

_PATIENCE = 10.0  # [s] for the drawing thread to take a robot, and for a thread to end


@runtime_checkable
class OwnLoop(LoopHandle, Protocol):
    """A simulation that can be started and stopped."""

    def start(self) -> None:
        """Wait for the first snapshot."""
        ...

    def stop(self) -> None:
        """End it; may be called again."""
        ...


StartLoop = Callable[[RobotModel, BorderData, Config, str], OwnLoop]
"""Begins the simulation of a robot with parameters and a controller; `start` then waits for it."""


class NewStage(NamedTuple):
    """A robot that runs and can be drawn.

    Attributes:
        loop: Its simulation, started.
        model: The robot.
        clouds: P_i of every pair of L_m, by the pair's name.
        parts: Its meshes.
        config: The parameters that it runs with.
        note: What the viewers should know, or an empty string.
    """

    loop: OwnLoop
    model: RobotModel
    clouds: Mapping[str, Cloud]
    parts: RobotParts
    config: Config
    note: str


@dataclass(frozen=True)
class Progress:
    """How far a piece of work is.

    Attributes:
        title: Of the robot.
        text: What is being done.
        share: 0 to 1; below 0 if nobody knows.
    """

    title: str
    text: str
    share: float = -1.0


class StageChange:
    """At most one change of the robot at a time; the same for all viewers.

    `begin` and `cancel` may be called by any thread, `take` by the one that draws.

    Attributes:
        progress: Of the change that is under way, or None.
        problem: Why the last one failed, or an empty string.
    """

    def __init__(self, start_loop: StartLoop | None) -> None:
        """Nothing under way.

        Args:
            start_loop: Makes simulations; None where the robot cannot be changed.
        """
        self.progress: Progress | None = None
        self.problem = ""
        self._start_loop = start_loop
        self._entries: list[RobotEntry] | None = None
        self._ready: NewStage | None = None
        self._taken, self._stopping = threading.Event(), threading.Event()
        self._loop: OwnLoop | None = None
        self._running: LoopHandle | None = None
        self._thread: threading.Thread | None = None
        self._lock = threading.Lock()

    @property
    def possible(self) -> bool:
        """Whether there is another robot to change to at all."""
        return self._start_loop is not None

    @property
    def entries(self) -> list[RobotEntry]:
        """All robots, as they were found when they were looked for last."""
        entries = self._entries  # read once: another thread may look again
        if entries is None:
            entries = self._entries = robot_entries()
        return entries

    def look_again(self) -> None:
        """There may be another robot now."""
        self._entries = None

    def begin(self, name: str, config: Config, controller: str, running: LoopHandle) -> None:
        """Make a robot ready.

        Args:
            name: One of `entries`.
            config: The parameters of now.
            controller: That of now.
            running: The simulation of now, which ends once the other one is shown.

        Raises:
            ConfigError: There is no such robot, it lacks something, or a change is under way.
        """
        entry = next((each for each in self.entries if each.name == name), None)
        if entry is None or self._start_loop is None:
            raise ConfigError(f"there is no robot {name!r} to choose")
        if entry.problem is not None:
            raise ConfigError(f"{entry.title}: {entry.problem}")
        with self._lock:
            progress = self.progress  # read once: its thread may end
            if progress is not None:
                raise ConfigError(f"{progress.title} is still being loaded; cancel that first")
            self.progress = Progress(entry.title, "begins")
        self.problem = ""
        self._stopping.clear()
        self._taken.clear()
        self._running = running  # no argument of the thread, which would hold it to its end
        self._thread = threading.Thread(
            target=self._work, args=(entry, config, controller), name="robot", daemon=True
        )
        self._thread.start()

    def cancel(self) -> None:
        """Stay with the robot of now, as far as the other is not shown yet."""
        self._stopping.set()

    def take(self) -> NewStage | None:
        """The robot that is to be shown from now on, if one has become ready; once."""
        ready, self._ready = self._ready, None
        return ready

    def shown(self) -> None:
        """Every viewer sees the robot that was taken."""
        self._taken.set()

    def close(self) -> None:
        """End what is under way, and the simulation that was begun here last."""
        self.cancel()
        self._taken.set()
        if self._thread is not None:
            self._thread.join(_PATIENCE)
        if self._loop is not None:
            self._loop.stop()

    def _work(self, entry: RobotEntry, config: Config, controller: str) -> None:
        try:
            self._replace(self._prepare(entry, config, controller))
        except Stopped:
            self.problem = f"{entry.title}: loading was cancelled"
        except DbbError as error:
            self.problem = f"{entry.title}: {error}"
        except Exception as error:  # nobody joins this thread: the viewers have to learn of it
            logger.exception("%s could not be loaded", entry.name)
            self.problem = f"{entry.title}: {type(error).__name__}: {error}"
        finally:
            self._running = None
            give_back()
            self.progress = None

    def _replace(self, stage: NewStage) -> None:
        """Have a robot shown, and end the simulation of the one before."""
        self._loop = stage.loop
        self._ready = stage
        self._taken.wait()  # until nobody draws the old one any more
        if isinstance(self._running, OwnLoop):
            self._running.stop()

    def _prepare(self, entry: RobotEntry, config: Config, controller: str) -> NewStage:
        def tell(text: str, share: float = -1.0) -> None:
            self.progress = Progress(entry.title, text, share)

        tell("reading its description")
        model = RobotModel(load_robot(entry.name))
        tell("looking for its border")
        data = kept_border_data(model)
        if data is None:
            data = run_apart(sample_border, entry.name, tell=tell, stopping=self._stopping)
        self._go_on()
        tell("reading its meshes")
        parts = RobotParts(model)
        self._go_on()
        tell("starting its simulation")
        loop, config, note = self._start(model, data, config, controller)
        if self._stopping.is_set():
            loop.stop()
            raise Stopped("stopped")
        return NewStage(loop, model, data.clouds, parts, config, note)

    def _start(
        self, model: RobotModel, data: BorderData, config: Config, controller: str
    ) -> tuple[OwnLoop, Config, str]:
        """With the parameters of now; with the defaults where this robot cannot begin with them."""
        try:
            return self._started(model, data, config, controller), config, ""
        except DbbError as error:
            if config == Config():
                raise
            note = f"the changed parameters do not suit it, so all are at their defaults ({error})"
        return self._started(model, data, Config(), controller), Config(), note

    def _started(
        self, model: RobotModel, data: BorderData, config: Config, controller: str
    ) -> OwnLoop:
        assert self._start_loop is not None
        loop = self._start_loop(model, data, config, controller)
        try:
            loop.start()
        except BaseException:
            loop.stop()
            raise
        return loop

    def _go_on(self) -> None:
        if self._stopping.is_set():
            raise Stopped("stopped")


def sample_border(tell: Tell, name: str) -> BorderData:
    """Pairs and clouds of a robot, sampled if they are not kept."""
    text = "sampling its border, once"
    tell(text, 0.0)
    return load_border_data(
        RobotModel(load_robot(name)),
        progress=False,
        processes=cores(),
        on_progress=lambda share: tell(text, share),
    )
