"""viser's private names exist in viser; in `app`, one file uses them, and a second its messages."""

from __future__ import annotations

import ast
import asyncio
import dataclasses
import logging
import socket
import time
import warnings
import zipfile
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any, get_type_hints

import msgspec
import pytest
import viser
from hypothesis import given, settings
from hypothesis import strategies as st
from viser import _messages
from websockets.asyncio.server import ServerConnection

from app.cli.serve import _is_loopback
from app.dashboard import job, notifications, server, viser_compat
from app.dashboard.gate import _TAKEN, RefusedError, Uploads, checked
from app.dashboard.viser_compat import Channel, _Buffer, close_server, open_server
from app.errors import ServerError
from tests.browser import wait_for
from tests.raw_client import RawClient, link, served

ROOM = Path(__file__).resolve().parent.parent / "app" / "dashboard"
ONE_FILE = "viser_compat.py"
OURS = {"_replace", "_fields", "_exit"}
"""Private names of NamedTuple and of `os`."""
OF_THE_SERVER = {"_websock_server"}
OF_A_CLIENT = {"_websock_connection", "_viser_server"}
OF_ITS_CAMERA = {"_state"}
OF_A_LOOP = {"_transports"}
OF_A_WIDGET = {"_impl"}
OF_CONNECTIONS = {
    "_live_connections",
    "_background_event_loop",
    "_broadcast_buffer",
    "_client_state_from_id",
    "_server_thread",
}
OF_AN_EVENT = {"_value", "_waiters"}
"""Private names of asyncio's events; viser's queue waits for one."""
ALSO = {"gate.py": {"_messages"}}
"""Viser's own message types define the messages of a page."""


def private(path: Path) -> set[str]:
    """Private attributes used on objects except `self` and `before`; private viser imports."""
    names = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Attribute):
            if not (isinstance(node.value, ast.Name) and node.value.id in {"self", "before"}):
                names.add(node.attr)
        elif isinstance(node, ast.ImportFrom) and (node.module or "").startswith("viser"):
            names |= {alias.name for alias in node.names}
    # Dunder names such as __version__ are public.
    return {name for name in names if name[0] == "_" and name[:2] != "__"} - OURS


@pytest.mark.parametrize("path", sorted(ROOM.rglob("*.py")), ids=lambda path: path.name)
def test_private_names_are_used_in_one_file(path: Path) -> None:
    assert path.name == ONE_FILE or private(path) <= ALSO.get(path.name, set())


def test_viser_has_the_private_names() -> None:
    server = open_server("127.0.0.1", 0)
    try:
        gui = server.gui
        used = private(ROOM / ONE_FILE) - OF_A_CLIENT - OF_ITS_CAMERA - {"_Buffer", "_infra"}
        for owner, names in (
            (server, OF_THE_SERVER),
            (gui.add_checkbox("box", False), OF_A_WIDGET),
            (server._websock_server, OF_CONNECTIONS),
            (asyncio.Event(), OF_AN_EVENT),
            (server._websock_server._background_event_loop, OF_A_LOOP),
            (viser, {"_messages", "_gui_api", "_gui_handles", "_icons"}),
        ):
            assert [name for name in names if not hasattr(owner, name)] == []
            used -= names
        assert used
        assert [name for name in used if not hasattr(gui, name)] == []
    finally:
        close_server(server)


def test_icons_and_type_hints_are_those_of_viser(monkeypatch: pytest.MonkeyPatch) -> None:
    server = open_server("127.0.0.1", 0)
    try:
        original = viser._icons.svg_from_icon.__wrapped__
        expected = {icon: original(icon) for icon in ("player-pause", "home")}
        server.gui.add_button("first", icon="phone")
        opened: list[object] = []
        monkeypatch.setattr(zipfile.ZipFile, "__init__", lambda *_, **__: opened.append(_))
        for icon, svg in expected.items():
            button = server.gui.add_button("b", icon=icon)  # type: ignore[arg-type]
            assert button._impl.props._icon_html == svg
            assert button._prop_hints == get_type_hints(type(button._impl.props))
        assert opened == []
    finally:
        close_server(server)


