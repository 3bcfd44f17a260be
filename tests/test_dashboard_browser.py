"""The page in a real browser with a loop without physics: first view, pulls and widgets."""

from __future__ import annotations

import numpy as np
import pytest

from app.dashboard.drag import GIZMO, SCALE
from app.dashboard.page import PRODUCT
from app.dashboard.panels.help import CARDS
from app.dashboard.panels.plots import SIGHT
from app.dashboard.panels.run import FREE, TITLES
from app.simulation.loop.commands import (
    Choose,
    Compare,
    Configure,
    Pause,
    Play,
    Pull,
    Release,
    Reset,
    Restart,
    Speed,
)
from app.simulation.scenarios import SCENARIOS
from tests.browser import DashboardTab, around, wait_for
from tests.dashboards import served_dashboard
from tests.robots import needs_pybullet

pytestmark = pytest.mark.browser

LINK = "/robot/panda_joint4"
"""Scene node of a link in the middle of the arm."""


@pytest.fixture(scope="module")
def served_once():
    with served_dashboard() as served:
        yield served


@pytest.fixture
def served(served_once):
    served_once.begin_anew()
    return served_once


@pytest.fixture(scope="module")
def opened(browser, served_once):
    tab = DashboardTab(browser, served_once.server.address)
    yield tab
    tab.close()


@pytest.fixture
def tab(opened, served):
    opened.page.mouse.move(640, 8)
    yield opened
    assert opened.errors == [], "the page's console"


def test_first_picture_shows_robot_border_panels_and_plots(tab, served):
    assert tab.page.title() == f"{PRODUCT} · {served.server.shared.model.description.title}"
    texts = (
        "out of the way of its arm",
        "end-effector – base",
        "score S, equation (10)",
        "Nearest",
        "Pause",
    )
    for text in texts:
        tab.page.get_by_text(text).filter(visible=True).first.wait_for(timeout=10_000)
    assert tab.page.get_by_text("no explanation for this instant").first.is_visible()
    first = tab.picture()
    page = served.page()
    page.view.meshes = False
    without_robot = tab.wait_for_change(first, 10_000)
    page.view.borders["lm-lEE"] = "hidden"
    tab.wait_for_change(without_robot, 3000)
    page.view.meshes, page.view.borders["lm-lEE"] = True, "score"

    tab.open_tab("Plots")
    assert tab.page.locator(".uplot canvas").count() == 3
    for title in (
        "distance [m]",
        "activation of the avoidance β_m",
        "avoidance acceleration of the base, β_m ẍ_m",
    ):
        wait_for(lambda title=title: tab.plot(title).shape[1] > 5, what=title)
    for pair, line in zip(served.loop.latest().pairs, tab.plot("distance [m]")[1:], strict=False):
        np.testing.assert_allclose(line, pair.d, atol=1e-5, err_msg=pair.name)
    tab.open_tab("Key")
    assert tab.page.get_by_text("closest points of a pair outside its buffer").is_visible()
    tab.open_tab("Why")


def test_plot_data_are_sent_only_while_the_plots_are_visible(tab, served):
    channel = served.page().channel
    wait_for(lambda: SIGHT not in channel.seen, what="the plots are hidden")
    tab.open_tab("Plots")
    wait_for(lambda: SIGHT in channel.seen, what="the plots are visible")
    wait_for(lambda: len(tab.plot("distance [m]")[0]) > 5, what="a curve")
    line = tab.page.locator(".u-legend .u-series", has_text="end-effector – base").first
    line.hover()
    wait_for(lambda: (line.get_attribute("title") or "").startswith("lm-lEE: signed distance"))
    tab.open_tab("Why")
    wait_for(lambda: SIGHT not in channel.seen, what="the plots are hidden")


def test_initial_camera_shows_the_whole_robot(tab, served):
    left, top, right, bottom = tab.canvas_box()
    base = [(x, y, z) for x in (-0.48, 0.48) for y in (-0.33, 0.33) for z in (0.0, 0.38)]
    snapshot, kinematics = served.loop.latest(), served.server.shared.parts.kinematics
    joints = [T.translation for T in kinematics.update(snapshot.q_m, snapshot.wheel_angles)]
    pixels = tab.pixels("/robot", np.array([*base, *joints]))
    assert (pixels > [left, top]).all()
    assert (pixels < [right, bottom]).all()
    assert np.ptp(pixels[:, 1]) > 0.4 * (bottom - top)


