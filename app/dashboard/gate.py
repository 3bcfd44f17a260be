"""Checks of connections and of the pages' messages, before viser handles them.

viser has no hook for these checks. Therefore this module wraps the functions that viser passes to
`websockets` when its server starts.
"""

import dataclasses
import ipaddress
import math
import re
import socket
import struct
import threading
from asyncio import get_running_loop
from collections.abc import Callable, Collection, Iterator
from contextlib import contextmanager, suppress
from functools import partial
from html import escape
from http import HTTPStatus
from typing import Any, Union, get_type_hints
from urllib.parse import urlsplit

import msgspec
from viser import UploadedFile, __version__, _messages
from websockets.asyncio import server as websockets_server
from websockets.asyncio.server import ServerConnection
from websockets.datastructures import Headers
from websockets.http11 import Request, Response

from app.dashboard.markup import with_head
from app.errors import ServerError

LARGEST_MESSAGE = 2**20  # [bytes] viser's client sends a file in parts of half this size
LARGEST_PICTURE = 32 * 2**20  # [bytes] of a screenshot, which a page sends on request
_MOST_PIXELS = 2**24  # [-] pixels of a screenshot
_MOST_WAITING = 2  # [-] unread messages of a connection
_SLOWEST = 10.0  # [s] longest time from the first part of a message to the last
_MOST_VIEWERS = 32  # [-] simultaneous connections
_QUERY = re.compile(r"(fixedDpr=([1-4]|[0-3]\.\d{1,3}))?")
"""Allowed query of an address: drawn pixels per pixel of the page. viser's other parameters are
refused, because one of them selects another server."""
_LONGEST_PATH = 255  # [characters] length of a path; no file of the page has a longer one
_MOST_UPLOADS = 2  # [-] simultaneous uploads
_LONGEST_NAME = 1000  # [characters] length of a name of an element, a file or a scene node
_LONGEST_VALUE = 2**16  # [characters] length of a widget's new value
_DEEPEST = 6  # [-] levels of nested containers
_LARGEST_NUMBER = 2**53  # [-] JavaScript represents all smaller integers exactly
_POLICY = (
    "default-src 'none'; script-src 'self' 'unsafe-inline' 'unsafe-eval' blob: data:; "
    "style-src 'self' 'unsafe-inline'; img-src 'self' data: blob:; font-src 'self' data: blob:; "
    "connect-src 'self' ws://{host} data: blob:; worker-src 'self' blob: data:; "
    "frame-ancestors 'none'; base-uri 'none'; form-action 'none'"
)
"""Content policy: viser's page contains its scripts, evaluates code of its markdown, and connects
only to this server."""
_HEADERS = {  # of each answer by `Gate`, in addition to the policy
    "X-Frame-Options": "DENY",
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cross-Origin-Resource-Policy": "same-origin",
}
_REFUSAL = """<!doctype html><html lang="en"><meta charset="utf-8"><title>Not possible</title>
<meta name="viewport" content="width=device-width"><link rel="icon" href="data:,">
<style>:root {{ color-scheme: light dark; font: 1.1rem/1.5 sans-serif }}
body {{ max-width: 40em; margin: 15vh auto; padding: 0 1em; overflow-wrap: anywhere }}</style>
<p>{why}.</p>{more}</html>
"""
_WAY_OUT = """<p>To reach this server under this name, restart it with
<code>--allow-host {name}</code>. Everybody who can open the page can move the robot.</p>"""
_LONGEST_REASON = 400  # [characters] length of the reason for a refusal
_REQUEST = re.compile(rb"([A-Z]+) (\S+) HTTP/1\.[01]\r\n")
_METHODS = "GET", "HEAD"
_PORTS = {"http": 80, "https": 443}
# Headers that may occur once only, because this module or viser reads a single value.
_SINGLE = ("Host", "Origin", "Upgrade", "Cookie", "Accept-Encoding")
_lock = threading.Lock()

