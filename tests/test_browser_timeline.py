"""The timeline: scene, plots and texts show the selected instant, `Back to now` returns."""

from __future__ import annotations

import numpy as np
import pytest

from app.dashboard.drag import GIZMO
from app.dashboard.scene.canvas import ROOT
from app.simulation.loop.commands import Pause, StepOnce
from app.simulation.trace.snapshot import Snapshot
from tests.browser import DashboardTab, wait_for
from tests.dashboards import served_dashboard
from tests.robots import needs_pybullet

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
    """Paused, after 4 s in which a pull makes the base move away."""
    served.pull_at_base(4.0, opened)
    opened.wait("t => Math.abs(dbb.seen().now - t) < 0.01", served.loop.latest().t)
    yield opened
    opened.click("Back to now")
    assert opened.errors == [], "errors on the page's console"


def shows(tab: DashboardTab, snapshot: Snapshot) -> bool:
    """Whether base and end-effector have the poses of the snapshot."""
    x, y, _ = snapshot.base_pose
    return (
        np.linalg.norm(tab.position(ROOT) - [x, y, 0.0]) < 1e-3
        and np.linalg.norm(tab.position(GIZMO) - snapshot.p_ee) < 1e-3
    )


def test_time_line_shows_a_past_state_while_the_simulation_continues(tab, served):
    page, loop = served.page(), served.loop
    tab.look_at(1.5)
    wait_for(lambda: not page.timeline.live, what="looking back")
    then = page.timeline.shown()
    assert served.loop.latest().t - then.t == pytest.approx(2.5, abs=0.06)
    assert then.t in [stored.t for stored in loop.stored()]
    wait_for(lambda: shows(tab, then), what="the past scene")
    now = loop.latest()
    loop.send(Pause(False))
    moved = np.linalg.norm(now.p_ee - then.p_ee) + np.linalg.norm(now.base_pose - then.base_pose)
    assert moved > 0.05, "the robot must have moved"
    wait_for(lambda: loop.latest().t > now.t + 0.5, what="progress of the simulation")
    tab.render(2)
    assert shows(tab, then)
    tab.page.get_by_text(f"t = {then.t:.2f} s").first.wait_for(timeout=40_000)
    tab.page.get_by_text("s ago").first.wait_for(timeout=40_000)


def test_plot_cursors_follow_the_shown_instant_and_vanish_at_now(tab, served):
    page = served.page()
    tab.look_at(3.0)
    wait_for(lambda: not page.timeline.live)
    then = page.timeline.shown().t

    def cursors() -> list[float]:
        plots = [tab.plot(title) for title in sorted(page.view.plots) if "door" not in title]
        return [t for plot in plots for t, c in zip(plot[0], plot[-1], strict=True) if c == 1.0]

    wait_for(lambda: len(cursors()) == 3, what="a cursor in each of the three plots")
    np.testing.assert_allclose(cursors(), then, atol=0.05)
    tab.click("Back to now")
    wait_for(lambda: cursors() == [], what="no cursor")
    wait_for(lambda: shows(tab, served.loop.latest()), what="the newest instant")
    tab.page.get_by_text(f"t = {served.loop.latest().t:.2f} s, now").wait_for(timeout=40_000)
    assert tab.page.locator("#dbb-past").is_hidden()


def test_step_forward_simulates_and_step_back_replays(tab, served):
    loop, page = served.loop, served.page()
    for paused in (False, True):
        tab.click("Pause" if paused else "Continue")
        wait_for(lambda p=paused: loop.commands[-1:] == [Pause(p)])
        wait_for(lambda p=paused: loop.latest().paused is p)
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
    assert len(loop.commands) == count, "a replay must not simulate"
    tab.click("+20 ms")
    wait_for(lambda: page.timeline.shown().t == loop.latest().t)
    tab.click("+20 ms")
    wait_for(lambda: loop.commands[count:] == [StepOnce(DT)])


@needs_pybullet
def test_pull_in_the_scene_returns_to_the_present(tab, served):
    page = served.page()
    tab.look_at(3.0)
    wait_for(lambda: not page.timeline.live)
    at = tab.pixel(f"{ROOT}/panda_joint4", (0.0, 0.03, 0.0))
    tab.drag(at, at + np.array([-60.0, -40.0]))
    wait_for(lambda: page.timeline.live, what="the present")


