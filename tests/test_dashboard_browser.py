"""The page in a real browser, in front of a loop without physics."""

from __future__ import annotations

import asyncio
import time

import numpy as np
import pytest
from viser import _messages

from app.dashboard.hand import GIZMO, SCALE
from app.dashboard.server import serve_dashboard
from app.simulation.snapshot import Configure, Pause, Reset
from tests.browser import DashboardTab, chromium
from tests.fakes import ScriptedLoop, fake_clouds
from tests.robots import husky_panda

pytestmark = pytest.mark.browser


@pytest.fixture(scope="module")
def browser():
    with chromium() as browser:
        yield browser


@pytest.fixture(scope="module")
def clouds():
    return fake_clouds(husky_panda(), spacing=0.015)


@pytest.fixture
def served(clouds):
    loop = ScriptedLoop(husky_panda())
    loop.start()
    server = serve_dashboard(loop, husky_panda(), clouds, port=0)
    yield server, loop
    server.stop()
    loop.stop()


@pytest.fixture
def tab(browser, served):
    tab = DashboardTab(browser, served[0].address)
    yield tab
    tab.close()
    assert tab.errors == [], "the page's console"
    assert served[0].error is None, "the drawing thread"


def wait_for(condition, seconds=20.0):
    deadline = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < deadline, "did not come true in time"
        time.sleep(0.02)


def changed(tab, before, after):
    """Pixels of the scene that differ."""
    left, top, right, bottom = tab.canvas_box()
    difference = np.abs(before.astype(int) - after.astype(int)).max(axis=-1)
    return int((difference[top:bottom, left:right] > 24).sum())


def wait_for_change(tab, before, least, seconds=20.0):
    """Wait until so many pixels of the scene differ from a picture; gives the new picture."""
    deadline = time.monotonic() + seconds
    while True:
        after = tab.picture()
        if changed(tab, before, after) >= least:
            return after
        assert time.monotonic() < deadline, f"only {changed(tab, before, after)} pixels changed"


def test_first_picture_shows_robot_border_panel_and_plots(tab, served):
    page = tab.page
    for text in (
        "real-time factor",
        "d_b [m]",
        "f_max [N]",
        "hand k [N/m]",
        "solver failures",
        "distance [m]",
        "activation β_m",
        "score S",
    ):
        assert page.get_by_text(text).filter(visible=True).first.is_visible(), text
    assert page.locator(".uplot canvas").count() == 3
    plotted = "() => Object.values(__viserTestpoints.uplots).every(p => p.chart.data[0].length > 5)"
    tab.wait(plotted)
    first = tab.picture()
    tab.open_tab("View")
    tab.check("Robot", on=False)
    without_robot = wait_for_change(tab, first, 20_000)
    tab.open_tab("Border & force")
    tab.choose("Coloured by", "hidden")
    wait_for_change(tab, without_robot, 20_000)


def test_the_robot_is_framed_by_the_scene(tab):
    left, top, right, bottom = tab.canvas_box()
    corners = [(x, y, z) for x in (-0.5, 0.55) for y in (-0.35, 0.35) for z in (0.0, 1.0)]
    pixels = np.array([tab.pixel("/robot", corner) for corner in corners])
    assert (pixels > [left, top]).all()
    assert (pixels < [right, bottom]).all()
    assert np.ptp(pixels[:, 1]) > 0.4 * (bottom - top)


def test_d_b_slider_shows_the_new_border_at_once(tab, served):
    _, loop = served
    tab.open_tab("Run")
    before = tab.picture()
    tab.set_slider("d_b [m]", 0.25)
    wait_for(lambda: any(isinstance(c, Configure) for c in loop.commands))
    assert loop.commands[-1].config.border.d_b == 0.25
    tab.page.get_by_text("= 0.250 m").wait_for(timeout=10_000)
    wait_for_change(tab, before, 10_000)


def test_dragging_the_gizmo_pulls_the_hand_and_letting_go_releases_it(tab, served):
    _, loop = served
    start = loop.latest().p_ee.copy()
    tab.drag_gizmo(GIZMO, axis=1, metres=0.2, scale=SCALE)
    wait_for(lambda: loop.pulls() and loop.pulls()[-1] is None)
    targets = np.array([target for target in loop.pulls() if target is not None])
    moved = targets - start
    assert len(targets) >= 4
    assert (np.diff(moved[:, 1]) >= 0).all()
    assert moved[-1, 1] == pytest.approx(0.2, abs=0.02)
    np.testing.assert_allclose(moved[:, [0, 2]], 0.0, atol=1e-3)
    wait_for(lambda: np.linalg.norm(tab.position(GIZMO) - loop.latest().p_ee) < 1e-3)


def test_closing_the_page_in_mid_drag_releases_the_hand(browser, served):
    _, loop = served
    tab = DashboardTab(browser, served[0].address)
    tab.drag_gizmo(GIZMO, axis=1, metres=0.1, scale=SCALE, steps=4, drop=False)
    wait_for(lambda: len(loop.pulls()) > 1)
    assert loop.pulls()[-1] is not None
    tab.close()
    wait_for(lambda: loop.pulls()[-1] is None)


def test_a_forged_value_is_refused_with_a_notice_and_set_back(tab, served):
    server, loop = served
    slider = server.page.main_panel.knobs["border.d_b"].handles[0]
    tab.open_tab("Run")
    forged = _messages.GuiUpdateMessage(slider._impl.uuid, {"value": 99999.0})
    [client] = server.viser.get_clients()
    future = asyncio.run_coroutine_threadsafe(
        server.viser.gui._handle_gui_updates(client, forged), server.viser.get_event_loop()
    )
    future.result(timeout=5)
    tab.page.get_by_text("Not possible").wait_for(timeout=10_000)
    assert slider.value == 0.15
    assert loop.commands == []


def test_pause_and_reset_reach_the_loop(tab, served):
    _, loop = served
    tab.click("Pause")
    tab.page.get_by_role("button", name="Continue", exact=True).wait_for(timeout=10_000)
    tab.click("Continue")
    wait_for(lambda: Pause(False) in loop.commands)
    tab.click("Reset")
    wait_for(lambda: Reset() in loop.commands)
    assert loop.commands == [Pause(True), Pause(False), Reset()]


def test_the_end_of_the_simulation_is_shown_to_later_viewers_too(browser, served):
    server, loop = served
    loop.error = RuntimeError("the plant is gone")
    wait_for(lambda: server.page._banner.visible)
    tab = DashboardTab(browser, server.address)
    tab.page.get_by_text("the plant is gone").wait_for(timeout=10_000)
    tab.close()


def test_the_camera_follows_the_base_if_asked(tab, served):
    _, loop = served
    server = served[0]
    [client] = server.viser.get_clients().values()
    before = client.camera.position.copy()
    server.page.view.follow = True
    time.sleep(0.2)
    with loop._lock:
        loop._base[:2] = 0.4, -0.3
    wait_for(lambda: np.linalg.norm(client.camera.position - before - [0.4, -0.3, 0.0]) < 5e-3)