_TAKEN = (
    _messages.ViewerCameraMessage,
    _messages.GuiUpdateMessage,
    _messages.CommandTriggerMessage,
    _messages.SceneNodeDragMessage,
    _messages.TransformControlsUpdateMessage,
    _messages.TransformControlsDragStartMessage,
    _messages.TransformControlsDragEndMessage,
    _messages.GetRenderResponseMessage,
    _messages.FileTransferStartUpload,
    _messages.FileTransferPart,
    _messages.FileTransferPartAck,
)
"""Types of messages that this program's page sends. viser accepts further types: one opens a tunnel
to this machine; another one, about an unknown form, is stored forever and sent to every viewer."""
_VERSION = f"viser-v{__version__}"  # name of the websocket protocol


class RefusedError(ValueError):
    """A message is refused; the page shows the reason `why` after "Refused: "."""

    def __init__(self, why: str, message: Any = None) -> None:
        super().__init__(why)
        self.message = message  # the refused message, or None if unknown


class GarbageError(RefusedError):
    """A connection has sent data that no page of this program sends, and is closed."""


class Gate:
    """It refuses connections and messages that a viser server must not get."""

    def __init__(self, host: str, allowed: Collection[str], largest_upload: int) -> None:
        """Create a gate; the arguments are those of `open_server`."""
        self._allowed = {name.lower() for name in allowed}
        self._own_names = {host.lower(), *self._allowed}
        self._largest_upload = largest_upload
        self._uploads: set[Uploads] = set()  # of each connected viewer
        self.widget: Callable[[Any, str], Any] = lambda connection, uuid: None
        """Returns a widget of a page, by the page's connection and the widget's UUID, or None."""
        self.on_refused: Callable[[Any, RefusedError], None] = lambda connection, refused: None
        """Called with connection and error after each `RefusedError` except a `GarbageError`."""

    @contextmanager
    def closed(self) -> Iterator[None]:
        """Context: the server that viser starts in it lets this gate check all connections."""
        with _lock:
            original, seen = websockets_server.serve, []

            def serve(handler: Any, *args: Any, process_request: Any, **more: Any) -> Any:
                seen.append(True)
                more |= {"max_size": LARGEST_MESSAGE, "max_queue": _MOST_WAITING}
                more["create_connection"] = _Connection
                more["process_request"] = partial(self._answer, process_request)
                return original(partial(self._handle, handler), *args, **more)

            websockets_server.serve = serve  # type: ignore[assignment]
            try:
                yield
            finally:
                websockets_server.serve = original
        if not seen:
            raise ServerError("this version of viser starts its server in an unknown way")

    async def _answer(
        self, inner: Callable[..., Any], connection: "_Connection", request: Request
    ) -> Response | None:
        """Return a refusal, or the answer of viser's `inner` with scripts; None for a websocket."""
        if (answer := self._refusal(request, connection.method)) is None:
            answer = inner(connection, request)
            answer = await answer if hasattr(answer, "__await__") else answer
            if answer and answer.headers.get("Content-Type", "").startswith("text/html"):
                answer.body = with_head(bytes(answer.body), answer.headers["Content-Encoding"])
                del answer.headers["Content-Length"]
                answer.headers["Content-Length"] = str(len(answer.body))
        if answer is not None:
            host = ", ".join(request.headers.get_all("Host")).encode("ascii", "ignore").decode()
            answer.headers.update(_HEADERS)
            answer.headers["Content-Security-Policy"] = _POLICY.format(host=host)
            answer.body = b"" if connection.method == "HEAD" else answer.body
        return answer

    def _refusal(self, request: Request, method: str) -> Response | None:
        headers = request.headers
        path, _, query = request.path.partition("?")
        status, more = HTTPStatus.BAD_REQUEST, ""  # unless a case below replaces them
        if method not in _METHODS:
            status = HTTPStatus.METHOD_NOT_ALLOWED
            why = f"this server does not accept the method {method}; use GET or HEAD"
        elif twice := [name for name in _SINGLE if len(headers.get_all(name)) > 1]:
            why = f"the request has the header {twice[0]} more than once"
        elif not is_allowed(
            headers.get("Origin"), headers.get("Host"), self._own_names, self._allowed
        ):
            status, why = HTTPStatus.FORBIDDEN, "this page is not allowed to connect to this server"
            name = re.match(r"[\w.-]+", headers.get("Host", ""))
            more = _WAY_OUT.format(name=name[0] if name else "NAME")
        elif headers.get("Upgrade", "").lower() == "websocket":
            if len(self._uploads) < _MOST_VIEWERS:
                return None
            status = HTTPStatus.SERVICE_UNAVAILABLE
            why = f"{len(self._uploads)} pages are open: this is the limit of the server"
        elif len(path) > _LONGEST_PATH:
            status = HTTPStatus.REQUEST_URI_TOO_LONG
            why = f"the path has {len(path)} characters; the limit is {_LONGEST_PATH}"
        elif not _QUERY.fullmatch(query):
            why = f"unknown parameter in the address: {query}"
            # A relative address, because a proxy may serve this page below a path.
            more = '<p><a href=".">Open the page without it</a></p>'
        else:
            return None
        html = _REFUSAL.format(why=escape(why[:_LONGEST_REASON]), more=more)
        body = html.encode(errors="replace")
        fields = {"Content-Length": str(len(body)), "Content-Type": "text/html; charset=utf-8"}
        return Response(status.value, status.phrase, Headers(fields), body)

    async def _handle(self, inner: Callable[..., Any], connection: Any) -> None:
        """Run viser's handler `inner`, which gets only checked messages of this version's pages."""
        if connection.subprotocol != _VERSION:  # viser would print each wrong version
            return await connection.close(1002, "this page is of another version; reload it")
        connection.transport.max_size = 2**13  # [bytes] read at once, then other connections
        uploads = Uploads(self._largest_upload, self._uploads)
        connection.gate, connection.uploads = self, uploads
        self._uploads.add(uploads)
        try:
            await inner(connection)
        finally:
            self._uploads.discard(uploads)


