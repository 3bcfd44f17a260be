"""The dashboard without a browser: connection, pages, scene, tour, plots and readings."""

from __future__ import annotations

import asyncio
import gc
import itertools
import json
import re
import socket
import threading
import time
import urllib.request
import weakref
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pinocchio as pin
import pytest
import trimesh
import viser
from hypothesis import given
from hypothesis import strategies as st

from app.border.dbb import construct_dbb
from app.border.mobile import MobileBody
from app.border.score import ScoreField
from app.config import BorderConfig
from app.dashboard.drag import DragHandles, Grip
from app.dashboard.markup import DEFECT
from app.dashboard.notifications import Notifier
from app.dashboard.page import Page
from app.dashboard.panels import Moment
from app.dashboard.panels.help import CARDS, CLOSE, NEXT, PULL, SHOW, SHOWN, WATCH
from app.dashboard.panels.run import (
    FREE,
    INPUTS,
    METHOD_TITLES,
    TITLES,
    ComparePanel,
    RunPanel,
    machine_rows,
    outcomes_html,
    pairs_html,
    scores_html,
    status_rows,
)
from app.dashboard.panels.why import header_html, sentence, why_html
from app.dashboard.plans import plot_plans
from app.dashboard.record import Course
from app.dashboard.scene.borders import MAX_POINTS, Borders, DrawnBorders, subsample
from app.dashboard.scene.canvas import ANCHORS, CHARACTER, LINE, ROOT, Canvas, set_apart
from app.dashboard.scene.colours import css, viridis
from app.dashboard.scene.layers import draw_distances, draw_motion, segments
from app.dashboard.scene.legend import (
    METRES_PER_NEWTON,
    Legend,
    legend_html,
    tick_texts,
    title_of,
)
from app.dashboard.scene.robot import (
    GREY,
    MAX_FACES,
    LinkPoses,
    RobotParts,
    for_display,
    load_visuals,
)
from app.dashboard.scene.scene import RobotScene
from app.dashboard.server import FRAME, TEXTS_EVERY, check_address, serve_dashboard
from app.dashboard.shared import SharedState
from app.dashboard.verdict import COLOURS, judge
from app.dashboard.view import View
from app.errors import ConfigError, LoopError, RobotFileError, ServerError
from app.onboarding.read.links import read_mesh
from app.robot.assets import package_roots, resolve_package_uri, resolved_urdf
from app.robot.state import Measurement, RobotState
from app.simulation.loop.commands import Compare, Pause, Play, Pull, Release, Reset, Restart
from app.simulation.people import PullReading, held_point
from app.simulation.trace.snapshot import GhostReading, PairReading, Refusal, Score
from app.simulation.trace.trace import Trace
from tests.dashboards import parts
from tests.fakes import ScriptedLoop, fake_clouds
from tests.raw_client import RawClient
from tests.robots import husky_panda, random_state


class Recorder:
    """Records commands or notifications."""

    def __init__(self):
        self.commands, self.notes, self.standing, self.client_id = [], [], [], 1

    def send(self, command):
        self.commands.append(command)

    def add_notification(self, title, text, **_):
        self.notes.append((title, text))
        self.standing.append(text)
        return SimpleNamespace(remove=lambda: self.standing.remove(text))

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
    server = serve_dashboard(loop, husky_panda(), clouds, port=0, parts=parts())
    yield server
    server.stop()


def wait_for(condition, seconds=20.0):
    deadline = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < deadline, "condition not met in time"
        time.sleep(0.01)


# The pull


def grip_of(sink, client=None, timeline=None):
    client = client or Recorder()
    client.client_id = 7
    return Grip(
        sink, Notifier(sink), client, timeline or SimpleNamespace(live=True, go_live=lambda: None)
    )


def held(link=None):
    """An active grip, the recorder of its commands, and a client that receives its notices."""
    sink, client = Recorder(), Recorder()
    grip = grip_of(sink, client)
    grip.take(*(link or ()))
    return grip, sink, client


LINK = ("panda_joint3", (0.0, 0.1, 0.2))


@pytest.mark.parametrize("link", [None, LINK])
def test_drag_pulls_and_its_end_releases(link):
    grip, sink, _ = held(link)
    for x in (0.5, 0.4):
        grip.pull(np.array([x, 0.0, 0.8]))
    grip.release()
    assert sink.commands == [
        Pull((0.5, 0.0, 0.8), *(link or ()), who=7),
        Pull((0.4, 0.0, 0.8), *(link or ()), who=7),
        Release(7),
    ]
    assert not grip.holds_anything


def test_released_grip_releases_only_once():
    grip, sink, _ = held()
    grip.pull(np.array([0.5, 0.0, 0.8]))
    grip.release()
    grip.release()
    assert sink.commands[1:] == [Release(7)]


def test_released_grip_does_not_pull():
    grip, sink, _ = held()
    grip.release()
    grip.pull(np.array([9.0, 9.0, 9.0]))
    assert sink.commands == []


def test_remaining_events_of_a_drag_have_no_effect_on_a_pull_by_keys():
    grip, sink, _ = held()
    grip.release()  # the simulation has restarted
    grip.nudge(np.array([1.0, 0.0, 0.0]), ScriptedLoop(husky_panda()).latest())
    grip.pull(np.array([9.0, 9.0, 9.0]))
    [pull] = sink.commands
    assert max(pull.target) < 9.0


def test_drag_of_a_viewer_who_sees_the_past_shows_the_present_and_pulls_nothing():
    timeline = SimpleNamespace(live=False)
    timeline.go_live = lambda: setattr(timeline, "live", True)
    grip = grip_of(sink := Recorder(), client := Recorder(), timeline)
    for _ in range(2):
        assert sink.commands == []
        grip.take()
        grip.pull(np.array([0.5, 0.0, 0.8]))
    assert [type(command) for command in sink.commands] == [Pull]
    assert client.notes == [("Now", "The page showed the past. Pull again.")]


def test_keys_of_a_viewer_who_sees_the_past_pull_the_present_end_effector(loop):
    timeline = SimpleNamespace(live=False)
    timeline.go_live = lambda: setattr(timeline, "live", True)
    grip = grip_of(sink := Recorder(), client := Recorder(), timeline)
    grip.nudge((1.0, 0.0, 0.0), snapshot := loop.latest())
    [pull] = sink.commands
    assert np.linalg.norm(np.subtract(pull.target, snapshot.p_ee)) < 0.1
    assert client.notes == []


def test_refused_pull_is_not_released():
    class FullSink(Recorder):
        def send(self, command):
            if isinstance(command, Pull):
                raise LoopError("busy")
            super().send(command)

    grip = grip_of(sink := FullSink())
    grip.take()
    with pytest.raises(LoopError):
        grip.pull(np.array([0.5, 0.0, 0.8]))
    grip.release()
    assert sink.commands == []
    assert not grip.holds_anything


