"""Robots of the page: replacement of the running robot, and new robots from a zip."""

import threading
from collections.abc import Callable, Mapping
from contextlib import ExitStack
from pathlib import Path
from typing import NamedTuple

from app.border.cache import BorderData, kept_border_data
from app.border.dbb import Cloud
from app.config import Config
from app.dashboard.job import Job, build_robot, look_into_package, sample_border
from app.dashboard.scene.robot import RobotParts
from app.errors import ConfigError, DbbError
from app.onboarding.read.package import LARGEST_ARCHIVE, Contents
from app.onboarding.request import NAME, Request
from app.robot import assets
from app.robot.description import load_robot
from app.robot.model import RobotModel
from app.simulation.loop.loop import LoopHandle
from app.simulation.plants import default_plant
from app.system import remove_abandoned, temporary_folder

_NEEDED = assets.resolved_urdf if default_plant() == "planar" else assets.bare_urdf
"""Raises `AssetError` if a robot lacks a file that the default plant needs. pybullet (`planar`)
needs every mesh; without a mesh, MuJoCo and the page use the convex bodies."""


class RobotEntry(NamedTuple):
    name: str
    title: str
    about: str  # base and arm in a few words; empty if the description is invalid
    problem: str | None  # reason why the robot cannot be used, or None
    own: bool  # whether it is one of the user's own robots
    report: bool  # whether a report about its creation exists

    @property
    def label(self) -> str:
        return self.name if self.problem is None else f"{self.name} (not available)"


def robot_entries() -> list[RobotEntry]:
    entries = []
    for name in assets.robot_names():
        title, about, problem = name, "", None
        page = assets.robot_folder(name) / "report.html"
        report = page.is_file() and not page.is_symlink()
        try:
            description = load_robot(name)
            title = description.title
            about = f"{description.base.kind} base, arm of {len(description.arm.joints)} joints"
            _NEEDED(description)
        except DbbError as error:
            problem = str(error)
        entries.append(RobotEntry(name, title, about, problem, assets.is_own(name), report))
    return entries


Changes = Mapping[str, float | str]  # values of changed parameters, by the parameter's path
StartLoop = Callable[[RobotModel, BorderData, Config, str], LoopHandle]
"""Creates the simulation of a robot with parameters and a controller; the caller starts it."""


class RunningRobot(NamedTuple):
    """A robot whose simulation runs and that can be drawn."""

    loop: LoopHandle
    model: RobotModel
    clouds: Mapping[str, Cloud]  # P_i of all pairs of arm and base, by the pairs' names
    parts: RobotParts
    config: Config
    note: str  # message for the viewers, or an empty string


