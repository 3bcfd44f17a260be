"""A user's own robot in the page: a zip is uploaded, converted, shown and pulled.

Only the numbers of samples are smaller than in normal use.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from app.border.cache import BorderData, kept_border_data
from app.border.sampling import SamplingConfig
from app.config import Config
from app.dashboard import robots
from app.dashboard.drag import GIZMO, SCALE
from app.dashboard.server import DashboardServer
from app.jobs.process import Report
from app.onboarding import new_robot
from app.onboarding.new_robot import finish
from app.onboarding.request import Request
from app.robot.model import RobotModel
from app.simulation.loop.loop import SimulationLoop
from app.simulation.scenarios.start import StartSolver
from app.simulation.session import Session
from tests.browser import DashboardTab, wait_for
from tests.dashboards import served_dashboard
from tests.onboarding import arm, cart, cube, few_samples, robot, with_mesh, zipped

pytestmark = [pytest.mark.browser, pytest.mark.slow]

TOY = with_mesh(robot([*cart(), *arm()]), "package://toy/meshes/m.stl")
FOREIGN = (
    "<p>not the robot's</p><script>top.foreign = 1</script>"
    '<img src="data:," onerror="top.foreign = 1">'
)
BLOCKED = "Blocked script execution in 'about:srcdoc'"
"""The browser's error when it blocks the script in the report."""
LATE = "Tried to update non-existent component"
"""The error of viser's page for a widget that is changed and removed in the same frame.

viser applies changes after removals; the widgets of the old robot are removed all the same.
"""
SAMPLING = SamplingConfig(
    pair_samples=2000,
    cloud_samples=2000,
    voxel_plan=0.05,
    voxel_height=0.05,
    rounds=1,
    retries=1,
    sectors=2,
)


def make_robot_with_few_samples(report: Report, request: Request) -> None:
    """Main function of the process that makes the robot, with one guiding line.

    The border is stored beside the robots.
    """
    with few_samples(request.out.parent), pytest.MonkeyPatch.context() as patch:
        patch.setattr(new_robot, "SIDES", ("guiding-front",))
        finish(
            request,
            tell=lambda text: report(text, -1.0),
            processes=1,
            sampling=SAMPLING,
            on_progress=lambda share: report("sampling the border", share),
        )


def stored_border(model: RobotModel) -> BorderData | None:
    return kept_border_data(model, SAMPLING)


def begin(model: RobotModel, data: BorderData, config: Config, controller: str) -> SimulationLoop:
    make = partial(Session, model, data, config, controller=controller, physics="kinematic", seed=0)
    start = model.description.lines["guiding-front"].start_m
    loop = SimulationLoop(make, StartSolver(model, data.pairs, config.border.d_b).solve(start))
    loop.begin()
    return loop


@pytest.fixture
def server(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[DashboardServer]:
    """A server with the paper's robot and an empty folder for the user's robots."""
    folder = tmp_path / "robots"
    monkeypatch.setenv("DBB_ROBOTS", str(folder))
    monkeypatch.setattr("app.robot.assets.cache_folder", lambda: folder)
    monkeypatch.setattr(robots, "build_robot", make_robot_with_few_samples)
    monkeypatch.setattr(robots, "kept_border_data", stored_border)
    with served_dashboard(start_loop=begin) as (server, _):
        yield server


def choose_file(tab: DashboardTab, path: Path) -> None:
    with tab.page.expect_file_chooser() as chooser:
        tab.click("Upload a zip")
    chooser.value.set_files(path)


def wait_for_text(tab: DashboardTab, text: str) -> None:
    found = tab.page.get_by_text(text).filter(visible=True).first
    found.wait_for(timeout=240_000)  # [ms] making a robot takes long


def test_zip_becomes_a_robot_whose_base_avoids_the_end_effector(
    browser: Any, server: DashboardServer, tmp_path: Path
) -> None:
    good = {"toy/toy.urdf": TOY, "toy/meshes/m.stl": cube()}
    tab = DashboardTab(browser, server.address)
    tab.open_tab("Robot")
    tab.page.get_by_text("Your own robot").click()
    choose_file(tab, zipped(tmp_path, {"../toy.urdf": TOY}))
    wait_for_text(tab, "leads out of the zip by '..'")
    choose_file(tab, zipped(tmp_path, good))
    wait_for_text(tab, "Choose the base link and the tip link.")
    tab.click("Create robot")
    wait_for_text(tab, "is ready: choose it")
    report = tmp_path / "robots" / "toy" / "report.html"
    report.write_text(FOREIGN + report.read_text(encoding="utf-8"), encoding="utf-8")
    tab.click("Report")
    wait_for_text(tab, "Report on the creation of toy")
    tab.page.frame_locator("iframe").get_by_text("not the robot's").wait_for()
    assert tab.page.evaluate("window.foreign") is None
    tab.click("Close")
    shared = server.shared
    tab.click("Use this robot")
    wait_for(lambda: server.shared is not shared, what="the new robot")
    tab.wait_for_scene()
    assert [text for text in tab.errors if text.startswith(BLOCKED)], "the script is blocked"
    tab.errors = [text for text in tab.errors if not text.startswith((LATE, BLOCKED))]
    pull_towards_the_base(tab, server)
    assert tab.errors == []


def pull_towards_the_base(tab: DashboardTab, server: DashboardServer) -> None:
    """Drag the end-effector backwards, at most six times, until the base has moved."""
    loop = server.shared.loop
    begin = loop.latest().base_pose.copy()
    for _ in range(6):
        tab.drag_gizmo(GIZMO, 0, -0.15, SCALE)
        if np.linalg.norm(loop.latest().base_pose[:2] - begin[:2]) > 0.02:
            break
    newest = loop.latest()
    assert newest.base_pose[0] < begin[0] - 0.02, (newest.base_pose, newest.p_ee)
    assert not newest.in_contact