def test_no_pull_follows_a_release_by_another_thread():
    class SlowSink(Recorder):
        def send(self, command):
            if isinstance(command, Pull):
                releasing.start()
                releasing.join(0.2)  # without a lock, the release comes first
            super().send(command)

    grip = grip_of(sink := SlowSink())
    releasing = threading.Thread(target=grip.release)
    grip.take()
    grip.pull(np.array([0.5, 0.0, 0.8]))
    releasing.join()
    assert [type(command) for command in sink.commands] == [Pull, Release]


def test_taking_another_point_releases_the_first():
    grip, sink, _ = held()
    for _ in range(2):
        grip.pull(np.array([0.5, 0.0, 0.8]))
        grip.take(*LINK)
    first, second = Pull((0.5, 0.0, 0.8), who=7), Pull((0.5, 0.0, 0.8), *LINK, who=7)
    assert sink.commands == [first, Release(7), second, Release(7)]
    assert not grip.holds_end_effector


@pytest.mark.parametrize("link", [None, LINK])
def test_keys_do_not_change_a_drag(link, loop):
    grip, sink, _ = held(link)
    grip.pull(np.array([0.95, 0.1, 0.5]))
    grip.nudge(np.array([1.0, 0.0, 0.0]), loop.latest())
    assert len(sink.commands) == 1
    grip.release_keys()
    assert grip.holds_anything


def test_gizmo_returns_only_after_the_end_of_a_drag_that_a_restart_has_released(loop):
    """During the drag, the browser ignores a new position."""
    grip, _, client = held()
    gizmo = SimpleNamespace(on_update=lambda _: None, position=np.zeros(3))
    scene = SimpleNamespace(add_transform_controls=lambda *_, **__: gizmo)
    handles = DragHandles(scene, SimpleNamespace(links=None), grip, {})
    event = SimpleNamespace(phase="start", target=gizmo, client=client)
    handles._drag_gizmo(event)
    grip.release()
    handles.update(loop.latest())
    assert not gizmo.position.any()
    for event.phase in ("end", "update"):  # which can come in this order
        handles._drag_gizmo(event)
    handles.update(loop.latest())
    np.testing.assert_array_equal(gizmo.position, loop.latest().p_ee)


def test_keys_pull_again_after_their_release(loop):
    grip, sink, _ = held()
    grip.release()
    for _ in range(2):
        grip.nudge(np.array([1.0, 0.0, 0.0]), loop.latest())
        grip.release_keys()
    assert [type(command) for command in sink.commands] == 2 * [Pull, Release]


def test_targets_below_the_floor_stop_at_it_with_one_notice_per_drag():
    grip, sink, client = held()
    for _ in range(3):
        grip.pull(np.array([0.5, 0.0, -0.3]))
    assert {command.target for command in sink.commands} == {(0.5, 0.0, 0.0)}
    assert len(client.notes) == 1
    grip.take()
    grip.pull(np.array([0.5, 0.0, -0.3]))
    assert len(client.notes) == 2


# Error messages for the user


@pytest.mark.parametrize(
    ("error", "title", "message"),
    [(ConfigError("too much"), "Not possible", "Too much"), (IndexError("x"), "Internal", DEFECT)],
)
def test_callback_error_is_shown_only_to_the_client_that_caused_it(error, title, message):
    everybody, client = Recorder(), Recorder()

    def fails(_):
        raise error

    asyncio.run(Notifier(everybody).guard(fails)(SimpleNamespace(client=client)))
    [(shown, text)] = client.notes
    assert shown.startswith(title)
    assert text == message
    assert everybody.notes == []


def test_repeated_notices_are_merged_and_counted():
    client = Recorder()
    notifier = Notifier(Recorder())
    for text in ("too much", "too much", "too little"):
        notifier.warn(client, text)
    assert [text for _, text in client.notes] == ["Too much", "Too much (2 times)", "Too little"]
    assert client.standing == ["Too little"]


def test_a_message_after_the_end_of_an_equal_one_is_not_counted(monkeypatch):
    client, notifier = Recorder(), Notifier(Recorder())
    for seconds in (0.0, 60.0):
        monkeypatch.setattr("app.dashboard.notifications.monotonic", lambda s=seconds: s)
        notifier.warn(client, "too much")
    assert [text for _, text in client.notes] == ["Too much", "Too much"]


def test_notifier_keeps_no_reference_to_a_disconnected_client():
    """A stored handle of its message would keep the whole page alive."""
    notifier, gone = Notifier(Recorder()), Recorder()
    gone.client_id, kept = 7, weakref.ref(gone)
    gone.standing.append(gone)  # page and parts refer to each other too
    notifier.warn(gone, "too much")
    del gone
    notifier.warn(Recorder(), "too little")
    gc.collect()
    assert kept() is None


def test_long_message_is_truncated():
    client = Recorder()
    Notifier(Recorder()).warn(client, "a" * 10**6)
    [(_, text)] = client.notes
    assert len(text) < 10_000


def page_of(dashboard):
    """The page of the only client."""
    wait_for(lambda: len(dashboard.pages) == 1, 20.0)
    [page] = dashboard.pages.values()
    return page


@pytest.mark.slow
def test_simulation_failure_stays_visible_on_the_page(dashboard, loop):
    with RawClient(dashboard.address):
        banner = page_of(dashboard)._banner
        loop.error = ValueError("a <bad> number")
        wait_for(lambda: banner.visible)
        assert DEFECT in banner.content
        assert "ValueError" not in banner.content
        assert dashboard.error is None


@pytest.mark.slow
def test_drawing_error_stops_the_drawing_visibly(dashboard, loop):
    with RawClient(dashboard.address):
        banner = page_of(dashboard)._banner
        loop.latest = lambda: 1 / 0
        wait_for(lambda: banner.visible and dashboard.error is not None)
        assert DEFECT in banner.content
        assert isinstance(dashboard.error, ZeroDivisionError)


def test_cancelling_a_slow_job_is_acknowledged(dashboard):
    held, job = threading.Event(), dashboard.shared.robot_switch
    with RawClient(dashboard.address):
        told = page_of(dashboard).change.text
        job.start("map", "begins", held.wait)
        wait_for(lambda: "<b>map</b>: begins" in told.content)
        job.cancel()
        wait_for(lambda: "<b>map</b>: cancelling" in told.content)
        held.set()
        wait_for(lambda: not told.visible)


@pytest.mark.slow
def test_each_client_has_its_own_page_until_it_disconnects(dashboard):
    with RawClient(dashboard.address):
        first = page_of(dashboard)
        with RawClient(dashboard.address):
            wait_for(lambda: len(dashboard.pages) == 2, 20.0)
            first.view.borders["lm-lEE"] = "hidden"
            second = next(page for page in dashboard.pages.values() if page is not first)
            assert second.view.borders["lm-lEE"] == "score"
            second.timeline.step(-0.1)
            assert first.timeline.live
        wait_for(lambda: list(dashboard.pages.values()) == [first])
    wait_for(lambda: dashboard.pages == {})
    assert dashboard.error is None