def test_slow_shutdown_of_a_server_prints_nothing(capfd) -> None:
    server = open_server("127.0.0.1", 0)
    loop = server._websock_server._background_event_loop
    assert loop is not None
    loop.call_soon_threadsafe(time.sleep, 1.5)  # [s] longer than viser waits
    close_server(server)
    time.sleep(0.7)
    assert capfd.readouterr().out == ""


@pytest.mark.parametrize("request_", [b"", b"GET / HTTP/1.1\r\nHost: localhost\r\n\r\n"])
def test_server_ends_before_a_client_reads_or_asks(request_: bytes) -> None:
    server = open_server("127.0.0.1", 0)
    with socket.create_connection(("127.0.0.1", server.get_port())) as client:
        client.sendall(request_)
        if request_:
            client.recv(1)  # the answer is larger than the buffers of both ends
        begin = time.monotonic()
        close_server(server)
        assert time.monotonic() - begin < 5.0  # [s] websockets itself waits for 10 s


def test_invalid_messages_of_a_page_are_ignored() -> None:
    heard: list[object] = []
    box = SimpleNamespace(on_update=lambda _: None)
    client: Any = SimpleNamespace(gui=SimpleNamespace(add_text=lambda *_, **__: box))
    notifier: Any = SimpleNamespace(guard=lambda act: act)
    channel = Channel(client, notifier)
    channel.on("go", heard.append)
    channel.on("now", lambda: heard.append("now"))
    wrong = ("x", "NaN", "1e999", "null", "9" * 400, '"x"', "1,2", "[1]", "")
    for text in ('[1,"go",2]', *(f'[1,"go",{each}]' for each in wrong), '[1,"now"]', '[1,"now",1]'):
        event: Any = SimpleNamespace(client=client, target=SimpleNamespace(value=text))
        channel._hear(event)
    assert heard == [2.0, "now"]


def test_a_server_without_a_gate_is_closed(monkeypatch) -> None:
    closed = []
    monkeypatch.setattr(viser_compat, "close_server", lambda each: closed.append(each.stop()))
    # As if viser had another way to start its server.
    monkeypatch.setattr("app.dashboard.gate.websockets_server", SimpleNamespace(serve=None))
    with pytest.raises(ServerError, match="unknown way"):
        open_server("127.0.0.1", 0)
    assert len(closed) == 1


def test_errors_caused_by_clients_are_logged_once_a_minute(caplog, monkeypatch) -> None:
    monkeypatch.setattr("app.dashboard.viser_compat._said", {})
    close_server(open_server("127.0.0.1", 0))
    modules = job, notifications, server, viser_compat
    for _ in range(3):
        for module in modules:
            try:
                int("a defect")
            except ValueError as error:
                module.logger.error(f"{module.__name__} failed", exc_info=error)
        logging.getLogger("asyncio").warning("socket.send() raised exception.")
    failed = [f"{module.__name__} failed" for module in modules]
    assert sorted(caplog.messages) == [*failed, "socket.send() raised exception."]


def test_large_message_is_read_in_small_pieces(monkeypatch) -> None:
    read, usual = [], ServerConnection.data_received
    monkeypatch.setattr(
        ServerConnection,
        "data_received",
        lambda self, data: (read.append(len(data)), usual(self, data)),
    )
    opened = open_server("127.0.0.1", 0)
    try:
        with RawClient(f"http://127.0.0.1:{opened.get_port()}") as client:
            wait_for(opened.get_clients, what="the client")
            client.send_raw(b"x" * 10**6)
            wait_for(lambda: sum(read) > 10**6, what="all bytes")
    finally:
        close_server(opened)
    assert max(read) <= 2**13


@pytest.mark.parametrize(
    ("host", "alone"), [("127.0.0.1", True), ("localhost", True), ("::1", True), ("0.0.0.0", False)]
)
def test_is_loopback_detects_local_addresses(host, alone) -> None:
    assert _is_loopback(host) is alone


@pytest.mark.parametrize("persistent", [False, True])
def test_removal_of_a_node_is_sent_before_it_is_created_again(persistent: bool) -> None:
    """Without the removal the page keeps the former pose, because viser sends no default pose.

    Persistent messages, which later clients receive from the start, need no removal.
    """
    loop = asyncio.new_event_loop()
    queue = _Buffer(loop, persistent_messages=persistent)
    frame = _messages.FrameMessage("/robot", SimpleNamespace())
    for message in (frame, _messages.RemoveSceneNodeMessage("/robot"), replace(frame)):
        queue.push(message)
    kinds = [type(message).__name__ for message in queue.message_from_id.values()]
    assert kinds == ["RemoveSceneNodeMessage"] * (not persistent) + ["FrameMessage"]
    loop.close()


