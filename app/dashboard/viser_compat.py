"""Every use of viser's private names: no tunnel, values and uploads that are checked.

viser has no place for these checks, so its handlers are put behind some. A test fails if the names
with an underscore change.
"""

from __future__ import annotations

import contextlib
import io
import logging
from typing import Any

import viser
from viser import _messages

from app.dashboard.notifications import Notifier
from app.dashboard.origin import foreign_origins_refused

_MOST_AT_ONCE = 2  # [-] uploads of one viewer


def open_server(host: str, port: int) -> viser.ViserServer:
    """A server that listens.

    Args:
        host: Address to listen at, which can be bound: viser waits for ever at one that cannot.
        port: Port to listen at; 0 takes a free one, and so does viser if it is taken.

    Raises:
        ServerError: viser starts in a way that is not known.
    """
    logging.getLogger("websockets").setLevel(logging.WARNING)  # every viewer's coming and going
    with _silence(), foreign_origins_refused(host):
        server = viser.ViserServer(host=host, port=port, verbose=False)
    _forbid_sharing(server)
    return server


def close_server(server: viser.ViserServer) -> None:
    """End a server and its threads."""
    with _silence():
        server.stop()


def _silence() -> contextlib.redirect_stdout[io.StringIO]:
    """Holds back what viser prints about itself: the address is the caller's to print."""
    return contextlib.redirect_stdout(io.StringIO())


def _forbid_sharing(server: viser.ViserServer) -> None:
    """Take away the handler by which any client could open a public tunnel to this machine."""
    for message in (_messages.ShareUrlRequest, _messages.ShareUrlDisconnect):
        server._websock_server.unregister_handler(message)


def guard_values(gui: viser.GuiApi, notifier: Notifier) -> None:
    """Answer a value that its widget cannot take with a notice to the sender, and set it back.

    May be called again for the same GUI.

    Args:
        gui: Of the page or of one client.
        notifier: Tells the sender.
    """
    handle = gui._handle_gui_updates

    async def guarded(client_id: Any, message: _messages.GuiUpdateMessage) -> None:
        problem = _problem(message)
        if problem is None:
            try:
                await handle(client_id, message)
                return
            except (TypeError, ValueError, OverflowError):
                problem = "the value is not of the widget's kind"
        client = gui._resolve_client(client_id)
        if client is not None:
            notifier.warn(client, f"Refused: {problem}.")
            _set_back(gui, client, message)

    _replace_handler(gui, _messages.GuiUpdateMessage, handle, guarded)


def _problem(message: _messages.GuiUpdateMessage) -> str | None:
    if not isinstance(message.uuid, str) or not isinstance(message.updates, dict):
        return "this is no update of a widget"
    if set(message.updates) != {"value"}:
        return "of a widget only its value can be set"
    return None


def _set_back(
    gui: viser.GuiApi, client: viser.ClientHandle, message: _messages.GuiUpdateMessage
) -> None:
    known = gui._gui_input_handle_from_uuid
    widget = known.get(message.uuid) if isinstance(message.uuid, str) else None
    if widget is not None and not widget._impl.is_button:
        client._websock_connection.queue_message(
            _messages.GuiUpdateMessage(widget._impl.uuid, {"value": widget.value})
        )


def guard_uploads(gui: viser.GuiApi, notifier: Notifier, most: int) -> None:
    """Answer an upload that is too large with a notice to the sender, and forget it.

    May be called again for the same GUI.

    Args:
        gui: Of one client.
        notifier: Tells the sender.
        most: [bytes] of one file.
    """
    states = gui._current_file_upload_states
    start, part = gui._handle_file_transfer_start, gui._handle_file_transfer_part

    def refuse(client_id: Any, why: str) -> None:
        client = gui._resolve_client(client_id)
        if client is not None:
            notifier.warn(client, f"Refused: {why}.")

    def guarded_start(client_id: Any, message: _messages.FileTransferStartUpload) -> None:
        size, count = message.size_bytes, message.part_count
        if not isinstance(size, int) or not isinstance(count, int) or not 0 <= count <= most:
            refuse(client_id, "this is no upload")
        elif size > most:
            refuse(client_id, f"{size / 1e6:.0f} MB; a file may have {most / 1e6:.0f} MB")
        elif len(states) >= _MOST_AT_ONCE:
            refuse(client_id, "one upload after the other")
        else:
            start(client_id, message)

    def guarded_part(client_id: Any, message: _messages.FileTransferPart) -> None:
        state = states.get(message.transfer_uuid)
        if state is None:
            return
        if not isinstance(message.content, bytes) or not isinstance(message.part_index, int):
            refuse(client_id, "this is no part of an upload")
        elif state["transferred_bytes"] + len(message.content) > most:
            states.pop(message.transfer_uuid, None)
            refuse(client_id, f"more than {most / 1e6:.0f} MB")
        else:
            part(client_id, message)

    _replace_handler(gui, _messages.FileTransferStartUpload, start, guarded_start)
    _replace_handler(gui, _messages.FileTransferPart, part, guarded_part)


def _replace_handler(gui: viser.GuiApi, message: type[Any], handler: Any, guarded: Any) -> None:
    """Put a guard in the place of viser's own handler of a message, once."""
    interface = gui._websock_interface
    if handler in interface._incoming_handlers.get(message, []):
        interface.unregister_handler(message, handler)
        interface.register_handler(message, guarded)


def taken_upload(button: viser.GuiUploadButtonHandle) -> viser.UploadedFile:
    """What was uploaded by a button, which would keep it until the next one."""
    file, button._impl.value = button.value, viser.UploadedFile("", b"")
    return file


def image_size(client: viser.ClientHandle) -> tuple[float, float]:
    """[px] width and height of a viewer's scene; 0 while unknown."""
    state = client.camera._state
    return state.image_width, state.image_height