@pytest.mark.slow
def test_reset_releases_every_grip(dashboard, loop):
    with RawClient(dashboard.address):
        grip = page_of(dashboard).grip
        grip.take()
        grip.pull(loop.latest().p_ee + np.array([0.1, 0.0, 0.0]))
        drawn = dashboard.pictures
        wait_for(lambda: dashboard.pictures > drawn + 1, 20.0)
        assert loop.latest().pulls
        loop.send(Pause(True))
        loop.send(Reset())
        wait_for(lambda: not grip.holds_anything)
    assert dashboard.error is None


def test_drawing_resumes_at_once_after_a_suspension(dashboard, monkeypatch):
    """As after SIGSTOP and SIGCONT: the suspended time does not count as time of drawing."""
    held_up = 2.0  # [s]
    with RawClient(dashboard.address):
        page = page_of(dashboard)
        draw, held = page.draw, threading.Event()

        def draw_late(**how):
            draw(**how)
            if not held.is_set():
                time.sleep(held_up)
                held.set()

        monkeypatch.setattr(page, "draw", draw_late)
        assert held.wait(20.0)
        before = dashboard.pictures
        wait_for(lambda: dashboard.pictures > before + 3, held_up / 2)


@pytest.mark.slow
def test_invalid_message_closes_only_the_connection_of_its_sender(dashboard):
    with RawClient(dashboard.address):
        page_of(dashboard)
        for data in (b"garbage", "a text", b"\xc1" * 1000, b"\x81\xa4type\xa7Nothing"):
            with RawClient(dashboard.address) as rude:
                rude.send_raw(data)
                rude._thread.join(timeout=10.0)
                assert not rude._thread.is_alive(), "still connected"
        wait_for(lambda: len(dashboard.pages) == 1)
    assert dashboard.error is None


@pytest.mark.parametrize("step", ["draw", "__init__"])
def test_failing_page_does_not_affect_other_pages(dashboard, step, monkeypatch, caplog):
    def fails(*_, **__):
        raise ZeroDivisionError("a defect of one page")

    with RawClient(dashboard.address):
        first = page_of(dashboard)
        with monkeypatch.context() as patch:
            if step == "draw":
                patch.setattr(first, "draw", fails)
            else:
                patch.setattr(Page, "__init__", fails)
            with RawClient(dashboard.address):
                wait_for(lambda: "a defect of one page" in caplog.text)
                before = dashboard.pictures
                wait_for(lambda: dashboard.pictures > before + 3)
                wait_for(lambda: len(dashboard.pages) == (2 if step == "draw" else 1))
                assert first.closed is (step == "draw")
                assert dashboard.error is None
        wait_for(lambda: len(dashboard.pages) == 1)


# The server


def test_port_in_use_is_one_clear_line(clouds, loop):
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = taken.getsockname()[1]
        with pytest.raises(ServerError, match=f"127.0.0.1:{port}") as caught:
            serve_dashboard(loop, husky_panda(), clouds, port=port)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("host", "port"),
    [("192.0.2.1", 0), ("127.0.0.1", 70000), ("-", 0), ("[::1]", 0), ("a..b", 0), ("a" * 64, 0)],
)
def test_invalid_address_is_rejected_at_once(host, port):
    begin = time.monotonic()
    with pytest.raises(ServerError, match="cannot listen"):
        check_address(host, port)
    assert time.monotonic() - begin < 5.0


def test_a_failed_start_leaves_no_drawing_thread(loop, clouds, monkeypatch):
    monkeypatch.setattr("app.dashboard.server.Watchdog", None)
    with pytest.raises(TypeError):
        serve_dashboard(loop, husky_panda(), clouds, port=0, parts=parts())
    assert "dashboard" not in {thread.name for thread in threading.enumerate()}


def test_serving_prints_nothing(loop, clouds, capfd):
    server = serve_dashboard(loop, husky_panda(), clouds, port=0, parts=parts())
    server.stop()
    assert capfd.readouterr().out == ""
    assert re.fullmatch(r"http://127\.0\.0\.1:\d+", server.address)


def test_server_address_at_ipv6_can_be_opened(loop, clouds):
    try:
        check_address("::1", 0)
    except ServerError:
        pytest.skip("this machine has no IPv6")
    server = serve_dashboard(loop, husky_panda(), clouds, host="::1", port=0, parts=parts())
    try:
        RawClient(server.address).close()
        assert urllib.request.urlopen(server.address, timeout=60).status == 200
    finally:
        server.stop()


# Robot


@pytest.mark.parametrize("seed", range(5))
def test_drawn_link_poses_match_the_controllers_model(seed):
    state = random_state(np.random.default_rng(seed))
    model = state.model
    poses = LinkPoses(model)
    drawn = poses.update(state.measurement.q_m, np.zeros(2))
    T_world_root = state.data.oMi[1]
    for name in model.description.arm.joints:
        expected = T_world_root.inverse() * state.data.oMi[model.pin.getJointId(name)]
        at = drawn[poses.model.getJointId(name)]
        np.testing.assert_allclose(at.homogeneous, expected.homogeneous, atol=1e-12)


def test_wheels_turn_by_the_angle_of_their_side_about_the_axle():
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


@pytest.mark.slow
def test_decimated_meshes_keep_their_extent():
    model = LinkPoses(husky_panda()).model
    visuals = load_visuals(husky_panda().description)
    geometry = pin.buildGeomFromUrdfString(
        model, resolved_urdf(husky_panda().description), pin.GeometryType.VISUAL
    )
    assert len(visuals) == geometry.ngeoms
    items = {item.name: item for item in geometry.geometryObjects}
    for visual in visuals:
        item = items[visual.name]
        assert len(visual.mesh.faces) <= MAX_FACES + 2
        if item.meshPath.endswith((".stl", ".obj")):
            original = read_mesh(Path(item.meshPath)).apply_scale(item.meshScale)
            np.testing.assert_allclose(visual.mesh.bounds, original.bounds, atol=0.003)
            assert visual.mesh.area == pytest.approx(original.area, rel=0.1)  # no corners cut


SEVERAL_VISUALS = """
<robot name="toy">
  <material name="red"><color rgba="1 0 0 1"/></material>
  <link name="a">
    <visual><origin xyz="0.1 0 0" rpy="0 0 1"/><geometry><box size="1 2 3"/></geometry></visual>
    <visual><origin xyz="0 0.2 0"/><geometry><mesh filename="{mesh}" scale="0.5 1 2"/></geometry>
      <material name="red"/></visual>
  </link>
  <link name="b">
    <visual><geometry><mesh filename="{mesh}"/></geometry></visual>
    <visual><origin xyz="0 0 0.3"/><geometry><sphere radius="0.2"/></geometry></visual>
  </link>
  <joint name="ab" type="revolute"><parent link="a"/><child link="b"/><axis xyz="0 0 1"/>
    <limit lower="-1" upper="1" effort="1" velocity="1"/></joint>
</robot>"""


