"""A client of the dashboard's server that speaks viser's protocol and can send any data."""

from __future__ import annotations

import contextlib
import threading
from collections.abc import Iterable, Iterator
from typing import Any

import msgspec
import viser
import websockets
from viser import _messages
from websockets.asyncio.client import connect as connect_async
from websockets.sync.client import connect

from app.dashboard.viser_compat import close_server, open_server


@contextlib.contextmanager
def served(allowed: Iterable[str] = ()) -> Iterator[viser.ViserServer]:
    """A server of the dashboard on a free port."""
    server = open_server("127.0.0.1", 0, allowed=allowed)
    try:
        yield server
    finally:
        close_server(server)


def link(server: viser.ViserServer, origin: str | None) -> Any:
    """An asynchronous connection from a page with an origin."""
    return connect_async(
        f"ws://127.0.0.1:{server.get_port()}",
        origin=origin,
        subprotocols=[websockets.Subprotocol(f"viser-v{viser.__version__}")],
    )


class RawClient:
    """One connection; it counts and discards the server's messages.

    Attributes:
        received: [bytes] received so far.
    """

    def __init__(self, address: str, origin: str | None = None) -> None:
        """Connect and send a camera pose, which registers the client at the server."""
        self._connection = connect(
            address.replace("http://", "ws://"),
            origin=origin,
            max_size=None,
            compression=None,
            subprotocols=[websockets.Subprotocol(f"viser-v{viser.__version__}")],
        )
        self.received = 0
        self._thread = threading.Thread(target=self._drain, daemon=True)
        self._thread.start()
        self.send(
            _messages.ViewerCameraMessage(
                wxyz=(1.0, 0.0, 0.0, 0.0),
                position=(2.0, 2.0, 1.5),
                fov=0.75,
                near=0.01,
                far=100.0,
                image_height=900,
                image_width=1600,
                look_at=(0.0, 0.0, 0.4),
                up_direction=(0.0, 0.0, 1.0),
            )
        )

    def send(self, message: Any) -> None:
        """Send one message of viser's."""
        self.send_raw(msgspec.msgpack.encode(message.as_serializable_dict()))

    def send_raw(self, data: bytes | str | Iterable[bytes]) -> None:
        """Send any data as a message; the items of an iterable are its fragments."""
        self._connection.send(data)

    def set_widget(self, handle: Any, value: object) -> None:
        """Send the message of a user who sets a widget to a value."""
        self.send(_messages.GuiUpdateMessage(handle._impl.uuid, {"value": value}))

    @contextlib.contextmanager
    def asleep(self) -> Iterator[None]:
        """Neither read nor answer, like a browser on a sleeping machine; stay connected."""
        with self._connection.protocol_mutex:
            yield

    def close(self) -> None:
        """Close the connection."""
        self._connection.close()
        self._thread.join(timeout=5.0)

    def __enter__(self) -> RawClient:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _drain(self) -> None:
        with contextlib.suppress(websockets.ConnectionClosed):
            for data in self._connection:
                self.received += len(data)
