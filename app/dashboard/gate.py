"""The gate: what a client sends is checked once, before viser sees it.

viser has no place for such checks, so that what it hands to `websockets` when it starts is wrapped:
requests are checked by `is_allowed` and answered with headers that keep foreign pages out; each
message is checked by `checked` before viser takes it apart.
"""

from __future__ import annotations

import http
import ipaddress
import socket
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any
from urllib.parse import parse_qsl, urlsplit

from websockets.asyncio import server as websockets_server
from websockets.asyncio.server import ServerConnection
from websockets.datastructures import Headers
from websockets.http11 import Request, Response

from app.dashboard.messages import GarbageError, RefusedError, Uploads, checked
from app.errors import ServerError

_LARGEST_MESSAGE = 2**20  # [bytes] viser's client sends a file in parts of half of that
_LARGEST_PICTURE = 32 * 2**20  # [bytes] what a page that was asked for a picture may answer
_POLICY = (
    "default-src 'none'; script-src 'self' 'unsafe-inline' 'unsafe-eval' blob: data:; "
    "style-src 'self' 'unsafe-inline'; img-src 'self' data: blob:; font-src 'self' data: blob:; "
    "connect-src 'self' ws://{host} data: blob:; worker-src 'self' blob: data:; "
    "frame-ancestors 'none'; base-uri 'none'; form-action 'none'"
)
"""viser's page has its scripts in it and compiles its markdown; it speaks to nobody else."""


@dataclass(frozen=True)
class Limits:
    """Bounds of what clients may do.

    Attributes:
        viewers: Connections at a time.
        upload: [bytes] of one file.
        parameters: Names that the page's address may carry; viser's own one for the density of the
            picture is harmless, others would tell the page whom to obey.
    """

    viewers: int = 32
    upload: int = 0
    parameters: frozenset[str] = frozenset({"fixedDpr"})


class Gate:
    """What stands between a server of viser and whoever connects to it.

    Attributes:
        widget: Finds the widget of a page, by the page's connection and the widget's name.
        on_refused: Is called with the connection and the reason when a message was refused.
    """

    def __init__(self, own_name: str, limits: Limits) -> None:
        """Prepare.

        Args:
            own_name: The name that the server is told to listen at.
            limits: Bounds of what clients may do.
        """
        self._own_name, self._limits = own_name, limits
        self._viewers = 0
        self.widget: Callable[[Any, str], Any] = lambda connection, uuid: None
        self.on_refused: Callable[[Any, RefusedError], None] = lambda connection, refused: None

    def answer(self, request: Request) -> Response | None:
        """The refusal of a request, or None if it may go on to viser."""
        headers = request.headers
        if not is_allowed(headers.get("Origin"), headers.get("Host"), self._own_name):
            return _refusal(
                http.HTTPStatus.FORBIDDEN, "this page is not allowed to connect to this server"
            )
        if headers.get("Upgrade", "").lower() == "websocket":
            if self._viewers >= self._limits.viewers:
                return _refusal(
                    http.HTTPStatus.SERVICE_UNAVAILABLE,
                    f"{self._viewers} pages are open, which is the most that this server serves",
                )
            return None
        query = parse_qsl(urlsplit(request.path).query, keep_blank_values=True)
        if unknown := {name for name, _ in query} - self._limits.parameters:
            return _refusal(
                http.HTTPStatus.BAD_REQUEST,
                f"the address has the unknown parameter {min(unknown)!r}; "
                f"it may have: {', '.join(sorted(self._limits.parameters)) or 'none'}",
            )
        return None

    def process_request(self, inner: Callable[..., Any]) -> Callable[..., Any]:
        """Wraps viser's own answer to requests: behind this gate's, with safe headers."""

        async def process(connection: ServerConnection, request: Request) -> Response | None:
            answer = self.answer(request)
            if answer is None:
                answer = inner(connection, request)
                answer = await answer if hasattr(answer, "__await__") else answer
            if answer is not None:
                answer.headers.update(_safe_headers(request.headers.get("Host", "")))
            return answer

        return process

    def handler(self, inner: Callable[..., Any]) -> Callable[..., Any]:
        """Wraps viser's handler of connections, which gets only messages that were checked."""

        async def handle(connection: ServerConnection) -> None:
            self._viewers += 1
            try:
                await inner(_Checked(connection, self, self._limits))
            finally:
                self._viewers -= 1

        return handle

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
                more["max_size"] = _LARGEST_PICTURE
                return original(
                    self.handler(handler),
                    *args,
                    process_request=self.process_request(process_request),
                    **more,
                )

            websockets_server.serve = serve  # type: ignore[assignment]
            try:
                yield
            finally:
                websockets_server.serve = original
        if not seen:
            raise ServerError("this version of viser starts its server in a way that is not known")


_lock = threading.Lock()


class _Checked:
    """A connection whose messages have been checked; all else is the connection's own."""

    def __init__(self, connection: ServerConnection, gate: Gate, limits: Limits) -> None:
        self._connection, self._gate = connection, gate
        self._uploads = Uploads(limits.upload)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._connection, name)

    async def recv(self) -> bytes:
        """The next message that viser may see; who sends another is told, or is no page."""
        while True:
            data = await self._connection.recv()
            try:
                return checked(
                    data,
                    _LARGEST_MESSAGE,
                    self._uploads,
                    lambda uuid: self._gate.widget(self, uuid),
                )
            except GarbageError as garbage:
                await self._connection.close(1008, str(garbage)[:100])
            except RefusedError as refused:
                self._gate.on_refused(self, refused)


def is_allowed(origin: str | None, host: str | None, own_name: str) -> bool:
    """Whether a request may be answered.

    A browser names the page's origin in every websocket's request; it has to be the address that
    the request is sent to. That address has to be a number, localhost, or this server's name:
    else a foreign name that has been made to point here would be its own origin.

    Args:
        origin: The request's header `Origin`; None for programs that are no browsers.
        host: Its header `Host`.
        own_name: The name that the server was told to listen at.
    """
    if host is None:
        return origin is None
    if not _is_here(urlsplit(f"//{host}").hostname, own_name):
        return False
    return origin is None or urlsplit(origin).netloc.lower() == host.lower()


def _is_here(name: str | None, own_name: str) -> bool:
    if name is None:
        return False
    try:
        ipaddress.ip_address(name)
    except ValueError:
        known = {"localhost", own_name.lower(), socket.gethostname().lower()}
        return name.lower() in known or name.lower().endswith(".localhost")
    return True


def _safe_headers(host: str) -> dict[str, str]:
    """Headers of every answer; `host` has passed `is_allowed`."""
    return {
        "Content-Security-Policy": _POLICY.format(host=host),
        "X-Frame-Options": "DENY",
        "X-Content-Type-Options": "nosniff",
        "Referrer-Policy": "no-referrer",
        "Cross-Origin-Opener-Policy": "same-origin",
        "Cross-Origin-Resource-Policy": "same-origin",
    }


def _refusal(status: http.HTTPStatus, why: str) -> Response:
    body = f"{why}\n".encode()
    fields = Headers(
        {"Content-Length": str(len(body)), "Content-Type": "text/plain; charset=utf-8"}
    )
    return Response(status.value, status.phrase, fields, body)
