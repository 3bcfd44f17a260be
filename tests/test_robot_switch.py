"""A change of the robot in the dashboard: preserved state, new state, failures."""

from __future__ import annotations

import gc
import threading
import time
import weakref
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext

import pytest

from app.border.cache import BorderData
from app.cli import serve
from app.cli.options import Setup
from app.config import Config
from app.dashboard import markup, robots
from app.dashboard.job import give_back
from app.dashboard.robots import RobotEntry
from app.dashboard.scene import robot
from app.dashboard.server import DashboardServer, serve_dashboard
from app.dashboard.view import HIDDEN, View
from app.errors import LoopError, UnreachableError
from app.robot.model import RobotModel
from app.simulation.loop.commands import Pull
from app.simulation.loop.pacing import gc_frozen
from tests.browser import wait_for
from tests.dashboards import clouds, parts, served_dashboard
from tests.fakes import ScriptedLoop
from tests.raw_client import RawClient
from tests.robots import husky_panda

pytestmark = pytest.mark.slow

OTHER = "other"
"""A second robot: the paper's with another name, which needs no other package."""
OWN = Config().replace("border.eps", 0.005)
"""The default parameters of the second robot."""


def other() -> RobotModel:
    description = husky_panda().description
    own = {"title": "The other robot", "config": OWN}
    return RobotModel(description.model_copy(update=own))


class Loops:
    """Starts scripted loops and stores weak references to them."""

    def __init__(self) -> None:
        self.begun: list[weakref.ref[ScriptedLoop]] = []
        self.refuses: Config | None = None

    def __call__(
        self, model: RobotModel, data: BorderData, config: Config, controller: str
    ) -> ScriptedLoop:
        if self.refuses is not None and config == self.refuses:
            raise UnreachableError("the end-effector cannot reach it")
        loop = ScriptedLoop(model)
        self.begun.append(weakref.ref(loop))
        return loop

    def alive(self) -> list[ScriptedLoop]:
        gc.collect()
        return [loop for ref in self.begun if (loop := ref()) is not None]


@pytest.fixture(autouse=True)
def two_robots(monkeypatch: pytest.MonkeyPatch) -> None:
    """Two available robots and one that is not installed; models and borders need no loading."""
    entries = [
        RobotEntry("husky_panda", "Husky", "differential base", None, False, False),
        RobotEntry(OTHER, "Other", "differential base", None, False, False),
        RobotEntry(
            "absent",
            "Absent",
            "",
            "the package 'x' is not installed; try: pip install x",
            False,
            False,
        ),
    ]
    data = BorderData(None, clouds(), "cache")  # type: ignore[arg-type]
    monkeypatch.setattr(robots, "robot_entries", lambda: entries)
    monkeypatch.setattr(robots, "load_robot", lambda name: name)
    monkeypatch.setattr(
        robots, "RobotModel", lambda name: other() if name == OTHER else husky_panda()
    )
    monkeypatch.setattr(robots, "kept_border_data", lambda _: data)
    seen = parts().visuals
    monkeypatch.setattr(robot, "_visuals", lambda *_: list(seen))  # loading takes seconds


def choose(server: DashboardServer, name: str) -> None:
    """Start a change like the panel and wait for its end, with or without success."""
    shared = server.shared
    shared.robot_switch.begin(name, shared.tuning.changes, shared.loop)
    wait_for(lambda: shared.robot_switch.progress is None, what="the end of the change")


@contextmanager
def viewer(server: DashboardServer) -> Iterator[RawClient]:
    with RawClient(server.address) as client:
        wait_for(lambda: server.pages, what="a page")
        yield client


def title(server: DashboardServer) -> str:
    return server.shared.model.description.title