class RobotSwitch(Job):
    """Job that replaces the robot for all viewers; the drawing thread calls `take` and `shown`."""

    replaces_robot = True

    def __init__(self, start_loop: StartLoop | None) -> None:
        super().__init__()
        self._start_loop = start_loop
        self.possible = start_loop is not None  # whether the robot can be switched
        self.entries: list[RobotEntry] = []  # all robots that the last search found
        self._ready: RunningRobot | None = None
        self._taken = threading.Event()
        self._loop: LoopHandle | None = None

    def look(self) -> None:
        """Search for robots, and update `entries`; this reads the files of each robot."""
        self.entries = robot_entries()

    def begin(self, name: str, changes: Changes, running: LoopHandle) -> None:
        """Start to prepare the robot `name`; once it is shown, the simulation `running` ends.

        The robot gets the present controller and the parameters `changes`, or its defaults if its
        simulation does not start with `changes`. Raises `ConfigError` if the robot does not exist
        or cannot be used, or if another switch is running.
        """
        if name not in [each.name for each in self.entries]:
            self.look()  # the robot may be new
        entry = next((each for each in self.entries if each.name == name), None)
        if entry is None or self._start_loop is None:
            raise ConfigError(f"the robot {name!r} does not exist, or cannot be used here")
        if entry.problem is not None:
            raise ConfigError(f"{entry.title}: {entry.problem}")
        replaced, controller = [running], running.latest().controller

        def work() -> None:
            self._taken.clear()
            robot = self._prepare(entry, changes, controller)
            self._loop, self._ready = robot.loop, robot
            self._taken.wait()  # until the pages show the new robot
            replaced.pop().stop()

        self.start(entry.title, "reading the description", work)

    def take(self) -> RunningRobot | None:
        """Return a robot that has become ready since the last call, or None."""
        ready, self._ready = self._ready, None
        return ready

    def shown(self) -> None:
        """Report that no page draws the old robot any longer."""
        self._taken.set()

    def close(self) -> None:
        """Cancel the running switch, and stop the last simulation that a switch has started."""
        self._taken.set()
        super().close()
        if self._loop is not None:
            self._loop.stop()

    def _prepare(self, entry: RobotEntry, changes: Changes, controller: str) -> RunningRobot:
        model = RobotModel(load_robot(entry.name))
        self.report("looking for the border")
        data = kept_border_data(model) or self.run(sample_border, entry.name)
        self.check()
        self.report("reading the meshes")
        parts = RobotParts(model, apart=True)
        self.check()
        self.report("starting the simulation")
        usual = model.description.config
        config = usual.changed(changes)
        note = "your changed parameters keep their values" if config != usual else ""
        try:
            loop = self._started(model, data, config, controller)
        except DbbError as error:
            if config == usual or self.cancelled:
                raise
            config = usual
            note = f"all parameters have their defaults: yours do not suit this robot ({error})"
            loop = self._started(model, data, config, controller)
        return RunningRobot(loop, model, data.clouds, parts, config, note)

    def _started(
        self, model: RobotModel, data: BorderData, config: Config, controller: str
    ) -> LoopHandle:
        assert self._start_loop is not None
        loop = self._start_loop(model, data, config, controller)
        try:
            loop.start()
            self.check()
        except BaseException:
            loop.stop()
            raise
        return loop


class Package(NamedTuple):
    archive: Path  # deleted after a successful build, before the next upload, and by `close`
    urdfs: Mapping[str, Contents]  # contents of its URDFs, by their path in the zip


class RobotBuild(Job):
    """Upload of a zip, and build of a robot from it."""

    def __init__(self, switch: RobotSwitch) -> None:
        """Start without an upload; `switch` searches for robots again after each build."""
        super().__init__()
        self.package: Package | None = None  # last uploaded zip, until a robot is built from it
        self.built = ""  # name of the built robot; empty after the start of a new upload or build
        self._switch = switch
        self._folder = ExitStack()

    def receive(self, name: str, content: bytes) -> None:
        """Read an uploaded zip in a job; `ConfigError` if it is too large, or if a job runs."""
        if len(content) > LARGEST_ARCHIVE:
            raise ConfigError(f"a zip may have at most {LARGEST_ARCHIVE / 1e6:.0f} MB")

        def work() -> None:
            self.built = ""
            self._forget()
            with ExitStack() as stack:
                archive = stack.enter_context(temporary_folder()) / _file_name(name)
                archive.write_bytes(content)
                self.package = Package(archive, self.run(look_into_package, archive))
                self._folder = stack.pop_all()

        self.start(_file_name(name), "reading", work)

    def build(self, request: Request) -> None:
        """Build a robot in a job; `ConfigError` as for `new_folder`, or if another job runs."""
        new_folder(request.name)

        def work() -> None:
            self.built = ""
            try:
                self.run(build_robot, request)
            finally:
                remove_abandoned(request.out.parent)  # the process may end before its cleanup
            self.built = request.name
            self._switch.look()
            self._forget()  # the robot's folder has all required files

        self.start(request.name, "starting", work)

    def close(self) -> None:
        super().close()
        self._forget()

    def _forget(self) -> None:
        self.package = None
        self._folder.close()


def new_folder(name: str) -> Path:
    """Return the folder for a new robot; `ConfigError` if its name is not allowed or in use."""
    if not NAME.fullmatch(name):  # checked before it becomes a part of a path
        raise ConfigError("a name starts with a letter and has only letters, digits and _")
    if name in assets.robot_names():
        raise ConfigError(f"a robot {name!r} exists; choose another name")
    return assets.user_robots()[0] / name


def _file_name(name: str) -> str:
    """Return a safe file name for an upload, from the name that the browser reports."""
    kept = "".join(c for c in name if c.isascii() and (c.isalnum() or c in "._-"))
    return f"{kept.lower().removesuffix('.zip').strip('.')[:60] or 'robot'}.zip"
