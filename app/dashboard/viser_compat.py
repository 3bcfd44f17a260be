"""Servers of viser, silent and behind a gate; calls to and from pages; watchdog of connections.

In `app`, only this module and `app.dashboard.gate` use viser's private names in Python. If one of
these names changes, `tests/test_viser_compat.py` or `tests/test_gate.py` fails.
"""

import asyncio
import contextlib
import io
import json
import logging
import math
import threading
import time
import traceback
import warnings
import zipfile
from collections.abc import Callable, Sequence
from functools import cache
from inspect import signature
from types import NoneType
from typing import Any, NamedTuple, get_type_hints

import numpy as np
import viser
from viser import _gui_api, _gui_handles, _icons, _messages
from viser._assignable_props_api import AssignablePropsBase
from viser.infra import _infra
from viser.infra._async_message_buffer import AsyncMessageBuffer
from websockets.exceptions import ConnectionClosed, WebSocketException
from websockets.protocol import CONNECTING

from app.dashboard.gate import LARGEST_PICTURE, Gate, RefusedError
from app.dashboard.notifications import Notifier
from app.strict import from_json

logger = logging.getLogger("app.dashboard")  # for all errors that viewers can cause
_GRACE = 0.3  # [s] time for connections to close regularly; then the others are broken off
_ENDING = 10.0  # [s] timeout for the end of viser's thread
LOOK = 0.5  # [s] period of checks of the connections
SILENT = 3  # [checks] without an answer, after which a viewer counts as silent
STUCK = 20  # [checks] without an answer or a delivery, after which a connection is closed
_KNOCKS = (  # log records of failed connections; the cause may be a peer
    "opening handshake failed",
    "unexpected internal error",
    "socket.accept() out of system resource",
)
_pictures = threading.BoundedSemaphore(2)  # [-] simultaneous screenshots
_said: dict[tuple[str, str], float] = {}  # [s] time of the last log record of each kind


def _passes(record: logging.LogRecord) -> bool:
    """Whether a log record is written: one of each kind per minute, as any peer can cause records.

    Records of failed connections (`_KNOCKS`) lose the traceback if the peer can have caused the
    error. Their text is changed, because viser hides the text "opening handshake failed".
    """
    text = record.getMessage().partition("\n")[0]
    error = record.exc_info[1] if record.exc_info else None
    place = traceback.format_tb(error.__traceback__, limit=-1) if error else ()
    kind = str(record.msg).partition("\n")[0], f"{type(error).__name__} {place}"
    if text in _KNOCKS:
        record.msg = f"a connection: {text}" + (f": {error!r}" if error else "")
        record.args = ()
        of_peer = isinstance(error, NoneType | WebSocketException | EOFError | OSError)
        # The first data of a connection are not a valid request, such as two requests at once.
        protocol = getattr(getattr(record, "websocket", None), "protocol", None)
        broke_off = protocol is not None and protocol.state is CONNECTING and protocol.parser_exc
        if of_peer or broke_off:
            record.exc_info = None
            kind = text, ""
    due = _said.get(kind, -math.inf) <= time.monotonic() - 60.0
    if due:
        _said[kind] = time.monotonic()
    return due


def open_server(
    host: str, port: int, largest_upload: int = 0, allowed: Sequence[str] = ()
) -> viser.ViserServer:
    """Start a server behind a `Gate`, at an address for which `check_address` has succeeded.

    Port 0 selects a free port. `largest_upload` [bytes] is the largest size of an uploaded file; 0
    forbids uploads. Browsers may also use the names `allowed` for the server. Raises `ServerError`
    if viser starts its server in an unexpected way.
    """
    logging.getLogger("websockets").setLevel(logging.WARNING)  # no records of each connection
    for name in ("websockets.server", "asyncio", logger.name):
        logging.getLogger(name).addFilter(_passes)  # a filter is added once only
    warnings.filterwarnings("ignore", "Queued a .* on a closed connection")  # normal at its end
    _replace_parts_of_viser()
    gate = Gate(host, allowed, largest_upload)
    with contextlib.ExitStack() as started:
        with contextlib.redirect_stdout(io.StringIO()), gate.closed():
            server = viser.ViserServer(host=host, port=port, verbose=False)
            started.callback(close_server, server)
        started.pop_all()
    notifier = Notifier(server)

    def client_of(connection: Any) -> viser.ClientHandle | None:
        clients = server.get_clients().values()
        return next((each for each in clients if _connection(each) is connection), None)

    def widget(connection: Any, uuid: str) -> Any:
        owners = server, client_of(connection)
        known = [each.gui._gui_input_handle_from_uuid for each in owners if each is not None]
        return next((widgets[uuid] for widgets in known if uuid in widgets), None)

    def on_refused(connection: Any, refused: RefusedError) -> None:
        if (client := client_of(connection)) is None:
            return
        notifier.warn(client, f"Refused: {refused}.")
        shown = widget(connection, getattr(refused.message, "uuid", ""))
        if shown is not None and not shown._impl.is_button:
            client._websock_connection.queue_message(
                _messages.GuiUpdateMessage(shown._impl.uuid, {"value": shown.value})
            )

    gate.widget, gate.on_refused = widget, on_refused
    return server


