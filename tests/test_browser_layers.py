"""Each layer of the scene is visible in its place while it is on, and hidden while it is off."""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise
from typing import NamedTuple

import numpy as np
import pytest

from app.dashboard.scene.camera import PRESETS, placed
from app.dashboard.scene.canvas import ROOT
from app.dashboard.scene.legend import METRES_PER_NEWTON
from app.simulation.loop.commands import Compare
from app.simulation.trace.snapshot import Snapshot
from tests.browser import DashboardTab, around, wait_for
from tests.dashboards import Served, served_dashboard

pytestmark = pytest.mark.browser

Array = np.ndarray


@pytest.fixture(scope="module")
def served():
    """A paused loop after a pull of the end-effector towards the base, which has moved away."""
    with served_dashboard() as served:
        served.pull_at_base(1.6)
        assert served.loop.latest().beta_m > 0.3
        yield served


@pytest.fixture(scope="module")
def opened(browser, served):
    tab = DashboardTab(browser, served.server.address)
    tab.open_tab("View")
    yield tab
    tab.close()


@pytest.fixture
def tab(opened):
    yield opened
    assert opened.errors == [], "errors in the page's console"


class Layer(NamedTuple):
    """A checkbox of the tab "View" and points of its layer in the scene.

    Attributes:
        box: Its label.
        places: (K, 3) [m] in the frame `node`, from the dashboard.
        radius: [px] distance from the places within which pixels change.
        least: [px] smallest number of changed pixels.
        node: Frame of the places; the empty name is the world.
        share: [-] smallest share of the changed pixels within the radius. Below 0.9 where the
            border also changes its colours, or where a label is longer than the radius.
    """

    box: str
    places: Callable[[Served], Array]
    radius: int
    least: int
    node: str = ""
    share: float = 0.9


def from_snapshot(function: Callable[[Snapshot], object]) -> Callable[[Served], Array]:
    """A function that returns (K, 3) [m] points of the latest snapshot, from `function`."""
    return lambda served: np.array(function(served.loop.latest())).reshape(-1, 3)


def between(a: Array, b: Array) -> list[Array]:
    """Nine points (3,) [m] on the line from a to b, including its ends."""
    return [a + u * (b - a) for u in np.linspace(0.0, 1.0, 9)]


def robot(served: Served) -> Array:
    """(K, 3) [m] points on base and arm, in the robot's frame."""
    base = [(x, y, z) for x in (-0.4, 0.0, 0.4) for y in (-0.25, 0.25) for z in (0.1, 0.3)]
    parts = served.server.shared.parts.kinematics
    snapshot = served.loop.latest()
    arm = [T.translation for T in parts.update(snapshot.q_m, snapshot.wheel_angles)]
    return np.array([*base, *arm])


def border(served: Served, pair: str = "lm-lEE", *, above: bool = False) -> Array:
    """(K, 3) [m] border points in the base's frame; with `above`, only those above its top."""
    borders = served.server.shared.borders
    config = served.loop.latest().config.border
    points = borders.coloured(pair, "score", config, whole=above).points
    return points[points[:, 2] > borders.top][::7] if above else points[::7]


def contour(served: Served) -> Array:
    """(K, 3) [m] points of the slice of the nearest pair's border, in the base's frame."""
    snapshot = served.loop.latest()
    nearest = min((pair for pair in snapshot.pairs if pair.mobile), key=lambda pair: pair.d)
    borders = served.server.shared.borders
    curves = borders.surface(snapshot.config.border).curves(float(nearest.p_b[2]))
    return np.concatenate(curves)[::5]


def closest_lines(snapshot: Snapshot) -> list[Array]:
    """Points (3,) [m] in the world on the lines between closest points."""
    return [p for pair in snapshot.pairs for p in between(pair.p_a, pair.p_b)]


