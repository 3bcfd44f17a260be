"""Viser's servers, silent and behind a gate; and every use of viser's private names.

A queue of messages loses no wake-up here. `tests/test_gate.py` fails if a private name changes.
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
from collections.abc import Callable, Sequence
from inspect import signature
from types import NoneType
from typing import Any, ClassVar, NamedTuple

import numpy as np
import viser
from viser import _messages
from viser.infra import _infra
from viser.infra._async_message_buffer import AsyncMessageBuffer
from websockets.exceptions import ConnectionClosed, WebSocketException
from websockets.protocol import CONNECTING

from app.dashboard.gate import (
    LARGEST_PICTURE,
    Gate,
    ReadLink,
    RefusedError,
    draws_in_software,
    read_no_link,
)
from app.dashboard.notifications import Notifier
from app.strict import parsed

logger = logging.getLogger("app.dashboard")  # one for all that viewers can cause

_ENDING = 10.0  # [s] for viser's thread, on a busy machine
LOOK = 0.5  # [s] between two looks at the connections
SILENT = 3  # [looks] without an answer, after which a viewer may sleep
_MINUTE = 60.0  # [s]
_KNOCKS = (
    "opening handshake failed",
    "unexpected internal error",
    "socket.accept() out of system resource",
)
_pictures = threading.BoundedSemaphore(2)  # [-] large messages that may be under way
STUCK = 20  # [looks] without anything delivered, after which a connection is closed


class _Knocks(logging.Filter):
    """Of what strangers can cause again and again, one record a minute is enough.

    Their library would write the whole way to each one who connects and speaks otherwise, or too
    many at once, a hundred times a second. An error that no stranger's bytes explain is a mistake
    in this program or its libraries: it is written whole, by another name, as viser hides what it
    takes for a knock.
    """

    _said: ClassVar[dict[tuple[str, str], float]] = {}

    def filter(self, record: logging.LogRecord) -> bool:
        """Whether it is written, a knock in one line."""
        text = record.getMessage().partition("\n")[0]
        error = record.exc_info[1] if record.exc_info else None
        kind = str(record.msg).partition("\n")[0], _place(error)
        if text in _KNOCKS:
            record.msg, record.args = (
                f"a connection: {text}" + (f": {error!r}" if error else ""),
                (),
            )
            of_peer = isinstance(error, NoneType | WebSocketException | EOFError | OSError)
            if of_peer or _broke_off(getattr(record, "websocket", None)):
                record.exc_info = None
                kind = text, ""
        due = self._said.get(kind, -math.inf) <= time.monotonic() - _MINUTE
        if due:
            self._said[kind] = time.monotonic()
        return due


def _place(error: BaseException | None) -> str:
    """Where an error was raised."""
    frames = traceback.extract_tb(error.__traceback__, limit=-1) if error else ()
    return f"{type(error).__name__} {[(frame.filename, frame.lineno) for frame in frames]}"


def _broke_off(connection: Any) -> bool:
    """Whether websockets could not read what came before a connection was open.

    As with requests that come one behind the other: their answer then fails within websockets.
    """
    protocol = getattr(connection, "protocol", None)
    return protocol is not None and protocol.state is CONNECTING and bool(protocol.parser_exc)


_knocks = _Knocks()


def open_server(
    host: str,
    port: int,
    largest_upload: int = 0,
    read_link: ReadLink = read_no_link,
    allowed: Sequence[str] = (),
) -> viser.ViserServer:
    """A server that listens.

    viser waits for ever at a host that cannot be bound, and takes another port for one that is
    taken; 0 takes a free one. Files of `largest_upload` [bytes] can be uploaded, none if it is 0.
    Browsers may reach it by the `allowed` names too.

    Raises:
        ServerError: viser starts in a way that is not known.
    """
    logging.getLogger("websockets").setLevel(logging.WARNING)  # every viewer's coming and going
    for name in ("websockets.server", "asyncio", logger.name):
        logging.getLogger(name).addFilter(_knocks)  # the same one is added once
    warnings.filterwarnings("ignore", "Queued a .* on a closed connection")  # who has just gone
    setattr(_infra, "AsyncMessageBuffer", _Buffer)  # noqa: B010  # pyright: it is private
    gate = Gate({host, *allowed}, largest_upload, read_link)
    with _silence(), gate.closed():
        server = viser.ViserServer(host=host, port=port, verbose=False)
    notifier = Notifier(server)

    def client_of(connection: Any) -> viser.ClientHandle | None:
        live = list(server._websock_server._live_connections.items())
        numbers = (number for number, each in live if each is connection)
        return server.get_clients().get(next(numbers, -1))

    def widget(connection: Any, uuid: str) -> Any:
        client = client_of(connection)
        guis = [server.gui, *([client.gui] if client else [])]
        return next((w for gui in guis if (w := _widget(gui, uuid)) is not None), None)

    def on_refused(connection: Any, refused: RefusedError) -> None:
        client = client_of(connection)
        if client is None:
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
    """End a server and its threads."""
    with _silence():
        server.stop()
        thread = server._websock_server._server_thread
        if thread is not None:
            thread.join(_ENDING)  # viser waits for a second; the last that it does is to print


def taken_upload(button: viser.GuiUploadButtonHandle) -> viser.UploadedFile:
    """What was uploaded by a button, which would keep it until the next one."""
    file, button._impl.value = button.value, viser.UploadedFile("", b"")
    return file


def scene_picture(
    client: viser.ClientHandle, height: int, width: int, timeout: float
) -> np.ndarray:
    """(height, width, 4) the scene as a viewer's browser draws it, which may send that much.

    Raises:
        RuntimeError: The viewer has gone.
        TimeoutError: Nothing came within the timeout [s].
    """
    connection = _connection(client)
    if connection is None:
        raise RuntimeError("the page has gone")
    with _pictures:
        connection.protocol.max_message_size += LARGEST_PICTURE
        try:
            return client.get_render(height, width, transport_format="png", timeout=timeout)
        finally:
            connection.protocol.max_message_size -= LARGEST_PICTURE


def address_of(client: viser.ClientHandle) -> str:
    """The page's address, as the viewer's browser has it, without a query."""
    connection = _connection(client)
    request = connection.request if connection is not None else None
    return f"http://{request.headers.get('Host', '') if request is not None else ''}/"


def image_size(client: viser.ClientHandle) -> tuple[float, float]:
    """[px] width and height of a viewer's scene; 0 while unknown."""
    state = client.camera._state
    return state.image_width, state.image_height


