"""Robot build: a new robot from an uploaded zip; the same for all viewers."""

from __future__ import annotations

import shutil
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple

from app.dashboard.job import Job
from app.dashboard.robot_switch import RobotSwitch
from app.dashboard.work import build_robot
from app.errors import ConfigError
from app.jobs.process import Cancelled
from app.onboarding.read.contents import Contents, look_into
from app.onboarding.read.unpack import LARGEST_ARCHIVE
from app.onboarding.request import Request
from app.robot.assets import robot_names


class Package(NamedTuple):
    """A zip that was uploaded and looked into.

    Attributes:
        archive: Where it is kept until it has become a robot or another one comes.
        urdfs: Its URDFs, by their path in it.
    """

    archive: Path
    urdfs: Mapping[str, Contents]


class RobotBuild(Job):
    """At most one zip, and one robot that is being built of it.

    Attributes:
        package: The last upload that can be used, or None.
        built: Name of the robot that was built last, or an empty string.
    """

    def __init__(self, switch: RobotSwitch) -> None:
        """Nothing uploaded yet.

        Args:
            switch: Offers the robots; searches again when there is another one.
        """
        super().__init__()
        self.package: Package | None = None
        self.built = ""
        self._switch = switch
        self._folder: tempfile.TemporaryDirectory[str] | None = None

    def receive(self, name: str, content: bytes) -> None:
        """Take a zip, and read what it holds.

        Args:
            name: Of the file, for people.
            content: Its bytes.

        Raises:
            ConfigError: It is too large, or something is under way.
        """
        if len(content) > LARGEST_ARCHIVE:
            raise ConfigError(f"a zip may have {LARGEST_ARCHIVE / 1e6:.0f} MB")

        def work() -> None:
            self.built = ""
            self._forget()
            self._folder = tempfile.TemporaryDirectory(prefix="dbb-upload-")
            archive = Path(self._folder.name) / _file_name(name)
            archive.write_bytes(content)
            self.package = Package(archive, look_into(archive))

        self.start(_file_name(name), "is being read", work)

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
            except Cancelled:  # the process may have had no time to tidy up
                for begun in request.out.resolve().parent.glob(f".{request.name}-*"):
                    shutil.rmtree(begun, ignore_errors=True)
                raise
            self.built = request.name
            self._switch.look_again()
            self._forget()  # what it needs of the zip is in its own folder now

        self.start(request.name, "begins", work)

    def close(self) -> None:
        """Cancel, and remove what was uploaded."""
        super().close()
        self._forget()

    def _forget(self) -> None:
        self.package = None
        if self._folder is not None:
            self._folder.cleanup()
            self._folder = None


def _file_name(name: str) -> str:
    """A name for the file that a browser calls so, which may say anything."""
    kept = "".join(c for c in name if c.isascii() and (c.isalnum() or c in "._-"))
    return f"{kept.lower().removesuffix('.zip').strip('.')[:60] or 'robot'}.zip"
