"""The gate: who may connect and what a page may send is checked once, before viser sees it.

viser has no place for such checks, so that what it hands to `websockets` when it starts is wrapped:
requests are checked by `is_allowed` and answered with headers that keep foreign pages out; each
message is checked by `checked` before viser takes it apart. The types of messages are viser's own
annotations, which viser itself does not check.
"""

from __future__ import annotations

import dataclasses
import gzip
import http
import ipaddress
import math
import socket
import struct
import threading
from asyncio import get_running_loop
from collections.abc import Callable, Collection, Iterator
from contextlib import contextmanager
from functools import lru_cache
from html import escape
from pathlib import Path
from typing import Any, Literal, Union, get_type_hints
from urllib.parse import parse_qsl, urlsplit

import msgspec
from viser import UploadedFile, __version__, _messages
from websockets.asyncio import server as websockets_server
from websockets.asyncio.server import ServerConnection
from websockets.datastructures import Headers
from websockets.http11 import Request, Response

from app.errors import ServerError

LARGEST_MESSAGE = 2**20  # [bytes] viser's client sends a file in parts of half of that
LARGEST_PICTURE = 32 * 2**20  # [bytes] which only a page that was asked for one may send
_MOST_PIXELS = 2**24  # [-] of such a picture
_MOST_WAITING = 2  # [-] messages of a viewer that have come and are not taken yet
_SLOWEST = 10.0  # [s] from the first part of a message to its last
_MOST_VIEWERS = 32  # [-] connections at a time
DENSITY = "fixedDpr"
"""The one name of viser's own that a page's address may carry, of how many pixels are drawn for one
of the page; others would tell the page whom to obey."""
ReadLink = Callable[[str], tuple[str, str]]
"""Of an address's query: why it is wrong, or an empty text, and the query without what is."""
_LONGEST_PATH = 255  # [characters] of an address, beyond which no file can be looked for
_MOST_UPLOADS = 2  # [-] unfinished ones
_LONGEST_NAME = 1000  # [characters] of an element, a file or a scene node
_LONGEST_VALUE = 2**16  # [characters] of what a widget is set to
_DEEPEST = 6  # [-] containers in one another
_LARGEST_NUMBER = 2**53  # [-] up to which a page has every integer; beyond it none is meant
_POLICY = (
    "default-src 'none'; script-src 'self' 'unsafe-inline' 'unsafe-eval' blob: data:; "
    "style-src 'self' 'unsafe-inline'; img-src 'self' data: blob:; font-src 'self' data: blob:; "
    "connect-src 'self' ws://{host} data: blob:; worker-src 'self' blob: data:; "
    "frame-ancestors 'none'; base-uri 'none'; form-action 'none'"
)
"""viser's page has its scripts in it and compiles its markdown; it speaks to nobody else."""
_HEADERS = {
    "X-Frame-Options": "DENY",
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cross-Origin-Resource-Policy": "same-origin",
}
"""Of every answer, with the policy."""
_ANSWER = """<!doctype html><html lang="en"><meta charset="utf-8"><title>Not possible</title>
<meta name="viewport" content="width=device-width"><link rel="icon" href="data:,">
<style>:root {{ color-scheme: light dark; font: 1.1rem/1.5 sans-serif }}
body {{ max-width: 40em; margin: 15vh auto; padding: 0 1em; overflow-wrap: anywhere }}</style>
<p>{why}.</p>{more}</html>
"""
"""What a person sees of a refused address."""
_WAY_OUT = """<p>If this server is meant to be reached under this name, restart it with
<code>--allow-host {name}</code>; who can open it can move the robot.</p>"""
_LONGEST_REASON = 400  # [characters] of it
_SINGLE = ("Host", "Origin", "Upgrade", "Cookie", "Accept-Encoding")
"""Headers that are asked for one value here or by viser."""
_SCRIPT, _CONTROLS, _STYLE = (
    Path(__file__).with_name(name).read_text(encoding="utf-8")
    for name in ("page.js", "controls.js", "page.css")
)
_HEAD = f'<head><meta charset="utf-8"><script>{_SCRIPT}{_CONTROLS}</script><style>{_STYLE}</style>'
"""What stands in the page before viser's own client."""
_lock = threading.Lock()

