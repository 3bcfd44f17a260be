"""Robots of the page: another one replaces the running one, a new one is built of a zip."""

from __future__ import annotations

import threading
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple, Protocol, runtime_checkable

from app.border.cache import BorderData, kept_border_data
from app.border.dbb import Cloud
from app.config import Config
from app.dashboard.job import Job, build_robot, check_rows, look_into_package, sample_border
from app.dashboard.scene.robot import RobotParts
from app.errors import ConfigError, DbbError
from app.jobs.process import Cancelled
from app.onboarding.read.package import LARGEST_ARCHIVE, Contents
from app.onboarding.request import Request
from app.robot.assets import bare_urdf, is_own, resolved_urdf, robot_folder, robot_names
from app.robot.description import load_robot
from app.robot.model import RobotModel
from app.simulation.loop.loop import LoopHandle
from app.simulation.plants import default_plant
from app.system import remove_abandoned, temporary_folder

if TYPE_CHECKING:
    from app.onboarding.check import Row

_NEEDED = resolved_urdf if default_plant() == "planar" else bare_urdf
"""pybullet reads every mesh; MuJoCo and the viewer take the convex bodies if one is missing."""


class RobotEntry(NamedTuple):
    """A described robot."""

    name: str
    title: str
    about: str
    """Base and arm in a few words."""
    problem: str | None
    """Why it cannot be shown, with the command that helps where there is one; or None."""
    own: bool
    """Whether it is one of the user's."""
    report: bool
    """Whether there is a report on how it was made."""

    @property
    def label(self) -> str:
        """In a list."""
        return self.name if self.problem is None else f"{self.name} (not available)"


def robot_entries() -> list[RobotEntry]:
    """All of them, by name."""
    return [_entry(name) for name in robot_names()]


def _entry(name: str) -> RobotEntry:
    folder, title, about, problem = robot_folder(name), name, "", None
    page = folder / "report.html"
    own, report = is_own(name), page.is_file() and not page.is_symlink()
    try:
        description = load_robot(name)
        title = description.title
        about = f"{description.base.kind} base, arm of {len(description.arm.joints)} joints"
        _NEEDED(description)
    except DbbError as error:
        problem = str(error)
    return RobotEntry(name, title, about, problem, own, report)


@runtime_checkable
class OwnLoop(LoopHandle, Protocol):
    """A simulation that can be started and stopped."""

    def start(self) -> None: ...  # waits for the first snapshot

    def stop(self) -> None: ...  # may be called again


Changes = Mapping[str, float | str]
"""Parameters that are not at a robot's defaults, by path."""
StartLoop = Callable[[RobotModel, BorderData, Config, str], OwnLoop]
"""Begins the simulation of a robot with parameters and a controller; `start` then waits for it."""


class RunningRobot(NamedTuple):
    """A robot that runs and can be drawn."""

    loop: OwnLoop
    model: RobotModel
    clouds: Mapping[str, Cloud]
    """P_i of every pair of L_m, by the pair's name."""
    parts: RobotParts
    config: Config
    """The parameters that it runs with."""
    note: str
    """What the viewers should know, or an empty string."""


def _named(name: str, entries: Sequence[RobotEntry]) -> RobotEntry | None:
    return next((each for each in entries if each.name == name), None)