def test_visuals_have_the_poses_colours_and_sizes_of_the_urdf(tmp_path, monkeypatch):
    mesh = tmp_path / "part.stl"
    trimesh.creation.box(extents=(0.1, 0.2, 0.4)).export(mesh)
    urdf = SEVERAL_VISUALS.format(mesh=mesh)
    monkeypatch.setattr("app.dashboard.scene.robot.resolved_urdf", lambda _: urdf)
    model = pin.buildModelFromXML(urdf)
    visuals = load_visuals(husky_panda().description)
    whole = pin.buildGeomFromUrdfString(model, urdf, pin.GeometryType.VISUAL).geometryObjects
    assert [visual.name for visual in visuals] == [item.name for item in whole]
    for visual, item in zip(visuals, whole, strict=True):
        assert visual.joint == item.parentJoint
        assert visual.placement.isApprox(item.placement)
        item.geometry.computeLocalAABB()
        box = np.array([item.geometry.aabb_local.min_, item.geometry.aabb_local.max_])
        np.testing.assert_allclose(visual.mesh.bounds, box, atol=2e-3)
    red, grey = visuals[1].colour, visuals[2].colour
    assert (red, grey) == ((255, 0, 0), GREY)


@pytest.mark.parametrize(
    ("wrong", "words"),
    [('scale="0.5,1,2"', "scale='0.5,1,2'"), ('scale="2"', "3 numbers"), ("", "no filename")],
)
def test_invalid_mesh_element_error_names_its_link(wrong, words, monkeypatch):
    file = 'filename="/a.stl"' if wrong else ""
    urdf = (
        f'<robot name="toy"><link name="lonely"><visual><geometry><mesh {file} {wrong}/>'
        "</geometry></visual></link></robot>"
    )
    monkeypatch.setattr("app.dashboard.scene.robot.resolved_urdf", lambda _: urdf)
    with pytest.raises(RobotFileError, match="lonely") as refusal:
        load_visuals(husky_panda().description)
    assert words in str(refusal.value)


def test_decimation_keeps_the_corners_of_meshes_with_many_parts():
    """The UR5's links are nested shells with caps."""
    if not package_roots("example-robot-data"):
        pytest.skip("the optional robots are not installed")
    for part in ("upperarm", "forearm", "wrist2"):
        uri = f"package://example-robot-data/robots/ur_description/meshes/ur5/visual/{part}.dae"
        whole = read_mesh(resolve_package_uri(uri))
        light = for_display(whole)
        assert len(light.faces) <= 4 * MAX_FACES
        assert light.area == pytest.approx(whole.area, rel=0.05)  # fast decimation: 0.74 to 0.9


EVERYWHERE = (-np.inf, -np.inf, np.inf, np.inf)


@given(
    st.dictionaries(
        st.sampled_from("abcdefghi"),
        st.tuples(st.floats(-60, 60), st.floats(-30, 30), st.text("x ", min_size=3, max_size=30)),
    )
)
def test_labels_do_not_overlap_and_return_to_their_place_when_free(labels):
    spots = set_apart(labels, {}, EVERYWHERE)
    boxes = []
    for name, (u, v, text) in labels.items():
        anchor, rise = spots[name]
        wide = CHARACTER * (len(text) + 1)
        left = u - wide * {"left": 0.0, "center": 0.5, "right": 1.0}[anchor.partition("-")[2]]
        low = v + rise - (LINE if anchor.startswith("top") else 0.0)
        boxes.append((left, low, left + wide, low + LINE))
    for (a, b, c, d), (x, y, z, w) in itertools.combinations(boxes, 2):
        assert a >= z - 1e-6 or x >= c - 1e-6 or b >= w - 1e-6 or y >= d - 1e-6
    if labels:
        assert spots[next(iter(labels))] == (ANCHORS[0], 0.0), (
            "the first label must be at its place"
        )
    assert set_apart(labels, spots, EVERYWHERE) == spots
    for name, label in labels.items():
        alone = set_apart({name: label}, spots, EVERYWHERE)
        assert alone == {name: (ANCHORS[0], 0.0)}, "a single label must be at its place"


@pytest.mark.parametrize(("u", "anchor"), [(0.0, "left"), (95.0, "right")])
@pytest.mark.parametrize(("v", "side"), [(0.0, "bottom"), (45.0, "top")])
def test_label_at_an_edge_is_inside_the_picture(u, anchor, v, side):
    free = (-100.0, -50.0, 100.0, 50.0)
    spots = set_apart({"a": (u, v, "gripper – base")}, {}, free)
    assert spots == {"a": (f"{side}-{anchor}", 0.0)}


def test_door_label_appears_when_the_door_becomes_near(scene, loop, clouds):
    data = SharedState(loop, husky_panda(), clouds, parts())
    door = loop.latest().pairs[0]._replace(name="lm-door", d=0.1)
    shown, canvas = replace(loop.latest(), pairs=(door,)), Canvas(scene)
    with canvas.picture(texts=True):
        draw_distances(canvas, shown, judge(shown), View.first([], []), data.spoken)
    assert canvas._handles["/distances/label_lm-door"].text == "door – base 100 mm"


def test_unreadable_mesh_is_named(tmp_path):
    path = tmp_path / "bad.xyzzy"
    path.write_text("no mesh")
    with pytest.raises(RobotFileError, match=r"bad\.xyzzy"):
        read_mesh(path)


# Border


@pytest.fixture
def scene():
    server = viser.ViserServer(host="127.0.0.1", port=0, verbose=False)
    yield server.scene
    server.stop()


@pytest.fixture(scope="module")
def borders(clouds):
    return Borders(husky_panda(), clouds)


def test_a_ghost_shows_the_links_that_are_apart_from_the_robot(scene, monkeypatch):
    frames, add_frame, model = {}, scene.add_frame, husky_panda()

    def recorded(name, **options):
        frames[name] = add_frame(name, **options)
        return frames[name]

    monkeypatch.setattr(scene, "add_frame", recorded)
    parts, q_m = RobotParts(model), np.array(model.description.arm.ready_position)
    robot, ghost = (RobotScene(scene, parts, ghost, light=True) for ghost in (None, 0))

    def visible(turn, roll):
        still = GhostReading("dbb", np.zeros(3), q_m, np.zeros(2), np.zeros(3), 1.0)
        robot.update(still)
        ghost.update(still._replace(q_m=q_m + turn, wheel_angles=np.full(2, roll)))
        ghost.hide_links_near(robot)
        shown = {name for name in frames if name.startswith("/ghost_0/") and frames[name].visible}
        return {name.removeprefix("/ghost_0/") for name in shown}

    assert not visible(0.0, 1.0)  # turned wheels look alike
    arm = [f"panda_joint{k}" for k in range(1, 8)]
    for k in range(6):  # joints 1 and 2 have a common origin: only their rotation differs
        assert set(arm[k:]) <= visible(0.1 * np.eye(7)[k], 0.0)
        assert not set(arm[:k]) & visible(0.1 * np.eye(7)[k], 0.0)


def view_of(**quantities):
    return View({"lm-lEE": "hidden", "lm-l3": "hidden"} | quantities)