_TAKEN = (
    _messages.ViewerCameraMessage,
    _messages.GuiUpdateMessage,
    _messages.CommandTriggerMessage,
    _messages.ScenePointerMessage,
    _messages.SceneNodeDragMessage,
    _messages.TransformControlsUpdateMessage,
    _messages.TransformControlsDragStartMessage,
    _messages.TransformControlsDragEndMessage,
    _messages.GetRenderResponseMessage,
    _messages.FileTransferStartUpload,
    _messages.FileTransferPart,
    _messages.FileTransferPartAck,
)
"""What this program's page sends. viser has others: one opens a tunnel to this machine for anybody,
and one of a form that nobody has is kept, and told to every viewer, for ever."""
_Point = tuple[float, float, float]
_NARROWER: dict[type, dict[str, Any]] = {
    _messages.ScenePointerMessage: {
        "event_type": Literal["click"],
        "ray_origin": _Point,
        "ray_direction": _Point,
        "screen_pos": tuple[tuple[float, float]],
    }
}
"""Where viser's annotations allow what its handlers do not bear: what this program's page sends."""
_VERSION = f"viser-v{__version__}"  # the protocol that a page names


class RefusedError(ValueError):
    """A message that viser must not see, and why, in words that follow "Refused: "."""

    def __init__(self, why: str, message: Any = None) -> None:
        super().__init__(why)
        self.message = message
        """It, if it has at least its own types: to tell its sender what holds instead."""


class GarbageError(RefusedError):
    """What is no message of a page at all: whoever sends it is none."""


class Gate:
    """What stands between a server of viser and whoever connects to it."""

    def __init__(self, names: Collection[str], largest_upload: int, read_link: ReadLink) -> None:
        """Prepare.

        `names` are those by which browsers may reach the server, `largest_upload` [bytes] of one
        file, 0 if there is nothing to upload.
        """
        self._own_names = {name.lower() for name in names}
        self._largest_upload, self._read_link = largest_upload, read_link
        self._uploads: set[Uploads] = set()  # of each viewer who is there
        self.widget: Callable[[Any, str], Any] = lambda connection, uuid: None
        """Finds the widget of a page, by the page's connection and the widget's name."""
        self.on_refused: Callable[[Any, RefusedError], None] = lambda connection, refused: None
        """Is called with the connection and the reason when a message was refused."""

    @contextmanager
    def closed(self) -> Iterator[None]:
        """A server that viser starts meanwhile stands behind this gate.

        Raises:
            ServerError: No server was started in the expected way; it must not be used.
        """
        with _lock:
            original, seen = websockets_server.serve, []

            def serve(
                handler: Callable[..., Any],
                *args: Any,
                process_request: Callable[..., Any],
                **more: Any,
            ) -> Any:
                seen.append(True)
                more |= {"max_size": LARGEST_MESSAGE, "max_queue": _MOST_WAITING}
                return original(
                    self._handler(handler),
                    *args,
                    process_request=self._process_request(process_request),
                    **more,
                )

            websockets_server.serve = serve  # type: ignore[assignment]
            try:
                yield
            finally:
                websockets_server.serve = original
        if not seen:
            raise ServerError("this version of viser starts its server in a way that is not known")

    def _process_request(self, inner: Callable[..., Any]) -> Callable[..., Any]:
        """Wraps viser's own answer to requests: behind this gate's, with safe headers."""

        async def process(connection: ServerConnection, request: Request) -> Response | None:
            answer = self._refusal(request)
            if answer is None:
                answer = inner(connection, request)
                answer = await answer if hasattr(answer, "__await__") else answer
                if answer and answer.headers.get("Content-Type", "").startswith("text/html"):
                    answer.body = with_script(
                        bytes(answer.body), answer.headers["Content-Encoding"]
                    )
                    del answer.headers["Content-Length"]
                    answer.headers["Content-Length"] = str(len(answer.body))
            if answer is not None:
                host = ", ".join(request.headers.get_all("Host")).encode("ascii", "ignore").decode()
                answer.headers.update(_HEADERS)
                answer.headers["Content-Security-Policy"] = _POLICY.format(host=host)
            return answer

        return process

    def _refusal(self, request: Request) -> Response | None:
        """The refusal of a request, or None if it may go on to viser."""
        headers, more = request.headers, ""
        path, _, query = request.path.partition("?")
        if twice := [name for name in _SINGLE if len(headers.get_all(name)) > 1]:
            status = http.HTTPStatus.BAD_REQUEST
            why = f"the request has the header {twice[0]} twice"
        elif not is_allowed(headers.get("Origin"), headers.get("Host"), self._own_names):
            status = http.HTTPStatus.FORBIDDEN
            why = "this page is not allowed to connect to this server"
            more = _WAY_OUT.format(name=escape(headers.get("Host", "NAME").partition(":")[0]))
        elif headers.get("Upgrade", "").lower() == "websocket":
            if len(self._uploads) < _MOST_VIEWERS:
                return None
            status = http.HTTPStatus.SERVICE_UNAVAILABLE
            why = f"{len(self._uploads)} pages are open, which is the most that this server serves"
        elif len(path) > _LONGEST_PATH:
            status = http.HTTPStatus.REQUEST_URI_TOO_LONG
            why = "there is no file of so long a name"
        else:
            why, rest = self._read_link(query)
            if not why:
                return None
            # Relative, for a server that a proxy has below a path.
            status, address = http.HTTPStatus.BAD_REQUEST, escape(f"?{rest}" if rest else ".")
            more = f'<p>Without that: <a href="{address}">{escape(rest) or "the page"}</a></p>'
        body = _ANSWER.format(why=escape(why[:_LONGEST_REASON]), more=more).encode(errors="replace")
        kind = "text/html; charset=utf-8"
        fields = Headers({"Content-Length": str(len(body)), "Content-Type": kind})
        return Response(status.value, status.phrase, fields, body)

    def _handler(self, inner: Callable[..., Any]) -> Callable[..., Any]:
        """Wraps viser's handler of connections, which gets only messages that were checked."""

        async def handle(connection: ServerConnection) -> None:
            if connection.subprotocol != _VERSION:  # viser would print each one
                return await connection.close(1002, "this page is of another version; reload it")
            connection.transport.max_size = 2**13  # [bytes] that are read before others' turn
            uploads = Uploads(self._largest_upload, self._uploads)
            self._uploads.add(uploads)
            try:
                await inner(_Checked(connection, self, uploads))
            finally:
                self._uploads.discard(uploads)

        return handle


