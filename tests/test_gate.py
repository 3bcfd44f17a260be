"""The gate in front of viser: permitted connections and messages."""

from __future__ import annotations

import asyncio
import io
import logging
import math
import socket
import time
import urllib.error
import urllib.request
from contextlib import suppress
from html import escape
from types import SimpleNamespace

import msgspec
import pytest
import viser
import websockets
from hypothesis import given
from hypothesis import strategies as st
from PIL import Image
from viser import _messages
from websockets.asyncio import server as websockets_server
from websockets.asyncio.client import connect

from app.dashboard.gate import (
    _TAKEN,
    LARGEST_MESSAGE,
    Gate,
    RefusedError,
    Uploads,
    checked,
    is_alike,
    is_allowed,
)
from app.dashboard.notifications import Notifier
from app.errors import ServerError
from tests.browser import wait_for
from tests.raw_client import RawClient, link, served

CAMERA = {
    "type": "ViewerCameraMessage",
    "wxyz": [1, 0.0, 0.0, 0.0],
    "position": [2.0, 2.0, 1.5],
    "fov": 0.75,
    "near": 0.01,
    "far": 100.0,
    "image_height": 900,
    "image_width": 1600,
    "look_at": [0.0, 0.0, 0.4],
    "up_direction": [0.0, 0.0, 1.0],
}


def pass_on(message, *, uploads=None, widget=None):
    data = msgspec.msgpack.encode(message)
    passed = checked(data, uploads or Uploads(1000), lambda uuid: widget)
    assert passed == data
    return passed


def camera(**changes):
    return {**CAMERA, **changes}


@pytest.mark.parametrize(
    ("of_page", "host", "allowed"),
    [
        ("http://127.0.0.1:8080", "127.0.0.1:8080", True),
        ("http://localhost:8080", "localhost:8080", True),
        ("http://LOCALHOST:8080", "localhost:8080", True),
        ("http://[::1]:8080", "[::1]:8080", True),
        ("http://192.168.1.7:8080", "192.168.1.7:8080", True),
        ("http://robot:8080", "robot:8080", True),
        ("https://robot", "robot.", True),
        ("https://robot.", "robot.", True),  # the same name, fully qualified
        ("https://robot", "robot:443", True),  # proxies that add the default port,
        ("http://robot:8080", "robot", True),  # lose the port,
        ("https://robot", "127.0.0.1:8080", True),  # or forward their own address
        ("https://192.168.1.7", "192.168.1.7:443", True),
        ("http://192.168.1.7", "192.168.1.7:443", False),
        ("http://robot.evil.example", "127.0.0.1:8080", False),
        ("http://robot:x", "127.0.0.1:8080", False),
        ("http://192.168.1.7:9000", "192.168.1.7:8080", False),
        (None, "127.0.0.1:8080", True),  # no browser
        ("http://evil.example", "127.0.0.1:8080", False),
        ("http://127.0.0.1:9000", "127.0.0.1:8080", False),  # another server's page
        ("http://localhost:8080", "127.0.0.1:8080", False),
        ("null", "127.0.0.1:8080", False),  # a file, or a sandboxed frame
        ("", "127.0.0.1:8080", False),
        (
            "http://evil.example:8080",
            "evil.example:8080",
            False,
        ),  # it may resolve to this host
        (None, "evil.example:8080", False),
        ("http://localhost.evil.example:8080", "localhost.evil.example:8080", False),
        ("http://127.0.0.1:8080", None, False),
        (None, "[", False),  # not an address
        ("http://[", "127.0.0.1:8080", False),
        (None, "127.0.0.1:x", False),
        (None, "127.0.0.1:8080; script-src *", False),
        (None, "127.0.0.1:8080/a", False),
    ],
)
def test_only_the_servers_own_page_is_allowed(of_page, host, allowed):
    assert is_allowed(of_page, host, {"robot"}, {"robot"}) is allowed


def try_to_connect(server, of_page):
    async def attempt():
        async with link(server, of_page) as connection:
            return await asyncio.wait_for(connection.recv(), timeout=10.0)

    return asyncio.run(attempt())


def get(server, path, host=""):
    """Status, headers and text of a page; `host` is the name by which the server is reached."""
    address = f"http://127.0.0.1:{server.get_port()}{path}"
    headers = {"Host": host} if host else {}
    try:
        answer = urllib.request.urlopen(urllib.request.Request(address, headers=headers))
    except urllib.error.HTTPError as error:
        answer = error
    return answer.status, answer.headers, answer.read()


