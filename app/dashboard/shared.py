"""State that all viewers share: simulation, parameters with their history, and background jobs."""

import math
import threading
from collections.abc import Callable, Iterable, Mapping
from functools import cached_property
from time import monotonic

import numpy as np

from app.border.dbb import Cloud
from app.config import Config
from app.control.contract import check_gains
from app.dashboard import phrases as words
from app.dashboard.explorer import Explorer
from app.dashboard.plans import plot_plans, quantities
from app.dashboard.record import Course, Strip, Track
from app.dashboard.robots import RobotBuild, RobotSwitch
from app.dashboard.scene.borders import Borders
from app.dashboard.scene.robot import RobotParts
from app.errors import ConfigError
from app.robot.model import RobotModel
from app.simulation.loop.commands import Configure, Watch
from app.simulation.loop.loop import LoopHandle
from app.simulation.plants.door import BODY as DOOR
from app.simulation.scenarios.leading import Scenario

BURST = 0.7  # [s] further changes of one parameter within this time belong to the same step
MOST_STEPS = 200  # [-] largest number of steps that can be undone


class Tuning:
    """The configuration and its history; each change is sent to the simulation; thread-safe."""

    def __init__(
        self,
        sink: LoopHandle,
        config: Config,
        usual: Config,
        clock: Callable[[], float] = monotonic,
    ) -> None:
        """Start with `config` of the simulation `sink`, and with the robot's defaults `usual`."""
        self._sink, self._clock, self.usual = sink, clock, usual
        self._steps, self._at = [config], 0  # configurations, oldest first; index of the present
        self._burst: tuple[str, float] | None = None  # path, time [s] of the last change
        self._lock = threading.RLock()

    @property
    def config(self) -> Config:
        """The present configuration; it is the same object until a change."""
        with self._lock:
            return self._steps[self._at]

    @property
    def changes(self) -> dict[str, float | str]:
        return self.config.changes(self.usual)

    def set(self, path: str, value: float | str) -> None:
        """Change one parameter; its changes, each within `BURST` of the last, are one `undo` step.

        Raises `ConfigError` for an unknown parameter, a wrong value, or a gain that is too large.
        """
        with self._lock:
            if self.config.value(path) == value:
                return
            config, now = self.config.replace(path, value), self._clock()
            check_gains(config, config.disturbance.stated_period)
            last, at = self._burst or ("", -math.inf)
            if last == path and now - at <= BURST:
                self._steps.pop()
                self._at -= 1
            changed = self._steps[self._at] != config  # a fast change and its reversal are no step
            if changed:
                self._add(config)
            self._burst = (path, now) if changed else None
            self._sink.send(Configure(config))

    def load(self, config: Config) -> None:
        """Set the configuration, as one step of `undo`; `ConfigError` if a gain is too large."""
        with self._lock:
            if config != self.config:
                check_gains(config, config.disturbance.stated_period)
                self._add(config)
                self._sink.send(Configure(config))

    def reset(self, paths: Iterable[str] | None = None) -> None:
        """Set the parameters `paths` (default: all) to the robot's defaults, as one step."""
        with self._lock:
            defaults = {path: self.usual.value(path) for path in paths or ()}
            self.load(self.usual if paths is None else self.config.changed(defaults))

    def undo(self) -> None:
        """Undo the last step; raises `ConfigError` without one."""
        self._go(-1, "nothing to undo")

    def redo(self) -> None:
        """Repeat the step that was undone last; raises `ConfigError` without one."""
        self._go(1, "nothing to redo")

    def move_to(self, sink: LoopHandle, config: Config, usual: Config) -> None:
        """Continue with the simulation `sink` of another robot, which runs with `config`.

        In the history, all changed parameters keep their values, and the others get the defaults
        `usual`. If `config` differs from the present configuration, it becomes a further step.
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
        self._steps = [*self._steps[: self._at + 1], config][-MOST_STEPS - 1 :]
        self._at, self._burst = len(self._steps) - 1, None


class SharedState:
    """Data of a robot and its simulation that all pages share, and the background jobs."""

    def __init__(
        self,
        loop: LoopHandle,
        model: RobotModel,
        clouds: Mapping[str, Cloud],
        parts: RobotParts | None = None,
        *,
        case: Scenario | None = None,
        robot_switch: RobotSwitch | None = None,
        before: "SharedState | None" = None,
    ) -> None:
        """Use jobs and parameters of the old robot's state `before`; see also `serve_dashboard`."""
        self._newest = first = loop.latest()
        self.loop, self.model, self.clouds = loop, model, clouds  # P_i by the names of pairs of L_m
        self.case = case  # a scenario that a button plays, or None
        self.of_door = f"{model.body_names[0]}-{DOOR}"  # pair that exists if there is a door
        pairs = [pair for pair in first.pairs if pair.name != self.of_door]
        self.pairs = [pair.name for pair in pairs]  # all pairs but that of a door
        self.mobile = [pair.name for pair in pairs if pair.mobile]  # pairs of L_m
        named = (*self.pairs, self.of_door)
        self.spoken = {name: words.spoken(name, model.body_names) for name in named}
        self.parts = parts or RobotParts(model)
        self.borders = Borders(model, clouds)
        self.robot_switch = before.robot_switch if before else robot_switch or RobotSwitch(None)
        self.robot_build = before.robot_build if before else RobotBuild(self.robot_switch)
        self.plans = plot_plans(model, self.pairs, self.of_door)
        self.quantities = quantities(model, first)  # curves to add, by name
        self.tracks = {
            "base": Track(lambda snapshot: np.append(snapshot.base_pose[:2], 0.004)),  # [m]
            "end-effector": Track(lambda snapshot: snapshot.p_ee),
        }
        self.course, self.strip = Course(), Strip(model.body_names)
        self.keepers = (*self.tracks.values(), self.course, self.strip)  # get each snapshot
        self.last = -1.0  # [s] time of the newest collected snapshot; −1 if there is none
        self._watched = True
        usual = model.description.config
        self.tuning = before.tuning if before else Tuning(loop, first.config, usual)

    @cached_property
    def explorer(self) -> Explorer:
        """Explorer of postures, for the drawing thread only; created at its first use."""
        return Explorer(self.model, self.clouds, self.loop.latest())

    def update(self) -> None:
        """Add each new snapshot once to all `keepers`; after a restart, reset them."""
        before, self._newest = self._newest, self.loop.latest()
        if not self._newest.follows(before):
            self.last = -1.0
            for keeper in self.keepers:
                keeper.begin()
        for snapshot in self.loop.history(self.last):
            if snapshot.run != self._newest.run:
                return  # restarted just now; the next call resets the keepers
            self.last = snapshot.t
            for keeper in self.keepers:
                keeper.add(snapshot)

    def watch(self, watched: bool) -> None:
        """Report to the simulation whether a viewer is connected; without one, it pauses."""
        if watched != self._watched:
            self._watched = watched
            self.loop.send(Watch(watched))

    def close(self) -> None:
        """End the background jobs, and the simulation that a switch of the robot has started."""
        self.robot_build.close()
        self.robot_switch.close()