def test_slider_of_d_b_shows_the_new_border(tab, served):
    before = tab.picture()
    tab.open_tab("Tune")
    tab.set_slider("Buffer distance d_b [m]", 0.25)
    wait_for(lambda: any(isinstance(c, Configure) for c in served.loop.commands))
    assert served.loop.commands[-1].config.border.d_b == 0.25
    tab.page.get_by_text("= 0.250 m").first.wait_for(timeout=40_000)
    tab.wait_for_change(before, 5000)
    tab.set_slider("Buffer distance d_b [m]", 0.15)
    tab.page.get_by_text("= 0.150 m").first.wait_for(timeout=40_000)
    tab.open_tab("Run")


def test_dragging_the_gizmo_pulls_the_end_effector_and_a_drop_releases_it(tab, served):
    loop = served.loop
    wait_for(lambda: np.linalg.norm(tab.position(GIZMO) - loop.latest().p_ee) < 1e-3)
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


@pytest.mark.parametrize("cause", ["selected text", "the system"])
def test_a_drag_that_the_browser_cancels_ends(tab, served, cause):
    loop, page = served.loop, served.page()
    wait_for(lambda: np.linalg.norm(tab.position(GIZMO) - loop.latest().p_ee) < 1e-3)
    if cause == "selected text":
        tab.page.keyboard.press("Control+a")  # also selects the canvas
        tab.drag_gizmo(GIZMO, axis=1, metres=0.1, scale=SCALE)
    else:
        [at] = tab.pixels(GIZMO, tab.arrow(GIZMO, 1, SCALE)[None]).tolist()
        for kind, up in (("touchStart", 0.0), ("touchMove", 10.0), ("touchMove", 30.0)):
            tab.fingers(kind, [{"x": at[0], "y": at[1] - up}])
        wait_for(lambda: page.grip.holds_end_effector, what="the pull")
        tab.fingers("touchCancel", [])
    tab.page.mouse.move(
        *(np.add(tab.canvas_box()[:2], 20.0)).tolist()
    )  # a stuck gizmo would follow
    wait_for(loop.pulls, what="a pull")
    wait_for(lambda: loop.pulls()[-1] is None and not page.grip.holds_anything, what="the release")
    wait_for(lambda: np.linalg.norm(tab.position(GIZMO) - loop.latest().p_ee) < 1e-3)
    tab.page.evaluate("() => getSelection().removeAllRanges()")


@needs_pybullet
def test_link_dragged_by_the_mouse_is_pulled_and_shows_the_force(tab, served):
    loop = served.loop
    wait_for(lambda: np.linalg.norm(tab.position(GIZMO) - loop.latest().p_ee) < 1e-3)
    before = tab.picture_at_rest()
    start = tab.pixel(LINK, (0.0, 0.03, 0.0))
    tab.drag(start, start + np.array([-90.0, -60.0]), drop=False)
    wait_for(lambda: len(loop.pulls()) > 1, what="a pull")
    pulls = [command for command in loop.commands if isinstance(command, Pull)]
    assert {pull.link for pull in pulls} <= {f"panda_joint{i}" for i in range(3, 6)}
    assert len({(pull.link, pull.point, pull.who) for pull in pulls}) == 1, "one point of one link"
    wait_for(lambda: tab.is_shown("/pull/0"), what="the rubber band")
    [pull] = loop.latest().pulls
    newtons = f"pull {np.linalg.norm(pull.force):.0f} N"
    wait_for(lambda: tab.text("/pull/label_0") == newtons, what=newtons)
    along = [tab.pixel("", tuple(pull.point + u * (pull.target - pull.point))) for u in (0.3, 0.6)]
    tab.wait_for_change(before, 40, np.array(along), radius=12)

    tab.page.wait_for_timeout(1600)  # [ms] longer than a sleeping browser may hold a pull
    assert not any(isinstance(command, Release) for command in loop.commands), (
        "the mouse button is still pressed"
    )
    tab.page.mouse.up()
    wait_for(lambda: isinstance(loop.commands[-1], Release), what="the release")
    wait_for(lambda: not tab.is_shown("/pull/0") and not tab.is_shown("/pull/label_0"))
    tab.wait_for_picture(before, most=200)


