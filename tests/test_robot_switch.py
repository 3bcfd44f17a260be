"""Another robot on the dashboard without a restart: persistent state, new state, failures."""

from __future__ import annotations

import gc
import threading
import time
import weakref
from collections.abc import Iterator
from contextlib import contextmanager

import pytest

from app.border.cache import BorderData
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
from tests.browser import wait_for
from tests.dashboards import clouds, parts, served_dashboard
from tests.fakes import ScriptedLoop
from tests.raw_client import RawClient
from tests.robots import husky_panda

pytestmark = pytest.mark.slow

OTHER = "other"
"""A second robot: the paper's by another name, so that nothing else has to be installed."""
OWN = Config().replace("border.eps", 0.005)
"""Its parameters by default."""


def other() -> RobotModel:
    description = husky_panda().description
    own = {"title": "The other robot", "config": OWN}
    return RobotModel(description.model_copy(update=own))


class Loops:
    """Begins scripted loops and knows all of them."""

    def __init__(self) -> None:
        self.begun: list[weakref.ref[ScriptedLoop]] = []
        self.refuses: Config | None = None

    def __call__(
        self, model: RobotModel, data: BorderData, config: Config, controller: str
    ) -> ScriptedLoop:
        if self.refuses is not None and config == self.refuses:
            raise UnreachableError("the hand does not come there")
        loop = ScriptedLoop(model)
        self.begun.append(weakref.ref(loop))
        return loop

    def alive(self) -> list[ScriptedLoop]:
        gc.collect()
        return [loop for ref in self.begun if (loop := ref()) is not None]


@pytest.fixture(autouse=True)
def two_robots(monkeypatch: pytest.MonkeyPatch) -> None:
    """Two robots that can be had and one that cannot; models and borders are there at once."""
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
    monkeypatch.setattr(robot, "load_visuals", lambda *_: list(seen))  # else seconds each time


def choose(server: DashboardServer, name: str) -> None:
    """Begin a change as the panel does, and wait until it has ended in one way or the other."""
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


def test_every_viewer_gets_the_other_robot_with_the_parameters_and_layers_of_before() -> None:
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


def test_four_changes_leave_nothing_behind() -> None:
    """Threads, loops, meshes, widgets, scene nodes and messages are as many as after the second."""
    loops = Loops()
    with served_dashboard(start_loop=loops) as (server, _), viewer(server):
        counts, threads, models = [], [], []
        for k in range(4):
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
        assert counts[1:] == [counts[1]] * 3
        assert counts[1][-1] == 1
        assert max(threads[2:]) <= threads[1]  # fewer, once the tour has asked the browser
        gc.collect()
        assert [ref() is None for ref in models] == [True] * 3 + [False]


def test_nothing_of_a_replaced_robot_waits_for_the_next_collection() -> None:
    """Python might not look for its cycles before several more robots have come."""
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
                page.hand,
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


def test_memory_is_given_back() -> None:
    class Node:
        """Holds itself, and much."""

        def __init__(self) -> None:
            self.itself, self.held = self, bytearray(1000)

    gc.disable()
    try:
        ref = weakref.ref(Node())
        give_back()
        assert ref() is None
    finally:
        gc.enable()


def test_what_a_viewer_held_is_let_go_of() -> None:
    with served_dashboard(start_loop=Loops()) as (server, _), viewer(server):
        old = server.shared.loop
        page = next(iter(server.pages.values()))
        assert isinstance(old, ScriptedLoop)
        page.grip.take()
        page.grip.pull(old.latest().p_ee, None)
        assert isinstance(old.commands[-1], Pull)
        choose(server, OTHER)
        assert old.pulls()[-1] is None


def test_parameters_that_do_not_suit_the_robot_fall_back_and_the_viewers_are_told() -> None:
    loops = Loops()
    told: list[str] = []
    with served_dashboard(start_loop=loops) as (server, _), viewer(server):
        server._notifier.tell = lambda *said: told.append(said[-1])  # type: ignore[method-assign]
        server.shared.tuning.set("border.d_b", 0.3)
        loops.refuses = OWN.replace("border.d_b", 0.3)
        choose(server, OTHER)
        assert title(server) == "The other robot"
        assert server.shared.tuning.config == server.shared.tuning.usual == OWN
        (note,) = told
        assert "all parameters are at their defaults: the robot cannot start with yours" in note
        assert "(the hand does not come there)" in note
        server.shared.tuning.undo()  # nothing is lost
        assert server.shared.tuning.config.border.d_b == 0.3


@pytest.mark.parametrize("why", ["refused", "crashed", "cancelled"])
def test_if_it_fails_the_old_robot_goes_on_and_the_page_says_why(
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
            "refused": "does not come there",
            "crashed": markup.DEFECT,  # the log has the exception, a page never
            "cancelled": "cancelled",
        }[why]
        wait_for(lambda: expected in panel.about.content, what="the reason")
        t = first.latest().t
        wait_for(lambda: first.latest().t > t, what="time to go on")
        loops.refuses = None
        monkeypatch.undo()


@pytest.mark.parametrize(("before", "after"), [("score", "score"), (HIDDEN, HIDDEN)])
def test_of_a_robot_without_the_shown_pairs_the_first_border_is_shown(
    before: str, after: str
) -> None:
    view = View.first(["a", "b"], [])
    view.borders = dict.fromkeys(view.borders, before)
    assert view.of_robot(["c", "d"], []).borders == {"c": after, "d": HIDDEN}


def test_a_page_that_cannot_be_made_does_not_hold_up_the_change(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    loop = ScriptedLoop(husky_panda())
    loop.start()
    server = serve_dashboard(
        loop, husky_panda(), clouds(), port=0, parts=parts(), start_loop=Loops()
    )

    def fails(*_: object) -> None:
        raise ZeroDivisionError("a defect")

    try:
        monkeypatch.setattr(server.shared, "followed_by", fails)
        choose(server, OTHER)
        wait_for(lambda: server.error is not None, what="the end of drawing")
    finally:
        server.stop()
        loop.stop()


def test_a_robot_that_is_not_there_or_not_whole_is_refused_at_once() -> None:
    with served_dashboard(start_loop=Loops()) as (server, _):
        change = server.shared.robot_switch
        for name, words in (
            ("absent", "pip install x"),
            ("nobody", "robot 'nobody' does not exist"),
        ):
            with pytest.raises(Exception, match=words):
                change.begin(name, {}, server.shared.loop)
        assert change.progress is None


def test_a_simulation_that_has_ended_is_replaced_too() -> None:
    with served_dashboard(start_loop=Loops()) as (server, _), viewer(server):
        server.shared.loop.error = LoopError("gone")
        wait_for(lambda: server._failure is not None, what="the failure to be shown")
        choose(server, OTHER)
        assert server.shared.loop.error is None
        assert server._failure is None
        pictures = server.pictures
        time.sleep(0.2)
        wait_for(lambda: server.pictures > pictures, what="pictures")
