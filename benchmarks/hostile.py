"""Hostile clients beside an honest viewer: `python -m benchmarks.hostile --seconds 600 [--json]`.

The server is a process of `dbb serve`. One viewer receives all pictures in a separate process, at
first without an attack, then while the attacks take turns on all other connections. The results are
the viewer's longest wait for a picture, alone and in each attack, and the server's memory before
and after the attacks.
"""

from __future__ import annotations

import json as json_module
import math
import os
import signal
import socket
import struct
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from contextlib import ExitStack, closing, suppress
from pathlib import Path
from typing import Any

import msgspec
import psutil
import tyro
import viser
import websockets
import zstandard
from viser import _messages
from websockets.sync.client import ClientConnection, connect

from app.cli.common import print_result
from app.cli.options import Json
from app.jobs.progress import progress_bar

_LONGEST_WAIT = 1.0  # [s] largest accepted wait of the honest viewer for a picture
_LARGEST_GROWTH = 1.15  # [-] largest accepted ratio of the server's memory after and before
_ALONE = 70.0  # [s] time of the viewer alone, before the attacks; then `History` (60 s) is full
_TURN = 10.0  # [s] duration of an attack
_SETTLED = 30.0  # [s] time between the attacks and the measurement of memory
_PLACES = 31  # [-] number of connections beside the viewer
_PAGE = 10.0  # [s] timeout for the widgets of a page
_HALF = 300  # [-] number of simultaneous incomplete requests
_PATIENCE = 600.0  # [s] timeout for the start and the end of the server
_BINARY, _PING = 2, 9  # [-] kinds of a websocket's frame


def main(seconds: float = 600.0, json: Json = False) -> None:
    """Attack a server; the status is 1 if the server ends, the viewer waits too long for a picture,
    or the server's memory grows too much.

    Args:
        seconds: [s] duration of all attacks.
        json: Print only one JSON object.
    """
    with tempfile.TemporaryDirectory() as folder, ExitStack() as stack:
        port = _free_port()
        server = _served(port, Path(folder))
        stack.callback(_end, server)
        _wait_for(port, server)
        with suppress(websockets.ConnectionClosed), closing(_Client(port)) as first:
            first.find_widgets()
        alone = _watched(port, _ALONE)
        alone_s = _longest(_silences(alone))
        before, log_before = _memory(server), (folder_log := Path(folder) / "log").stat().st_size
        watcher = _watched(port, seconds)
        attacks, cpu_s, peak, turns = _attack(port, server, seconds)
        silences = _silences(watcher)
        time.sleep(_SETTLED)
        result = {
            "seconds": seconds,
            "attacks": attacks,
            "server_cpu_s": cpu_s,
            "longest_wait_alone_s": alone_s,
            "longest_wait_s": _longest(silences),
            "longest_waits_s": {
                name: _longest(silences, [turn for each, *turn in turns if each == name])
                for name in _ATTACKS
            },
            "memory_before_mb": before,
            "memory_peak_mb": peak,
            "memory_after_mb": _memory(server),
            "log_bytes": folder_log.stat().st_size - log_before,
            "load": os.getloadavg()[1],
            "serves": server.poll() is None,
        }
    print_result(result, json=json)
    if findings := _findings(result):
        sys.exit("\n".join(findings))


def _findings(result: dict[str, Any]) -> list[str]:
    found = []
    if not result["serves"]:
        found.append("the server has ended")
    if result["longest_wait_s"] > _LONGEST_WAIT:
        found.append(f"the viewer waited {result['longest_wait_s']:.1f} s for a picture")
    if result["memory_after_mb"] > _LARGEST_GROWTH * result["memory_before_mb"]:
        found.append(f"memory grew to {result['memory_after_mb']:.0f} MB")
    return found


def _served(port: int, folder: Path) -> subprocess.Popen[bytes]:
    """Start `dbb serve` in a folder, as a user does."""
    words = ("-m", "app", "serve", "--physics", "kinematic", "--port", str(port))
    root = str(Path(__file__).resolve().parent.parent)
    environment = {**os.environ, "PYTHONPATH": root, "DBB_ROBOTS": str(folder / "robots")}
    with (folder / "log").open("wb") as log:
        return subprocess.Popen(
            [sys.executable, *words], cwd=folder, env=environment, stdout=log, stderr=log
        )


def _wait_for(port: int, server: subprocess.Popen[bytes]) -> None:
    """Wait until the server answers."""
    end = time.monotonic() + _PATIENCE
    while time.monotonic() < end and server.poll() is None:
        with suppress(OSError), socket.create_connection(("127.0.0.1", port), timeout=1.0):
            return
        time.sleep(0.2)
    raise RuntimeError("the server does not start")


def _end(server: subprocess.Popen[bytes]) -> None:
    server.send_signal(signal.SIGTERM)
    server.wait(_PATIENCE)


def _watched(port: int, seconds: float) -> subprocess.Popen[bytes]:
    """Start the honest viewer, and wait until it is connected."""
    words = ("-m", "benchmarks.client", "websocket", f"http://127.0.0.1:{port}", str(seconds))
    viewer = subprocess.Popen([sys.executable, *words], stdout=subprocess.PIPE)
    if viewer.stdout is None or viewer.stdout.readline() != b"ready\n":
        raise RuntimeError("the viewer does not connect")
    return viewer