def test_viewers_get_the_other_robot_with_their_parameters_and_layers() -> None:
    loops = Loops()
    with served_dashboard(start_loop=loops) as (server, _), viewer(server), viewer(server):
        wait_for(lambda: len(server.pages) == 2, what="two pages")
        shared = server.shared
        shared.tuning.set("border.d_b", 0.2)
        pages = list(server.pages.values())
        pages[0].view.bodies, pages[1].view.dark = True, False
        first = shared.loop
        choose(server, OTHER)
        assert title(server) == "The other robot"
        assert server.shared.tuning.config.border.d_b == 0.2
        new = list(server.pages.values())
        assert not set(new) & set(pages)
        assert all(page.closed for page in pages)
        assert [page.view.bodies for page in new] == [True, False]
        assert [page.view.dark for page in new] == [True, False]
        assert isinstance(first, ScriptedLoop)
        wait_for(lambda: not first._thread.is_alive(), what="the end of the old simulation")
        server.shared.tuning.undo()
        assert server.shared.tuning.config == OWN
        (loop,) = loops.alive()
        wait_for(lambda: loop.latest().config == OWN, what="the undone step")


def test_three_changes_leave_no_objects_behind() -> None:
    """After the second change, the numbers of threads, loops, widgets and nodes do not grow."""
    loops = Loops()
    with served_dashboard(start_loop=loops) as (server, _), viewer(server):
        counts, threads, models = [], [], []
        for k in range(3):
            choose(server, OTHER if k % 2 == 0 else "husky_panda")
            models.append(weakref.ref(server.shared.parts))
            drawn = server.pictures
            wait_for(lambda drawn=drawn: server.pictures > drawn + 6, what="some pictures")
            client = next(iter(server.viser.get_clients().values()))
            gui, scene = client.gui, client.scene
            threads.append(threading.active_count())
            counts.append(
                (
                    len(gui._gui_input_handle_from_uuid),
                    len(gui._container_handle_from_uuid),
                    len(gui._panel_handle_from_uuid),
                    len(gui._command_handle_from_uuid),
                    len(scene._handle_from_node_name),
                    len(client.camera._state.camera_cb),
                    len(server.pages),
                    len(loops.alive()),
                )
            )
        assert counts[2] == counts[1]
        assert counts[1][-1] == 1
        assert threads[2] <= threads[1]  # fewer after the tour has queried the browser
        gc.collect()
        assert [ref() is None for ref in models] == [True] * 2 + [False]


def test_a_replaced_robot_is_freed_without_a_garbage_collection() -> None:
    """The garbage collector is off during the second change."""
    loops = Loops()
    with served_dashboard(start_loop=loops) as (server, _), viewer(server):
        choose(server, OTHER)
        shared, (page,) = server.shared, server.pages.values()
        old = {
            type(each).__name__: weakref.ref(each)
            for each in (
                shared,
                shared.model,
                shared.parts,
                shared.borders,
                shared.strip,
                shared.loop,
                page,
                page._scene,
                page.handles,
                page.timeline,
            )
        }
        del shared, page
        gc.disable()
        try:
            choose(server, "husky_panda")
            assert [name for name, ref in old.items() if ref() is not None] == []
        finally:
            gc.enable()


def test_the_command_frees_the_first_robot(monkeypatch: pytest.MonkeyPatch) -> None:
    loops, ended = Loops(), []

    def change(server: DashboardServer) -> None:
        shared = server.shared
        old = [weakref.ref(each) for each in (shared.model, shared.parts, shared.loop)]
        del shared
        with viewer(server):
            choose(server, OTHER)
        # The switch's thread may still collect garbage; a second collection would then do nothing.
        wait_for(lambda: not any(ref() for ref in old), what="the release of the first robot")
        ended.append(True)

    monkeypatch.setattr(DashboardServer, "run_forever", change)
    serve_small_border(monkeypatch, loops)
    assert ended == [True]