def has_no_gpu(client: viser.ClientHandle) -> bool:
    """Whether a viewer's browser has said that it draws in software."""
    connection = _connection(client)
    return connection is not None and draws_in_software(connection.request)


def finite(value: Any) -> float:
    """A number that a page says.

    Raises:
        ValueError: It is none.
    """
    if not math.isfinite(number := float(value)):
        raise ValueError("no number of a page")
    return number


class Channel:
    """What one viewer's page and this program say to each other beside viser's widgets.

    viser has no widget that spans the page, reads a number as a person typed it, or says whether
    anybody sees it; the page's own scripts have. They call functions by words, and are called.
    """

    def __init__(self, client: viser.ClientHandle, notifier: Notifier) -> None:
        self._client = client
        self._acts: dict[str, tuple[Callable[..., None], Callable[[Any], Any]]] = {}
        self._box = client.gui.add_text("", "", visible=False)
        self._box.on_update(notifier.guard(self._hear))
        self.seen: frozenset[str] = frozenset()
        """What the page has said of itself: the names of the `sight`s that a person sees, "narrow"
        if it is a narrow one, "untouched" until a person presses or turns anything."""
        self.on("seen", lambda names: setattr(self, "seen", frozenset(names.split())), str)
        self.on("refused", lambda text: notifier.warn(client, text[:300]), str)

    def begin(self) -> None:
        """Begin what the page has beside viser's widgets, all of which are there, anew."""
        ranges = {
            uuid: (handle.min, handle.max)
            for uuid, handle in self._client.gui._gui_input_handle_from_uuid.items()
            if isinstance(handle, viser.GuiSliderHandle | viser.GuiNumberHandle)
        }
        self._run("dbb?.end(); window.dbb = window.dbbControls", self._box._impl.uuid, ranges)

    def tell(self, word: str, *values: Any) -> None:
        """Call a function of the page with values that JSON can have."""
        self._run(f"dbb.{word}", *values)

    def on(self, word: str, act: Callable[..., None], kind: Callable[[Any], Any] = finite) -> None:
        """Call `act` with the values that the page says after a word, numbers or of a kind."""
        self._acts[word] = act, kind

    def sight(self, name: str) -> None:
        """Have the page say whether a person sees the GUI container that is now open."""
        self._client.gui.add_html(f'<div data-seen="{name}"></div>')

    def _run(self, function: str, *values: Any) -> None:
        told = json.dumps(values, separators=(",", ":"), allow_nan=False)
        source = f"window.{function}(...{told})"
        self._client._websock_connection.queue_message(
            _messages.RunJavascriptMessage(source=source)
        )

    def _hear(self, event: viser.GuiEvent) -> None:
        if event.client is None:
            return
        try:
            _, word, *values = parsed(json.loads, event.target.value)
            act, kind = self._acts[word]
            values = [kind(value) for value in values]
            signature(act).bind(*values)
        except (ValueError, TypeError, KeyError, OverflowError):  # no page of this program says so
            return
        act(*values)