def test_border_is_redrawn_only_after_a_change(scene, borders):
    cloud = DrawnBorders(scene, borders, husky_panda())
    view, config = view_of(**{"lm-lEE": "score"}), BorderConfig()
    assert cloud.update(view, config)
    assert not cloud.update(view, config)
    assert cloud.update(view, config.model_copy(update={"d_b": 0.2}))
    view.borders["lm-l3"] = "determinant"
    assert cloud.update(view, config)
    assert [legend.pair for legend in cloud.legends] == ["end-effector – base", "forearm – base"]
    assert [legend.title[:3] for legend in cloud.legends] == ["Sco", "Mob"]


@pytest.mark.parametrize("quantity", ["determinant", "reachability", "score"])
def test_legend_and_colours_match_the_values_on_the_border(borders, clouds, quantity):
    field = ScoreField.of(husky_panda(), "lEE")
    function = {
        "determinant": field.singularity,
        "reachability": field.reachability,
        "score": field.score,
    }[quantity]
    for whole in (False, True):
        coloured = borders.coloured("lm-lEE", quantity, BorderConfig(), whole=whole)
        points = construct_dbb(clouds["lm-lEE"], 0.15, 0.01).points
        points = points if whole else points[points[:, 2] <= borders.top]
        values = function(points)
        assert coloured.legend.low == values.min()
        assert coloured.legend.high == values.max()
        assert coloured.legend.total == len(points)
        assert coloured.legend.drawn == len(coloured.points) == min(len(points), MAX_POINTS)
        u = (function(coloured.points) - values.min()) / np.ptp(values)
        np.testing.assert_allclose(coloured.colours.astype(int), viridis(u), atol=1)


def test_coloured_border_is_shared_between_clients(borders):
    one = borders.coloured("lm-lEE", "score", BorderConfig(), whole=False)
    assert borders.coloured("lm-lEE", "score", BorderConfig(), whole=False) is one


def test_hidden_border_has_no_legend(scene, borders):
    cloud = DrawnBorders(scene, borders, husky_panda())
    view = view_of(**{"lm-lEE": "score"})
    cloud.update(view, BorderConfig())
    view.borders["lm-lEE"] = "hidden"
    assert cloud.update(view, BorderConfig())
    assert cloud.legends == []
    assert f"{ROOT}/border_lm-lEE" not in scene._handle_from_node_name


@pytest.mark.parametrize("z", [0.1, 0.3, 0.45])
def test_slice_lies_at_its_height_on_the_border(borders, z):
    (contour,) = borders.surface(BorderConfig()).curves(z)
    np.testing.assert_allclose(contour[:, 2], z)
    body = MobileBody(husky_panda())
    np.testing.assert_allclose(body.distance(contour[::20]), 0.15, atol=0.005)


@pytest.mark.parametrize("scale", [1e-9, 3.7e-4, 0.02, 1.0, 95.0, 4.2e6])
def test_tick_labels_times_their_power_of_ten_equal_the_values(scale):
    low, high = -0.31 * scale, scale
    texts, factor = tick_texts(low, high)
    power = int(re.search(r"<sup>(.*)</sup>", factor)[1].replace("−", "-")) if factor else 0
    shown = [float(text.replace("−", "-")) * 10.0**power for text in texts]
    np.testing.assert_allclose(shown, [low, (low + high) / 2, high], atol=0.006 * scale)


def test_legend_states_the_number_of_drawn_points():
    title, unit = title_of("score", "differential")
    legend = Legend("lm-lEE", title, unit, 0.15, -1.0, 2.0, 20_000, 50_000, 0.38)
    html = legend_html([legend])
    assert "m⁴/rad⁴" in html
    assert "20,000 of 50,000 points" in html
    assert "0.150 m" in html


def test_subsample_is_deterministic_and_without_repetition():
    chosen = subsample(1000, 300)
    assert len(np.unique(chosen)) == 300
    np.testing.assert_array_equal(chosen, subsample(1000, 300))
    np.testing.assert_array_equal(subsample(10, 300), np.arange(10))


# Colours, lines, arrows


def test_colour_map_increases_in_lightness():
    colours = viridis(np.linspace(0, 1, 101)).astype(float)
    lightness = colours @ [0.2126, 0.7152, 0.0722]
    assert (np.diff(lightness) > 0).all()


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


def test_force_arrow_starts_at_the_end_effector_and_scales_with_force(scene, loop):
    snapshot = replace(
        loop.latest(), hand_force=np.array([30.0, -40.0, 0.0]), hand_target=np.zeros(3)
    )
    canvas = Canvas(scene)
    with canvas.picture(texts=True):
        draw_motion(canvas, snapshot, husky_panda().description.base.axes, 0.3)
    start, end = canvas._handles["/person"].points[0]
    np.testing.assert_allclose(start, snapshot.p_ee, atol=1e-6)
    np.testing.assert_allclose(end - start, snapshot.hand_force * METRES_PER_NEWTON, atol=1e-6)


def test_nodes_missing_in_a_picture_are_hidden_until_drawn_again(scene):
    canvas = Canvas(scene)

    def picture(*names, texts=True, text="a"):
        with canvas.picture(texts=texts):
            for name in names:
                canvas.label(name, np.zeros(3), text)
        return {name: handle.visible for name, handle in canvas._handles.items()}

    assert picture("/a", "/b") == {"/a": True, "/b": True}
    assert picture("/b", texts=False, text="b") == {"/a": False, "/b": True}
    assert canvas._handles["/b"].text == "a", "text must not change without texts=True"
    assert picture("/a") == {"/a": True, "/b": False}
    assert picture() == {"/a": False, "/b": False}


def test_links_are_drawn_and_pulled_in_the_controllers_frames(dashboard, loop):
    with RawClient(dashboard.address):
        drawn, robot = page_of(dashboard)._scene.robot, husky_panda()
        loop.send(Pause(True))
        loop.place(base_pose := np.array([0.5, -0.2, 2.5]))
        wait_for(lambda: drawn.root.position[0] == pytest.approx(0.5))
        q_m, state = loop.latest().q_m, RobotState(robot)
        state.update(Measurement(base_pose, np.zeros(2), q_m, np.zeros(robot.n_m)))
        for name in robot.description.arm.joints:
            joint, _ = held_point(robot, name, (0.0, 0.0, 0.0))
            T = drawn.world_pose(parts().kinematics.model.getJointId(name))
            assert T.isApprox(state.data.oMi[joint], 1e-6), name


# The tour


@pytest.fixture
def guided(dashboard):
    """A page, a function that sends messages of its browser, and one that waits for a card."""
    with RawClient(dashboard.address) as client:
        page, number = page_of(dashboard), itertools.count()

        def say(*words):
            client.set_widget(page.channel._box, json.dumps([f"{next(number)}", *words]))

        def shows(state):
            title = CARDS[state].title if state else ""
            wait_for(lambda: page.guide._shown.title == title)

        yield page, say, shows