def close_server(server: viser.ViserServer) -> None:
    """Stop a server, and wait for the end of its network thread, at most `_ENDING`."""
    with contextlib.redirect_stdout(io.StringIO()):
        if (loop := server._websock_server._background_event_loop) and not loop.is_closed():
            loop.call_soon_threadsafe(loop.call_later, _GRACE, _break_off, loop)
        server.stop()
        if (thread := server._websock_server._server_thread) is not None:
            thread.join(_ENDING)  # viser waits for a second and then prints a message


def _break_off(loop: Any) -> None:
    for transport in tuple(loop._transports.values()):  # also with an unread answer or no request
        transport.abort()


def taken_upload(button: viser.GuiUploadButtonHandle) -> viser.UploadedFile:
    """Return a button's uploaded file, and delete it from the button to free the memory."""
    file, button._impl.value = button.value, viser.UploadedFile("", b"")
    return file


def scene_picture(
    client: viser.ClientHandle, height: int, width: int, timeout: float
) -> np.ndarray:
    """Return the scene as a viewer's browser draws it: (height, width, 4) uint8, RGBA.

    Raises `RuntimeError` if the viewer has disconnected, and `TimeoutError` after `timeout` [s].
    """
    if (connection := _connection(client)) is None:
        raise RuntimeError("the page has disconnected")
    with _pictures:
        connection.protocol.max_message_size += LARGEST_PICTURE  # until the picture is here
        try:
            return client.get_render(height, width, transport_format="png", timeout=timeout)
        finally:
            connection.protocol.max_message_size -= LARGEST_PICTURE


def image_size(client: viser.ClientHandle) -> tuple[float, float]:
    """Return width and height [px] of a viewer's scene; 0 while unknown."""
    state = client.camera._state
    return state.image_width, state.image_height


def has_no_gpu(client: viser.ClientHandle) -> bool:
    """Whether a viewer's browser has reported that it draws in software."""
    request = getattr(_connection(client), "request", None)
    return request is not None and "dbb-draws=software" in request.headers.get("Cookie", "")


def finite(value: Any) -> float:
    """Return a value as a number; raises errors of `float`, `ValueError` if not finite."""
    if not math.isfinite(number := float(value)):
        raise ValueError("not a finite number")
    return number


class Channel:
    """Calls of functions, by name, between this program's scripts in the page and this program."""

    def __init__(self, client: viser.ClientHandle, notifier: Notifier) -> None:
        self._client = client
        self._acts: dict[str, tuple[Callable[..., None], Callable[[Any], Any]]] = {}
        self._box = client.gui.add_text("", "", visible=False)
        self._box.on_update(notifier.guard(self._hear))
        self.seen: frozenset[str] = frozenset()
        """State of the page: the names of `sight` that are visible, and "untouched" until the first
        input of a person."""
        self.on("seen", lambda names: setattr(self, "seen", frozenset(names.split())), str)
        self.on("refused", lambda text: notifier.warn(client, text[:300]), str)

    def begin(self) -> None:
        """Create the elements of this program's scripts anew; call this when all widgets exist."""
        ranges = {
            uuid: (handle.min, handle.max)
            for uuid, handle in self._client.gui._gui_input_handle_from_uuid.items()
            if isinstance(handle, viser.GuiSliderHandle | viser.GuiNumberHandle)
        }
        self._run("dbb?.end(); window.dbb = window.dbbControls", self._box._impl.uuid, ranges)

    def tell(self, word: str, *values: Any) -> None:
        """Call the function `word` of the page's scripts with values of JSON types."""
        self._run(f"dbb.{word}", *values)

    def on(self, word: str, act: Callable[..., None], kind: Callable[[Any], Any] = finite) -> None:
        """Call `act` with the values of each valid message `word`, converted by `kind`."""
        self._acts[word] = act, kind

    def sight(self, name: str) -> None:
        """Add a mark to the open GUI container: while the mark is visible, `seen` has `name`."""
        self._client.gui.add_html(f'<div data-seen="{name}"></div>')

    def _run(self, function: str, *values: Any) -> None:
        arguments = json.dumps(values, separators=(",", ":"), allow_nan=False)
        source = f"window.{function}(...{arguments})"
        self._client._websock_connection.queue_message(
            _messages.RunJavascriptMessage(source=source)
        )

    def _hear(self, event: viser.GuiEvent) -> None:
        if event.client is None:
            return
        try:
            _, word, *values = from_json(event.target.value)
            act, kind = self._acts[word]
            values = [kind(value) for value in values]
            signature(act).bind(*values)
        except (ValueError, TypeError, KeyError, OverflowError):  # not a message of this page
            return
        act(*values)


