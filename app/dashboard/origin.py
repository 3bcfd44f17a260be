"""Origin check: pages of other origins are refused, which viser itself would accept."""

from __future__ import annotations

import http
import ipaddress
import socket
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any
from urllib.parse import urlsplit

from websockets.asyncio import server as websockets_server
from websockets.asyncio.server import ServerConnection
from websockets.datastructures import Headers
from websockets.http11 import Request, Response

from app.errors import ServerError

_lock = threading.Lock()


def is_allowed(origin: str | None, host: str | None, own_name: str) -> bool:
    """Whether a request may be answered.

    A browser names the page's origin in every websocket's request; it has to be the address that
    the request is sent to. That address has to be a number, localhost, or this server's name:
    else a foreign name that has been made to point here would be its own origin.

    Args:
        origin: The request's header `Origin`; None for programs that are no browsers.
        host: Its header `Host`.
        own_name: The name that the server listens at.
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


@contextmanager
def foreign_origins_refused(own_name: str) -> Iterator[None]:
    """A server that viser starts meanwhile refuses what `is_allowed` does not allow.

    viser has no place for such a check: what it hands to `websockets` when it starts is wrapped.

    Args:
        own_name: The name that the server listens at.

    Raises:
        ServerError: No server was started in the expected way; it must not be used.
    """
    with _lock:
        original, seen = websockets_server.serve, []

        def serve(*args: Any, process_request: Callable[..., Any], **more: Any) -> Any:
            seen.append(True)
            checked = _checked(process_request, own_name)
            return original(*args, process_request=checked, **more)

        websockets_server.serve = serve  # type: ignore[assignment]
        try:
            yield
        finally:
            websockets_server.serve = original
    if not seen:
        raise ServerError("this version of viser starts its server in a way that is not known")


def _checked(process_request: Callable[..., Any] | None, own_name: str) -> Callable[..., Any]:
    async def process(connection: ServerConnection, request: Request) -> Response | None:
        headers = request.headers
        if not is_allowed(headers.get("Origin"), headers.get("Host"), own_name):
            body = b"this page is not allowed to connect to this server\n"
            fields = Headers({"Content-Length": str(len(body)), "Content-Type": "text/plain"})
            return Response(http.HTTPStatus.FORBIDDEN, "Forbidden", fields, body)
        if process_request is None:
            return None
        answer = process_request(connection, request)
        return await answer if hasattr(answer, "__await__") else answer

    return process
