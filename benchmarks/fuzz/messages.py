"""Mutated messages of every kind that a page may send, to a real dashboard server.

The gate's own check first judges each message in this process. Garbage ends the connection of its
sender. Therefore only some garbage is sent through a socket; the client then connects again.
"""

from __future__ import annotations

import contextlib
import dataclasses
import logging
import os
import tempfile
import time
from collections import Counter, deque
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any, get_args, get_type_hints
from unittest.mock import patch

import msgspec
import numpy as np
import psutil
import websockets
from PIL import Image
from viser import _messages, _viser

from app.cli.common import load_robot_and_border
from app.config import Config
from app.dashboard import gate
from app.dashboard.export.browser import VARIABLE
from app.dashboard.job import Job
from app.dashboard.panels.save import SIZES, png
from app.dashboard.server import DashboardServer, serve_dashboard
from app.onboarding.read.package import LARGEST_ARCHIVE
from app.simulation.loop.commands import Pause
from app.simulation.loop.process_loop import ProcessLoop
from app.simulation.session import Session
from benchmarks.fuzz import Length
from benchmarks.fuzz.mutate import HOSTILE, mutated
from tests.raw_client import RawClient

_BURST = 500  # [-] messages between two checks
_WARM = 0.5  # [-] share of the test after which memory is first measured
_GARBAGE_EVERY = 10.0  # [s] time between two disconnected clients; a new page takes a long time
_LARGEST_GROWTH = 1.1  # [-] largest accepted ratio of the memory at the end and at `_WARM`
_PATIENCE = 60.0  # [s] timeout for a new page or the next step, on a busy machine
_PACKED = tuple(value for value in HOSTILE if value != 10**400)
"""Hostile values that msgpack can encode."""
_PICTURE = png(Image.new("RGBA", (SIZES["width"][2], SIZES["height"][2])))
"""The answer of a page to a request for a picture."""
_asked: deque[str] = deque(maxlen=1)
"""The identifier of the last request to a page."""


def fuzz_messages(
    length: Length, seed: int, keep: Path, on_progress: Callable[[float], None]
) -> dict[str, Any]:
    """Send mutated messages; returns the counts and the findings.

    Args:
        length: Length of the test.
        seed: Seed of the mutations.
        keep: Not used, because a message follows from the seed.
        on_progress: Called with the finished share.
    """
    model, data = load_robot_and_border("husky_panda")
    q_start = np.array(model.description.arm.ready_position)
    loop = ProcessLoop(partial(Session, model, data, Config(), physics="kinematic"), q_start)
    with _elsewhere():
        loop.begin()
        try:
            loop.start()
            server = serve_dashboard(loop, model, data.clouds, port=0)
            try:
                return _Fuzz(server, loop, seed).run(length, on_progress)
            finally:
                server.stop()
        finally:
            loop.stop()


@contextlib.contextmanager
def _elsewhere() -> Iterator[None]:
    """Use a separate folder and separate robots, because pressed buttons write files.

    Films and pictures of pages find no browser, because each would use a core for seconds.
    """
    before, name = os.getcwd(), getattr(_viser, "_make_uuid")  # noqa: B009  # pyright: private

    def remembered() -> str:
        _asked.append(name())
        return _asked[-1]

    with tempfile.TemporaryDirectory() as folder:
        other = {"DBB_ROBOTS": f"{folder}/robots", VARIABLE: f"{folder}/none"}
        with patch.dict(os.environ, other), patch.object(_viser, "_make_uuid", remembered):
            os.chdir(folder)
            try:
                yield
            finally:
                os.chdir(before)