def _connection(client: viser.ClientHandle) -> Any:
    return client._viser_server._websock_server._live_connections.get(client.client_id)


class _Seen(NamedTuple):
    answer: asyncio.Task[None] | None = None  # to the last ping
    unanswered: int = 0  # [-] successive checks without this answer
    sent: tuple[int, ...] = ()  # number of the last message of each queue that was sent
    unsent: int = 0  # [-] successive checks without a new message although messages wait


class Watchdog:
    """Reports viewers that answer no pings; closes connections without answers or without delivery.

    A browser answers a ping even if its page is busy. Time is counted in checks, because the thread
    that counts also receives the answers: a delay of this program counts as one check.
    """

    def __init__(self, server: viser.ViserServer, on_silent: Callable[[int], None]) -> None:
        """Start the checks; each check calls `on_silent` with the number of each silent viewer."""
        self.closed = 0  # number of connections that were closed; their pages connect again
        self._server, self._on_silent = server._websock_server, on_silent
        self._seen: dict[int, _Seen] = {}
        assert self._server._background_event_loop is not None, "the server runs"
        self._loop = self._server._background_event_loop
        self._loop.call_soon_threadsafe(self._look)

    def _look(self) -> None:
        before, self._seen = self._seen, {}
        for number, connection in tuple(self._server._live_connections.items()):
            seen = self._seen_now(number, connection, before.get(number, _Seen()))
            self._seen[number] = seen
            if seen.unanswered >= SILENT:
                self._on_silent(number)
            if max(seen.unanswered, seen.unsent) == STUCK:
                self.closed += 1
                text = "nothing reached viewer %d for %g s: the connection is closed and made anew"
                logger.warning(text, number, STUCK * LOOK)
                connection.transport.abort()
        self._loop.call_later(LOOK, self._look)

    def _seen_now(self, number: int, connection: Any, before: _Seen) -> _Seen:
        answer, unanswered = before.answer, before.unanswered + 1
        if answer is None or answer.done():
            answer, unanswered = self._loop.create_task(_ping(connection)), 0
        queues = [self._server._broadcast_buffer]
        if number in self._server._client_state_from_id:
            queues.append(self._server._client_state_from_id[number].message_buffer)
        sent = tuple(queue.generator_cursors.get(number, -1) for queue in queues)
        unsent = before.unsent
        if sent != before.sent or all(
            last + 1 >= queue.message_counter for last, queue in zip(sent, queues, strict=True)
        ):
            unsent = 0
        elif not any(queue.atomic_counter for queue in queues):  # no picture is being composed
            unsent += 1
        return _Seen(answer, unanswered, sent, unsent)


async def _ping(connection: Any) -> None:
    with contextlib.suppress(ConnectionClosed):
        await (await connection.ping())


class _WakingEvent(asyncio.Event):
    """An event whose `set` wakes all waiters even if the event is already set.

    viser sets its event in another thread, then again in the loop. asyncio's event ignores the
    second call, and a waiter can sleep forever (docs/viser_wakeup.md).
    """

    def set(self) -> None:
        self._value = True
        for waiter in tuple(self._waiters):
            if not waiter.done():
                waiter.set_result(True)


class _Buffer(AsyncMessageBuffer):
    """A queue that always wakes its waiters, and that delivers each removal of a node.

    viser drops a removal if the node is created again before the removal is sent. The page then
    keeps pose and callbacks of the old node, because viser does not send default poses.
    """

    def __init__(self, *args: Any, **more: Any) -> None:
        super().__init__(*args, **more)
        self.message_event = _WakingEvent()

    def push(self, message: Any) -> None:
        if message.lifecycle_phase == "create" and not self.persistent_messages:
            key = message.redundancy_key()
            with self.buffer_lock:
                before = self.message_from_id.get(self.id_from_redundancy_key.get(key, -1))
                if before is not None and before.lifecycle_phase == "remove":
                    del self.id_from_redundancy_key[key]
        super().push(message)


_archive = cache(lambda: zipfile.ZipFile(_icons.ICONS_DIR / "tabler-icons.zip"))  # opens in 50 ms


def _replace_parts_of_viser() -> None:
    """Replace viser's queue of messages, and its slow searches of type hints and of icons."""
    hints = cache(get_type_hints)
    of_class = property(lambda self: hints(type(self._impl.props)))
    setattr(_infra, "AsyncMessageBuffer", _Buffer)  # noqa: B010  # pyright: it is private
    setattr(AssignablePropsBase, "_prop_hints", of_class)  # noqa: B010
    icon = cache(lambda name: _archive().read(f"{name}.svg").decode("utf-8"))
    for module in (_gui_api, _gui_handles):
        setattr(module, "svg_from_icon", icon)  # noqa: B010
