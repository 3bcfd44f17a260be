"""Mailbox of commands: of those that replace one another only the newest is kept."""

from __future__ import annotations

import threading
from collections.abc import Hashable

from app.errors import LoopError
from app.simulation.loop.commands import (
    Choose,
    Command,
    Configure,
    Pause,
    Play,
    Pull,
    Release,
    Reset,
    Restart,
    Speed,
)

MOST = 64
"""Commands that may wait at once; as those of a kind replace one another, far more than there are
kinds."""

_STATES = (Configure, Choose, Pause, Speed)
_BEGINNINGS = (Reset, Restart, Play)


class Mailbox:
    """Takes commands from any thread; one thread fetches them.

    However many are sent, what waits is bounded and so is the work of obeying it. A parameter keeps
    the place of the command that it replaces, so that a beginning sent meanwhile has the newest.
    What happens rather than is set, such as a pull, takes its place at the end.
    """

    def __init__(self) -> None:
        self._waiting: dict[Hashable, Command] = {}
        self._lock = threading.Lock()

    def put(self, command: Command) -> None:
        """Leave a command.

        Raises:
            LoopError: Too many different ones wait.
        """
        key = _key(command)
        with self._lock:
            if len(self._waiting) >= MOST and key not in self._waiting:
                raise LoopError(f"more than {MOST} commands wait; send fewer at once")
            if isinstance(command, Restart) and key in self._waiting:
                return  # what begins anew already would only begin once more
            if not isinstance(command, _STATES):
                self._waiting.pop(key, None)
            self._waiting[key] = command

    def take(self) -> list[Command]:
        """All that wait, in order; they wait no longer."""
        if not self._waiting:  # a glance without the lock: it is done a thousand times a second
            return []
        with self._lock:
            commands = list(self._waiting.values())
            self._waiting.clear()
        return commands


def _key(command: Command) -> Hashable:
    """Commands of equal keys replace one another."""
    if isinstance(command, (Pull, Release)):
        return Pull, command.who
    return _BEGINNINGS if isinstance(command, _BEGINNINGS) else type(command)