@pytest.mark.parametrize("host", ["127.0.0.1", "localhost", "LOCALHOST", "::1", "robot.lan"])
def test_pages_of_other_ports_need_the_option(host):
    shown = f"[{host}]" if ":" in host else host
    for allowed in ((), (host,)):
        gate = Gate(host, allowed, 0)
        names = gate._own_names, gate._allowed
        assert is_allowed(f"http://{shown}:8080", f"{shown}:8080", *names)
        assert is_allowed(f"http://{shown}:9000", f"{shown}:8080", *names) is bool(allowed)


def test_the_servers_own_page_can_connect_and_a_foreign_page_cannot():
    with served() as server:
        with pytest.raises(websockets.InvalidStatus) as refused:
            try_to_connect(server, "http://evil.example")
        assert refused.value.response.status_code == 403
        assert try_to_connect(server, f"http://127.0.0.1:{server.get_port()}")
        assert try_to_connect(server, None)


@pytest.mark.parametrize(
    ("request_line", "status", "has_page"),
    [
        ("HEAD / HTTP/1.1", 200, False),  # a check of the server's health
        ("GET / HTTP/1.0", 200, True),  # a proxy in its usual configuration
        ("HEAD /nothing HTTP/1.0", 404, False),
        ("OPTIONS * HTTP/1.1", 405, True),
        ("POST / HTTP/1.1\r\nContent-Length: 3\r\n\r\nabc", 405, True),
    ],
)
def test_every_request_gets_an_answer(request_line, status, has_page, caplog):
    with served() as server, socket.create_connection(("127.0.0.1", server.get_port())) as raw:
        raw.sendall(f"{request_line}\r\nHost: 127.0.0.1\r\n\r\n".encode())
        head, _, page = raw.makefile("rb").read().partition(b"\r\n\r\n")
    assert head.startswith(f"HTTP/1.1 {status} ".encode())
    assert b"frame-ancestors 'none'" in head
    assert bool(page) is has_page
    assert caplog.records == []


@pytest.mark.parametrize(
    "query",
    ["websocket=ws://evil.example", "playbackPath=x", "initDarkMode=1", "=x", "fixedDpr=1&<b>=1"]
    + [f"fixedDpr={value}" for value in ("", "50", "nan", "-1", "1e9")],
)
def test_a_link_cannot_set_options_of_the_page(query):
    with served() as server:
        status, _, text = get(server, f"/?{query}")
        assert status == 400
        assert escape(f"unknown parameter in the address: {query}.").encode() in text
        assert b"<b>" not in text
        assert get(server, "/?fixedDpr=0.5")[0] == 200


@pytest.mark.parametrize(
    ("header", "status"),
    [("Host: \xff", 403), ("Host: a\r\nHost: b", 400), ("Host: a\r\nCookie: a\r\nCookie: b", 400)],
)
def test_an_unreadable_request_is_refused_without_a_log_entry(header, status, caplog):
    with served() as server, socket.create_connection(("127.0.0.1", server.get_port())) as raw:
        raw.sendall(f"GET //[ HTTP/1.1\r\n{header}\r\n\r\n".encode("latin1"))
        answer = raw.makefile("rb").read()
    assert answer.startswith(f"HTTP/1.1 {status} ".encode())
    assert b"frame-ancestors 'none'" in answer
    assert caplog.records == []


def test_connections_without_a_session_are_logged_once_a_minute(caplog, monkeypatch):
    monkeypatch.setattr("app.dashboard.viser_compat._said", {})
    with served() as server:
        here = "127.0.0.1", server.get_port()
        request = b"GET /x HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n"
        for knock in (b"", b"", 2 * request, 2 * request):
            with socket.create_connection(here) as raw:
                raw.sendall(knock)
                raw.shutdown(socket.SHUT_WR)
                raw.makefile("rb").read()
        assert get(server, "/")[0] == 200
        for _ in range(2):
            logging.getLogger("asyncio").error("socket.accept() out of system resource\nsocket: x")
    logged = [record for record in caplog.records if record.levelno >= logging.ERROR]
    assert 1 <= len(logged) == len({record.getMessage() for record in logged}) <= 3
    assert all("\n" not in record.getMessage() and not record.exc_info for record in logged)
    assert "a connection: socket.accept() out of system resource" in caplog.text


