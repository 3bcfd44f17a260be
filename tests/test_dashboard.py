"""Laws of the dashboard that need no browser."""

from __future__ import annotations

import asyncio
import re
import socket
import time
from types import SimpleNamespace

import numpy as np
import pinocchio as pin
import pytest
import viser
from viser import _messages

from app.border.dbb import construct_dbb
from app.border.mobile import MobileBody
from app.config import BorderConfig, Config, parameter
from app.dashboard.acting_points import METRES_PER_NEWTON, arrow
from app.dashboard.border_cloud import MAX_POINTS, BorderCloud, subsample
from app.dashboard.colours import FULL, NEAR, REST, distance_colour, viridis
from app.dashboard.hand import Grip
from app.dashboard.legend import legend_html, make_legend, normalised, tick_texts
from app.dashboard.notices import Notices
from app.dashboard.pair_lines import segments
from app.dashboard.panels.run import buffer_text, pairs_html, status_html
from app.dashboard.panels.tuning import BORDER_AND_FORCE, GAINS, MAIN, Tuning, apply, slider_step
from app.dashboard.robot import LinkPoses
from app.dashboard.server import check_address, serve_dashboard
from app.dashboard.view import View
from app.dashboard.visuals import MAX_FACES, load_visuals, read_mesh
from app.dashboard.window import LENGTH, PERIOD, Window
from app.errors import AssetError, ConfigError, ServerError
from app.robot.urdf import resolved_urdf
from app.simulation.snapshot import Configure, PairReading, Pull
from tests.fakes import ScriptedLoop, fake_clouds
from tests.robots import husky_panda, random_state

TUNED = [
    path for tab in (MAIN, BORDER_AND_FORCE, GAINS) for paths in tab.values() for path in paths
]


class Recorder:
    """Takes commands, or notifications, and keeps them."""

    def __init__(self):
        self.commands, self.notes = [], []

    def send(self, command):
        self.commands.append(command)

    def add_notification(self, title, text, **_):
        self.notes.append((title, text))

    def get_clients(self):
        return {1: self}


@pytest.fixture(scope="module")
def clouds():
    return fake_clouds(husky_panda(), spacing=0.02)


@pytest.fixture
def loop():
    loop = ScriptedLoop(husky_panda())
    loop.start()
    yield loop
    loop.stop()


@pytest.fixture
def dashboard(loop, clouds):
    server = serve_dashboard(loop, husky_panda(), clouds, port=0)
    yield server
    server.stop()


def wait_for(condition, seconds=5.0):
    deadline = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < deadline, "did not come true in time"
        time.sleep(0.01)


# Sliders


def test_sliders_have_range_unit_and_help_of_the_configuration(dashboard):
    page = dashboard.page
    sliders = page.main_panel.sliders | page.border_panel.sliders | page.gains_panel.sliders
    assert set(sliders) == set(TUNED)
    for path, slider in sliders.items():
        about = parameter(path)
        assert (slider.min, slider.max) == (about.low, about.high), path
        assert slider.value == about.default, path
        assert slider.hint == (about.help or None), path
        assert about.unit == "-" or about.unit in slider.label, path


def test_every_default_lies_on_a_step_of_its_slider():
    for path in TUNED:
        about = parameter(path)
        step = slider_step(about.low, about.high)
        assert 100 <= (about.high - about.low) / step <= 1000.0001, path
        assert (about.default / step) % 1 == pytest.approx(0, abs=1e-9) or (
            about.default / step
        ) % 1 == pytest.approx(1, abs=1e-9), path


@pytest.mark.parametrize("value", [99999.0, -1.0, float("nan"), float("inf")])
def test_a_value_out_of_range_is_refused_and_the_slider_set_back(value):
    sink = Recorder()
    tuning = Tuning(sink, Config())
    slider = SimpleNamespace(value=value)
    with pytest.raises(ConfigError, match=r"border\.d_b"):
        apply(tuning, "border.d_b", slider)
    assert slider.value == Config().border.d_b
    assert tuning.config == Config()
    assert sink.commands == []


def test_a_value_in_range_is_sent_once_and_changes_nothing_else():
    sink = Recorder()
    tuning = Tuning(sink, Config())
    for _ in range(2):
        apply(tuning, "border.d_b", SimpleNamespace(value=0.2))
    assert sink.commands == [Configure(Config().replace("border.d_b", 0.2))]


def test_defaults_button_restores_every_slider_of_its_tab(dashboard, loop):
    panel = dashboard.page.main_panel
    for path in ("border.d_b", "force.f_max"):
        dashboard.page.tuning.set(path, parameter(path).high)
    panel.reset()
    assert dashboard.page.tuning.config == Config()
    assert loop.commands[-1] == Configure(Config())


# The hand


