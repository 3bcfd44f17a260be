"""Work that the dashboard leaves to processes of its own, as functions for `Job.run`.

The process that calls one of them imports this module first: what a function needs, it imports.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from app.jobs.process import Report, background_cores

if TYPE_CHECKING:
    from app.border.cache import BorderData
    from app.onboarding.request import Request
    from app.studies.sweep.plan import SweepPlan


def sample_border(report: Report, robot: str) -> BorderData:
    """Pairs and clouds of a robot, sampled if they are not cached."""
    from app.border.cache import load_border_data
    from app.robot.assets import load_robot
    from app.robot.model import RobotModel

    text = "sampling its border, once"
    report(text, 0.0)
    return load_border_data(
        RobotModel(load_robot(robot)),
        progress=False,
        processes=background_cores(),
        on_progress=lambda share: report(text, share),
    )


def build_robot(report: Report, request: Request) -> None:
    """Description, border and report of a new robot, in the folder that the request names."""
    from app.onboarding.write.make import finish

    text = ""

    def say(what: str) -> None:
        nonlocal text
        text = what
        report(text, -1.0)

    finish(
        request,
        tell=say,
        processes=background_cores(),
        progress=False,
        on_progress=lambda share: report(text, share),
    )


def sweep_to_files(report: Report, plan: SweepPlan, folder: Path) -> None:
    """A sweep, and its files in a folder."""
    from app.studies.sweep.files import write_sweep
    from app.studies.sweep.sweep import sweep

    result = sweep(plan, processes=1, on_progress=lambda share: report("sweep under way", share))
    write_sweep(result, folder)


def write_report(report: Report, log: Path, page: Path) -> None:
    """The report of a log as a page."""
    from app.simulation.trace.log import read_log
    from app.studies.run_report.report import run_report

    report("drawing the figures", -1.0)
    page.write_text(run_report(read_log(log)), encoding="utf-8")


def write_replay(report: Report, log: Path, page: Path) -> None:
    """The replay of a log as a page."""
    from app.border.cache import load_border_data
    from app.dashboard.export.replay import replay_html
    from app.robot.assets import load_robot
    from app.robot.model import RobotModel
    from app.simulation.trace.log import read_log

    read = read_log(log)
    duration = max(read.snapshots[-1].t - read.snapshots[0].t, 1e-9)
    model = RobotModel(load_robot(read.meta.robot))
    clouds = load_border_data(model, progress=False).clouds
    text = replay_html(
        read, model, clouds, on_progress=lambda t: report("drawing the pictures", t / duration)
    )
    page.write_text(text, encoding="utf-8")