def test_an_error_while_answering_is_logged_with_its_traceback(caplog, monkeypatch):
    """Viser itself hides all errors before a connection is open."""
    with served() as server:
        assert get(server, "/")[0] == 200  # from here on, viser does so
        with monkeypatch.context() as patched:
            patched.setattr("app.dashboard.gate.is_allowed", lambda *_: {}["a mistake"])
            assert get(server, "/")[0] == 500
    [logged] = [record for record in caplog.records if record.levelno >= logging.ERROR]
    assert "a mistake" in logged.getMessage()
    assert isinstance(logged.exc_info[1], KeyError)


def test_an_error_within_an_open_connection_is_logged_with_its_traceback(caplog):
    with served() as server, RawClient(f"http://127.0.0.1:{server.get_port()}"):
        wait_for(server.get_clients, what="the client")
        [connection] = server._websock_server._live_connections.values()
        try:
            raise AssertionError("a mistake")
        except AssertionError:
            connection.logger.exception("unexpected internal error")
    [logged] = [record for record in caplog.records if record.levelno >= logging.ERROR]
    assert "a mistake" in caplog.text
    assert logged.exc_info


def test_pages_of_another_version_are_closed_without_output(capfd):
    async def reason(server, protocols):
        address = f"ws://127.0.0.1:{server.get_port()}"
        async with connect(address, subprotocols=protocols) as connection:
            with pytest.raises(websockets.ConnectionClosed) as closed:
                await asyncio.wait_for(connection.recv(), 10.0)
        return closed.value.rcvd

    with served() as server:
        for protocols in (None, ["viser-v0.0.1"]):
            closed = asyncio.run(reason(server, protocols))
            assert closed.code == 1002  # by this code a page does not try again
            assert "another version" in closed.reason
    assert "ersion" not in capfd.readouterr().out


def test_every_answer_forbids_frames_and_connections_to_others():
    with served() as server:
        for path, expected in (
            ("/", 200),
            ("/nothing", 404),
            ("/?websocket=x", 400),
            (f"/{'a' * 300}", 414),
        ):
            status, headers, _ = get(server, path)
            assert status == expected
            policy = headers["Content-Security-Policy"]
            assert "frame-ancestors 'none'" in policy
            assert f"connect-src 'self' ws://127.0.0.1:{server.get_port()} data:" in policy
            assert headers["X-Frame-Options"] == "DENY"


def test_a_viewer_beyond_the_limit_is_refused_until_another_leaves(monkeypatch):
    monkeypatch.setattr("app.dashboard.gate._MOST_VIEWERS", 2)

    async def visit(server):
        async with link(server, None), link(server, None):
            with pytest.raises(websockets.InvalidStatus) as refused:
                await link(server, None)
            assert refused.value.response.status_code == 503
        for _ in range(100):  # the server registers the end a little later
            try:
                async with link(server, None) as connection:
                    return await asyncio.wait_for(connection.recv(), timeout=10.0)
            except websockets.InvalidStatus:
                await asyncio.sleep(0.05)
        return b""

    with served() as server:
        assert asyncio.run(visit(server))


def test_the_gate_does_not_apply_to_other_servers():
    before = websockets_server.serve
    with served():
        assert websockets_server.serve is before


def test_a_viser_without_the_gates_entry_point_is_refused():
    with (
        pytest.raises(ServerError, match="this version of viser"),
        Gate("127.0.0.1", (), 0).closed(),
    ):
        pass


def test_messages_of_a_page_pass_unchanged():
    pass_on(CAMERA)
    pass_on({"type": "GuiUpdateMessage", "uuid": "a", "updates": {"value": [1, 2.5, "x", True]}})
    pass_on(
        {
            "type": "TransformControlsUpdateMessage",
            "name": "/a",
            "wxyz": [1, 0, 0, 0],
            "position": [0.1, 0.2, 0.3],
            "owner": "c",
        }
    )