def event(phase, position=(0.5, 0.0, 0.8), client_id=1, client=None):
    client = client or Recorder()
    target = SimpleNamespace(position=np.array(position))
    return SimpleNamespace(phase=phase, target=target, client_id=client_id, client=client)


def grip():
    sink = Recorder()
    return Grip(sink, Notices(sink)), sink


def test_a_drag_pulls_and_its_end_lets_go():
    hand, sink = grip()
    for phase, x in (("start", 0.5), ("update", 0.4), ("end", 0.4)):
        hand.drag(event(phase, (x, 0.0, 0.8)))
    assert sink.commands == [Pull((0.5, 0.0, 0.8)), Pull((0.4, 0.0, 0.8)), Pull(None)]
    assert hand.holder is None


def test_a_client_that_is_gone_releases_the_hand_once():
    hand, sink = grip()
    hand.drag(event("start"))
    hand.release(2)
    assert hand.holder == 1
    hand.release(1)
    hand.release(1)
    assert sink.commands[1:] == [Pull(None)]


def test_only_who_grabbed_the_hand_first_pulls_it():
    hand, sink = grip()
    other = Recorder()
    hand.drag(event("start"))
    for phase in ("start", "update", "end"):
        hand.drag(event(phase, (9.0, 9.0, 9.0), client_id=2, client=other))
    assert sink.commands == [Pull((0.5, 0.0, 0.8))]
    assert hand.holder == 1
    assert len(other.notes) == 1


def test_targets_below_the_floor_stop_at_it_with_one_notice_a_drag():
    hand, sink = grip()
    client = Recorder()
    for phase in ("start", "update", "update"):
        hand.drag(event(phase, (0.5, 0.0, -0.3), client=client))
    assert {command.target for command in sink.commands} == {(0.5, 0.0, 0.0)}
    assert len(client.notes) == 1
    hand.drag(event("end", client=client))
    hand.drag(event("start", (0.5, 0.0, -0.3), client=client))
    assert len(client.notes) == 2


# Errors reach the user


@pytest.mark.parametrize(
    ("error", "title"), [(ConfigError("too much"), "Not possible"), (KeyError("x"), "Internal")]
)
def test_an_exception_of_a_callback_is_shown_to_who_caused_it(error, title):
    everybody, client = Recorder(), Recorder()

    def fails(_):
        raise error

    asyncio.run(Notices(everybody).guard(fails)(event("start", client=client)))
    [(shown, text)] = client.notes
    assert shown.startswith(title)
    assert str(error) in text
    assert everybody.notes == []


def test_the_end_of_the_simulation_stays_on_the_page(dashboard, loop):
    loop.error = ValueError("a <bad> number")
    banner = dashboard.page._banner
    wait_for(lambda: banner.visible)
    assert "a &lt;bad&gt; number" in banner.content
    assert dashboard.error is None


def test_an_error_of_the_drawing_ends_it_visibly(dashboard, loop):
    loop.latest = lambda: 1 / 0
    wait_for(lambda: dashboard.page._banner.visible)
    assert "ZeroDivisionError" in dashboard.page._banner.content
    assert isinstance(dashboard.error, ZeroDivisionError)


# The server


def test_a_port_in_use_is_one_clear_line(clouds, loop):
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = taken.getsockname()[1]
        with pytest.raises(ServerError, match=f"127.0.0.1:{port}") as caught:
            serve_dashboard(loop, husky_panda(), clouds, port=port)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(("host", "port"), [("192.0.2.1", 0), ("127.0.0.1", 70000), ("-", 0)])
def test_an_address_that_cannot_be_bound_is_refused_at_once(host, port):
    begin = time.monotonic()
    with pytest.raises(ServerError, match="cannot listen"):
        check_address(host, port)
    assert time.monotonic() - begin < 5.0


def test_no_client_can_open_a_public_tunnel(dashboard):
    handlers = dashboard.viser._websock_server._incoming_handlers
    assert _messages.GuiUpdateMessage in handlers
    assert _messages.ShareUrlRequest not in handlers


def test_nothing_is_printed_by_serving(loop, clouds, capfd):
    server = serve_dashboard(loop, husky_panda(), clouds, port=0)
    server.stop()
    assert capfd.readouterr().out == ""
    assert re.fullmatch(r"http://127\.0\.0\.1:\d+", server.address)


# Robot


@pytest.mark.parametrize("seed", range(5))
def test_drawn_links_stand_where_the_controller_has_them(seed):
    state = random_state(np.random.default_rng(seed))
    model = state.model
    poses = LinkPoses(model)
    drawn = poses.update(state.measurement.q_m, np.zeros(2))
    T_world_root = state.data.oMi[1]
    for name in model.description.arm.joints:
        expected = T_world_root.inverse() * state.data.oMi[model.pin.getJointId(name)]
        at = drawn[poses.model.getJointId(name)]
        np.testing.assert_allclose(at.homogeneous, expected.homogeneous, atol=1e-12)


