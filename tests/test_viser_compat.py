"""viser's private names are used only in one file, and exist in viser."""

from __future__ import annotations

import ast
import asyncio
import logging
import time
import zipfile
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any, get_type_hints

import pytest
import viser
from viser import _messages
from websockets.asyncio.server import ServerConnection

from app.dashboard import job, notifications, server, viser_compat
from app.dashboard.server import is_loopback
from app.dashboard.viser_compat import Channel, _Buffer, close_server, open_server
from tests.browser import wait_for
from tests.raw_client import RawClient

ROOM = Path(__file__).resolve().parent.parent / "app" / "dashboard"
ONE_FILE = "viser_compat.py"
OURS = {"_replace", "_fields", "_exit"}
"""Private names of NamedTuple and of `os`."""
OF_THE_SERVER = {"_websock_server"}
OF_A_CLIENT = {"_websock_connection", "_viser_server"}
OF_ITS_CAMERA = {"_state"}
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
    """Names with an underscore of other objects than `self`, and private modules of viser."""
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
    time.sleep(1.0)
    assert capfd.readouterr().out == ""


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


def test_errors_caused_by_clients_are_logged_once_a_minute(caplog, monkeypatch) -> None:
    monkeypatch.setattr("app.dashboard.viser_compat._Knocks._said", {})
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
    assert is_loopback(host) is alone


@pytest.mark.parametrize("persistent", [False, True])
def test_removal_of_a_node_is_sent_before_it_is_created_again(persistent: bool) -> None:
    """Otherwise the page keeps the former pose, as viser sends no default pose.

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
