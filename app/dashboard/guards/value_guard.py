"""Values that viser cannot take, as only a program in the place of a browser sends them.

viser converts what a client sends to the type of the widget's value, sets whatever attribute the
message names, and drops the exception if that fails: the sender would not learn of it. So its
handler is put behind a check here. The names with an underscore are viser's own; a test fails if
they change.
"""

from __future__ import annotations

from typing import Any

import viser
from viser import _messages

from app.dashboard.notifications import Notices


def guard_values(gui: viser.GuiApi, notices: Notices) -> None:
    """Answer a value that its widget cannot take with a notice to the sender, and set it back.

    May be called again for the same GUI.

    Args:
        gui: Of the page or of one client.
        notices: Tells the sender.
    """
    interface, handle = gui._websock_interface, gui._handle_gui_updates
    if handle not in interface._incoming_handlers.get(_messages.GuiUpdateMessage, []):
        return

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
            notices.warn(client, f"Refused: {problem}.")
            _set_back(gui, client, message)

    interface.unregister_handler(_messages.GuiUpdateMessage, handle)
    interface.register_handler(_messages.GuiUpdateMessage, guarded)


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