@pytest.mark.parametrize(
    "message",
    [
        camera(position=[0.0, 0.0]),
        camera(position=[0.0, 0.0, math.nan]),
        camera(look_at=[math.inf, 0.0, 0.0]),
        camera(fov="wide"),
        camera(fov=math.nan),
        camera(image_height=None),
        camera(extra=1),
        {k: v for k, v in CAMERA.items() if k != "wxyz"},
        {"type": "GuiUpdateMessage", "uuid": "a", "updates": {"label": "forged"}},
        {"type": "GuiUpdateMessage", "uuid": "a", "updates": {}},
        {"type": "GuiUpdateMessage", "uuid": "a", "updates": {"value": 1, "visible": False}},
        {"type": "GuiUpdateMessage", "uuid": 3, "updates": {"value": 1}},
        {"type": "GuiUpdateMessage", "uuid": "a", "updates": {"value": math.nan}},
        {"type": "GuiUpdateMessage", "uuid": "a", "updates": {"value": 1e300}},  # int() of it
        {"type": "GuiUpdateMessage", "uuid": "a", "updates": {"value": -(2**60)}},
        {"type": "GuiUpdateMessage", "uuid": "a", "updates": {"value": [[[[[[[[1]]]]]]]]}},
        {"type": "GuiUpdateMessage", "uuid": "a" * 5000, "updates": {"value": 1}},
        {"type": "GuiFormDirtyMessage", "uuid": "a"},  # it would be stored for ever
        {"type": "ShareUrlRequest"},
        {"type": "ShareUrlDisconnect"},
        {"type": "RunJavascriptMessage", "source": "1"},
        {"type": "NoSuchMessage"},
        {},
        [],
        7,
    ],
    ids=repr,
)  # viser itself accepts these
def test_messages_that_no_page_sends_are_refused(message):
    with pytest.raises(RefusedError):
        pass_on(message)


@pytest.mark.parametrize(
    "data", [b"", b"\xff" * 9, b"\x91" * 5000, "text", b"\xdd\xff\xff\xff\xff"]
)
def test_bytes_that_are_no_message_are_refused(data):
    with pytest.raises(RefusedError):
        checked(data, Uploads(0), lambda uuid: None)


@pytest.mark.parametrize(
    ("parts", "pause", "stays"),
    [([b""] * 90, 0.0, True), ([b"x" * 2**17] * 9, 0.0, False), ([b""] * 9, 0.1, False)],
    ids=["many", "large", "slow"],
)
def test_a_too_large_or_too_slow_message_ends_its_connection(parts, pause, stays, monkeypatch):
    monkeypatch.setattr("app.dashboard.gate._SLOWEST", 0.5)
    with served() as server, RawClient(f"http://127.0.0.1:{server.get_port()}") as client:
        camera = msgspec.msgpack.encode(CAMERA)

        def message():
            yield camera[:9]
            yield from (time.sleep(pause) or part for part in parts)
            client._thread.join(0.0 if stays else 10.0)  # the client reads until the end
            yield camera[9:]

        with suppress(websockets.ConnectionClosed):
            client.send_raw(message())
        client._thread.join(0.5)
        assert client._thread.is_alive() is stays


def test_every_message_kind_of_viser_is_accepted_or_listed_as_refused():
    with served() as server, RawClient(f"http://127.0.0.1:{server.get_port()}"):
        wait_for(server.get_clients, what="the client")
        [client] = server.get_clients().values()
        places = server._websock_server, client._websock_connection
        obeyed = {kind for place in places for kind in place._incoming_handlers}
    assert obeyed - set(_TAKEN) == {
        _messages.GuiButtonHoldMessage,
        _messages.GuiFormDirtyMessage,
        _messages.GuiFormSubmitMessage,
        _messages.SceneNodeClickMessage,
        _messages.ScenePointerMessage,
        _messages.ShareUrlDisconnect,
        _messages.ShareUrlRequest,
    }
    requested = _messages.GetRenderResponseMessage
    assert set(_TAKEN) - obeyed == {requested, _messages.FileTransferPartAck}


def test_only_a_picture_may_be_large():
    content = b"x" * 2 * LARGEST_MESSAGE
    pass_on(answered(png() + content))
    for message in (
        {"type": "GuiUpdateMessage", "uuid": "a", "updates": {"value": content}},
        {
            "type": "FileTransferPart",
            "source_component_uuid": None,
            "transfer_uuid": "a",
            "part_index": 0,
            "content": content,
        },
        {
            "type": "GetRenderResponseMessage",
            "payload": [1] * (LARGEST_MESSAGE + 1),
            "render_uuid": "a",
        },
    ):
        with pytest.raises(RefusedError):
            pass_on(message)