def test_messages_to_a_closed_viewer_are_dropped_without_a_warning():
    with warnings.catch_warnings(record=True) as warned, served() as server:
        with RawClient(f"http://127.0.0.1:{server.get_port()}"):
            wait_for(server.get_clients, what="the client")
            [client] = server.get_clients().values()
        wait_for(lambda: not server.get_clients(), what="the end of the viewer")
        client.gui.add_text("x", "")
    assert [str(each.message) for each in warned] == []


def messages_of_kind(kind, server, client):
    """Messages of a kind within viser's own annotations, about existing elements."""
    known = {
        "uuid": list(client.gui._gui_input_handle_from_uuid),
        "source_component_uuid": list(client.gui._gui_input_handle_from_uuid),
        "name": [*client.scene._handle_from_node_name],
    }
    hints = get_type_hints(kind)
    fields = {
        field.name: st.sampled_from(known[field.name])
        if field.name in known
        else st.just({"value": 0.7})
        if field.name == "updates"
        else st.from_type(hints[field.name])
        for field in dataclasses.fields(kind)
        if field.init
    }
    return st.fixed_dictionaries({"type": st.just(kind.__name__), **fields})


@pytest.fixture(scope="module")
def visited():
    """A server and a viewer with a widget for each kind of message."""
    with served() as server, RawClient(f"http://127.0.0.1:{server.get_port()}"):
        wait_for(server.get_clients, what="the client")
        [client] = server.get_clients().values()
        client.gui.add_slider("x", min=0.0, max=1.0, step=0.1, initial_value=0.3)
        client.gui.add_checkbox("y", False)
        client.gui.add_upload_button("z")
        client.scene.add_transform_controls("/gizmo")
        client.scene.add_box("/box").on_drag()(lambda _: None)
        client.scene.on_click()(lambda _: None)
        yield server, client


@pytest.mark.parametrize("kind", _TAKEN, ids=lambda kind: kind.__name__)
def test_visers_handlers_process_every_message_that_passes_the_gate(kind, visited):
    """Random messages within viser's own types either are refused or raise no error."""
    server, client = visited
    loop = server._websock_server._background_event_loop

    async def handled(message):
        for place in (server._websock_server, client._websock_connection):
            await place._handle_incoming_message(client.client_id, message)

    @settings(database=None)
    @given(messages_of_kind(kind, server, client))
    def bears(content):
        widgets = client.gui._gui_input_handle_from_uuid
        try:
            data = checked(msgspec.msgpack.encode(content), Uploads(1000), widgets.get)
        except (RefusedError, OverflowError):  # no message holds such a number
            return
        message = _messages.Message.deserialize(data)
        asyncio.run_coroutine_threadsafe(handled(message), loop).result(10.0)

    bears()


async def _set_between_look_and_wait(event: asyncio.Event) -> bool:
    """Whether a waiter wakes if another thread sets the event just before the wait starts."""
    waiter = asyncio.ensure_future(event.wait())
    await asyncio.sleep(0)
    event._value = True  # the thread's call, which saw no waiter yet
    asyncio.get_running_loop().call_soon(event.set)
    done, _ = await asyncio.wait([waiter], timeout=0.2)
    waiter.cancel()
    return bool(done)


def test_no_wake_up_of_the_message_queue_is_lost():
    async def both():
        buffer = _Buffer(asyncio.get_running_loop(), persistent_messages=False)
        ours = await _set_between_look_and_wait(buffer.message_event)
        return ours, await _set_between_look_and_wait(asyncio.Event())

    assert asyncio.run(both()) == (True, False), "viser's own event, the second one, loses it"


def test_viewers_and_broadcasts_use_the_queue_without_lost_wake_ups():
    with served() as server:
        assert type(server._websock_server._broadcast_buffer) is _Buffer

        async def come():
            async with link(server, None) as connection:
                await connection.recv()
                states = server._websock_server._client_state_from_id
                return [type(state.message_buffer) for state in states.values()]

        assert asyncio.run(come()) == [_Buffer]