def test_buttons_pause_continue_and_restart(tab, served):
    tab.click("Pause")
    tab.page.get_by_role("button", name="Continue", exact=True).first.wait_for(timeout=40_000)
    tab.click("Continue")
    wait_for(lambda: Pause(False) in served.loop.commands)
    tab.click("Restart")
    wait_for(lambda: Restart() in served.loop.commands)
    assert served.loop.commands == [Pause(True), Pause(False), Restart()]


def test_choices_of_scenario_speed_and_controller_reach_the_loop_once(tab, served):
    tab.choose("Scenario", TITLES["guiding-front"])
    wait_for(lambda: served.loop.latest().scenario == "guiding-front")
    tab.open_tab("Lab")
    tab.set_slider("Speed", 2.5)
    wait_for(lambda: served.loop.latest().speed == 2.5)
    tab.open_tab("Run")
    tab.choose("Controller", "none: without avoidance")
    wait_for(lambda: served.loop.latest().controller == "none")
    wanted = [Play(SCENARIOS["guiding-front"]), Speed(2.5), Choose("none")]
    assert served.loop.commands == wanted, "each command once"
    tab.choose("Controller", "dbb: with avoidance")
    wait_for(lambda: served.loop.latest().controller == "dbb")


def test_keyboard_shortcuts_work_and_are_listed_in_the_help(tab, served):
    tab.page.mouse.click(640, 120)  # the scene, so that no widget takes the key
    for key, command, paused in (
        ("Space", Pause(True), True),
        ("Space", Pause(False), False),
        ("r", Restart(), False),
    ):
        count = len(served.loop.commands)
        tab.page.keyboard.press(key)
        wait_for(lambda count=count: len(served.loop.commands) > count, what=key)
        assert served.loop.commands[-1] == command
        wait_for(lambda paused=paused: served.loop.latest().paused is paused)
    light = tab.picture()
    tab.page.keyboard.press("l")
    tab.wait_for_change(light, 50_000)
    tab.page.keyboard.press("l")
    tab.open_tab("Help")
    assert tab.page.get_by_text("pause or continue").filter(visible=True).count() == 1
    tab.open_tab("Run")


def test_folders_and_buttons_work_by_keyboard_alone(tab, served):
    keys = tab.page.keyboard

    def reach(text):
        for _ in range(80):
            keys.press("Tab")
            if tab.page.evaluate("() => document.activeElement.innerText") == text:
                return
        pytest.fail(f"{text} is not reached")

    tab.open_tab("Why")
    inside = tab.page.get_by_text("There are no details for this instant.")
    reach("Details")
    keys.press("Enter")
    inside.wait_for()
    keys.press("Space")
    inside.wait_for(state="hidden")
    reach("Restart")
    keys.press("Space")
    wait_for(lambda: served.loop.commands, what="a command")
    reach("Pause")
    for paused in (True, False):  # the focus stays on the button
        keys.press("Space")
        wait_for(lambda paused=paused: served.loop.commands[-1] == Pause(paused))
        status = tab.page.locator("#dbb-row").get_by_text("now, paused")
        status.wait_for(state="visible" if paused else "hidden")
    assert served.loop.commands == [Restart(), Pause(True), Pause(False)]


def test_second_robot_appears_in_the_scene_and_in_the_table(tab, served):
    tab.open_tab("Compare")
    assert tab.page.get_by_text("No comparison is running.").is_visible()
    tab.choose("Second robot", "repulsive: arm repulsion only")
    wait_for(lambda: served.loop.commands == [Compare(("repulsive",), "path")])
    p_ee = served.loop.latest().p_ee
    assert not tab.is_shown("/ghost_0/fixed"), "links that coincide with the robot's are hidden"
    served.loop.place((-0.35, 0.0, 0.0))  # the ghost stays behind
    wait_for(lambda: tab.is_shown("/ghost_0/fixed"))
    wait_for(
        lambda: (tab.text("/names/1") or "").startswith("violet, arm repulsion only"),
        what="the ghost's name",
    )
    tab.page.get_by_text("no contact, smallest distance").first.wait_for(timeout=40_000)
    heads = tab.page.locator("th").filter(visible=True)
    heads.nth(1).wait_for()
    assert [text.split()[-1] for text in heads.all_inner_texts()] == ["dbb", "repulsive"]
    wait_for(lambda: np.linalg.norm(tab.position("/robot") - [-0.35, 0.0, 0.0]) < 1e-3)
    np.testing.assert_allclose(tab.position("/ghost_0"), 0.0, atol=1e-6)
    wait_for(lambda: in_scene(tab, p_ee), what="the ghost's end-effector beside the panels")
    with_ghost = tab.picture_at_rest()
    tab.choose("Third robot", "none: without avoidance")
    wait_for(lambda: len(served.loop.latest().ghosts) == 2)
    tab.choose("Second robot", "off")
    wait_for(lambda: served.loop.commands[-1] == Compare(("none",), "path"))
    tab.render(3)
    assert (
        tab.row("Third robot").locator("input").first.input_value() == "none: without avoidance"
    ), "the third robot stays"
    served.loop.send(Compare())
    tab.wait_for_change(with_ghost, 500, tab.pixel("", tuple(p_ee))[None], radius=50)
    assert tab.page.get_by_text("No comparison is running.").is_visible()
    tab.open_tab("Why")


