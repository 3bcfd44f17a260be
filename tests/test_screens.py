"""Any screen: less detail without a GPU, and touch input on narrow screens."""

from __future__ import annotations

import re
from collections.abc import Callable

import numpy as np
import pytest

from app.dashboard import server
from app.dashboard.drag import GIZMO, SCALE
from app.dashboard.panels.help import CARDS, SHOWN, WATCH
from app.dashboard.scene.borders import LIGHT_POINTS
from app.dashboard.scene.robot import LIGHT_FACES, Visual
from app.simulation.loop.commands import Compare, Play, Pull, Release, Reset
from tests.browser import DashboardTab, wait_for
from tests.dashboards import Served, parts, served_dashboard
from tests.robots import needs_pybullet

pytestmark = pytest.mark.browser

PHONE = (390, 844)  # [px]
TABLET = (820, 1180)


@pytest.fixture(scope="module")
def served():
    with served_dashboard() as served:
        served.pull_at_base(1.2)
        yield served


def drawn(tab: DashboardTab) -> dict[str, int]:
    """Counts of triangles, draw calls and points in a new picture."""
    with tab.drawing():
        tab.render(2)
    return tab.page.evaluate("() => ({ ...window.__viserTestpoints.rendererInfo.render })")


def settled(tab: DashboardTab, holds: Callable[[dict[str, int]], object], what: str) -> dict:
    """Counts of a picture, once they satisfy `holds` and rest; `what` is for the failure's text."""
    seen: list[dict[str, int]] = [{}]

    def rests() -> bool:
        seen.append(drawn(tab))
        tab.page.wait_for_timeout(500)  # [ms] the server sends the meshes one by one
        counts = [{k: each.get(k) for k in ("triangles", "calls", "points")} for each in seen[-2:]]
        return counts[0] == counts[1] and bool(holds(seen[-1]))

    wait_for(rests, what=what)
    return seen[-1]


@needs_pybullet
def test_browser_without_gpu_gets_low_detail_until_it_is_switched_off(browser, served):
    tab = DashboardTab(browser, served.server.address, honest=True)
    assert served.page().view.light
    light = settled(tab, lambda now: now["points"], "the border")
    assert light["points"] <= LIGHT_POINTS
    tab.open_tab("View")
    tab.check("Low detail", on=False)
    fine = settled(tab, lambda now: now["triangles"] > 8 * light["triangles"], "the fine drawing")
    assert fine["calls"] > 1.5 * light["calls"]
    assert not tab.page.get_by_text("Software WebGL rendering").count(), (
        "the notice must appear only once"
    )
    tab.check("Low detail", on=True)
    wait_for(lambda: drawn(tab)["triangles"] < 1.5 * light["triangles"], what="low detail")
    assert tab.errors == []


def test_settings_have_no_field_for_another_server(browser, served):
    tab = DashboardTab(browser, served.server.address)
    tab.page.get_by_label("Display settings").first.click()
    tab.page.get_by_text("Reset View").wait_for(timeout=40_000)
    addresses = tab.page.evaluate(
        """() => [...document.querySelectorAll("input")]
        .filter((each) => each.offsetHeight && each.value.startsWith("ws")).length"""
    )
    assert addresses == 0
    tab.close()


def plots_keep_their_width_within_the_panel(tab: DashboardTab) -> None:
    """Check the open tab "Plots": without a limit, a plot and the drawer widen each other."""
    tab.wait("() => dbbTest.plot('distance [m]')")
    tab.page.wait_for_timeout(800)  # [ms] the panel slides open
    edges = """() => [...document.querySelectorAll(".uplot")].map((plot) => {
        const rect = (element) => element.getBoundingClientRect();
        const panel = rect(plot.closest(".mantine-ScrollArea-viewport")).right;
        const right = Math.max(...[...plot.querySelectorAll("*")].map((each) => rect(each).right));
        return [plot.offsetWidth, right <= panel + 0.5 && panel <= innerWidth];
    })"""
    before = tab.page.evaluate(edges)
    assert before
    assert all(visible for _, visible in before)
    tab.page.wait_for_timeout(1600)  # [ms] the width changed within 1.5 s
    assert tab.page.evaluate(edges) == before


def test_light_meshes_have_few_faces_and_the_same_extent():
    def room(visuals: list[Visual], joint: int) -> np.ndarray:
        """Corners (2, 3) [m] of the box around the objects that a joint moves, in its frame."""
        moved = [
            v.mesh.copy().apply_transform(v.placement.homogeneous).bounds
            for v in visuals
            if v.joint == joint
        ]
        return np.array([np.min(moved, axis=0)[0], np.max(moved, axis=0)[1]])

    fine, light = parts().visuals, parts().light_visuals
    for joint in {visual.joint for visual in fine}:
        np.testing.assert_allclose(room(light, joint), room(fine, joint), atol=0.02)
    assert sum(len(v.mesh.faces) for v in light) < 1.2 * LIGHT_FACES * len(light)