class _Checked:
    """A connection whose messages have been checked; all else is the connection's own."""

    def __init__(self, connection: ServerConnection, gate: Gate, uploads: Uploads) -> None:
        self._connection, self._gate, self._uploads = connection, gate, uploads

    def __getattr__(self, name: str) -> Any:
        return getattr(self._connection, name)

    async def recv(self) -> bytes:
        """The next message that viser may see; who sends another is told, or is no page."""
        while True:
            try:
                data = await self._message()
                return checked(data, self._uploads, lambda uuid: self._gate.widget(self, uuid))
            except GarbageError as garbage:
                await self._connection.close(1008, str(garbage)[:100])
            except RefusedError as refused:
                self._gate.on_refused(self, refused)

    async def _message(self) -> bytes:
        """The next message; `websockets` limits its bytes while they arrive, this its time."""
        message, late, abort = bytearray(), None, self._connection.transport.abort
        try:
            async for part in self._connection.recv_streaming(decode=False):
                late = late or get_running_loop().call_later(_SLOWEST, abort)
                message += part
        finally:
            if late is not None:
                late.cancel()
        return bytes(message)


def read_no_link(query: str) -> tuple[str, str]:
    """Of a server whose pages nobody shares: only the density of the picture may be named."""
    others = [name for name, _ in parse_qsl(query, keep_blank_values=True) if name != DENSITY]
    return (f"unknown parameter {others[0]!r}", "") if others else ("", query)


@lru_cache(maxsize=2)
def with_script(page: bytes, encoding: str) -> bytes:
    """The page of viser with `_HEAD` before its own; `encoding` is gzip or identity."""
    html = (gzip.decompress if encoding == "gzip" else bytes)(page)
    html = html.replace(b"<head>", _HEAD.encode(), 1)
    return gzip.compress(html) if encoding == "gzip" else html


def draws_in_software(request: Request | None) -> bool:
    """Whether the page that opened a connection has said that it has no GPU to draw with."""
    return request is not None and "dbb-draws=software" in request.headers.get("Cookie", "")


def is_allowed(origin: str | None, host: str | None, own_names: Collection[str]) -> bool:
    """Whether a request may be answered.

    A browser names the page's origin in every websocket's request; it has to be the address that
    the request is sent to. That address has to be a number, localhost, or this server's name:
    else a foreign name that has been made to point here would be its own origin.

    Args:
        origin: The request's header `Origin`; None for programs that are no browsers.
        host: Its header `Host`.
        own_names: Names by which browsers may reach the server, in small letters.
    """
    if host is None:
        return origin is None
    try:
        here, page = urlsplit(f"//{host}"), urlsplit(origin or "")
        whole = here.netloc == host and here.port != 0  # looked at: one that is no number raises
    except ValueError:  # no address at all
        return False
    if not (whole and _is_here(here.hostname, own_names)):
        return False
    return origin is None or page.netloc.lower() == host.lower()


def _is_here(name: str | None, own_names: Collection[str]) -> bool:
    if name is None:
        return False
    try:
        ipaddress.ip_address(name)
    except ValueError:
        known = {"localhost", *own_names, socket.gethostname().lower()}
        return name.rstrip(".") in known or name.lower().endswith(".localhost")
    return True