def _silences(viewer: subprocess.Popen[bytes]) -> list[tuple[float, float]]:
    """Wait for the end of a viewer; return start and length [s] of each silence that it reports."""
    return json_module.loads(viewer.communicate()[0].splitlines()[-1])["silences_s"]


def _longest(
    silences: list[tuple[float, float]], within: Sequence[Sequence[float]] = ((0.0, math.inf),)
) -> float:
    """[s] the longest of the silences that overlap one of some intervals; 0 if none does."""
    touching = [
        length
        for begin, length in silences
        if any(begin < last and begin + length > first for first, last in within)
    ]
    return max(touching, default=0.0)


def _attack(
    port: int, server: subprocess.Popen[bytes], seconds: float
) -> tuple[dict[str, int], dict[str, float], float, list[tuple[str, float, float]]]:
    """Let the attacks take turns.

    Returns:
        The number of items that each attack has sent, the server's processor time [s] during each
        attack, the largest memory [MB], and name, start and end [s] of each turn.
    """
    done, spent, peak = dict.fromkeys(_ATTACKS, 0), dict.fromkeys(_ATTACKS, 0.0), 0.0
    turns: list[tuple[str, float, float]] = []
    begin = time.monotonic()
    with progress_bar("hostile clients", 1.0) as on_progress:
        while (gone := time.monotonic() - begin) < seconds and server.poll() is None:
            for name, attack in _ATTACKS.items():
                start = time.monotonic()
                end, before = min(start + _TURN, begin + seconds), _cpu(server)
                while time.monotonic() < end and server.poll() is None:
                    with suppress(OSError, websockets.WebSocketException, TimeoutError):
                        done[name] += attack(port, end)
                    peak = max(peak, _memory(server))
                    time.sleep(0.05)
                spent[name] += _cpu(server) - before
                turns.append((name, start, time.monotonic()))
            on_progress(min(gone / seconds, 1.0))
    return done, spent, peak, turns


def _cpu(server: subprocess.Popen[bytes]) -> float:
    """[s] processor time of the server without its children; 0 if it has ended."""
    with suppress(psutil.NoSuchProcess):
        return sum(psutil.Process(server.pid).cpu_times()[:2])
    return 0.0


class _Client:
    """A client that acts as a page, and stores the widgets that it receives."""

    def __init__(self, port: int) -> None:
        self._connection: ClientConnection = connect(
            f"ws://127.0.0.1:{port}",
            max_size=None,
            compression=None,
            subprotocols=[websockets.Subprotocol(f"viser-v{viser.__version__}")],
        )
        self.widgets: dict[str, dict[str, Any]] = {}

    def close(self) -> None:
        """Close the connection without a closing message."""
        self._connection.socket.close()

    def send(self, message: Any) -> None:
        """Send a message."""
        self._connection.send(msgspec.msgpack.encode(message.as_serializable_dict()))

    def find_widgets(self) -> None:
        """Send the camera's pose, and receive the widgets of the page that the server makes."""
        eye, to, up = (2.0, 2.0, 1.5), (0.0, 0.0, 0.4), (0.0, 0.0, 1.0)
        turn, size = (1.0, 0.0, 0.0, 0.0), (900, 1600)
        self.send(_messages.ViewerCameraMessage(turn, eye, 0.75, 0.01, 100.0, *size, to, up))
        end = time.monotonic() + _PAGE
        with suppress(TimeoutError):
            while time.monotonic() < end and not self.named("GuiUploadButtonMessage"):
                self._take(self._connection.recv(timeout=_PAGE, decode=False))

    def _take(self, data: bytes) -> None:
        size, packed = struct.unpack_from("<QQ", data)
        plain = zstandard.ZstdDecompressor().decompress(
            data[16 : 16 + packed], max_output_size=size
        )
        for message in msgspec.msgpack.decode(plain)["messages"]:
            if message.get("type", "").startswith("Gui") and "props" in message:
                self.widgets[message["uuid"]] = message

    def named(self, kind: str) -> list[str]:
        """The identifiers of the widgets of a kind."""
        return [uuid for uuid, each in self.widgets.items() if each["type"] == kind]


def _frame(kind: int, data: bytes = b"", *, last: bool = True) -> bytes:
    """A websocket frame of a client, with a mask of zeros."""
    size = len(data)
    head = bytes([(0x80 if last else 0) | kind])
    if size < 126:
        head += bytes([0x80 | size])
    elif size < 2**16:
        head += bytes([0x80 | 126]) + struct.pack(">H", size)
    else:
        head += bytes([0x80 | 127]) + struct.pack(">Q", size)
    return head + b"\0\0\0\0" + data