class _Connection(ServerConnection):
    """A connection that answers HTTP/1.0 and any method; `recv` returns only allowed messages.

    The library `websockets` answers only GET requests of HTTP/1.1, but proxies send HTTP/1.0, and
    health checks send HEAD requests.
    """

    method = "GET"  # method of the HTTP request, such as "HEAD"
    gate: Gate
    uploads: "Uploads"

    def data_received(self, data: bytes) -> None:
        """Read data; replace method and version of a request by GET and HTTP/1.1."""
        if self.method not in _METHODS:  # the answer is on its way: ignore the request's content
            return
        if self.request is None and (line := _REQUEST.match(data)):
            self.method, rest = line[1].decode(), data[line.end() :]
            # Content that follows the request would be an error, and its headers announce it.
            rest = rest if self.method in _METHODS else b"\r\n"
            data = b"GET %b HTTP/1.1\r\n%b" % (line[2], rest)
        super().data_received(data)

    async def recv(self, decode: bool | None = False) -> Any:
        """Return the next allowed message; report refused ones, and disconnect after garbage."""
        while True:
            try:
                data = await self._message()
                return checked(data, self.uploads, lambda uuid: self.gate.widget(self, uuid))
            except GarbageError as garbage:
                await self.close(1008, str(garbage)[:100])
            except RefusedError as refused:
                self.gate.on_refused(self, refused)

    async def _message(self) -> bytes:
        """Return the next message; abort the connection if its transfer exceeds `_SLOWEST`."""
        message, late = bytearray(), None
        try:
            async for part in self.recv_streaming(decode=False):
                late = late or get_running_loop().call_later(_SLOWEST, self.transport.abort)
                message += part
        finally:
            if late is not None:
                late.cancel()
        return bytes(message)