def png(size=(8, 4), frames=1):
    file = io.BytesIO()
    more = [Image.new("1", size, k % 2) for k in range(1, frames)]
    Image.new("1", size).save(file, "PNG", save_all=True, append_images=more)
    return file.getvalue()


def answered(payload):
    return {"type": "GetRenderResponseMessage", "payload": payload, "render_uuid": "a"}


@pytest.mark.parametrize(
    "payload",
    [b"x", b"GIF89a" + bytes(30), png((20_000, 2_000)), png(frames=3), png()[:20], b"\x89PNG"],
    ids=["bytes", "another kind", "many pixels", "many frames", "cut", "short"],
)  # some unpack to gigabytes
def test_a_reply_that_is_no_picture_or_too_large_unpacked_is_refused(payload):
    pass_on(answered(png()))
    pass_on(answered(b""))  # a page that could draw none
    with pytest.raises(RefusedError, match="not a still PNG picture"):
        pass_on(answered(payload))


def announced(size, parts=1, transfer="a"):
    return {
        "type": "FileTransferStartUpload",
        "source_component_uuid": "b",
        "transfer_uuid": transfer,
        "filename": "x.zip",
        "mime_type": "application/zip",
        "part_count": parts,
        "size_bytes": size,
    }


def part(content, transfer="a", index=0):
    return {
        "type": "FileTransferPart",
        "source_component_uuid": "b",
        "transfer_uuid": transfer,
        "part_index": index,
        "content": content,
    }


def test_an_upload_accepts_exactly_the_announced_parts():
    uploads = Uploads(1000)
    pass_on(announced(900, 2), uploads=uploads)
    pass_on(part(b"x" * 500), uploads=uploads)
    for wrong in (401, 1), (399, 1), (1, 0), (1, 2):
        wrong = part(b"x" * wrong[0], index=wrong[1])
        with pytest.raises(RefusedError, match="announced"):
            pass_on(wrong, uploads=uploads)
    pass_on(part(b"x" * 400, index=1), uploads=uploads)
    with pytest.raises(RefusedError, match="announced"):
        pass_on(part(b"", index=2), uploads=uploads)


def test_a_duplicate_part_of_an_upload_is_refused():
    """If a duplicate counted as a new part, viser would wait for ever for the missing part."""
    uploads = Uploads(1000)
    for transfer in ("a", "b"):
        pass_on(announced(900, 3, transfer), uploads=uploads)
        pass_on(part(b"x" * 450, transfer, index=0), uploads=uploads)
        with pytest.raises(RefusedError, match="announced"):
            pass_on(part(b"x" * 450, transfer, index=0), uploads=uploads)
    with pytest.raises(RefusedError, match="too many uploads at a time"):  # of another viewer
        pass_on(announced(900, 3, "c"), uploads=Uploads(1000, [uploads]))


def test_empty_files_can_be_uploaded_one_after_the_other():
    uploads = Uploads(1000)
    for transfer in ("a", "b", "c"):
        pass_on(announced(0, 0, transfer), uploads=uploads)


def test_uploads_are_bounded_in_size_and_number():
    uploads = Uploads(1000)
    for size, parts in ((1001, 1), (-1, 1), (-5, -5), (10, 1_000_000_000), (10, 0), (0, 1)):
        with pytest.raises(RefusedError):
            pass_on(announced(size, parts), uploads=uploads)
    pass_on(announced(900, transfer="a"), uploads=uploads)
    pass_on(announced(900, transfer="b"), uploads=uploads)
    with pytest.raises(RefusedError, match="too many uploads at a time"):
        pass_on(announced(900, transfer="c"), uploads=uploads)
    pass_on(part(b"x" * 900), uploads=uploads)
    pass_on(announced(900, transfer="c"), uploads=uploads)


def test_only_upload_widgets_accept_a_file():
    """Start and parts of an upload name an element; viser would set its value to the file."""
    slider, button = (SimpleNamespace(value=value) for value in (0.3, viser.UploadedFile("", b"")))
    uploads = Uploads(1000)
    pass_on(announced(9), uploads=uploads, widget=button)
    for message in (announced(0, 0, "b"), part(b"x" * 9)):
        with pytest.raises(RefusedError, match="accepts no files"):
            pass_on(message, uploads=uploads, widget=slider)
    pass_on(part(b"x" * 9), uploads=uploads, widget=button)


