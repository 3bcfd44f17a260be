"""The whole of `dbb new-robot`: made, bordered, reported on, and only then put in its place."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

from app.border.cache import BorderData, load_border_data
from app.border.sampling.config import SamplingConfig
from app.onboarding.new_robot import NewRobot, make_robot
from app.onboarding.read.package import FOLDER, is_package, open_package
from app.onboarding.request import Request
from app.onboarding.write.folder import whole_folder, write_robot
from app.onboarding.write.report import report_html


def finish(
    request: Request,
    *,
    tell: Callable[[str], None] = lambda _: None,
    processes: int | None = None,
    sampling: SamplingConfig | None = None,
    progress: bool = True,
    on_progress: Callable[[float], None] | None = None,
) -> tuple[NewRobot, BorderData]:
    """Make a robot and write its folder.

    Args:
        request: What is asked.
        tell: Called with what is being done.
        processes: How many to count and sample with; all cores if not given.
        sampling: Of the border; by default as every command samples it.
        progress: Whether to draw a bar on stderr while the border is sampled.
        on_progress: Called with the share of the border that is sampled, 0 to 1.

    Raises:
        RobotFileError: The URDF cannot become a robot.
        AssetError: A package is not installed.
        DescriptionError: What came out is no robot that the core takes.
        OutputError: The folder is there already or cannot be written.
    """
    request.name  # noqa: B018 - a wrong name is told before any work
    with whole_folder(request.out) as folder:
        if is_package(request.urdf):
            tell("unpacking the zip")
            path = open_package(Path(request.urdf), folder, request.file)
            name = f"{Path(request.urdf).name}: {path.relative_to((folder / FOLDER).resolve())}"
            request = replace(request, urdf=str(path), source=name)
        robot = make_robot(request, folder, tell=tell, processes=processes)
        tell("sampling the border")
        data = load_border_data(
            robot.model,
            sampling=sampling,
            processes=processes,
            progress=progress,
            on_progress=on_progress,
        )
        tell("writing the report")
        write_robot(robot, folder)
        page = report_html(robot, robot.model, data)
        (folder / "report.html").write_text(page, encoding="utf-8")
    return robot, data