def test_wheels_turn_by_their_own_side_about_the_axle():
    poses = LinkPoses(husky_panda())
    base = husky_panda().description.base
    q_m = np.zeros(husky_panda().n_m)
    at_rest = poses.update(q_m, np.zeros(2))
    turned = poses.update(q_m, np.array([0.7, -0.2]))
    for names, angle in ((base.right_wheel_joints, 0.7), (base.left_wheel_joints, -0.2)):
        for name in names:
            i = poses.model.getJointId(name)
            turn = at_rest[i].inverse() * turned[i]
            expected = pin.utils.rotate("y", angle)
            np.testing.assert_allclose(turn.rotation, expected, atol=1e-12)


def test_decimated_meshes_keep_their_extent():
    model = LinkPoses(husky_panda()).model
    visuals = load_visuals(husky_panda().description, model)
    geometry = pin.buildGeomFromUrdfString(
        model, resolved_urdf(husky_panda().description), pin.GeometryType.VISUAL
    )
    assert len(visuals) == geometry.ngeoms
    for visual, item in zip(visuals, geometry.geometryObjects, strict=True):
        assert len(visual.mesh.faces) <= MAX_FACES + 2
        if item.meshPath.endswith((".stl", ".obj")):
            original = read_mesh(item.meshPath).apply_scale(item.meshScale)
            np.testing.assert_allclose(visual.mesh.bounds, original.bounds, atol=0.003)


def test_an_unreadable_mesh_is_named(tmp_path):
    path = tmp_path / "bad.xyzzy"
    path.write_text("no mesh")
    with pytest.raises(AssetError, match=r"bad\.xyzzy"):
        read_mesh(str(path))


# Border


@pytest.fixture
def border(clouds):
    """In a scene of its own: the dashboard's drawing thread draws borders too."""
    scene = viser.ViserServer(host="127.0.0.1", port=0, verbose=False)
    top = float(MobileBody(husky_panda()).upper[2])
    calls = []

    def border_of(pair, config):
        calls.append(pair)
        return construct_dbb(clouds[pair], config.d_b, config.eps).points

    def values_of(quantity, pair, points):
        return points[:, 0]

    yield BorderCloud(scene, top, border_of, values_of), top, calls
    scene.stop()


def test_the_border_is_selected_anew_only_when_it_has_changed(border):
    cloud, _, calls = border
    view, config = View(pair="lm-lEE"), BorderConfig()
    assert cloud.update(view, config)
    assert not cloud.update(view, config)
    assert cloud.update(view, config.model_copy(update={"d_b": 0.2}))
    view.pair = "lm-l3"
    assert cloud.update(view, config)
    assert calls == ["lm-lEE", "lm-lEE", "lm-l3"]


def test_legend_numbers_are_those_of_the_border(border, clouds):
    cloud, top, _ = border
    view, config = View(pair="lm-lEE"), BorderConfig()
    for whole in (False, True):
        view.whole_border = whole
        cloud.update(view, config)
        points = construct_dbb(clouds["lm-lEE"], config.d_b, config.eps).points
        points = points if whole else points[points[:, 2] <= top]
        assert cloud.legend.low == points[:, 0].min()
        assert cloud.legend.high == points[:, 0].max()
        assert cloud.legend.total == len(points)
        assert cloud.legend.drawn == min(len(points), MAX_POINTS)


def test_a_hidden_border_has_no_legend(border):
    cloud, _, _ = border
    view = View(pair="lm-lEE")
    cloud.update(view, BorderConfig())
    view.quantity = "hidden"
    assert cloud.update(view, BorderConfig())
    assert cloud.legend is None
    assert not cloud._cloud.visible


@pytest.mark.parametrize("scale", [1e-9, 3.7e-4, 0.02, 1.0, 95.0, 4.2e6])
def test_ticks_times_their_power_of_ten_are_the_values(scale):
    low, high = -0.31 * scale, scale
    texts, factor = tick_texts(low, high)
    power = int(re.search(r"<sup>(.*)</sup>", factor)[1].replace("−", "-")) if factor else 0
    shown = [float(text.replace("−", "-")) * 10.0**power for text in texts]
    np.testing.assert_allclose(shown, [low, (low + high) / 2, high], atol=0.006 * scale)


def test_legend_says_how_many_points_are_drawn():
    legend = make_legend("lm-lEE", "score", 0.15, np.linspace(-1, 2, 50_000), 20_000, 0.38)
    html = legend_html(legend)
    assert "20,000 of the 50,000 points" in html
    assert "0.150 m" in html
    np.testing.assert_allclose(normalised(np.array([-1.0, 0.5, 2.0]), legend), [0.0, 0.5, 1.0])