def acting_points(snapshot: Snapshot) -> list[Array]:
    """Points (3,) [m] in the world: the acting points, and points on the arrows above them."""
    places = []
    for a in snapshot.acting:
        stem, top = np.array([0.0, 0.0, 0.4]), np.array([*a.p_act[:2], 0.46])
        places += [a.p_n, a.p_t, *between(a.p_act, a.p_act + stem)]
        places += between(top, top - METRES_PER_NEWTON * a.f)
    return places


def person_force(snapshot: Snapshot) -> list[Array]:
    """Points (3,) [m] in the world on the person's force, and around the arrows above the base."""
    tip = snapshot.p_ee + METRES_PER_NEWTON * snapshot.hand_force
    base = np.append(snapshot.base_pose[:2], 0.45)
    around_base = [base + 0.22 * np.array([np.cos(a), np.sin(a), 0.0]) for a in np.arange(0, 6, 1)]
    return [*between(snapshot.p_ee, tip), base, *around_base]


def trails(served: Served) -> Array:
    """(K, 3) [m] points in the world on the trails of base and end-effector."""
    tracks = served.server.shared.tracks
    ways = [track.until(np.inf) for track in tracks.values()]
    return np.array([p for way in ways for a, b in pairwise(way) for p in between(a, b)])


LAYERS = (
    Layer("Robot", robot, 110, 9_000, ROOT),
    Layer("Convex bodies", robot, 110, 5000, ROOT),
    Layer("Include the top", lambda served: border(served, above=True), 15, 3000, ROOT, 0.7),
    Layer("Slice at the arm", contour, 20, 150, ROOT),
    Layer("Closest points", from_snapshot(closest_lines), 110, 60),
    Layer("Acting points", from_snapshot(acting_points), 60, 200, share=0.7),
    Layer("Forces", from_snapshot(person_force), 60, 100),
    Layer("Trails", trails, 12, 40),
)


@pytest.fixture(scope="module")
def at_first(opened):
    """The picture at the start and at the end of each layer's test."""
    opened.rest()
    return opened.picture_at_rest()