def test_tour_looks_back_in_time_on_request(loop, guided):
    page, say, shows = guided
    loop.pull_at_base(4.0)
    page.guide.go("tour 4")
    shows("tour 4")
    say("card", SHOW)
    wait_for(lambda: not page.timeline.live)
    assert page.timeline.shown().t == pytest.approx(1.0, abs=0.05)


def test_tour_advances_only_on_a_click_on_the_current_card(dashboard, loop, guided):
    page, say, shows = guided
    say("tour")
    shows("welcome")
    say("card", NEXT)  # on a card that is not shown
    loop.send(Pull((0.4, 0.0, 0.8)))  # by another client
    drawn = dashboard.pictures
    wait_for(lambda: dashboard.pictures > drawn + 3 * TEXTS_EVERY / FRAME)
    shows("welcome")
    page.guide.go("tour 1")
    for i in range(1, 5):
        shows(f"tour {i}")
        say("card", SHOW)
        say("card", NEXT)
    shows("tour 5")
    assert NEXT not in CARDS["tour 5"].buttons
    say("card", CLOSE)
    shows("")


@pytest.mark.parametrize(
    ("way", "after"), [("pull", "pull"), ("close", ""), ("touch", ""), ("guest", "")]
)
def test_demonstration_ends_with_its_card(dashboard, loop, guided, monkeypatch, way, after):
    monkeypatch.setattr("app.dashboard.server.UNTOUCHED", 0.1)
    _, say, shows = guided
    say("seen", "untouched")
    shows("demo")
    assert Compare(("none",)) in loop.commands
    assert loop.latest().scenario == SHOWN
    loop.commands.clear()
    match way:
        case "pull" | "close":  # the click arrives before the report of the first input
            monkeypatch.setattr("app.dashboard.server.UNTOUCHED", 60.0)
            say("card", PULL if way == "pull" else CLOSE)
            shows(after)
        case "touch":
            say("seen", "")
            shows(after)
        case "guest":
            with RawClient(dashboard.address):
                shows(after)
    assert loop.commands == [Compare(), Reset()]


def test_repeated_demonstration_keeps_its_scenario_until_a_pull(loop, guided, monkeypatch):
    monkeypatch.setattr("app.dashboard.server.UNTOUCHED", 0.1)
    _, say, shows = guided
    say("seen", "untouched")
    shows("demo")
    say("card", WATCH)
    say("seen", "")
    shows("watch")
    assert [type(each) for each in loop.commands] == 2 * [Compare, Play]
    say("card", PULL)
    shows("pull")
    assert loop.commands[-2:] == [Compare(), Reset()]


@pytest.mark.parametrize("way", ["close", "escape", "tour"])
def test_a_comparison_of_the_guide_ends_with_its_card(loop, guided, way):
    """The robot stays where it is; a comparison that a viewer has chosen continues."""
    page, say, shows = guided
    for chosen in ((), ("none", "repulsive")):
        page.guide.go("tour 5" if way == "tour" else "welcome")
        say("card", SHOW if way == "tour" else WATCH)
        wait_for(lambda: page.guide._compares)
        shows("tour 5" if way == "tour" else "watch")
        if chosen:
            loop.send(Compare(chosen))
        loop.commands.clear()
        say(*(("escape",) if way == "escape" else ("card", CLOSE)))
        shows("")
        assert loop.commands == ([] if chosen else [Compare()])
        assert [ghost.controller for ghost in loop.latest().ghosts] == list(chosen)
    say("escape")  # without a card
    shows("")
    assert loop.commands == []


def test_a_comparison_of_the_guide_ends_with_its_viewer(loop, guided):
    page, say, shows = guided
    say("card", WATCH)
    shows("watch")
    loop.commands.clear()
    page.end()
    assert loop.commands == [Compare()]


def test_the_measured_result_replaces_the_expectation_on_the_card(loop, guided, monkeypatch):
    page, _, shows = guided
    page.guide.watch("watch")
    shows("watch")
    near = [Score(name, d, *5 * [0.0], 0.0, 0) for name, d in (("dbb", 0.072), ("none", 0.002))]
    ended = replace(loop.latest(), scenario="", scores=tuple(near))
    told = []
    monkeypatch.setattr(page.channel, "tell", lambda *words: told.append(words))
    page.guide.update(Moment(ended, ended, judge(ended)))
    texts = [words[2] for words in told if words[0] == "card"]
    (text,) = (each for each in texts if each.startswith("Result."))
    assert text.startswith(
        "Result. Solid, with avoidance: no contact, smallest distance 72 mm. "
        "Violet, without avoidance: no contact, smallest distance 2 mm. The scenario is "
    )
    assert "runs into" not in text


def test_end_of_the_demonstration_does_not_stop_a_newer_one(loop, guided, monkeypatch):
    monkeypatch.setattr("app.dashboard.server.UNTOUCHED", 0.1)
    page, say, shows = guided
    say("seen", "untouched")
    shows("demo")
    send = loop.send

    def send_late(command):
        send(command)
        if isinstance(command, Play):  # the drawing thread receives the first input now
            page.guide.leave_demonstration()

    monkeypatch.setattr(loop, "send", send_late)
    page.guide.watch("watch")
    assert page.guide.state == "watch"
    assert isinstance(loop.commands[-1], Play)


# Plots and readings


def buttons_of(page, label):
    """The button or box with this label."""
    handles = page.client.gui._gui_input_handle_from_uuid.values()
    return next(handle for handle in handles if getattr(handle, "label", "") == label)


def test_plots_show_the_data_of_the_loop(dashboard, loop):
    with RawClient(dashboard.address) as client:
        page = page_of(dashboard)
        client.set_widget(page.channel._box, '["1", "seen", "plots"]')
        _, plot = page._plots._plots["distance [m]"]
        wait_for(lambda: len(plot.data[0]) > 5)
        latest = loop.latest()
        lines = np.array(plot.data)
        np.testing.assert_allclose(lines[1:-2, -1], [p.d for p in latest.pairs], atol=1e-5)
        np.testing.assert_allclose(lines[-2], latest.config.border.d_b)
        assert (lines[-1] < 0).all(), "no cursor in the present"
        page.timeline.step(-0.1)
        wait_for(lambda: (np.array(plot.data[-1]) == 1.0).sum() == 1)


def test_plot_of_the_door_shows_its_distance_only_with_a_door(loop, robot):
    data, snapshot = SharedState(loop, robot, {}), loop.latest()
    first, *others = snapshot.pairs
    opened = (first, *others, first._replace(name=data.of_door, d=0.42))
    plan = plot_plans(robot, data.pairs, data.of_door)[1]
    assert [curve.label for curve in plan.curves] == ["door – base", "buffer d_b"]
    assert all(curve.hint for curve in plan.curves)
    assert plan.curves[0].value(replace(snapshot, pairs=opened)) == 0.42
    assert np.isnan(plan.curves[0].value(snapshot))