def test_banner_marks_the_past_and_escape_returns_to_the_present(tab, served):
    page, banner = served.page(), tab.page.locator("#dbb-past")
    assert banner.is_hidden()
    tab.look_at(3.0)
    wait_for(lambda: not page.timeline.live)
    then = page.timeline.shown().t
    tab.page.get_by_text(f"t = {then:.2f} s, ").wait_for(timeout=40_000)
    tab.page.keyboard.press("Escape")
    wait_for(lambda: page.timeline.live, what="the present")
    banner.wait_for(state="hidden", timeout=40_000)


def test_strip_shows_the_history_and_accepts_mouse_touch_and_keys(tab, served):
    page, strip = served.page(), tab.page.locator("#dbb-strip")
    box, size = strip.bounding_box(), tab.page.viewport_size
    assert (box["x"], box["width"]) == (0, size["width"]), "the strip must span the page"
    seen = tab.page.evaluate("() => dbb.seen()")
    pull = [snapshot for snapshot in served.loop.history(-1.0) if snapshot.beta_m > 0.0]
    assert max(beta for _, _, beta, _ in seen["rows"]) == pytest.approx(
        max(s.beta_m for s in pull), abs=2e-3
    )
    assert any(
        kind == "buffer" and "end-effector – base" in text for _, _, kind, text in seen["events"]
    )

    tab.click("Nearest")
    least = min(served.loop.history(-1.0), key=lambda s: min(p.d for p in s.pairs))
    wait_for(lambda: page.timeline.shown().t == pytest.approx(least.t), what="smallest distance")

    x, y = tab.page.evaluate("() => dbb.pixel(1)")
    tab.page.mouse.move(*tab.page.evaluate("() => dbb.pixel(3)"))
    tab.page.mouse.down()
    tab.page.mouse.move(x, y, steps=4)
    tab.page.mouse.up()
    wait_for(lambda: page.timeline.shown().t == pytest.approx(1.0, abs=0.06), what="the drag's end")
    for kind, t in (("touchStart", 2.0), ("touchMove", 2.5), ("touchEnd", None)):
        x = None if t is None else tab.page.evaluate("t => dbb.pixel(t)[0]", t)
        points = [] if x is None else [{"x": x, "y": y}]
        tab.fingers(kind, points)
    wait_for(lambda: page.timeline.shown().t == pytest.approx(2.5, abs=0.06), what="the finger")
    strip.press("ArrowLeft")
    wait_for(lambda: page.timeline.shown().t == pytest.approx(1.5, abs=0.06), what="the key")
    before = tab.page.evaluate("() => dbb.seen().until - dbb.seen().from")
    tab.page.mouse.move(x or 100, y)
    tab.page.mouse.wheel(0, -300)
    tab.wait("span => dbb.seen().until - dbb.seen().from < 0.7 * span", before)


def test_marks_and_event_buttons_of_the_time_line(tab, served):
    page = served.page()
    tab.click("Clear marks")
    tab.click("◂ Event")
    wait_for(lambda: not page.timeline.live)
    events = [event.t for event in served.server.shared.strip.events.values()]
    assert any(page.timeline.shown().t == pytest.approx(t, abs=DT) for t in events)
    tab.click("Mark start")
    wait_for(lambda: page.timeline.begin is not None)
    tab.click("Back to now")
    wait_for(lambda: page.timeline.live)
    tab.click("Mark end")
    wait_for(lambda: page.timeline.end is not None)
    said = f"marked {page.timeline.begin:.2f} to {page.timeline.end:.2f} s"
    tab.page.get_by_text(said).wait_for(timeout=40_000)
    tab.click("Clear marks")
    wait_for(lambda: page.timeline.begin is None)


def test_strip_has_the_colours_of_the_theme_also_during_a_pause(tab):
    drawn = "() => document.querySelector('#dbb-strip').toDataURL()"
    tab.open_tab("View")
    dark = tab.page.evaluate(drawn)
    tab.check("Dark theme", on=False)
    tab.wait(f"dark => ({drawn})() !== dark", dark)
    tab.check("Dark theme", on=True)
    tab.wait(f"dark => ({drawn})() === dark", dark)
    tab.open_tab("Plots")