@pytest.mark.parametrize("layer", LAYERS, ids=lambda layer: layer.box)
def test_a_layer_is_visible_in_its_place_and_only_while_it_is_on(tab, served, layer, at_first):
    is_on = tab.row(layer.box).locator("input[type=checkbox]").is_checked()
    before, places = at_first, tab.pixels(layer.node, layer.places(served))
    tab.check(layer.box, on=not is_on)
    after = tab.wait_for_change(before, layer.least, places, layer.radius)
    changed = tab.changed(before, after)
    there = (changed & around(places, layer.radius, before)).sum() / changed.sum()
    assert there > layer.share, f"only {there:.0%} of the change is in the layer's place"
    tab.check(layer.box, on=is_on)
    tab.wait_for_picture(before, most=layer.least // 4)


TITLES = {
    "determinant": "Mobility of the base",
    "reachability": "Reachability by the arm",
    "score": "Score S, equation (10)",
}


@pytest.mark.parametrize(("pair", "quantities"), [("lm-lEE", list(TITLES)), ("lm-l3", ["score"])])
def test_a_border_can_be_hidden_or_coloured_by_each_quantity(tab, served, pair, quantities):
    first = served.page().view.borders[pair]
    said = served.server.shared.spoken
    tab.choose(said[pair], "hidden")
    wait_for(lambda: served.page().view.borders[pair] == "hidden")
    other = "lm-l3" if pair == "lm-lEE" else "lm-lEE"
    tab.choose(said[other], "hidden")
    wait_for(lambda: not tab.is_shown(f"{ROOT}/border_lm-lEE"))
    picture = tab.picture()
    places = tab.pixels(ROOT, border(served, pair))
    for quantity in (*quantities, "hidden"):
        tab.choose(said[pair], quantity)
        picture = tab.wait_for_change(picture, 1500, places, radius=10)
        title = TITLES.get(quantity, "No border is shown")
        tab.page.get_by_text(title).filter(visible=True).first.wait_for(timeout=40_000)
    for name, quantity in ((pair, first), (other, "score" if other == "lm-lEE" else "hidden")):
        tab.choose(said[name], quantity)


def test_distance_labels_are_shown_at_no_pair_all_pairs_or_active_pairs(tab, served):
    snapshot = served.loop.latest()
    near = {pair.name for pair in snapshot.pairs if pair.d < snapshot.config.border.d_b}
    everything = {pair.name for pair in snapshot.pairs}
    assert near
    assert near < everything
    for choice, wanted in (("none", set()), ("all", everything), ("active", near)):
        before = tab.picture()
        tab.choose("Labels", choice)

        def written() -> set[str]:
            return {name for name in everything if tab.is_shown(f"/distances/label_{name}")}

        wait_for(lambda wanted=wanted: written() == wanted, what=choice)
        for pair in snapshot.pairs:
            if pair.name in wanted:
                text = f"{served.server.shared.spoken[pair.name]} {1000 * pair.d:.0f} mm"
                wait_for(lambda n=pair.name, t=text: tab.text(f"/distances/label_{n}") == t)
        tab.wait_for_change(before, 60)


def test_the_checkbox_switches_the_theme_between_dark_and_light(tab):
    dark = tab.picture()
    tab.check("Dark theme", on=False)
    light = tab.wait_for_change(dark, 100_000)
    assert light.mean() > dark.mean() + 100
    tab.check("Dark theme", on=True)
    tab.wait_for_picture(dark, most=3000)


def preset_view(served: Served, name: str) -> tuple[np.ndarray, np.ndarray]:
    """Eye and target of a preset in the viewer's window."""
    window = served.page().camera.window
    return placed(PRESETS[name], [served.loop.latest()], served.server.shared.parts.extent, window)


@pytest.mark.parametrize("name", [name for name in PRESETS if name != "door"])
def test_a_preset_places_the_camera_and_centres_its_target(tab, served, name):
    tab.click(name)
    eye, target = preset_view(served, name)
    wait_for(lambda: np.linalg.norm(tab.camera() - eye) < 5e-3, what=f"{eye}, not {tab.camera()}")
    tab.render(2)
    left, top, right, bottom = tab.canvas_box()
    middle = (left + right) / 2, (top + bottom) / 2
    np.testing.assert_allclose(tab.pixel("", tuple(target)), middle, atol=2.0)


def test_the_camera_follows_the_base_only_if_enabled_and_without_ghosts(tab, served):
    tab.click("iso")
    start = served.loop.latest().base_pose.copy()
    eye, _ = preset_view(served, "iso")
    wait_for(lambda: np.linalg.norm(tab.camera() - eye) < 5e-3)
    step = np.array([0.4, -0.3, 0.0])
    served.loop.place(start + step)
    wait_for(lambda: np.linalg.norm(tab.camera() - eye - step) < 5e-3, what="the camera follows")
    tab.check("Follow the base", on=False)
    wait_for(lambda: not served.page().view.follow)
    served.loop.place(start)
    wait_for(lambda: np.linalg.norm(tab.position(ROOT)[:2] - start[:2]) < 1e-3)
    tab.render(3)
    np.testing.assert_allclose(tab.camera(), eye + step, atol=5e-3)
    tab.check("Follow the base", on=True)
    served.loop.send(Compare(("none",)))
    wait_for(lambda: served.loop.latest().ghosts)
    tab.render(3)
    stands = tab.camera()
    served.loop.place(start + 0.2 * step)
    wait_for(lambda: np.linalg.norm(tab.position(ROOT)[:2] - (start + 0.2 * step)[:2]) < 1e-3)
    tab.render(3)
    np.testing.assert_allclose(tab.camera(), stands, atol=5e-3)
    served.loop.send(Compare())
    served.loop.place(start)
    wait_for(lambda: not served.loop.latest().ghosts)
