"""Uploads that are larger than they may be are refused before their bytes are kept.

viser keeps what a client sends until it is whole, whatever its size. So its handlers are put behind
a check here. The names with an underscore are viser's own; a test fails if they change.
"""

from __future__ import annotations

from typing import Any

import viser
from viser import _messages

from app.dashboard.notifications import Notices

_MOST_AT_ONCE = 2  # [-] uploads of one viewer


def guard_uploads(gui: viser.GuiApi, notices: Notices, most: int) -> None:
    """Answer an upload that is too large with a notice to the sender, and forget it.

    May be called again for the same GUI.

    Args:
        gui: Of one client.
        notices: Tells the sender.
        most: [bytes] of one file.
    """
    interface, states = gui._websock_interface, gui._current_file_upload_states
    start, part = gui._handle_file_transfer_start, gui._handle_file_transfer_part
    handlers = interface._incoming_handlers
    if start not in handlers.get(_messages.FileTransferStartUpload, []):
        return

    def refuse(client_id: Any, why: str) -> None:
        client = gui._resolve_client(client_id)
        if client is not None:
            notices.warn(client, f"Refused: {why}.")

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

    interface.unregister_handler(_messages.FileTransferStartUpload, start)
    interface.register_handler(_messages.FileTransferStartUpload, guarded_start)
    interface.unregister_handler(_messages.FileTransferPart, part)
    interface.register_handler(_messages.FileTransferPart, guarded_part)


def taken_upload(button: viser.GuiUploadButtonHandle) -> viser.UploadedFile:
    """What was uploaded by a button, which would keep it until the next one."""
    file, button._impl.value = button.value, viser.UploadedFile("", b"")
    return file
