"""Opens and closes viser's servers: silent, for pages of their own only, and without a tunnel."""

from __future__ import annotations

import contextlib
import io
import logging

import viser
from viser import _messages

from app.dashboard.guards.origin import foreign_origins_refused


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
