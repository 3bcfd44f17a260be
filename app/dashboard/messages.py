"""Messages of clients: their types, their sizes, and that their numbers are finite.

The types are viser's own annotations of its messages, which viser itself does not check.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable
from typing import Any, Union, get_type_hints

import msgspec
from viser import _messages

_MOST_UPLOADS = 2  # [-] unfinished ones of a viewer
_LONGEST_NAME = 1000  # [characters] of an element, a file or a scene node
_LARGEST_VALUE = 2**16  # [bytes] of what a widget is set to
_DEEPEST = 6  # [-] containers in one another

_TAKEN = (
    _messages.ViewerCameraMessage,
    _messages.GuiUpdateMessage,
    _messages.GuiButtonHoldMessage,
    _messages.GuiFormSubmitMessage,
    _messages.GuiFormDirtyMessage,
    _messages.CommandTriggerMessage,
    _messages.SceneNodeClickMessage,
    _messages.ScenePointerMessage,
    _messages.SceneNodeDragMessage,
    _messages.TransformControlsUpdateMessage,
    _messages.TransformControlsDragStartMessage,
    _messages.TransformControlsDragEndMessage,
    _messages.GetRenderResponseMessage,
    _messages.LocalStorageGetItemResponseMessage,
    _messages.FileTransferStartUpload,
    _messages.FileTransferPart,
    _messages.FileTransferPartAck,
)
"""What a page may send. Others exist, as one that opens a tunnel to this machine for anybody."""


class RefusedError(ValueError):
    """A message that viser must not see.

    Attributes:
        message: It, if it has at least its own types: to tell its sender what holds instead.
    """

    def __init__(self, why: str, message: Any = None) -> None:
        """Say why, in words that follow "Refused: "."""
        super().__init__(why)
        self.message = message


class GarbageError(RefusedError):
    """What is no message of a page at all: whoever sends it is none."""


def _record(message: type) -> type:
    """A record with the fields of a message of viser, whose types msgspec checks."""
    hints = get_type_hints(message)
    fields = [
        (f.name, hints[f.name], *([f.default] if f.default is not dataclasses.MISSING else []))
        for f in dataclasses.fields(message)
        if f.init
    ]
    return msgspec.defstruct(
        message.__name__, fields, tag_field="type", tag=message.__name__, forbid_unknown_fields=True
    )


_RECORDS = {message: _record(message) for message in _TAKEN}
_decoder = msgspec.msgpack.Decoder(type=Union[tuple(_RECORDS.values())])  # noqa: UP007


class Uploads:
    """What one viewer is uploading.

    viser keeps what it gets until a file is whole, whatever its size.
    """

    def __init__(self, largest: int) -> None:
        """Args: largest: [bytes] of one file; 0 if there is nothing to upload."""
        self._largest = largest
        self._left: dict[str, int] = {}

    def begin(self, transfer: str, size: int, parts: int) -> None:
        """Take note of a file that is announced.

        Raises:
            RefusedError: It is too large, or another is not finished.
        """
        if size > self._largest:
            raise RefusedError(f"{size / 1e6:.0f} MB; a file may have {self._largest / 1e6:.0f} MB")
        if not (size >= 0 and 0 <= parts <= max(size, 1)):
            raise RefusedError("this is no upload")
        if len(self._left) >= _MOST_UPLOADS:
            raise RefusedError("one upload after the other")
        self._left[transfer] = size

    def add(self, transfer: str, size: int) -> None:
        """Take note of a part.

        Raises:
            RefusedError: Nothing was announced of which it is a part.
        """
        left = self._left.get(transfer)
        if left is None or size > left:
            self._left.pop(transfer, None)
            raise RefusedError("more than was announced")
        if left > size:
            self._left[transfer] = left - size
        else:
            del self._left[transfer]


def checked(data: object, largest: int, uploads: Uploads, widget: Callable[[str], Any]) -> bytes:
    """The bytes of a message that viser may see.

    Args:
        data: As it came.
        largest: [bytes] of any message but a picture that was asked for.
        uploads: Of the same viewer.
        widget: Finds a widget of the page by its name; None if there is none.

    Raises:
        GarbageError: It is none that a page sends, or of other types.
        RefusedError: Its values are not of their kinds, not finite or too large.
    """
    if not isinstance(data, bytes):
        raise GarbageError("this is no message")
    picture = len(data) > largest
    if picture and b"GetRenderResponseMessage" not in data[:200]:
        raise RefusedError(f"a message of {len(data) / 1e6:.0f} MB")
    try:
        message = _decoder.decode(data)
    except (msgspec.DecodeError, RecursionError) as error:
        raise GarbageError(f"this is no message ({error})") from None
    if isinstance(message, _RECORDS[_messages.GetRenderResponseMessage]):
        return data
    if picture:
        raise RefusedError(f"a message of {len(data) / 1e6:.0f} MB")
    _check_values(message)
    if isinstance(message, _RECORDS[_messages.GuiUpdateMessage]):
        _check_update(message, widget(message.uuid))
    elif isinstance(message, _RECORDS[_messages.FileTransferStartUpload]):
        uploads.begin(message.transfer_uuid, message.size_bytes, message.part_count)
    elif isinstance(message, _RECORDS[_messages.FileTransferPart]):
        uploads.add(message.transfer_uuid, len(message.content))
    return data


def _check_update(message: Any, widget: Any) -> None:
    if set(message.updates) != {"value"}:
        raise RefusedError("of a widget only its value can be set", message)
    value = message.updates["value"]
    if isinstance(value, str | bytes | list | dict) and len(value) > _LARGEST_VALUE:
        raise RefusedError("the value is too long", message)
    if widget is not None and not is_alike(value, widget.value):
        raise RefusedError("the value is not of the widget's kind", message)


def is_alike(value: object, current: object) -> bool:
    """Whether a widget with a current value can be set to another: a number to a number."""
    if isinstance(current, tuple):
        return (
            isinstance(value, list)
            and len(value) == len(current)
            and all(map(is_alike, value, current))
        )
    if isinstance(current, bool):
        return isinstance(value, bool)
    if isinstance(current, int | float):
        return isinstance(value, int | float) and not isinstance(value, bool)
    return isinstance(value, type(current))


def _check_values(message: Any) -> None:
    for name in message.__struct_fields__:
        value = getattr(message, name)
        if isinstance(value, bytes) and name == "content":
            continue
        if isinstance(value, str) and len(value) > _LONGEST_NAME:
            raise RefusedError(f"{name} is too long", message)
        if not _is_plain(value, _DEEPEST):
            raise RefusedError(f"{name} has numbers that are not finite, or is too deep", message)


def _is_plain(value: Any, depth: int) -> bool:
    if isinstance(value, float):
        return math.isfinite(value)
    if isinstance(value, dict):
        return depth > 0 and all(_is_plain(v, depth - 1) for v in (*value, *value.values()))
    if isinstance(value, list | tuple):
        return depth > 0 and all(_is_plain(v, depth - 1) for v in value)
    return True