class RobotSwitch(Job):
    """At most one switch of the robot at a time; the same for all viewers.

    Any thread may call `begin` and `cancel`; the drawing thread calls `take` and `shown`.
    """

    def __init__(self, start_loop: StartLoop | None) -> None:
        """Nothing under way; without `start_loop` the robot cannot be switched."""
        super().__init__()
        self._start_loop = start_loop
        self._entries: list[RobotEntry] | None = None
        self._ready: RunningRobot | None = None
        self._taken = threading.Event()
        self._loop: OwnLoop | None = None

    @property
    def possible(self) -> bool:
        """Whether the robot can be switched at all."""
        return self._start_loop is not None

    @property
    def entries(self) -> list[RobotEntry]:
        """All robots, as of the last search."""
        return self.look() if (known := self._entries) is None else known

    def look(self) -> list[RobotEntry]:
        """Search; this reads every robot's files."""
        self._entries = found = robot_entries()
        return found

    def look_again(self) -> None:
        """Search in a thread that serves nobody: there may be another robot now."""
        threading.Thread(target=self.look, name="robots", daemon=True).start()

    def begin(self, name: str, changes: Changes, controller: str, running: LoopHandle) -> None:
        """Prepare a robot beside the running one, which ends once the other one is shown.

        It gets its own defaults with `changes`.

        Raises:
            ConfigError: There is no such robot, it lacks something, or a switch is under way.
        """
        entry = _named(name, self.entries) or _named(name, self.look())  # it may be new
        if entry is None or self._start_loop is None:
            raise ConfigError(f"there is no robot {name!r} to choose")
        if entry.problem is not None:
            raise ConfigError(f"{entry.title}: {entry.problem}")
        replaced: LoopHandle | None = running

        def work() -> None:
            nonlocal replaced
            self._taken.clear()
            try:
                self._replace(replaced, self._prepare(entry, changes, controller))
            finally:
                replaced = None  # else it would be kept until after memory was given back

        self.start(entry.title, "reading the description", work)

    def take(self) -> RunningRobot | None:
        """The robot to be shown from now on, if one has become ready; once."""
        ready, self._ready = self._ready, None
        return ready

    def shown(self) -> None:
        """Every viewer sees the robot that was taken."""
        self._taken.set()

    def close(self) -> None:
        """End what is under way, and the simulation that was begun here last."""
        self._taken.set()
        super().close()
        if self._loop is not None:
            self._loop.stop()

    def _replace(self, replaced: LoopHandle | None, robot: RunningRobot) -> None:
        """Have a robot shown, and end the simulation of the one before."""
        self._loop = robot.loop
        self._ready = robot
        self._taken.wait()  # until nobody draws the old one any more
        if isinstance(replaced, OwnLoop):
            replaced.stop()

    def _prepare(self, entry: RobotEntry, changes: Changes, controller: str) -> RunningRobot:
        model = RobotModel(load_robot(entry.name))
        self.report("looking for the border")
        data = kept_border_data(model)
        if data is None:
            data = self.run(sample_border, entry.name)
        self.check()
        self.report("reading the meshes")
        parts = RobotParts(model)
        self.check()
        self.report("starting the simulation")
        loop, config, note = self._start_suited(model, data, changes, controller)
        try:
            self.check()
        except Cancelled:
            loop.stop()
            raise
        return RunningRobot(loop, model, data.clouds, parts, config, note)

    def _start_suited(
        self, model: RobotModel, data: BorderData, changes: Changes, controller: str
    ) -> tuple[OwnLoop, Config, str]:
        """With what is changed now; with the defaults where this robot cannot begin so."""
        usual = model.description.config
        config = usual.changed(changes)
        try:
            return self._started(model, data, config, controller), config, ""
        except DbbError as error:
            if config == usual:
                raise
            note = f"all parameters are at their defaults, as it cannot start with yours ({error})"
        return self._started(model, data, usual, controller), usual, note

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


class RobotCheck(Job):
    """At most one check of a robot at a time, and the rows of the last one."""

    def __init__(self) -> None:
        super().__init__()
        self.name = ""
        """The robot that was checked last."""
        self.rows: list[Row] = []
        """As `dbb check-robot` prints them."""

    def begin(self, name: str) -> None:
        """Check a robot, as it is saved, in a process of its own.

        Raises:
            ConfigError: Another check is under way.
        """

        def work() -> None:
            self.name, self.rows = name, []
            self.rows = self.run(check_rows, name)

        self.start(name, "checking", work)


class Package(NamedTuple):
    """A zip that was uploaded and looked into."""

    archive: Path
    """Where it is kept until it has become a robot or another one comes."""
    urdfs: Mapping[str, Contents]
    """Its URDFs, by their path in it."""


class RobotBuild(Job):
    """At most one zip, and one robot that is being built of it."""

    def __init__(self, switch: RobotSwitch) -> None:
        """Nothing uploaded yet; `switch` searches again when there is another robot."""
        super().__init__()
        self.package: Package | None = None
        """The last upload that can be used, or None."""
        self.built = ""
        """Name of the robot that was built last, or an empty string."""
        self._switch = switch
        self._folder = ExitStack()

    def receive(self, name: str, content: bytes) -> None:
        """Take a zip, and read what it holds.

        Raises:
            ConfigError: It is too large, or something is under way.
        """
        if len(content) > LARGEST_ARCHIVE:
            raise ConfigError(f"a zip may have at most {LARGEST_ARCHIVE / 1e6:.0f} MB")

        def work() -> None:
            self.built = ""
            self._forget()
            archive = self._folder.enter_context(temporary_folder()) / _file_name(name)
            archive.write_bytes(content)
            self.package = Package(archive, self.run(look_into_package, archive))

        self.start(_file_name(name), "reading", work)

    def build(self, request: Request) -> None:
        """Build the robot in a process of its own.

        Raises:
            ConfigError: There is a robot of that name already, or something is under way.
            RobotFileError: The name cannot be one.
        """
        if request.name in robot_names():
            raise ConfigError(f"there is a robot {request.name!r} already; give another name")

        def work() -> None:
            self.built = ""
            try:
                self.run(build_robot, request)
            finally:
                remove_abandoned(request.out.parent)  # it may have had no time to tidy up
            self.built = request.name
            self._switch.look()
            self._forget()  # what it needs of the zip is in its own folder now

        self.start(request.name, "begins", work)

    def close(self) -> None:
        """Cancel, and remove what was uploaded."""
        super().close()
        self._forget()

    def _forget(self) -> None:
        self.package = None
        self._folder.close()


def _file_name(name: str) -> str:
    """A name for the file that a browser calls so, which may say anything."""
    kept = "".join(c for c in name if c.isascii() and (c.isalnum() or c in "._-"))
    return f"{kept.lower().removesuffix('.zip').strip('.')[:60] or 'robot'}.zip"
