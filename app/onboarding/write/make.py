"""The whole of `dbb new-robot`: made, bordered, reported on, and only then put in its place."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

from app.border.cache import BorderData, load_border_data
from app.border.sampling.config import SamplingConfig
from app.errors import DbbError, RobotFileError
from app.onboarding.new_robot import NewRobot, make_robot
from app.onboarding.read.package import FOLDER, is_package, open_package
from app.onboarding.request import Request
from app.onboarding.write.folder import whole_folder, write_robot
from app.onboarding.write.report import report_html

_log = logging.getLogger(__name__)


def finish(
    request: Request,
    *,
    tell: Callable[[str], None] = lambda _: None,
    processes: int | None = None,
    sampling: SamplingConfig | None = None,
    progress: bool = True,
    on_progress: Callable[[float], None] = lambda _: None,
) -> tuple[NewRobot, BorderData]:
    """Make a robot and write its folder.

    Args:
        request: What is asked.
        tell: Called with what is being done.
        processes: How many to count and sample with; all cores if not given.
        sampling: Of the border; by default as every command samples it.
        progress: Whether to draw a bar on stderr while the border is sampled.
        on_progress: Called with the share of a long step that is done, 0 to 1: of the places that
            are searched, then of the border.

    Raises:
        RobotFileError: The URDF cannot become a robot, or a library cannot take it.
        AssetError: A package is not installed.
        DescriptionError: What came out is no robot that the core takes.
        OutputError: The folder is there already or cannot be written.
    """
    request.name  # noqa: B018 - a wrong name is told before any work
    doing = ""

    def say(what: str) -> None:
        nonlocal doing
        doing = what
        tell(what)

    with whole_folder(request.out) as folder, one_message(lambda: doing):
        if is_package(request.urdf):
            say("unpacking the zip")
            path = open_package(Path(request.urdf), folder, request.file)
            name = f"{Path(request.urdf).name}: {path.relative_to((folder / FOLDER).resolve())}"
            request = replace(request, urdf=str(path), source=name)
        robot = make_robot(request, folder, tell=say, processes=processes, on_progress=on_progress)
        say("sampling the border")
        data = load_border_data(
            robot.model,
            sampling=sampling,
            processes=processes,
            progress=progress,
            on_progress=on_progress,
        )
        say("writing the report")
        write_robot(robot, folder)
        page = report_html(robot, robot.model, data)
        (folder / "report.html").write_text(page, encoding="utf-8")
    return robot, data


@contextmanager
def one_message(doing: Callable[[], str]) -> Iterator[None]:
    """Whatever a library raises becomes one line that names the step; its trace goes to the log.

    Args:
        doing: The step that is under way.

    Raises:
        RobotFileError: In place of what is no `DbbError`.
    """
    try:
        yield
    except DbbError:
        raise
    except Exception as error:  # pinocchio, coal, qhull, trimesh: they have no common base
        _log.debug("%s", doing(), exc_info=True)
        why = " ".join(str(error).split())[:300] or "no reason given"
        raise RobotFileError(
            f"{doing()}: a library cannot take this robot: {type(error).__name__}: {why}; "
            "look whether check_urdf takes the file, then report it with the URDF"
        ) from error