def test_every_log_quantity_can_be_added_to_and_removed_from_a_plot(dashboard, loop):
    with RawClient(dashboard.address) as client:
        page = page_of(dashboard)
        client.set_widget(page.channel._box, '["1", "seen", "plots"]')
        columns = Trace.of_snapshots(husky_panda(), [loop.latest()]).columns
        assert {column.name for column in columns} - set(dashboard.shared.quantities) == {"t_s"}
        assert page._plots._name.value == "base_x_m"
        plots, name, title = page._plots, "q_panda_joint4_rad", "end-effector error [mm]"
        client.set_widget(plots._name, name)
        client.set_widget(plots._into, title)
        for act, lines in (("Add", 2), ("Add", 2), ("Remove", 1)):
            client.set_widget(buttons_of(page, "Curve"), act)
            wait_for(lambda lines=lines: len(plots._plots[title][0].curves) == lines)
            plot = plots._plots[title][1]
            wait_for(lambda plot=plot: plot.visible and len(plot.data[0]) > 1)
            if lines == 2:
                np.testing.assert_allclose(plot.data[2][-1], loop.latest().q_m[3], atol=1e-3)
            assert len(plot.data) == lines + 2
    assert dashboard.error is None


def test_a_curve_without_a_value_is_reported_and_the_list_explains_the_column(dashboard):
    with RawClient(dashboard.address) as client:
        page = page_of(dashboard)
        plots, told = page._plots, []
        page.notifier.tell = lambda _, title, text: told.append(f"{title}: {text}")
        client.set_widget(plots._name, "door_angle_rad")
        wait_for(lambda: "door that the end-effector holds" in plots._name.hint)
        client.set_widget(buttons_of(page, "Curve"), "Add")
        wait_for(lambda: told)
    assert told[0].startswith("Empty curve: door_angle_rad has no value"), told


def test_a_restart_by_another_viewer_ends_a_pull_with_a_message(dashboard, loop):
    with RawClient(dashboard.address):
        page, told = page_of(dashboard), []
        page.notifier.tell = lambda _, title, text: told.append(title)
        page.grip.take()
        loop.send(Restart())
        wait_for(lambda: told)
        assert not page.grip.holds_anything
    assert told == ["Pull ended"]


def test_only_the_start_of_a_comparison_reports_that_the_timeline_starts_again(dashboard):
    with RawClient(dashboard.address):
        page, told = page_of(dashboard), []
        panel = next(each for each in page.panels if isinstance(each, ComparePanel))
        page.notifier.tell = lambda _, title, text: told.append(title)
        panel._choose()
        assert told == []
        panel._chosen = lambda: [METHOD_TITLES["none"]]
        panel._choose()
    assert told == ["New run"]


def test_input_of_a_comparison_that_another_viewer_has_chosen_is_shown(dashboard, loop):
    with RawClient(dashboard.address):
        page = page_of(dashboard)
        panel = next(each for each in page.panels if isinstance(each, ComparePanel))
        assert panel._input.value == INPUTS["path"]
        loop.send(Compare(("none",), "force"))
        wait_for(lambda: panel._input.value == INPUTS["force"])
        loop.send(Compare())
        wait_for(lambda: loop.latest().same == "")
        panel._input.value = INPUTS["path"]
        wait_for(lambda: panel.followed[id(panel._input)] == INPUTS["path"])
        loop.send(Compare(("none",), "force"))
        wait_for(lambda: panel._input.value == INPUTS["force"])


def test_view_of_the_door_is_refused_without_a_door(dashboard):
    with RawClient(dashboard.address):
        page = page_of(dashboard)
        with pytest.raises(ConfigError, match="no door"):
            page.look("door")


def test_a_curve_that_is_added_while_a_page_is_drawn_appears_with_the_next_values(dashboard):
    with RawClient(dashboard.address) as client:
        page = page_of(dashboard)
        client.set_widget(page.channel._box, '["1", "seen", "plots"]')
        plots, title = page._plots, next(iter(page._plots._plots))
        make = plots._make

        def make_late(plans):
            make(plans)
            if plots._plans[title] == plans[title]:
                plots._into.value = title
                plots._change(add=True)

        plots._make = make_late
        wait_for(lambda: plots._plots[title][0] == plots._plans[title])
        wait_for(lambda: len(plots._plots[title][1].data[0]) > 1)
        plan, plot = plots._plots[title]
        assert len(plot.data) == len(plot.series) == len(plan.curves) + 2
    assert dashboard.error is None


def test_posing_that_ends_during_a_drag_does_not_begin_again(dashboard, monkeypatch):
    with RawClient(dashboard.address):
        panel, explorer = page_of(dashboard).explorer_panel, dashboard.shared.explorer
        reach, reached = explorer.reach, threading.Event()

        def reach_late(*place):
            posture = reach(*place)
            panel._end()  # as the button "Discard the posture" in the meantime
            reached.set()
            return posture

        monkeypatch.setattr(explorer, "reach", reach_late)
        panel._enter(None)
        panel._viewer.grip.reach(dashboard.shared.loop.latest().p_ee)
        assert reached.wait(20.0)
        drawn = dashboard.pictures
        wait_for(lambda: dashboard.pictures > drawn + 1)
        assert panel.posture is None
    assert dashboard.error is None


def test_hidden_plots_are_not_sent(dashboard):
    with RawClient(dashboard.address) as client:
        page = page_of(dashboard)
        client.set_widget(page.channel._box, '["1", "seen", "plots"]')
        plots = {title: plot for title, (_, plot) in page._plots._plots.items()}
        hidden = [title for title in plots if title not in page.view.plots]
        assert hidden
        hidden.append("distance to the door [m]")  # there is no door
        wait_for(lambda: not any(plots[title].visible for title in hidden))
        assert all(len(plots[title].data[0]) == 1 for title in hidden)
        page.view.plots |= {hidden[0]}
        wait_for(lambda: plots[hidden[0]].visible and len(plots[hidden[0]].data[0]) > 1)


def test_view_tab_shows_changes_from_elsewhere(dashboard):
    with RawClient(dashboard.address):
        page, title = page_of(dashboard), "end-effector error [mm]"
        boxes = [buttons_of(page, label) for label in ("Dark theme", title)]
        wait_for(lambda: [box.value for box in boxes] == [True, False])
        page.view.toggle_dark()
        page.view.plots |= {title}
        wait_for(lambda: [box.value for box in boxes] == [False, True])


def status_html(snapshot):
    return "".join(status_rows(snapshot, judge(snapshot)))


def near_by(loop, d, **fields):
    """A snapshot whose first pair, end-effector and base, has the distance d [m]."""
    first, *others = loop.latest().pairs
    pairs = (first._replace(d=d, beta=float(d < 0.15)), *others)
    return replace(loop.latest(), pairs=pairs, **fields)


def coloured(html, state):
    return html.count(css(COLOURS[state]))