def in_scene(tab, place):
    """Whether the 50 px around a place (3,) [m] are in the picture and not covered by a panel."""
    mask = tab.scene_mask()
    near = around(tab.pixel("", tuple(place))[None], 50, mask)
    return near.sum() == 100**2 and mask[near].all()


def test_first_visit_shows_one_card_that_changes_only_on_a_click(browser, served):
    served.begin_anew()
    tab = DashboardTab(browser, served.server.address, (1000, 640), first_visit=True)
    card = tab.page.locator("#dbb-card")

    def wait_for_card(state: str) -> None:
        card.get_by_role("heading", name=CARDS[state].title, exact=True).wait_for(timeout=60_000)

    wait_for_card("welcome")
    assert "dbb" in tab.page.title()
    place = card.bounding_box()
    tab.click("Watch it (8 s)")
    wait_for(
        lambda: any(isinstance(c, Play) for c in served.loop.commands),
        what="the scenario is played",
    )
    assert Compare(("none",)) in served.loop.commands
    wait_for_card("watch")
    served.loop.send(Pull((0.5, 0.0, 0.5), who=7))  # another viewer
    del served.loop.commands[:]
    tab.click("Pull it yourself")
    wait_for_card("pull")
    wait_for(lambda: Compare() in served.loop.commands, what="the ghost is removed")
    tab.click("Take the tour")
    for i in range(1, 5):
        wait_for_card(f"tour {i}")
        if i == 3:
            tab.page.get_by_role("tab", name="Why", selected=True).wait_for()
        tab.click("Next")
    wait_for_card("tour 5")
    tab.page.get_by_role("tab", name="Compare", selected=True).wait_for()
    tab.page.get_by_text("Second robot").wait_for()
    now = card.bounding_box()
    assert now["y"] + now["height"] == pytest.approx(place["y"] + place["height"], abs=2)
    tab.page.keyboard.press("?")
    tab.page.get_by_role("tab", name="Help", selected=True).wait_for()
    tab.click("Close")
    card.wait_for(state="hidden")
    served.begin_anew()
    tab.page.reload()
    tab.wait_for_scene()
    tab.page.wait_for_timeout(1500)
    assert not card.is_visible()
    tab.page.keyboard.press("h")
    wait_for_card("tour 1")
    tab.page.keyboard.press("Escape")
    card.wait_for(state="hidden")
    assert tab.errors == []


def test_free_start_is_in_the_list_and_on_a_button_after_a_scenario(tab, served):
    tab.open_tab("Run")
    served.loop.send(Play(SCENARIOS["guiding-front"]))
    title = TITLES["guiding-front"]
    listed = tab.row("Scenario").locator("input").first
    wait_for(lambda: listed.input_value() == title, what="the scenario in the list")
    served.loop.send(Pull((0.5, 0.0, 0.5), who=7))
    wait_for(lambda: not served.loop.latest().scenario, what="its end")
    tab.render(3)
    assert listed.input_value() == title, "the list still shows the scenario"
    for way in (lambda: tab.choose("Scenario", FREE), lambda: tab.click("Back to the free start")):
        del served.loop.commands[:]
        way()
        wait_for(lambda: any(isinstance(c, Reset) for c in served.loop.commands), what="a reset")


def test_the_camera_stays_above_the_floor(tab, served):
    box = tab.canvas_box()
    middle = np.array([(box[0] + box[2]) / 2, box[1] + 0.2 * (box[3] - box[1])])
    for _ in range(3):
        tab.drag(middle, middle - np.array([0.0, 300.0]), steps=6)
        tab.render(2)
    assert tab.camera()[2] > 0.0
    tab.page.keyboard.press("1")