def test_phone_has_touch_pulls_a_header_a_drawer_and_plots(browser, served):
    tab = DashboardTab(browser, served.server.address, PHONE, touch=True)
    strip = tab.page.locator("#dbb-head")
    strip.wait_for(state="visible")
    tab.page.locator("[data-drawer=closed]").wait_for()
    pull_by_finger(tab, served)
    above, drawer = strip.bounding_box(), tab.page.locator("[data-drawer]").bounding_box()
    assert above["y"] == 0.0
    assert above["width"] == PHONE[0]
    bar = tab.page.locator("#dbb-bar").bounding_box()
    assert drawer["y"] + drawer["height"] <= bar["y"] + 1.0
    assert drawer["y"] > 0.75 * PHONE[1]
    tab.page.touchscreen.tap(150, drawer["y"] + 10)
    tab.page.locator("[data-drawer=open]").wait_for()
    opened = tab.page.locator("[data-drawer]").bounding_box()["y"]
    wait_for(lambda: tab.pixel("/robot")[1] < opened, what="the robot above the drawer")
    tab.page.get_by_text("Why · Plots · Compare · Key", exact=True).tap()
    tab.page.get_by_role("tab", name="Plots").tap()
    plots_keep_their_width_within_the_panel(tab)
    tab.page.get_by_role("tab", name="Compare").tap()
    chosen = tab.page.get_by_text("Second robot", exact=True).bounding_box()
    assert opened < chosen["y"] < bar["y"], "the opened tab must be visible"
    assert strip.is_visible()
    line = tab.page.locator("#dbb-bar")
    assert line.get_by_role("button", name=re.compile("Pause|Continue")).is_visible()
    tab.page.evaluate("() => dbbPanels.open('Why')")
    tab.page.get_by_role("tab", name="Why", selected=True).wait_for()
    assert tab.errors == []


@needs_pybullet
def test_touch_on_a_tablet_pulls_end_effector_and_link_and_opens_plots(browser, served):
    tab = DashboardTab(browser, served.server.address, TABLET, touch=True)
    tab.page.locator("[data-drawer=closed]").wait_for()
    pull_by_finger(tab, served)
    del served.loop.commands[:]
    link = tab.pixels("/robot/panda_joint4", np.zeros((1, 3)))[0]
    tab.touch(link, link + np.array([0.0, -40.0]))
    wait_for(lambda: any(isinstance(c, Release) for c in served.loop.commands), what="release")
    pulls = [c for c in served.loop.commands if isinstance(c, Pull)]
    assert pulls[-1].link is not None
    assert pulls[-1].target[2] > pulls[0].target[2]
    tab.page.evaluate("() => dbbPanels.open('Plots')")
    plots_keep_their_width_within_the_panel(tab)
    assert tab.errors == []


def pull_by_finger(tab: DashboardTab, served: Served) -> None:
    """Pull the end-effector forwards."""
    arrow = tab.arrow(GIZMO, 0, SCALE)
    a, b = tab.pixels(GIZMO, np.array([arrow, arrow + np.array([0.1, 0.0, 0.0])]))
    del served.loop.commands[:]
    tab.touch(a, b)
    wait_for(lambda: any(isinstance(c, Release) for c in served.loop.commands), what="release")
    pulls = [c for c in served.loop.commands if isinstance(c, Pull)]
    assert pulls[-1].link is None
    assert pulls[-1].target[0] - pulls[0].target[0] > 0.05


def test_untouched_page_plays_the_demonstration_until_the_first_input(browser, served, monkeypatch):
    monkeypatch.setattr(server, "UNTOUCHED", 0.5)
    served.begin_anew()
    tab = DashboardTab(browser, served.server.address, fresh=True)
    commands = served.loop.commands
    wait_for(lambda: any(isinstance(c, Play) for c in commands), what="the demonstration")
    played = next(c for c in commands if isinstance(c, Play))
    assert played.scenario.name == SHOWN
    assert Compare(("none",)) in commands
    tab.page.get_by_role("heading", name=CARDS["demo"].title).wait_for()
    del commands[:]
    tab.page.mouse.click(640, 40)
    wait_for(
        lambda: any(isinstance(c, Reset) for c in commands), what="the end of the demonstration"
    )
    assert Compare() in commands
    tab.page.locator("#dbb-card").wait_for(state="hidden")
    del commands[:]
    tab.page.wait_for_timeout(1500)
    assert not any(isinstance(c, Play) for c in commands)


def test_click_on_watch_counts_even_if_the_demonstration_starts_before(
    browser, served, monkeypatch
):
    monkeypatch.setattr(server, "UNTOUCHED", 2.0)
    served.begin_anew()
    tab = DashboardTab(browser, served.server.address, (1000, 640), fresh=True, first_visit=True)
    watch = tab.page.get_by_role("button", name=WATCH)
    tab.page.get_by_role("heading", name=CARDS["welcome"].title).wait_for()
    place = watch.bounding_box()
    tab.page.get_by_role("heading", name=CARDS["demo"].title).wait_for()
    assert watch.bounding_box() == pytest.approx(place, abs=2), "the button must not move"
    commands = served.loop.commands
    del commands[:]
    tab.page.mouse.click(place["x"] + place["width"] / 2, place["y"] + place["height"] / 2)
    tab.page.get_by_role("heading", name=CARDS["watch"].title).wait_for()
    wait_for(lambda: any(isinstance(c, Play) for c in commands), what="the scenario")
    tab.page.wait_for_timeout(1500)
    last = next(c for c in reversed(commands) if isinstance(c, Play | Reset))
    assert isinstance(last, Play), "the scenario must go on after the demonstration"
