"""Shared state of all viewers: the simulation, its parameters and record, and background jobs."""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable, Iterable, Mapping

from app.border.dbb import Cloud
from app.config import Config
from app.dashboard.explorer import Explorer
from app.dashboard.plans import plot_plans
from app.dashboard.record import Course, Record, Strip
from app.dashboard.robots import RobotBuild, RobotCheck, RobotSwitch, RunningRobot
from app.dashboard.scene.robot import RobotParts
from app.dashboard.scene.scene import SceneData
from app.errors import ConfigError
from app.robot.model import RobotModel
from app.simulation.loop.commands import Configure, Watch
from app.simulation.loop.loop import LoopHandle
from app.simulation.scenarios.leading import Scenario

BURST = 0.7  # [s] moves of one slider that follow each other faster are one step
MOST_STEPS = 200  # [-] that can be undone; each is a small record


class Tuning:
    """The configuration and its history; every change is sent to the simulation at once.

    May be called by any thread.
    """

    def __init__(
        self,
        sink: LoopHandle,
        config: Config,
        usual: Config | None = None,
        *,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        """Begin without a history; `config` holds already where changes go, to `sink`."""
        self._sink, self._clock = sink, clock
        self.usual = usual or Config()
        """The robot's defaults."""
        self._steps, self._at = [config], 0
        """What held after each step, oldest first, and which of them holds."""
        self._burst: tuple[str, float] | None = None
        """Parameter that was moved last, and when."""
        self._lock = threading.RLock()

    @property
    def config(self) -> Config:
        """What holds now; the same object as long as nothing changes."""
        with self._lock:
            return self._steps[self._at]

    @property
    def changes(self) -> dict[str, float | str]:
        """What is not at the robot's defaults, by path."""
        return self.config.changes(self.usual)

    def set(self, path: str, value: float | str) -> None:
        """Change one parameter; moves of the same one in a burst are one step.

        Raises:
            ConfigError: No such parameter, or a value that it cannot have.
        """
        with self._lock:
            if self.config.value(path) == value:
                return
            config, now = self.config.replace(path, value), self._clock()
            last, at = self._burst or ("", -math.inf)
            if last == path and now - at <= BURST:
                self._steps.pop()
                self._at -= 1
            if self._steps[self._at] != config:  # there and back in one burst is no step
                self._add(config)
                self._burst = path, now
            else:
                self._burst = None
            self._sink.send(Configure(config))

    def load(self, config: Config) -> None:
        """Take over a whole configuration, in one step."""
        with self._lock:
            if config != self.config:
                self._add(config)
                self._sink.send(Configure(config))

    def reset(self, paths: Iterable[str] | None = None) -> None:
        """Set parameters, by default all, to their defaults, in one step."""
        with self._lock:
            defaults = {path: self.usual.value(path) for path in paths or ()}
            self.load(self.usual if paths is None else self.config.changed(defaults))

    def undo(self) -> None:
        """Take the last step back.

        Raises:
            ConfigError: There is none.
        """
        self._go(-1, "nothing to undo")

    def redo(self) -> None:
        """Do the step again that was undone last.

        Raises:
            ConfigError: There is none, or something was changed since.
        """
        self._go(1, "nothing to redo")

    def move_to(self, sink: LoopHandle, config: Config, usual: Config) -> None:
        """Go on with another robot's simulation, which has a configuration already.

        The history is then of that robot: the same changes of its defaults. If its configuration is
        another than here, that is one step.
        """
        with self._lock:
            self._steps = [usual.changed(each.changes(self.usual)) for each in self._steps]
            self._sink, self.usual = sink, usual
            if self.config != config:
                self._add(config)

    def _go(self, steps: int, nothing: str) -> None:
        with self._lock:
            if not 0 <= self._at + steps < len(self._steps):
                raise ConfigError(nothing)
            self._at, self._burst = self._at + steps, None
            self._sink.send(Configure(self.config))

    def _add(self, config: Config) -> None:
        """A new step, in the place of those that were undone."""
        self._steps = [*self._steps[: self._at + 1], config][-MOST_STEPS - 1 :]
        self._at, self._burst = len(self._steps) - 1, None


class SharedState(SceneData):
    """One for all pages; the drawing thread calls `update` before it draws them."""

    def __init__(
        self,
        loop: LoopHandle,
        model: RobotModel,
        clouds: Mapping[str, Cloud],
        parts: RobotParts | None = None,
        *,
        case: Scenario | None = None,
        robot_switch: RobotSwitch | None = None,
        before: SharedState | None = None,
    ) -> None:
        """Load what pages need; see `serve_dashboard`.

        Of what was shared `before` with another robot stay the parameters, with their history, and
        the jobs for new robots.
        """
        super().__init__(loop, model, clouds, parts)
        self.case = case
        """A scenario that begins where the loop does, for a button that plays it, or None."""
        usual = model.description.config
        self.tuning = before.tuning if before else Tuning(loop, loop.latest().config, usual)
        self.robot_switch = before.robot_switch if before else robot_switch or RobotSwitch(None)
        self.robot_build = before.robot_build if before else RobotBuild(self.robot_switch)
        self.robot_check = before.robot_check if before else RobotCheck()
        self.plans = plot_plans(model, self.pairs, self.of_door)
        self.record = Record(curve for plan in self.plans for curve in plan.curves)
        """The plots' values in the last minutes."""
        self.course = Course()
        """The scenario that was begun last."""
        self.strip = Strip(model.body_names)
        """What happened when, in the last ten minutes."""
        self.keepers += [self.record, self.course, self.strip]
        self._watched = True
        self._explorer: Explorer | None = None

    def explorer(self) -> Explorer:
        """What answers for postures, made when it is asked first; for the drawing thread."""
        if self._explorer is None:
            self._explorer = Explorer(self.model, self.clouds, self.loop.latest())
        return self._explorer

    def followed_by(self, robot: RunningRobot) -> SharedState:
        """The same with another robot."""
        after = SharedState(robot.loop, robot.model, robot.clouds, robot.parts, before=self)
        self.tuning.move_to(robot.loop, robot.config, robot.model.description.config)
        return after

    def watch(self, watched: bool) -> None:
        """Let the simulation rest while nobody is there."""
        if watched != self._watched:
            self._watched = watched
            self.loop.send(Watch(watched))

    def close(self) -> None:
        """End the background jobs."""
        robots = (self.robot_build, self.robot_check, self.robot_switch)
        for job in robots:
            job.close()
