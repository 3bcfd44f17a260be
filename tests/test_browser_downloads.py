"""What the tab "Save" gives is what was asked for, and can be opened again."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from app.dashboard.export.browser import new_context
from app.simulation.trace.log import read_log
from tests.browser import DashboardTab, wait_for
from tests.dashboards import served_dashboard

pytestmark = pytest.mark.browser

BEGIN, END = 1.0, 2.0  # [s] of the marked interval
PATIENCE = 300_000  # [ms] for what is made at low priority beside a simulation


@pytest.fixture(scope="module")
def tab(browser):
    """Three seconds in which the base gives way, one of them marked; the tab "Save" is open."""
    with served_dashboard() as served:
        tab = DashboardTab(browser, served.server.address)
        served.pull_at_base(3.0)
        timeline = served.page().timeline
        wait_for(lambda: timeline.shown().t == pytest.approx(3.0))
        for back, mark in ((3.0 - BEGIN, "Mark begin"), (3.0 - END, "Mark end")):
            tab.set_slider("Back [s]", -back)
            wait_for(lambda t=3.0 - back: timeline.shown().t == pytest.approx(t))
            tab.click(mark)
        wait_for(lambda: timeline.end is not None)
        tab.page.get_by_text(f"marked {BEGIN:.2f} to {END:.2f} s").wait_for(timeout=40_000)
        tab.open_tab("Save")
        yield tab
        tab.close()
        assert tab.errors == []


def download(tab: DashboardTab, button: str, folder: Path) -> Path:
    """Press a button and keep what comes."""
    with tab.page.expect_download(timeout=PATIENCE) as coming:
        tab.click(button)
    path = folder / coming.value.suggested_filename
    coming.value.save_as(path)
    tab.page.get_by_text("is being made").wait_for(state="hidden", timeout=PATIENCE)
    return path


def test_a_picture_has_the_asked_size_and_shows_the_scene(tab, tmp_path):
    for name, pixels in (("width [px]", 642), ("height [px]", 358)):
        tab.set_slider(name, pixels)
    tab.page.wait_for_timeout(300)
    with tab.drawing(), Image.open(download(tab, "Picture (PNG)", tmp_path)) as picture:
        assert (picture.format, picture.size) == ("PNG", (642, 358))
        grey = np.array(picture.convert("L")).astype(float)
    middle = grey[60:300, 200:450]
    assert middle.max() - middle.min() > 120, "a white arm before a dark ground"


@pytest.mark.parametrize("kind", ["CSV", "Parquet"])
def test_a_log_holds_the_marked_interval(tab, tmp_path, kind):
    path = download(tab, f"Log ({kind})", tmp_path)
    assert path.suffix == f".{kind.lower()}"
    times = [snapshot.t for snapshot in read_log(path).snapshots]
    np.testing.assert_allclose(times, np.arange(BEGIN, END + 0.01, 0.02), atol=1e-6)


@pytest.fixture
def offline(browser):
    """A page without a network, and what goes wrong on it."""
    context = new_context(browser, (640, 480))
    context.set_offline(True)
    page, errors = context.new_page(), []
    page.on("pageerror", lambda error: errors.append(str(error)))
    page.on("console", lambda m: errors.append(m.text) if m.type == "error" else None)
    yield page
    context.close()
    assert errors == [], "the console of the file's page"


def test_a_report_opens_from_a_file_with_the_network_off(tab, tmp_path, offline):
    offline.goto(download(tab, "Report (HTML)", tmp_path).as_uri())
    assert offline.get_by_text("lm-lEE").first.is_visible()


def test_a_replay_moves_the_robot_from_a_file_with_the_network_off(tab, tmp_path, offline):
    offline.goto(download(tab, "Replay (HTML)", tmp_path).as_uri())
    offline.wait_for_function("() => dbbPage.ready() && dbbPage.has('/robot')", timeout=PATIENCE)
    joint = "() => dbbPage.viewer().nodePoseData['/robot/panda_joint4']?.position?.[2] ?? null"
    heights = set()

    def moves() -> bool:
        heights.add(offline.evaluate(joint))
        return len(heights - {None}) > 3

    wait_for(moves, what="the arm moves")