def is_allowed(
    origin: str | None, host: str | None, own_names: Collection[str], allowed: Collection[str]
) -> bool:
    """Whether the server accepts a request; `origin` and `host` are its headers, None if absent.

    `Host` must be an IP address, localhost or below it, the name of this machine, or one of
    `own_names`, because another website could let its own name point to this machine. `Origin`,
    which browsers send with each websocket request, must be absent, or have the same name and port
    as `Host`, or have a name in `allowed`, because a proxy can change `Host`. A request with
    neither header is accepted. `own_names` and `allowed` are in lower case.
    """
    if host is None:
        return origin is None
    try:
        here, page = urlsplit(f"//{host}"), urlsplit(origin or "")
        port = _PORTS.get(page.scheme)
        whole = here.netloc == host and here.port != 0  # raises if the port is not a number
        same = (here.hostname, here.port or port) == (page.hostname, page.port or port)
    except ValueError:  # not an address
        return False
    if not (whole and here.hostname and _is_here(here.hostname, own_names)):
        return False
    return origin is None or same or (page.hostname or "").rstrip(".") in allowed


def _is_here(name: str, own_names: Collection[str]) -> bool:
    with suppress(ValueError):
        ipaddress.ip_address(name)
        return True
    known = {"localhost", *own_names, socket.gethostname().lower()}
    return name.rstrip(".") in known or name.lower().endswith(".localhost")


def _record(message: type) -> type:
    """Return a record type for a type of viser message; msgspec checks the types of its fields."""
    name, hints = message.__name__, get_type_hints(message)
    fields = [
        (f.name, hints[f.name], *([f.default] if f.default is not dataclasses.MISSING else []))
        for f in dataclasses.fields(message)
        if f.init
    ]
    return msgspec.defstruct(name, fields, tag_field="type", tag=name, forbid_unknown_fields=True)


_RECORDS = {message: _record(message) for message in _TAKEN}
_decoder = msgspec.msgpack.Decoder(type=Union[tuple(_RECORDS.values())])  # noqa: UP007


class Uploads:
    """Register of a viewer's unfinished uploads; viser would store unregistered parts forever."""

    def __init__(self, largest: int, everyone: Collection["Uploads"] = ()) -> None:
        """Accept files up to `largest` [bytes]; `everyone` has the registers of all viewers."""
        self._largest, self._everyone = largest, everyone
        self.unfinished: dict[str, tuple[int, range]] = {}
        """Number of missing bytes, and indices of missing parts, by the transfer's UUID."""

    def begin(self, transfer: str, size: int, parts: int) -> None:
        """Register a new file of `size` [bytes] in `parts` parts, or raise `RefusedError`."""
        if size > self._largest:
            limit = f"the limit is {self._largest / 1e6:.0f} MB"
            raise RefusedError(f"a file of {size / 1e6:.0f} MB; {limit}")
        if size < 0 or not min(size, 1) <= parts <= size:
            raise RefusedError(f"an upload of {size} bytes cannot have {parts} parts")
        if sum(len(each.unfinished) for each in {self, *self._everyone}) >= _MOST_UPLOADS:
            raise RefusedError("too many uploads at a time; wait for the end of the others")
        if parts:
            self.unfinished[transfer] = size, range(parts)

    def add(self, transfer: str, part: int, size: int) -> None:
        """Register a part of `size` [bytes], or raise `RefusedError` if the file cannot have it."""
        left, parts = self.unfinished.get(transfer, (0, range(0)))
        if part not in parts[:1] or size > left or (size < left and not parts[1:]):
            raise RefusedError("this part does not belong to an announced upload")
        self.unfinished[transfer] = left - size, parts[1:]
        if not parts[1:]:
            del self.unfinished[transfer]