def _record(message: type) -> type:
    """A record with the fields of a message of viser, whose types msgspec checks."""
    hints = get_type_hints(message) | _NARROWER.get(message, {})
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
    """What one viewer is uploading: viser keeps what it gets until each part of a file is there.

    As a page sends them, parts come in their order: else viser would keep them for ever.
    """

    def __init__(self, largest: int, everyone: Collection[Uploads] = ()) -> None:
        """Nothing yet; a file may have `largest` [bytes]; few at a time, whoever sends them."""
        self._largest, self._everyone = largest, everyone
        self.unfinished: dict[str, tuple[int, range]] = {}
        """By transfer: how many bytes are still to come, and which parts."""

    def begin(self, transfer: str, size: int, parts: int) -> None:
        """Take note of a file that is announced; an empty one has no parts.

        Raises:
            RefusedError: It is too large, or another is not finished.
        """
        if size > self._largest:
            raise RefusedError(f"{size / 1e6:.0f} MB; a file may have {self._largest / 1e6:.0f} MB")
        if not min(size, 1) <= parts <= size:
            raise RefusedError("this is no upload")
        if sum(len(each.unfinished) for each in {self, *self._everyone}) >= _MOST_UPLOADS:
            raise RefusedError("one upload after the other")
        if parts:
            self.unfinished[transfer] = size, range(parts)

    def add(self, transfer: str, part: int, size: int) -> None:
        """Take note of a part of so many bytes.

        Raises:
            RefusedError: Nothing was announced of which it is the next part.
        """
        left, parts = self.unfinished.get(transfer, (0, range(0)))
        if part not in parts[:1] or size > left or (size < left and not parts[1:]):
            raise RefusedError("not what was announced")
        self.unfinished[transfer] = left - size, parts[1:]
        if not parts[1:]:
            del self.unfinished[transfer]


def checked(data: object, uploads: Uploads, widget: Callable[[str], Any]) -> bytes:
    """The bytes of a message that viser may see.

    Uploads are those of the same viewer; `widget` finds a widget of the page by its name, or None.

    Raises:
        GarbageError: It is none that a page sends, or of other types.
        RefusedError: Its values are not of their kinds, beyond a number of a page or too large.
    """
    if not isinstance(data, bytes):
        raise GarbageError("this is no message")
    if len(data) > LARGEST_MESSAGE and b"GetRenderResponseMessage" not in data[:200]:
        raise RefusedError(f"a message of {len(data) / 1e6:.0f} MB")
    try:
        message = _decoder.decode(data)
    except (msgspec.DecodeError, RecursionError) as error:
        raise GarbageError(f"this is no message ({error})") from None
    if isinstance(message, _RECORDS[_messages.GetRenderResponseMessage]):
        if not is_picture(message.payload):
            raise RefusedError("this is no picture that a page was asked for", message)
        return data
    for name in message.__struct_fields__:
        longest = _LONGEST_VALUE if name == "updates" else _LONGEST_NAME
        if not _is_plain(getattr(message, name), longest, _DEEPEST):
            raise RefusedError(f"{name} is too long, too deep or no number of a page", message)
    if isinstance(message, _RECORDS[_messages.GuiUpdateMessage]):
        if set(message.updates) != {"value"}:
            raise RefusedError("of a widget only its value can be set", message)
        shown, value = widget(message.uuid), message.updates["value"]
        if shown is not None and not is_alike(value, shown.value):
            raise RefusedError("the value is not of the widget's kind", message)
        if value not in getattr(shown, "options", (value,)):
            raise RefusedError(f"there is no {str(value)[:60]!r} to choose", message)
    source = getattr(message, "source_component_uuid", None)
    shown = None if source is None else widget(source)
    if shown is not None and not isinstance(shown.value, UploadedFile):
        raise RefusedError("there is nothing to upload to", message)  # it would become its value
    if isinstance(message, _RECORDS[_messages.FileTransferStartUpload]):
        uploads.begin(message.transfer_uuid, message.size_bytes, message.part_count)
    elif isinstance(message, _RECORDS[_messages.FileTransferPart]):
        uploads.add(message.transfer_uuid, message.part_index, len(message.content))
    return data


def is_picture(content: bytes) -> bool:
    """Whether it is empty, as where none could be made, or a PNG that does not unpack to much."""
    head = content.partition(b"IDAT")[0]
    size = 0 if len(head) < 24 else math.prod(struct.unpack_from(">II", head, 16))
    whole = head.startswith(b"\x89PNG\r\n\x1a\n") and 0 < size <= _MOST_PIXELS
    return not content or (whole and b"acTL" not in head)  # one of many frames


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


def _is_plain(value: Any, longest: int, depth: int) -> bool:
    """Whether numbers are a page's, texts at most `longest` long and containers at most so deep."""
    if isinstance(value, int | float):
        return abs(value) <= _LARGEST_NUMBER  # and no NaN
    if isinstance(value, str):
        return len(value) <= longest
    if isinstance(value, dict | list | tuple):
        inner = (*value, *value.values()) if isinstance(value, dict) else value
        return depth > 0 and all(_is_plain(each, longest, depth - 1) for each in inner)
    return True
