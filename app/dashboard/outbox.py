"""What viewers ask of the simulation: checked at once, and sent no faster than it is drawn.

A browser sends 20 events a second; a program that speaks to the server may send thousands. Of
those of a kind that replace each other only the newest goes on to the simulation.
"""

from __future__ import annotations

import threading
from time import monotonic

from app.simulation.loop import LoopHandle, checked
from app.simulation.snapshot import Command, Configure, Pull

PERIOD = 0.02
"""[s] least time between two commands of the same kind."""


class Outbox:
    """A sink of commands before the loop."""

    def __init__(self, loop: LoopHandle) -> None:
        """An empty one.

        Args:
            loop: Where they go.
        """
        self._loop = loop
        self._lock = threading.Lock()
        self._held: dict[object, Command] = {}
        self._sent: dict[object, float] = {}

    def send(self, command: Command) -> None:
        """Send a command, or hold it for the next `flush` if one of its kind has just gone.

        Raises:
            DbbError: It can never be obeyed.
        """
        checked(command)
        key, now = _replaceable(command), monotonic()
        with self._lock:
            if key is not None and now < self._sent.get(key, -PERIOD) + PERIOD:
                self._held[key] = command
                return
            self._held.pop(key, None)
            self._flush()  # what was held before this one goes before it
            self._loop.send(command)
            if key is not None:
                self._sent[key] = now

    def flush(self) -> None:
        """Send what is held; called by the drawing thread at each picture."""
        with self._lock:
            self._flush()

    def _flush(self) -> None:
        for command in self._held.values():
            self._loop.send(command)
        self._held.clear()


def _replaceable(command: Command) -> object:
    """Commands with the same key replace each other; None for those that never are replaced.

    To let go is never held: it ends a pull at once.
    """
    if isinstance(command, Configure):
        return Configure
    if isinstance(command, Pull) and command.target is not None:
        return Pull, getattr(command, "who", 0)
    return None