def _raw(port: int) -> socket.socket:
    """Open a websocket for frames of any content."""
    made = socket.create_connection(("127.0.0.1", port), timeout=5.0)
    made.sendall(
        f"GET / HTTP/1.1\r\nHost: 127.0.0.1:{port}\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
        "Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\nSec-WebSocket-Version: 13\r\n"
        f"Sec-WebSocket-Protocol: viser-v{viser.__version__}\r\n\r\n".encode()
    )
    made.recv(4096)
    return made


def _parts(port: int, end: float) -> int:
    """Send large fragments of messages that never end, on all connections at once."""
    part, sent = _frame(0, b"z" * 2**20, last=False), 0
    with ExitStack() as stack:
        for _ in range(_PLACES):
            each = stack.enter_context(_raw(port))
            with suppress(OSError):
                each.sendall(_frame(_BINARY, b"x" * 1000, last=False))
                for _ in range(31):
                    each.sendall(part)
                    sent += 1
        time.sleep(min(max(end - time.monotonic(), 0.0), 2.0))
    return sent


def _trickle(port: int, end: float) -> int:
    """Send empty fragments of a message that never ends."""
    sent, many = 0, _frame(0, last=False) * 1000
    with _raw(port) as each:
        each.sendall(_frame(_BINARY, b"x", last=False))
        while time.monotonic() < end:
            each.sendall(many)
            sent += 1000
    return sent


def _pings(port: int, end: float) -> int:
    """Send pings, and do not read the answers."""
    sent, many = 0, _frame(_PING, b"p" * 125) * 400
    with _raw(port) as each:
        each.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        while time.monotonic() < end:
            each.sendall(many)
            sent += 400
    return sent


def _half_requests(port: int, end: float) -> int:
    """Send incomplete HTTP requests."""
    with ExitStack() as stack:
        for _ in range(_HALF):
            each = stack.enter_context(socket.create_connection(("127.0.0.1", port), timeout=5.0))
            each.sendall(b"GET / HTTP/1.1\r\nHost: x")
        time.sleep(max(end - time.monotonic(), 0.0))
    return _HALF


def _come_and_go(port: int, end: float) -> int:
    """Open a page and leave it at once."""
    with closing(_Client(port)) as client:
        client.find_widgets()
    return 1


def _words(port: int, end: float) -> int:
    """Send malformed messages of the page's script, and invalid values of widgets."""
    sent = 0
    with closing(_Client(port)) as client:
        client.find_widgets()
        texts = client.named("GuiTextMessage")
        while time.monotonic() < end:
            for uuid in client.widgets:
                value = json_module.dumps([sent, "go", "x"]) if uuid in texts else float("nan")
                client.send(_messages.GuiUpdateMessage(uuid, {"value": value}))
                sent += 1
    return sent


def _bombs(port: int, end: float) -> int:
    """Upload files that need far more time or memory than their size suggests."""
    sent = 0
    bombs = (
        f"a{'.b' * 30_000} = 1".encode(),
        b'{"dbb_case": 1, "options": ' + b"[" * 60_000,
        b"<robot>" + b"<a>" * 20_000,
    )
    with closing(_Client(port)) as client:
        client.find_widgets()
        for uuid in client.named("GuiUploadButtonMessage"):
            for data in bombs:
                start = _messages.FileTransferStartUpload(
                    uuid, f"t{sent}", "a.toml", "text/plain", 1, len(data)
                )
                client.send(start)
                client.send(_messages.FileTransferPart(uuid, f"t{sent}", 0, data))
                sent += 1
        while time.monotonic() < end:
            client._take(client._connection.recv(timeout=1.0, decode=False))
    return sent


def _unfinished(port: int, end: float) -> int:
    """Begin uploads, and do not complete them, on four connections."""
    sent, clients = 0, ExitStack()
    with clients:
        for _ in range(4):
            client = clients.enter_context(closing(_Client(port)))
            client.find_widgets()
            for uuid in client.named("GuiUploadButtonMessage"):
                size = 60_000
                client.send(_messages.FileTransferStartUpload(uuid, "u", "a.zip", "a/b", 2, size))
                client.send(_messages.FileTransferPart(uuid, "u", 0, b"x" * (size - 1)))
                sent += 1
        time.sleep(min(max(end - time.monotonic(), 0.0), 2.0))
    return sent


_ATTACKS: dict[str, Callable[[int, float], int]] = {
    "large parts": _parts,
    "empty parts": _trickle,
    "unread pings": _pings,
    "half requests": _half_requests,
    "pages opened and left": _come_and_go,
    "malformed words": _words,
    "files that expand": _bombs,
    "unfinished uploads": _unfinished,
}
"""The attacks. Each takes a port and its end by `time.monotonic`, and returns the number of sent
items."""


def _memory(server: subprocess.Popen[bytes]) -> float:
    """[MB] memory of the server and of the processes that it has started."""
    total = 0.0
    with suppress(psutil.NoSuchProcess):
        here = psutil.Process(server.pid)
        for each in (here, *here.children(recursive=True)):
            with suppress(psutil.NoSuchProcess):
                total += each.memory_info().rss / 1e6
    return total


def _free_port() -> int:
    with socket.socket() as found:
        found.bind(("127.0.0.1", 0))
        return found.getsockname()[1]


if __name__ == "__main__":
    tyro.cli(main)