class _Fuzz:
    """The fuzzing client, a second client that only watches, and the server."""

    def __init__(self, server: DashboardServer, loop: ProcessLoop, seed: int) -> None:
        self._server, self._loop = server, loop
        self._rng = np.random.default_rng(seed)
        self._tally: Counter[str] = Counter()
        self._findings: dict[str, str] = {}
        self._kinds: Counter[str] = Counter()
        self._page: Any = None

    def run(self, length: Length, on_progress: Callable[[float], None]) -> dict[str, Any]:
        """Send messages until the end of the test or a finding; return counts and findings."""
        first = last = None
        with RawClient(self._server.address) as witness, _errors_in(self._findings):
            self._wait(lambda: self._server.pages, "no page for the watching client")
            self._client()
            begin, garbage, share = time.monotonic(), time.monotonic(), 0.0
            while share < 1.0 and not self._findings:
                if first is None and share > _WARM:
                    first = self._memory()
                seen = witness.received
                now = time.monotonic() - garbage > _GARBAGE_EVERY
                garbage = time.monotonic() if now else garbage
                self._burst(garbage=now)
                self._look(lambda seen=seen: witness.received > seen)
                share = length.share(time.monotonic() - begin, sum(self._kinds.values()))
                on_progress(share)
            last = self._memory()
            self._sender.close()
        growth = last / first if first else 1.0
        if growth > _LARGEST_GROWTH:
            self._findings[f"memory grew by {growth - 1:.0%}"] = ""
        return {
            "messages": sum(self._kinds.values()),
            **self._tally,
            "kinds": dict(self._kinds),
            "memory_mb": last,
            "memory_growth": growth,
            "findings": self._findings,
        }

    def _client(self) -> None:
        """Connect a sender, and wait for its page."""
        known = set(self._server.pages)
        self._sender = RawClient(self._server.address)
        self._wait(lambda: set(self._server.pages) - known, "no page for a new client")
        self._page = self._server.pages.get(max(self._server.pages, default=0), self._page)
        self._uploads = gate.Uploads(LARGEST_ARCHIVE)

    def _burst(self, *, garbage: bool) -> None:
        for _ in range(_BURST):
            kind = gate._TAKEN[int(self._rng.integers(len(gate._TAKEN)))]
            if self._rng.random() < 0.4:
                kind = _messages.GuiUpdateMessage
            self._kinds[kind.__name__] += 1
            data = msgspec.msgpack.encode(self._message(kind))
            verdict = self._verdict(data)
            self._tally[verdict] += 1
            try:
                if verdict != "garbage":
                    self._sender.send_raw(data)
                elif garbage:
                    garbage = False
                    self._sender.send_raw(self._in_parts(data))
                    self._sender.close()
                    self._client()
            except websockets.ConnectionClosed as error:
                if verdict != "garbage":  # the server may close while garbage is still being sent
                    title = f"a client was disconnected: {error}"
                    self._findings.setdefault(title, repr(data[:300]))
                self._client()

    def _in_parts(self, data: bytes) -> Iterator[bytes]:
        """The fragments of a message: the message itself, then few or many empty or large ones."""
        count, size = int(10 ** self._rng.uniform(0, 4.5)), int(10 ** self._rng.uniform(0, 5))
        yield data
        for k in range(min(count, 2**26 // size)):
            self._tally["parts"] += 1
            yield b"\0" * (size * (k % 2))

    def _verdict(self, data: bytes) -> str:
        """The gate's verdict; messages that are too long for `websockets` do not reach the gate."""
        if len(data) > gate.LARGEST_MESSAGE:
            return "garbage"
        try:
            gate.checked(data, self._uploads, self._widgets().get)
        except gate.GarbageError:
            return "garbage"
        except gate.RefusedError:
            return "refused"
        except Exception as error:  # any exception is a finding
            self._findings.setdefault(f"{type(error).__name__}: {error}"[:200], repr(data[:300]))
            return "garbage"
        return "taken"

    def _widgets(self) -> dict[str, Any]:
        return self._page.client.gui._gui_input_handle_from_uuid

    def _message(self, kind: type) -> Any:
        """A message of a kind, in most cases mutated."""
        fields = [f for f in dataclasses.fields(kind) if f.init]
        hints = get_type_hints(kind)
        message = {f.name: self._right(f.name, hints[f.name]) for f in fields}
        if kind is _messages.GuiUpdateMessage:
            handles = list(self._widgets().values())
            handle = handles[int(self._rng.integers(len(handles)))]
            value = mutated(_plain(handle.value), self._rng, _PACKED)
            message = {"uuid": handle._impl.uuid, "updates": {"value": value}}
        if self._rng.random() < 0.5:
            message = mutated(message, self._rng, _PACKED)
        return {"type": kind.__name__, **message} if isinstance(message, dict) else message

    def _right(self, name: str, hint: Any) -> Any:
        """A random value of the type that viser has for a field."""
        options = get_args(hint)
        if name in ("render_uuid", "request_uuid"):
            return _asked[-1] if _asked else ""
        if name == "payload":
            return _PICTURE
        if name in ("uuid", "container_uuid", "source_component_uuid"):
            names = list(self._widgets())
            return names[int(self._rng.integers(len(names)))]
        if name in ("name", "node_name"):
            nodes = list(self._page.client.scene._handle_from_node_name)
            nodes = nodes or ["/robot"]
            return nodes[int(self._rng.integers(len(nodes)))]
        if options and not isinstance(options[0], type) and not get_args(options[0]):
            return options[int(self._rng.integers(len(options)))]  # of a Literal, or None
        if getattr(hint, "__origin__", None) is tuple:
            return [self._right("", each) for each in options if each is not Ellipsis]
        if options and getattr(hint, "__origin__", None) is not dict:
            return self._right(name, options[int(self._rng.integers(len(options)))])
        plain = {bool: True, int: 3, float: float(self._rng.normal()), str: "a", bytes: b"a" * 9}
        return plain.get(hint, None if hint is type(None) else {})

    def _look(self, seen: Callable[[], bool]) -> None:
        """Cancel all jobs; check that the server works and that all parameters are in range.

        `seen` must become true when the watching client has received a message.
        """
        for job in self._jobs():  # not awaited, because a picture can take half a minute
            job.cancel()
        t = self._loop.latest().t

        def passes() -> bool:
            self._loop.send(Pause(False))  # an earlier message may pause it again
            return self._loop.latest().t != t

        self._wait(
            passes, "the simulation does not advance", lambda: str(self._loop.latest())[:2000]
        )
        self._wait(seen, "the watching client receives nothing")
        config = self._loop.latest().config
        if type(config).model_validate(config.model_dump()) != config:
            self._findings.setdefault("a parameter is out of its range", str(config))
        if self._server.error is not None:
            self._findings.setdefault(f"drawing ended: {self._server.error!r}", "")

    def _jobs(self) -> list[Job]:
        """All jobs that buttons of the pages can start."""
        shared = self._server.shared
        jobs = [shared.robot_switch, shared.robot_build]
        return [*jobs, *(page.files for page in list(self._server.pages.values()))]

    def _memory(self) -> float:
        """[MB] memory of this process and of its child processes, after all work has ended."""
        for job in self._jobs():
            job.close()
        here = psutil.Process()
        everyone = [here, *here.children(recursive=True)]
        return sum(each.memory_info().rss for each in everyone) / 1e6

    def _wait(self, true: Callable[[], Any], otherwise: str, why: Callable[[], str] = str) -> None:
        """Wait until the function `true` returns a true value.

        A timeout is a finding with the text `otherwise`, and the result of `why` as its details.
        """
        end = time.monotonic() + _PATIENCE
        while not true():
            if time.monotonic() > end:
                self._findings.setdefault(otherwise, why())
                return
            time.sleep(0.01)


@contextlib.contextmanager
def _errors_in(findings: dict[str, str]) -> Iterator[None]:
    """Add each error in the log to the findings."""

    class Errors(logging.Handler):
        def emit(self, record: logging.LogRecord) -> None:
            error = record.exc_info[1] if record.exc_info else None
            findings.setdefault(f"{record.getMessage()}: {error!r}"[:200], self.format(record))

    handler = Errors(logging.ERROR)
    logging.getLogger().addHandler(handler)
    try:
        yield
    finally:
        logging.getLogger().removeHandler(handler)


def _plain(value: Any) -> Any:
    """The value of a widget in the form that a page sends."""
    return list(value) if isinstance(value, tuple) else value
