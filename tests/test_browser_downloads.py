"""The tab "Save" delivers the requested files, and each file opens."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from app.dashboard.export.browser import new_context
from app.dashboard.export.offscreen import RATE
from app.simulation.trace.log_file import read_trace
from tests.browser import HELPERS, DashboardTab, wait_for
from tests.dashboards import served_dashboard
from tests.robots import needs_pybullet

pytestmark = pytest.mark.browser

BEGIN, END = 1.0, 1.2  # [s] of the marked interval
PATIENCE = 300_000  # [ms] for files that are made beside a simulation


@pytest.fixture(scope="module")
def tab(browser):
    """The open tab "Save" after a pull of 3 s, with a marked interval."""
    with served_dashboard() as served:
        tab = DashboardTab(browser, served.server.address)
        served.pull_at_base(3.0)
        timeline = served.page().timeline
        wait_for(lambda: timeline.shown().t == pytest.approx(3.0))
        for t, mark, name in ((BEGIN, "Mark start", "begin"), (END, "Mark end", "end")):
            timeline.go_to(t)
            tab.click(mark)
            wait_for(lambda name=name: getattr(timeline, name) is not None)
        tab.page.get_by_text(f"marked {BEGIN:.2f} to {END:.2f} s").wait_for(timeout=40_000)
        tab.open_tab("Save")
        tab.pages = served.server.pages
        yield tab
        tab.close()
        assert tab.errors == []


def download(tab: DashboardTab, button: str, folder: Path) -> Path:
    """Press a button and store the download."""
    with tab.page.expect_download(timeout=PATIENCE) as coming:
        tab.click(button)
    path = folder / coming.value.suggested_filename
    coming.value.save_as(path)
    job = next(iter(tab.pages.values())).files
    wait_for(lambda: job.progress is None, what="the end of the work")
    return path


def test_a_picture_has_the_requested_size_and_shows_the_scene(tab, tmp_path):
    for name, pixels in (("width [px]", 642), ("height [px]", 358)):
        tab.set_slider(name, pixels)
    tab.page.wait_for_timeout(300)
    with tab.drawing(), Image.open(download(tab, "Picture (PNG)", tmp_path)) as picture:
        assert (picture.format, picture.size) == ("PNG", (642, 358))
        grey = np.array(picture.convert("L")).astype(float)
    middle = grey[60:300, 200:450]
    assert middle.max() - middle.min() > 120, "no contrast between arm and background"


@pytest.mark.parametrize("kind", ["CSV", "Parquet"])
def test_a_log_contains_the_marked_interval(tab, tmp_path, kind, request):
    """The Parquet file is made in a process of its own, as for a user."""
    if kind == "CSV":
        request.getfixturevalue("made_here")
    path = download(tab, f"Log ({kind})", tmp_path)
    assert path.suffix == f".{kind.lower()}"
    if kind == "CSV":  # opens in spreadsheets and pandas: the first line has the columns
        with path.open(newline="", encoding="utf-8") as file:
            times = [float(row["t_s"]) for row in csv.DictReader(file)]
    else:
        times = [snapshot.t for snapshot in read_trace(path).snapshots]
    np.testing.assert_allclose(times, np.arange(BEGIN, END + 0.01, 0.02), atol=1e-6)


@pytest.mark.usefixtures("made_here")
def test_one_escape_returns_to_the_present_despite_a_notification(tab, tmp_path):
    """The client shows for some seconds that the download is complete."""
    timeline = next(iter(tab.pages.values())).timeline
    timeline.go_to(END)
    tab.page.locator("#dbb-past").wait_for()
    download(tab, "Log (CSV)", tmp_path)
    tab.page.locator(".mantine-Notification-root").first.wait_for()
    tab.page.keyboard.press("Escape")
    wait_for(lambda: timeline.live, what="the present")


@pytest.fixture
def offline(browser):
    """A page without a network; an error in its console fails the test."""
    context = new_context(browser, (640, 480))
    context.set_offline(True)
    context.add_init_script(HELPERS)
    page, errors = context.new_page(), []
    page.on("pageerror", lambda error: errors.append(str(error)))
    page.on("console", lambda m: errors.append(m.text) if m.type == "error" else None)
    yield page
    context.close()
    assert errors == [], "errors in the console of the page"


@pytest.mark.usefixtures("made_here")
def test_a_report_opens_without_a_network(tab, tmp_path, offline):
    offline.goto(download(tab, "Report (HTML)", tmp_path).as_uri())
    assert offline.get_by_text("end-effector – base").first.is_visible()


@needs_pybullet
@pytest.mark.usefixtures("made_here")
def test_a_replay_moves_the_robot_without_a_network(tab, tmp_path, offline):
    offline.goto(download(tab, "Replay (HTML)", tmp_path).as_uri())
    offline.wait_for_function("() => dbbPage.ready() && dbbPage.has('/robot')", timeout=PATIENCE)
    # Software rendering skips frames of the replay, so the page may always draw the same one.
    offline.evaluate("() => dbbTest.draw(false)")
    joint = "() => dbbPage.viewer().nodePoseData['/robot/panda_joint4']?.position?.[2] ?? null"
    heights = set()

    def moves() -> bool:
        heights.add(offline.evaluate(joint))
        return len(heights - {None}) > 3

    wait_for(moves, what="the arm moves")
    assert "husky_panda" in offline.title()
    assert offline.get_by_text("smallest distance").is_visible()


def test_a_film_is_made_with_progress_and_can_be_cancelled(tab, tmp_path):
    page = next(iter(tab.pages.values()))
    job = page.files
    page.timeline.go_to(END)
    tab.page.locator("#dbb-past").wait_for()
    tab.choose("Film format", ".gif")
    tab.click("Film")
    tab.page.get_by_text("Film: ").filter(visible=True).first.wait_for(timeout=PATIENCE)
    tab.page.keyboard.press("Escape")
    wait_for(lambda: page.timeline.live, what="the present")
    tab.click("Cancel")
    wait_for(lambda: job.progress is None, what="the end of the work")
    tab.page.get_by_role("button", name="Cancel").wait_for(state="hidden", timeout=PATIENCE)
    for name, pixels in (("width [px]", 160), ("height [px]", 90)):
        tab.set_slider(name, pixels)
    with Image.open(download(tab, "Film", tmp_path)) as film:
        assert (film.format, film.size) == ("GIF", (160, 90))
        assert film.n_frames == round((END - BEGIN) * RATE) + 1