@pytest.mark.parametrize(
    ("d", "controller", "state"),
    [
        (0.3, "dbb", "clear"),
        (0.08, "dbb", "giving way"),
        (0.08, "dbb at rest", "near"),
        (0.08, "repulsive", "resisting"),
        (0.08, "none", "near"),
        (-0.008, "dbb", "contact"),
        (-0.008, "none", "contact"),
    ],
)
def test_sentence_rows_and_bars_show_the_same_verdict(loop, d, controller, state):
    moves = () if "at rest" in controller else (-0.1, 0.0)
    snapshot = near_by(loop, d, controller=controller.split()[0])
    snapshot = replace(snapshot, base_velocity=np.array(moves or (0.0, 0.0)))
    verdict = judge(snapshot)
    assert (verdict.state, verdict.pairs[0]) == (state, state)
    names = {pair.name: pair.name for pair in snapshot.pairs}
    status, rows = status_html(snapshot), pairs_html(snapshot, verdict, names)
    assert state.capitalize() in why_html(snapshot, verdict)
    assert coloured(why_html(snapshot, verdict), state)
    assert coloured(rows, state) >= 1
    touches = state == "contact"
    assert bool(coloured(status, "contact")) == touches
    full = f"width:100%;height:100%;background:{css(COLOURS['contact'])}"
    assert ("overlap by 8 mm" in status) == (full in rows) == touches
    head = header_html(snapshot, verdict, {pair.name: pair.name for pair in snapshot.pairs})
    assert state.capitalize() in head
    assert f"{1000 * d:.0f} mm".replace("-", "−") in head or d > 0.2, (
        "at 0.3 m another pair is nearer"
    )


@pytest.mark.parametrize(
    ("field", "named"),
    [
        ("in_contact", "arm and base"),
        ("arm_in_contact", "links of the arm"),
        ("floor_contact", "arm and floor"),
    ],
)
def test_reported_contact_gives_the_verdict_and_the_sentence(loop, field, named):
    explained = SimpleNamespace(solved=False, near=())
    snapshot = replace(loop.latest(), explanation=explained, **{field: True})
    assert judge(snapshot).state == "contact"
    assert sentence(snapshot).startswith(f"{named.capitalize()} touch. ")


def test_abnormal_readings_are_coloured(loop):
    calm = replace(loop.latest(), t=2.0, overruns=0)

    def warnings(**fields):
        return coloured("".join(machine_rows(replace(calm, **fields))), "contact")

    assert warnings() == 0
    late = {"overruns": 500}, {"solver_failures": 3}, {"realtime_factor": 0.5}
    assert [warnings(**fields) for fields in late] == [1, 1, 1]


@pytest.mark.parametrize("factor", [0.5, 0.93, 0.96, 1.0, float("nan")])
def test_header_and_readings_agree_on_a_slow_simulation(loop, factor):
    shown = replace(loop.latest(), realtime_factor=factor, overruns=0)
    head = header_html(shown, judge(shown), {pair.name: pair.name for pair in shown.pairs})
    row = coloured("".join(machine_rows(shown)), "contact")
    assert ("busy computer" in head) == bool(row) == (factor < 0.95)


OUTCOMES = {"dbb": (0.104, 0), "none": (-0.008, 0), "repulsive": (0.05, 3), "barrier": (0.02, 0)}


def test_after_a_refusal_the_list_shows_the_present_scenario_again(loop):
    def widget() -> SimpleNamespace:
        return SimpleNamespace(value="", label="", icon=None, content="")

    panel, free = object.__new__(RunPanel), loop.latest()
    for name in ("_scenario", "_controller", "_pause", "_restart", "_course", "_pairs"):
        setattr(panel, name, widget())
    names = {pair.name: pair.name for pair in free.pairs}
    panel._shared = SimpleNamespace(course=Course(), model=husky_panda(), spoken=names)
    panel.followed, warnings = {}, []
    notifier = SimpleNamespace(warn=lambda _, text: warnings.append(text))
    page = object.__new__(Page)
    page.panels, page.notifier, page.client = [panel], notifier, None
    page._refusal, page._key, page._hung = None, widget(), widget()
    page.shared = SimpleNamespace(loop=SimpleNamespace(silence=0.0))
    refused = replace(free, refusal=Refusal(1, "the handle is too far away"))
    chosen, shown = TITLES["refrigerator"], []
    for snapshot in (free, free, refused, refused):
        page._renew(Moment(snapshot, snapshot, judge(snapshot)))
        shown.append(panel._scenario.value)
        panel._scenario.value = chosen  # a choice that the simulation has not answered yet
    assert shown == [FREE, chosen, FREE, chosen]
    assert warnings == ["the handle is too far away"]


def test_robot_with_contact_or_overlap_is_never_marked_best(loop):
    """Contact and overlap have their own word, in the colour of contact."""
    scores = tuple(
        Score(
            name, least, 0.0 if contacts or least < 0 else least / 10, 0.02, 0.1, 0, 0, 0, contacts
        )
        for name, (least, contacts) in OUTCOMES.items()
    )
    assert outcomes_html(scores).split("<br>") == [
        "<b>With avoidance</b> (dbb): no contact, smallest distance 104 mm",
        "<b>Without avoidance</b> (none): bodies overlap by 8 mm",
        "<b>Arm repulsion only</b> (repulsive): contact, smallest distance 50 mm",
        "<b>Minimum distance only</b> (barrier): no contact, smallest distance 20 mm",
    ]
    html = scores_html(scores)
    assert coloured(html, "contact") == 3, "two outcomes, and a distance below zero"
    cells = re.findall(r"<td[^>]*>(.*?)</td>", html)
    marked = [re.sub(r"<[^>]*>", "", cell) for cell in cells]
    assert [text for text in marked if "✓" in text] == ["✓ 104", "✓ 2.0"]
    assert "✓" not in scores_html(scores[:3]), "a single valid robot has no mark"
    assert [text for text in marked if text in ("no contact", "overlap", "contact")] == [
        "no contact",
        "overlap",
        "contact",
        "no contact",
    ]


@pytest.mark.parametrize(("link", "at_ee"), [(None, 1.0), ("panda_link4", 0.0)])
def test_pull_row_shows_the_force_and_the_force_that_the_arm_resists(loop, link, at_ee):
    pull = PullReading(1, link, np.zeros(3), np.ones(3), np.array([30.0, 0.0, 0.0]))
    held = replace(loop.latest(), pulls=(pull,), hand_force=at_ee * pull.force)
    assert "30.0 N</td>" in status_html(held)
    held = replace(held, force_bound=61.7)
    assert "30.0 N (the arm can resist 62 N)</td>" in status_html(held)


def test_buffer_row_names_the_required_d_b_and_is_coloured_only_if_near(loop):
    small = loop.latest().buffer._replace(needed=0.2311, needed_max=0.5, too_small=True)
    for d, state, text in ((0.1, "near", "d_b of"), (0.3, "clear", "lately: d_b of")):
        snapshot = near_by(loop, d, buffer=small)
        html = status_html(snapshot)
        assert f"{text} 0.24 m needed" in html
        assert bool(coloured(html, "near")) == (state == "near")
    hopeless = replace(snapshot, buffer=small._replace(needed=float("inf")))
    assert "no d_b suffices" in status_html(hopeless)