def checked(data: object, uploads: Uploads, widget: Callable[[str], Any]) -> bytes:
    """Return the unchanged bytes of an allowed message; register files and parts in `uploads`.

    `widget` returns a widget of the page by its UUID, or None. Raises `GarbageError` if the data
    are not a message of the types `_TAKEN`. Raises `RefusedError` if the message or a value is too
    large, an update is not a valid value of its widget, or a picture or an upload is not allowed.
    """
    if not isinstance(data, bytes):
        raise GarbageError("this is not a message")
    if len(data) > LARGEST_MESSAGE and b"GetRenderResponseMessage" not in data[:200]:
        limit = f"the limit is {LARGEST_MESSAGE / 1e6:.1f} MB"
        raise RefusedError(f"a message of {len(data) / 1e6:.1f} MB; {limit}")
    try:
        message = _decoder.decode(data)
    except (msgspec.DecodeError, RecursionError) as error:
        raise GarbageError(f"this is not a message ({error})") from None
    if isinstance(message, _RECORDS[_messages.GetRenderResponseMessage]):
        if not is_picture(message.payload):
            raise RefusedError("this is not a still PNG picture of an allowed size", message)
        return data
    for name in message.__struct_fields__:
        longest = _LONGEST_VALUE if name == "updates" else _LONGEST_NAME
        if not _is_plain(getattr(message, name), longest, _DEEPEST):
            raise RefusedError(f"{name} is too long, too deeply nested, or too large", message)
    if isinstance(message, _RECORDS[_messages.GuiUpdateMessage]):
        if set(message.updates) != {"value"}:
            raise RefusedError("only the value of a widget can be set", message)
        shown, value = widget(message.uuid), message.updates["value"]
        if shown is not None and not is_alike(value, shown.value):
            raise RefusedError("the value does not match the widget", message)
        if value not in getattr(shown, "options", (value,)):
            raise RefusedError(f"{str(value)[:60]!r} is not one of the choices", message)
    source = getattr(message, "source_component_uuid", None)
    shown = None if source is None else widget(source)
    if shown is not None and not isinstance(shown.value, UploadedFile):
        raise RefusedError("this element accepts no files", message)  # a file would be its value
    if isinstance(message, _RECORDS[_messages.FileTransferStartUpload]):
        uploads.begin(message.transfer_uuid, message.size_bytes, message.part_count)
    elif isinstance(message, _RECORDS[_messages.FileTransferPart]):
        uploads.add(message.transfer_uuid, message.part_index, len(message.content))
    return data


def is_picture(content: bytes) -> bool:
    """Whether `content` is empty, or has the head of a still PNG of at most `_MOST_PIXELS`."""
    head = content.partition(b"IDAT")[0]
    size = 0 if len(head) < 24 else math.prod(struct.unpack_from(">II", head, 16))
    whole = head.startswith(b"\x89PNG\r\n\x1a\n") and 0 < size <= _MOST_PIXELS
    return not content or (whole and b"acTL" not in head)  # not an animation


def is_alike(value: Any, current: object) -> bool:
    """Whether `value` has the type of a widget's current value; int and float count as one type."""
    if isinstance(current, tuple):  # a page sends it as a list
        as_long = isinstance(value, list) and len(value) == len(current)
        return as_long and all(map(is_alike, value, current))
    if isinstance(current, int | float) and not isinstance(current, bool):
        return isinstance(value, int | float) and not isinstance(value, bool)
    return isinstance(value, type(current))


def _is_plain(value: Any, longest: int, depth: int) -> bool:
    """Whether a value has no large number, no text over `longest`, and at most `depth` levels."""
    if isinstance(value, int | float):
        return abs(value) <= _LARGEST_NUMBER  # False for NaN
    if isinstance(value, str):
        return len(value) <= longest
    if isinstance(value, dict | list | tuple):
        inner = (*value, *value.values()) if isinstance(value, dict) else value
        return depth > 0 and all(_is_plain(each, longest, depth - 1) for each in inner)
    return True
