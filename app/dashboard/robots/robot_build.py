"""A new robot from an uploaded zip, made in a process of its own; the same for all viewers."""

from __future__ import annotations

import logging
import shutil
import tempfile
import threading
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import NamedTuple

from app.dashboard.memory import give_back
from app.dashboard.robots.robot_switch import Progress, StageChange
from app.errors import ConfigError, DbbError
from app.jobs.background import Stopped, Tell, cores, run_apart
from app.onboarding.read.package import Contents, look_into
from app.onboarding.read.unpack import LARGEST_ARCHIVE
from app.onboarding.request import Request
from app.robot.assets import robot_names

logger = logging.getLogger(__name__)

_PATIENCE = 10.0  # [s] for a thread to end


class Package(NamedTuple):
    """A zip that was uploaded and looked into.

    Attributes:
        archive: Where it is kept until it has become a robot or another one comes.
        urdfs: Its URDFs, by their path in it.
    """

    archive: Path
    urdfs: Mapping[str, Contents]


class Making:
    """At most one zip, and one robot that is being made of it.

    Attributes:
        package: What was uploaded last and can be used, or None.
        progress: Of what is under way, or None.
        problem: Why the last step failed, or an empty string.
        made: Name of the robot that was made last, or an empty string.
    """

    def __init__(self, change: StageChange) -> None:
        """Nothing uploaded yet.

        Args:
            change: Told that there is another robot to choose.
        """
        self.package: Package | None = None
        self.progress: Progress | None = None
        self.problem = self.made = ""
        self._change = change
        self._folder: tempfile.TemporaryDirectory[str] | None = None
        self._stopping = threading.Event()
        self._thread: threading.Thread | None = None
        self._lock = threading.Lock()

    def receive(self, name: str, content: bytes) -> None:
        """Take a zip, and look into it in a thread of its own.

        Args:
            name: Of the file, for people.
            content: Its bytes.

        Raises:
            ConfigError: It is too large, or something is under way.
        """
        if len(content) > LARGEST_ARCHIVE:
            raise ConfigError(f"a zip may have {LARGEST_ARCHIVE / 1e6:.0f} MB")

        def work() -> None:
            self._forget()
            self._folder = tempfile.TemporaryDirectory(prefix="dbb-upload-")
            archive = Path(self._folder.name) / _file_name(name)
            archive.write_bytes(content)
            self.package = Package(archive, look_into(archive))

        self._begin(Progress(_file_name(name), "is being looked into"), work)

    def make(self, request: Request) -> None:
        """Make the robot in a process of its own.

        Raises:
            ConfigError: There is a robot of that name already, or something is under way.
            RobotFileError: The name cannot be one.
        """
        if request.name in robot_names():
            raise ConfigError(f"there is a robot {request.name!r} already; give another name")

        def work() -> None:
            tell = self._tell(request.name)
            try:
                run_apart(make_new, request, tell=tell, stopping=self._stopping)
            except Stopped:  # it may have had no time to tidy up
                for begun in request.out.resolve().parent.glob(f".{request.name}-*"):
                    shutil.rmtree(begun, ignore_errors=True)
                raise
            self.made = request.name
            self._change.look_again()
            self._forget()  # what it needs of the zip is in its own folder now

        self._begin(Progress(request.name, "begins"), work)

    def cancel(self) -> None:
        """Stop what is under way; nothing of it is left."""
        self._stopping.set()

    def close(self) -> None:
        """Stop, and remove what was uploaded."""
        self.cancel()
        if self._thread is not None:
            self._thread.join(_PATIENCE)
        self._forget()

    def _begin(self, progress: Progress, work: Callable[[], None]) -> None:
        with self._lock:
            running = self.progress  # read once: its thread may end
            if running is not None:
                raise ConfigError(f"{running.title} {running.text}; cancel that first")
            self.progress = progress
        self.problem = self.made = ""
        self._stopping.clear()
        self._thread = threading.Thread(
            target=self._work, args=(progress.title, work), name="new robot"
        )
        self._thread.daemon = True
        self._thread.start()

    def _work(self, title: str, work: Callable[[], None]) -> None:
        try:
            work()
        except Stopped:
            self.problem = f"{title}: cancelled"
        except (DbbError, OSError) as error:
            told = str(error).removeprefix(f"{title}: ")  # some name the zip themselves
            self.problem = f"{title}: {told}"
        except Exception as error:  # nobody joins this thread: the viewers have to learn of it
            logger.exception("%s could not be made", title)
            self.problem = f"{title}: {type(error).__name__}: {error}"
        finally:
            give_back()
            self.progress = None

    def _tell(self, title: str) -> Tell:
        def tell(text: str, share: float) -> None:
            self.progress = Progress(title, text, share)

        return tell

    def _forget(self) -> None:
        self.package = None
        if self._folder is not None:
            self._folder.cleanup()
            self._folder = None


def make_new(tell: Tell, request: Request) -> None:
    """Description, border and report, in the folder that is asked for."""
    # Imported here: matplotlib is needed in this process alone.
    from app.onboarding.write.make import finish

    text = ""

    def say(what: str) -> None:
        nonlocal text
        text = what
        tell(text, -1.0)

    finish(
        request,
        tell=say,
        processes=cores(),
        progress=False,
        on_progress=lambda share: tell(text, share),
    )


def _file_name(name: str) -> str:
    """A name for the file that a browser calls so, which may say anything."""
    kept = "".join(c for c in name if c.isascii() and (c.isalnum() or c in "._-"))
    return f"{kept.lower().removesuffix('.zip').strip('.')[:60] or 'robot'}.zip"