values = st.recursive(
    st.none() | st.booleans() | st.integers(-9, 9) | st.floats() | st.text(max_size=3),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=2), inner),
    max_leaves=6,
)


OFFERED = [
    2,
    0.5,
    True,
    "",
    "b",
    "3",
    [0.5, 2],
    ["b", "c"],
    ["3", "4"],
    [0.5],
    [[1, 2], 3],
    [],
    None,
    {},
]
"""Values of every kind that a message can contain."""


@pytest.mark.parametrize(
    ("current", "accepted"),
    [
        (1, [2, 0.5]),
        (0.5, [2, 0.5]),
        (False, [True]),
        ("a", ["", "b", "3"]),
        ((1.0, 2.0), [[0.5, 2]]),
        (("a", "b"), [["b", "c"], ["3", "4"]]),
    ],
)
def test_a_widget_accepts_only_values_that_viser_can_cast_to_its_kind(current, accepted):
    """A cast to an integer loses at most a fraction."""
    found = [value for value in OFFERED if is_alike(value, current)]
    assert [str(value) for value in found] == [str(value) for value in accepted]  # True == 1
    whole, shown = isinstance(current, tuple), current if isinstance(current, tuple) else (current,)
    for values in found if whole else [[value] for value in found]:
        for own, value in zip(shown, values, strict=True):
            cast = type(own)(value)
            assert abs(cast - value) < 1.0 if type(own) is int else cast == value


def test_a_value_that_is_not_among_the_choices_is_refused():
    choice = SimpleNamespace(value="a", options=("a", "b"))
    message = {"type": "GuiUpdateMessage", "uuid": "w", "updates": {"value": "b"}}
    pass_on(message, widget=choice)
    with pytest.raises(RefusedError, match="'c' is not one of the choices"):
        pass_on(message | {"updates": {"value": "c"}}, widget=choice)


@given(st.dictionaries(st.sampled_from(list(CAMERA)), values, max_size=3))
def test_any_camera_message_is_complete_and_finite_or_refused(changes):
    message = {**CAMERA, **changes}
    try:
        pass_on(message)
    except RefusedError:
        return
    read = _messages.Message.deserialize(msgspec.msgpack.encode(message))
    numbers = [*read.wxyz, *read.position, *read.look_at, *read.up_direction, read.fov]
    assert len(numbers) == 14
    assert all(map(math.isfinite, numbers))


@pytest.mark.parametrize(
    "updates",
    [
        {"value": "much"},
        {"value": [0.2]},
        {"value": None},
        {"value": True},
        {},
        {"value": 0.2, "update_cb": []},
        {"gui_api": 1},
        {"removed": True},
    ],
)
def test_an_invalid_widget_value_is_reported_and_reset_at_its_sender(updates, monkeypatch):
    notices, sent = [], []
    monkeypatch.setattr(Notifier, "warn", lambda _, client, text: notices.append(text))
    with served() as server:
        slider = server.gui.add_slider("x", min=0.0, max=1.0, step=0.1, initial_value=0.3)
        state = dict(vars(slider._impl))
        with RawClient(f"http://127.0.0.1:{server.get_port()}") as raw:
            wait_for(server.get_clients, what="the client")
            [client] = server.get_clients().values()
            monkeypatch.setattr(client._websock_connection, "queue_message", sent.append)
            raw.send(_messages.GuiUpdateMessage(slider._impl.uuid, updates))
            wait_for(lambda: sent, what="the valid value")
        assert [message.updates for message in sent] == [{"value": 0.3}]
        assert len(notices) == 1
        assert vars(slider._impl) == state


def test_the_page_of_a_refused_host_name_states_the_option_to_allow_it():
    with served() as server:
        status, _, page = get(server, "/", "Robot.local:8080")
        assert status == 403
        assert b"<code>--allow-host Robot.local</code>" in page
    with served(allowed=["robot.local", "my_service"]) as server:
        for name in ("Robot.local:8080", "robot.local.", "my_service"):
            assert get(server, "/", name)[0] == 200
        assert b"<script>" not in get(server, "/", "<script>")[2]
        status, _, page = get(server, "/?unknown=1", "robot.local")
        assert status == 400
        assert b'href="."' in page  # relative, because a proxy may serve it below a path
