"""Looking back: the scene, the plots and the texts show that instant, and `Now` returns."""

from __future__ import annotations

import numpy as np
import pytest

from app.dashboard.drag import GIZMO
from app.dashboard.scene.robot import ROOT
from app.simulation.loop.commands import Pause, StepOnce
from app.simulation.trace.snapshot import Snapshot
from tests.browser import DashboardTab, wait_for
from tests.dashboards import served_dashboard

pytestmark = pytest.mark.browser

DT = 0.02  # [s] between two snapshots


@pytest.fixture(scope="module")
def served():
    with served_dashboard() as served:
        yield served


@pytest.fixture(scope="module")
def opened(browser, served):
    tab = DashboardTab(browser, served.server.address)
    tab.open_tab("Plots")
    yield tab
    tab.close()


@pytest.fixture
def tab(opened, served):
    """After 4 s in which the hand is pulled and the base gives way, time stands still."""
    served.pull_at_base(4.0)
    yield opened
    opened.click("Now")
    assert opened.errors == [], "the page's console"


def shows(tab: DashboardTab, snapshot: Snapshot) -> bool:
    """Whether base, hand and the arm's last link stand as they did."""
    x, y, _ = snapshot.base_pose
    return (
        np.linalg.norm(tab.position(ROOT) - [x, y, 0.0]) < 1e-3
        and np.linalg.norm(tab.position(GIZMO) - snapshot.p_ee) < 1e-3
    )


def test_the_slider_shows_the_robot_as_it_was_while_the_simulation_goes_on(tab, served):
    page, loop = served.page(), served.loop
    tab.set_slider("Back [s]", -2.5)
    wait_for(lambda: not page.timeline.live, what="looking back")
    then = page.timeline.shown()
    assert page.timeline.back == pytest.approx(2.5, abs=DT)
    assert then in loop.history(-1.0)
    wait_for(lambda: shows(tab, then), what="the scene as it was")
    now = loop.latest()
    loop.send(Pause(False))
    moved = np.linalg.norm(now.p_ee - then.p_ee) + np.linalg.norm(now.base_pose - then.base_pose)
    assert moved > 0.05, "it was elsewhere then"
    wait_for(lambda: loop.latest().t > now.t + 0.5, what="the simulation goes on")
    tab.render(2)
    assert shows(tab, then)
    tab.page.get_by_text(f"t = {then.t:.2f} s").first.wait_for(timeout=40_000)
    tab.page.get_by_text("s ago").first.wait_for(timeout=40_000)


def test_the_cursor_of_every_plot_stands_where_the_viewer_looks_and_goes_with_now(tab, served):
    page = served.page()
    tab.set_slider("Back [s]", -1.0)
    wait_for(lambda: not page.timeline.live)
    then = page.timeline.shown().t

    def cursors() -> list[float]:
        plots = [tab.plot(title) for title in sorted(page.view.plots)]
        return [t for plot in plots for t, c in zip(plot[0], plot[-1], strict=True) if c == 1.0]

    wait_for(lambda: len(cursors()) == 3, what="a cursor in each of the three plots")
    np.testing.assert_allclose(cursors(), then, atol=0.03)
    tab.click("Now")
    wait_for(lambda: cursors() == [], what="no cursor")
    wait_for(lambda: shows(tab, served.loop.latest()), what="the newest instant")
    tab.page.get_by_text(f"t = {served.loop.latest().t:.2f} s, now").wait_for(timeout=40_000)
    assert tab.row("Back [s]").locator("input").last.input_value() == "0"


def test_a_step_forward_from_now_is_simulated_and_a_step_back_is_remembered(tab, served):
    loop, page = served.loop, served.page()
    for paused in (False, True):
        tab.click("Stop / go")
        wait_for(lambda p=paused: loop.commands[-1:] == [Pause(p)])
        wait_for(lambda p=paused: page.timeline_panel._newest.paused is p)
    before = loop.latest().t
    tab.click("+20 ms")
    wait_for(lambda: loop.commands[-1] == StepOnce(DT))
    assert loop.latest().t == pytest.approx(before + DT)
    wait_for(lambda: shows(tab, loop.latest()))

    count = len(loop.commands)
    tab.click("−20 ms")
    wait_for(lambda: not page.timeline.live)
    assert page.timeline.shown().t == pytest.approx(before)
    tab.click("−1 s")
    wait_for(lambda: page.timeline.shown().t == pytest.approx(before - 1.0, abs=1e-3))
    wait_for(lambda: shows(tab, page.timeline.shown()))
    tab.click("+1 s")
    wait_for(lambda: page.timeline.shown().t == pytest.approx(before, abs=1e-3))
    assert len(loop.commands) == count, "what is past is not simulated again"


def test_who_takes_the_hand_is_back_in_the_present(tab, served):
    page = served.page()
    tab.set_slider("Back [s]", -1.0)
    wait_for(lambda: not page.timeline.live)
    at = tab.pixel(f"{ROOT}/panda_joint4", (0.0, 0.03, 0.0))
    tab.drag(at, at + np.array([-60.0, -40.0]))
    wait_for(lambda: page.timeline.live, what="the present")