def test_subsample_is_steady_and_without_repetition():
    chosen = subsample(1000, 300)
    assert len(np.unique(chosen)) == 300
    np.testing.assert_array_equal(chosen, subsample(1000, 300))
    np.testing.assert_array_equal(subsample(10, 300), np.arange(10))


# Colours, lines, arrows


def test_colour_map_grows_brighter_from_low_to_high():
    colours = viridis(np.linspace(0, 1, 101)).astype(float)
    lightness = colours @ [0.2126, 0.7152, 0.0722]
    assert (np.diff(lightness) > 0).all()


def test_distances_are_grey_outside_amber_at_the_border_red_at_full_force():
    assert distance_colour(0.151, 0.15, 0.05) == REST
    assert distance_colour(0.15 - 1e-9, 0.15, 0.05) == NEAR
    assert distance_colour(0.05, 0.15, 0.05) == FULL
    assert distance_colour(-0.1, 0.15, 0.05) == FULL


def test_each_pair_has_either_a_thin_or_a_thick_line():
    rng = np.random.default_rng(0)
    pairs = tuple(
        PairReading(f"{i}", True, d, 0.0, rng.random(3), rng.random(3))
        for i, d in enumerate((0.3, 0.15, 0.149, -0.02))
    )
    lengths = [
        np.linalg.norm(np.diff(segments(pairs, 0.15, inside=inside), axis=1), axis=-1).ravel() > 0
        for inside in (False, True)
    ]
    np.testing.assert_array_equal(lengths[0], [True, True, False, False])
    np.testing.assert_array_equal(lengths[1], ~lengths[0])


def test_arrow_has_the_direction_of_the_force_and_its_length_in_scale():
    force = np.array([30.0, -40.0, 0.0])
    start, end = arrow(np.ones(3), force)[0]
    np.testing.assert_allclose(start, np.ones(3))
    np.testing.assert_allclose(end - start, force * METRES_PER_NEWTON)


# Plots and readings


def snapshots(loop, times):
    from dataclasses import replace

    return [replace(loop.latest(), t=t) for t in times]


def test_the_window_of_the_plots_is_bounded_in_memory_and_time(loop):
    window = Window(pairs=5)
    for chunk in np.array_split(np.arange(0, 90, 0.02), 300):
        window.extend(snapshots(loop, chunk), chunk[-1])
    t = window.columns()[0]
    assert len(t) <= LENGTH / PERIOD + 2
    assert t[-1] - t[0] <= LENGTH
    assert t[-1] == pytest.approx(90, abs=2 * PERIOD)
    assert (np.diff(t) >= PERIOD - 1e-3).all()


def test_a_reset_empties_the_plots(loop):
    window = Window(pairs=5)
    window.extend(snapshots(loop, [8.0, 8.1, 8.2]), 8.2)
    window.extend([], 0.02)
    window.extend(snapshots(loop, [0.02, 0.1]), 0.1)
    np.testing.assert_allclose(window.columns()[0], [0.02, 0.1])


def test_plots_are_fed_from_the_loop(dashboard, loop):
    plots = dashboard.page._plots
    wait_for(lambda: len(plots._distances.data[0]) > 5)
    latest = loop.latest()
    lines = np.array(plots._distances.data)
    np.testing.assert_allclose(lines[1:-1, -1], [p.d for p in latest.pairs], atol=1e-5)
    np.testing.assert_allclose(lines[-1], latest.config.border.d_b)


def test_readings_show_every_pair_and_mark_what_should_worry(loop):
    from dataclasses import replace

    snapshot = replace(loop.latest(), solver_failures=3, in_contact=True)
    html = pairs_html(snapshot)
    for pair in snapshot.pairs:
        assert pair.name in html
        assert f"{1000 * pair.d:.0f}" in html
    worried, calm = status_html(snapshot), status_html(loop.latest())
    assert "25.0 %" in status_html(replace(snapshot, t=2.0, overruns=500))
    assert worried.count("rgb(222,49,40)") == calm.count("rgb(222,49,40)") + 2
    assert "arm on base" in worried


def test_a_buffer_that_is_too_small_is_marked_and_says_what_it_takes(loop):
    from dataclasses import replace

    calm = loop.latest()
    assert buffer_text(calm.buffer) == "enough"
    small = calm.buffer._replace(needed=0.2311, needed_max=0.5, too_small=True)
    hopeless = small._replace(needed=float("inf"))
    worried = status_html(replace(calm, buffer=small))
    assert "d_b of 0.24 m needed" in worried
    assert worried.count("rgb(222,49,40)") == status_html(calm).count("rgb(222,49,40)") + 1
    assert "no d_b suffices" in status_html(replace(calm, buffer=hopeless))