def _connection(client: viser.ClientHandle) -> Any:
    """A viewer's connection, or None once he has gone."""
    return client._viser_server._websock_server._live_connections.get(client.client_id)


def _widget(gui: viser.GuiApi, uuid: str) -> Any:
    return gui._gui_input_handle_from_uuid.get(uuid)


def _silence() -> contextlib.redirect_stdout[io.StringIO]:
    """Holds back what viser prints about itself: the address is the caller's to print."""
    return contextlib.redirect_stdout(io.StringIO())


class _Seen(NamedTuple):
    """What was seen of a connection; numbers of looks at which it was so, one after the other."""

    answer: asyncio.Task[None] | None = None
    """To the last question whether anybody is there."""
    unanswered: int = 0
    sent: tuple[int, ...] = ()
    """Number of the last message that was taken out of each queue for this viewer."""
    unsent: int = 0


class Watchdog:
    """Notices viewers who do not answer, and closes connections that deliver nothing.

    A browser answers a ping by itself, also while its page waits. All is counted in looks, made in
    the thread that receives: if this program itself is held up, that is one look.
    """

    def __init__(self, server: viser.ViserServer, on_silent: Callable[[int], None]) -> None:
        """Begin; `on_silent` gets the number of a viewer at each look at which he is silent."""
        self.closed = 0
        """Connections that it has closed; their pages connect anew by themselves."""
        self._server, self._on_silent = server._websock_server, on_silent
        self._seen: dict[int, _Seen] = {}
        loop = self._server._background_event_loop
        assert loop is not None, "the server runs"
        self._loop = loop
        loop.call_soon_threadsafe(self._look)

    def _look(self) -> None:
        live = dict(self._server._live_connections)
        self._seen = {
            number: self._seen_now(number, connection, self._seen.get(number, _Seen()))
            for number, connection in live.items()
        }
        for number, seen in self._seen.items():
            if seen.unanswered >= SILENT:
                self._on_silent(number)
            if max(seen.unanswered, seen.unsent) == STUCK:
                self.closed += 1
                logger.warning(
                    "nothing reached viewer %d for %g s: the connection is closed, so that the "
                    "page connects anew",
                    number,
                    STUCK * LOOK,
                )
                live[number].transport.abort()
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
        elif not any(queue.atomic_counter for queue in queues):  # else a picture is being composed
            unsent += 1
        return _Seen(answer, unanswered, sent, unsent)


async def _ping(connection: Any) -> None:
    """Wait until a viewer's browser has answered, or is gone."""
    with contextlib.suppress(ConnectionClosed):
        await (await connection.ping())


class _WakingEvent(asyncio.Event):
    """An event that wakes whoever waits, also if it is set already.

    viser sets its event from other threads, too, and once more in the loop. If the thread's call
    falls between a waiter's look at the event and its waiting, the second call finds the event set,
    wakes nobody, and the page gets nothing more (docs/viser_wakeup.md).
    """

    def set(self) -> None:
        self._value = True
        for waiter in tuple(self._waiters):
            if not waiter.done():
                waiter.set_result(True)


class _Buffer(AsyncMessageBuffer):
    """A queue whose waiters always wake, and which delivers each removal to a viewer.

    viser drops the removal of a node that is created again before it was sent. The page then keeps
    pose and callbacks of the old node, since viser sends no pose that equals its default.
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