def serve_small_border(monkeypatch: pytest.MonkeyPatch, loops: Loops) -> None:
    """Run `dbb serve` with a small border and without a simulation's process."""
    monkeypatch.setattr(serve, "load_model", lambda _: RobotModel(husky_panda().description))
    monkeypatch.setattr(serve, "_border", lambda _: BorderData(None, clouds(), "cache"))  # type: ignore[arg-type]
    monkeypatch.setattr(serve, "free_start", lambda *_: None)
    monkeypatch.setattr(serve._First, "begin_loop", lambda _, *about: loops(*about[:4]))
    asked = serve.Serving(port=0)
    serve._serve(serve._First(Setup(), Config(), asked, None, None))  # type: ignore[arg-type]


def test_ctrl_c_directly_after_the_address_ends_the_command(
    monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    def interrupted() -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("app.dashboard.server.give_back", interrupted)
    serve_small_border(monkeypatch, Loops())
    printed, errors = capfd.readouterr()
    assert printed == ""
    assert errors.startswith("Dashboard at ")
    assert len(errors.splitlines()) == 1


@pytest.mark.parametrize("frozen", [False, True])
def test_give_back_frees_reference_cycles(frozen: bool) -> None:
    class Node:
        """Refers to itself and to a large array."""

        def __init__(self) -> None:
            self.itself, self.held = self, bytearray(1000)

    gc.disable()
    try:
        ref = weakref.ref(Node())
        with gc_frozen() if frozen else nullcontext():
            give_back(frozen=frozen)
            assert (gc.get_freeze_count() > 0) == frozen
        assert ref() is None
    finally:
        gc.enable()


def test_a_served_page_does_not_wait_for_a_collection_of_the_robot() -> None:
    """A collection scans only the pages' objects. A scan of all objects would take 0.3 s."""
    with served_dashboard() as (server, _):
        existing = len(gc.get_objects())
        thread = threading.Thread(target=server.run_forever)
        thread.start()
        try:
            wait_for(lambda: len(gc.get_objects()) < existing / 10)
        finally:
            server.stop()
            thread.join()
    assert gc.get_freeze_count() == 0


def test_a_change_releases_the_pull_of_a_viewer() -> None:
    with served_dashboard(start_loop=Loops()) as (server, _), viewer(server):
        old = server.shared.loop
        page = next(iter(server.pages.values()))
        assert isinstance(old, ScriptedLoop)
        page.grip.take()
        page.grip.pull(old.latest().p_ee)
        assert isinstance(old.commands[-1], Pull)
        choose(server, OTHER)
        assert old.pulls()[-1] is None


def test_the_message_mentions_parameters_only_if_some_differ_from_their_defaults() -> None:
    notes: list[str] = []
    with served_dashboard(start_loop=Loops()) as (server, _), viewer(server):
        server._notifier.tell = lambda *args: notes.append(args[-1])  # type: ignore[method-assign]
        choose(server, OTHER)
        wait_for(lambda: len(notes) == 1, what="the first message")
        server.shared.tuning.set("border.d_b", 0.2)
        choose(server, "husky_panda")
        wait_for(lambda: len(notes) == 2, what="the second message")
    assert notes[0] == "The other robot is in use."
    assert notes[1].endswith(" is in use; your changed parameters keep their values.")


def test_unsuitable_parameters_are_reset_and_the_viewers_notified() -> None:
    loops = Loops()
    notes: list[str] = []
    with served_dashboard(start_loop=loops) as (server, _), viewer(server):
        server._notifier.tell = lambda *args: notes.append(args[-1])  # type: ignore[method-assign]
        server.shared.tuning.set("border.d_b", 0.3)
        loops.refuses = OWN.replace("border.d_b", 0.3)
        choose(server, OTHER)
        assert title(server) == "The other robot"
        assert server.shared.tuning.config == server.shared.tuning.usual == OWN
        (note,) = notes
        assert "defaults" in note
        assert "(the end-effector cannot reach it)" in note
        server.shared.tuning.undo()  # the change can be undone
        assert server.shared.tuning.config.border.d_b == 0.3


@pytest.mark.parametrize("why", ["refused", "crashed", "cancelled"])
def test_after_a_failure_the_old_robot_continues_and_the_cause_is_shown(
    why: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    loops = Loops()
    with served_dashboard(start_loop=loops) as (server, _), viewer(server):
        first, change = server.shared.loop, server.shared.robot_switch
        if why == "refused":
            loops.refuses = OWN
        else:

            def fails(_: object) -> None:
                change.cancel()
                if why == "crashed":
                    raise ZeroDivisionError("a defect")

            monkeypatch.setattr(robots, "kept_border_data", fails)
        choose(server, OTHER)
        assert server.shared.loop is first
        assert title(server) == husky_panda().description.title
        panel = next(iter(server.pages.values())).robot_panel
        assert panel is not None
        expected = {
            "refused": "cannot reach it",
            "crashed": markup.DEFECT,  # only the log contains the exception
            "cancelled": "cancelled",
        }[why]
        wait_for(lambda: expected in panel.about.content, what="the reason")
        t = first.latest().t
        wait_for(lambda: first.latest().t > t, what="a running loop")
        loops.refuses = None
        monkeypatch.undo()


@pytest.mark.parametrize(("before", "after"), [("score", "score"), (HIDDEN, HIDDEN)])
def test_the_first_border_takes_the_view_if_the_shown_pairs_are_missing(
    before: str, after: str
) -> None:
    view = View.first(["a", "b"], [])
    view.borders = dict.fromkeys(view.borders, before)
    assert view.of_robot(["c", "d"], []).borders == {"c": after, "d": HIDDEN}


def test_a_page_that_cannot_be_replaced_does_not_affect_other_pages(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def fails(*_: object) -> None:
        raise ZeroDivisionError("a defect")

    with served_dashboard(start_loop=Loops()) as (server, _), viewer(server), viewer(server):
        wait_for(lambda: len(server.pages) == 2, what="two pages")
        failing, other = server.pages.values()
        monkeypatch.setattr(failing, "with_robot", fails)
        choose(server, OTHER)
        wait_for(lambda: other.closed and failing.closed, what="the other viewer's new page")
        wait_for(lambda: [page.closed for page in server.pages.values()] == [False], what="it")
        pictures = server.pictures
        wait_for(lambda: server.pictures > pictures, what="pictures")
        assert title(server) == "The other robot"


def test_shared_data_that_cannot_be_built_does_not_block_the_change(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    loop = ScriptedLoop(husky_panda())
    loop.start()
    server = serve_dashboard(
        loop, husky_panda(), clouds(), port=0, parts=parts(), start_loop=Loops()
    )

    def fails(*_: object, **__: object) -> None:
        raise ZeroDivisionError("a defect")

    try:
        monkeypatch.setattr("app.dashboard.server.SharedState", fails)
        choose(server, OTHER)
        wait_for(lambda: server.error is not None, what="the end of drawing")
    finally:
        server.stop()
        loop.stop()


def test_an_unknown_or_not_installed_robot_is_refused_at_once() -> None:
    with served_dashboard(start_loop=Loops()) as (server, _):
        change = server.shared.robot_switch
        for name, words in (
            ("absent", "pip install x"),
            ("nobody", "robot 'nobody' does not exist"),
        ):
            with pytest.raises(Exception, match=words):
                change.begin(name, {}, server.shared.loop)
        assert change.progress is None


def test_a_failed_simulation_is_replaced_too() -> None:
    with served_dashboard(start_loop=Loops()) as (server, _), viewer(server):
        server.shared.loop.error = LoopError("gone")
        wait_for(lambda: server._failure is not None, what="the failure to be shown")
        choose(server, OTHER)
        assert server.shared.loop.error is None
        assert server._failure is None
        pictures = server.pictures
        time.sleep(0.2)
        wait_for(lambda: server.pictures > pictures, what="pictures")
