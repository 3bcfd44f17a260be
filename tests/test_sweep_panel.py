"""The dashboard's folder "Sweep": the newest map, and a sweep that ends with the server."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import psutil
import pytest

from app.dashboard.job import Job
from app.dashboard.panels import save
from app.dashboard.panels.save import STEP, SweepPanel, start_sweep
from app.dashboard.server import DashboardServer, serve_dashboard
from app.errors import OutputError
from app.studies.sweep.plan import SweepPlan
from tests.dashboards import clouds, parts
from tests.fakes import ScriptedLoop
from tests.raw_client import RawClient
from tests.robots import husky_panda
from tests.test_sweep_maps import result

pytestmark = pytest.mark.slow

SHORT = SweepPlan(
    heights=(1.9,), step=90.0, wheel_axis=False, length=0.02, speeds=(0.4,), physics="kinematic"
)


@pytest.fixture
def dashboard(tmp_path: Path) -> Iterator[DashboardServer]:
    loop = ScriptedLoop(husky_panda())
    loop.start()
    server = serve_dashboard(
        loop, husky_panda(), clouds(), port=0, parts=parts(), sweeps=tmp_path / "sweeps"
    )
    yield server
    server.stop()
    loop.stop()


def wait_for(condition: Callable[[], object], seconds: float = 400.0) -> None:
    deadline = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < deadline, "did not come true in time"
        time.sleep(0.05)


@pytest.fixture
def panel(dashboard: DashboardServer) -> Iterator[SweepPanel]:
    """Of the only viewer."""
    with RawClient(dashboard.address):
        wait_for(lambda: len(dashboard.pages) == 1, 30.0)
        [page] = dashboard.pages.values()
        yield page.sweep_panel


def test_without_a_map_there_is_a_line_and_a_new_map_appears_by_itself(
    panel: SweepPanel, tmp_path: Path
) -> None:
    from app.studies.sweep.sweep import write_sweep

    wait_for(lambda: "No map" in panel._text.content)
    assert panel._image is None
    (tmp_path / "sweeps").mkdir()
    write_sweep(result(("dbb",)), tmp_path / "sweeps")
    wait_for(lambda: panel._image is not None and "sweep_h0.3" in panel._text.content, 20.0)
    assert panel._image is not None
    assert np.asarray(panel._image.image).std() > 10


def test_a_map_that_cannot_be_read_is_told_as_text_and_the_page_goes_on(
    dashboard: DashboardServer, panel: SweepPanel, tmp_path: Path
) -> None:
    (tmp_path / "sweeps").mkdir()
    (tmp_path / "sweeps" / "sweep_h`{1}`<b>_v.png").write_bytes(b"no picture")
    wait_for(lambda: "&lt;b&gt;_v.png cannot be read" in panel._text.content, 20.0)
    [page] = dashboard.pages.values()
    assert not page.closed


def sweeping(job: Job) -> psutil.Process:
    """The process of a sweep under way, once it is one of low priority."""
    mine = psutil.Process(os.getpid())

    def low() -> list[psutil.Process]:
        return [process for process in mine.children() if process.nice() > mine.nice()]

    wait_for(low, 30.0)
    assert job.progress is not None
    (process,) = low()
    return process


def test_the_button_starts_a_sweep_with_what_is_chosen_and_stopping_the_server_ends_it(
    dashboard: DashboardServer, panel: SweepPanel, monkeypatch: pytest.MonkeyPatch
) -> None:
    dashboard.shared.tuning.set("force.f_max", 200.0)
    plans: list[SweepPlan] = []
    monkeypatch.setattr(
        save,
        "start_sweep",
        lambda job, plan, folder: (plans.append(plan), start_sweep(job, plan, folder)),
    )
    panel.begin()
    wait_for(lambda: "<b>sweep</b>" in panel.status.text.content, 20.0)
    (plan,) = plans
    assert (plan.controllers, plan.step, plan.config.force.f_max) == (("dbb",), STEP, 200.0)
    process = sweeping(dashboard.shared.sweep_job)
    dashboard.stop()
    assert not process.is_running()


def test_a_sweep_that_is_cancelled_ends_and_says_so(
    dashboard: DashboardServer, panel: SweepPanel
) -> None:
    panel.begin()
    process = sweeping(dashboard.shared.sweep_job)
    dashboard.shared.sweep_job.cancel()
    wait_for(lambda: not process.is_running(), 20.0)
    wait_for(lambda: "sweep: cancelled" in panel.status.text.content, 20.0)
    wait_for(lambda: "No map" in panel._text.content, 20.0)


def test_a_sweep_reports_how_far_it_is_and_leaves_its_files(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """In this process: what crosses the border of one is the same for all jobs."""
    monkeypatch.setattr(Job, "run", lambda self, work, *args: work(self.report, *args))
    job, shares = Job(), set()
    start_sweep(job, SHORT, tmp_path / "made")
    while (progress := job.progress) is not None:
        shares.add(progress.share)
        time.sleep(0.02)
    assert job.problem == ""
    assert max(shares) > 0.0
    assert sorted(p.name for p in (tmp_path / "made").iterdir()) == [
        "sweep.csv",
        "sweep.json",
        "sweep_h1.9_v0.4.png",
    ]


def test_a_folder_that_cannot_be_made_is_refused(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(OutputError, match="file"):
        start_sweep(Job(), SHORT, tmp_path / "file" / "below")
