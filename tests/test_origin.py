"""Who may speak to the server."""

from __future__ import annotations

import asyncio
from contextlib import contextmanager

import pytest
import viser
import websockets
from websockets.asyncio.client import connect

from app.dashboard import origin
from app.dashboard.origin import foreign_origins_refused, is_allowed
from app.errors import ServerError


@pytest.mark.parametrize(
    ("of_page", "host", "allowed"),
    [
        ("http://127.0.0.1:8080", "127.0.0.1:8080", True),
        ("http://localhost:8080", "localhost:8080", True),
        ("http://LOCALHOST:8080", "localhost:8080", True),
        ("http://[::1]:8080", "[::1]:8080", True),
        ("http://192.168.1.7:8080", "192.168.1.7:8080", True),
        ("http://robot:8080", "robot:8080", True),
        (None, "127.0.0.1:8080", True),  # no browser
        ("http://evil.example", "127.0.0.1:8080", False),
        ("http://127.0.0.1:9000", "127.0.0.1:8080", False),  # another server's page
        ("http://localhost:8080", "127.0.0.1:8080", False),
        ("null", "127.0.0.1:8080", False),  # a file, or a sandboxed frame
        ("", "127.0.0.1:8080", False),
        ("http://evil.example:8080", "evil.example:8080", False),  # a name made to point here
        (None, "evil.example:8080", False),
        ("http://localhost.evil.example:8080", "localhost.evil.example:8080", False),
        ("http://127.0.0.1:8080", None, False),
    ],
)
def test_only_the_servers_own_page_is_allowed(of_page, host, allowed):
    assert is_allowed(of_page, host, "robot") is allowed


@contextmanager
def served():
    with foreign_origins_refused("127.0.0.1"):
        server = viser.ViserServer(host="127.0.0.1", port=0, verbose=False)
    try:
        yield server
    finally:
        server.stop()


def try_to_connect(server, of_page):
    async def attempt():
        async with connect(
            f"ws://127.0.0.1:{server.get_port()}",
            origin=of_page,
            subprotocols=[websockets.Subprotocol(f"viser-v{viser.__version__}")],
        ) as connection:
            return await asyncio.wait_for(connection.recv(), timeout=10.0)

    return asyncio.run(attempt())


def test_a_foreign_page_cannot_connect_and_the_own_one_can():
    with served() as server:
        with pytest.raises(websockets.InvalidStatus) as refused:
            try_to_connect(server, "http://evil.example")
        assert refused.value.response.status_code == 403
        assert try_to_connect(server, f"http://127.0.0.1:{server.get_port()}")
        assert try_to_connect(server, None)


def test_the_check_is_taken_away_again_for_other_servers():
    before = origin.websockets_server.serve
    with served():
        assert origin.websockets_server.serve is before


def test_a_viser_that_starts_in_another_way_is_not_used():
    with (
        pytest.raises(ServerError, match="this version of viser"),
        foreign_origins_refused("127.0.0.1"),
    ):
        pass
