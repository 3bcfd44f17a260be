"""Viser's servers, silent and behind a gate; and every use of viser's private names.

A queue of messages loses no wake-up here. `tests/test_gate.py` fails if a private name changes.
"""

from __future__ import annotations

import asyncio
import contextlib
import io
import logging
from typing import Any

import viser
from viser import _messages
from viser.infra import _infra
from viser.infra._async_message_buffer import AsyncMessageBuffer

from app.dashboard.gate import Gate, Limits
from app.dashboard.messages import RefusedError
from app.dashboard.notifications import Notifier


def open_server(host: str, port: int, limits: Limits | None = None) -> viser.ViserServer:
    """A server that listens.

    Args:
        host: Address to listen at, which can be bound: viser waits for ever at one that cannot.
        port: Port to listen at; 0 takes a free one, and so does viser if it is taken.
        limits: Bounds of what clients may do.

    Raises:
        ServerError: viser starts in a way that is not known.
    """
    logging.getLogger("websockets").setLevel(logging.WARNING)  # every viewer's coming and going
    setattr(_infra, "AsyncMessageBuffer", _Buffer)  # noqa: B010  # pyright: it is private
    gate = Gate(host, limits or Limits())
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


def taken_upload(button: viser.GuiUploadButtonHandle) -> viser.UploadedFile:
    """What was uploaded by a button, which would keep it until the next one."""
    file, button._impl.value = button.value, viser.UploadedFile("", b"")
    return file


def image_size(client: viser.ClientHandle) -> tuple[float, float]:
    """[px] width and height of a viewer's scene; 0 while unknown."""
    state = client.camera._state
    return state.image_width, state.image_height


def _widget(gui: viser.GuiApi, uuid: str) -> Any:
    return gui._gui_input_handle_from_uuid.get(uuid)


def _silence() -> contextlib.redirect_stdout[io.StringIO]:
    """Holds back what viser prints about itself: the address is the caller's to print."""
    return contextlib.redirect_stdout(io.StringIO())


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
    def __init__(self, *args: Any, **more: Any) -> None:
        super().__init__(*args, **more)
        self.message_event = _WakingEvent()
