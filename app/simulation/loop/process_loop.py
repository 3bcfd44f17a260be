"""The loop in a process of its own, where no drawing and no browser's traffic holds it up.

Python runs one thread at a time: in the server's process a drawing thread that the system has put
aside keeps the simulation waiting. Commands go out by a pipe, snapshots come back by another.
"""

from __future__ import annotations

import threading
from collections.abc import Callable
from multiprocessing.connection import Connection

import numpy as np

from app.errors import LoopError
from app.simulation.loop.child import LoopChild
from app.simulation.loop.command_check import checked
from app.simulation.loop.commands import Command
from app.simulation.loop.mailbox import Mailbox
from app.simulation.loop.process import Failure, Started
from app.simulation.session import Session
from app.simulation.trace.history import History
from app.simulation.trace.snapshot import Snapshot

Array = np.ndarray

_PATIENCE = 5.0  # [s] for a thread to end by itself
_POST_EVERY = 0.002  # [s] between two posts of commands


class RemoteTraceback(Exception):  # noqa: N818 - the text of one, not an error by itself
    """Cause of an error that comes from another process: its traceback there."""

    def __str__(self) -> str:
        """The text on lines of its own."""
        return f"\n{self.args[0]}"


class ProcessLoop:
    """Runs a session in a child process; to others it is what `SimulationLoop` is.

    The child is spawned, so a script that uses it must guard its main part by
    `if __name__ == "__main__":`. It ends when it is told to, and when its parent is gone.

    Attributes:
        error: The exception that ended the loop, or None.
        links: Where the arm can be held, once it has started.
    """

    def __init__(
        self, make_session: Callable[[], Session], q_start: Array, child: LoopChild | None = None
    ) -> None:
        """Prepare; `start` begins.

        Args:
            make_session: Called once in the child; it must be possible to pickle it, as is
                `functools.partial(Session, model, data, config)`.
            q_start: (n_m,) arm configuration at the start and after each reset.
            child: A process that waits; one of its own if not given.
        """
        self.error: BaseException | None = None
        self.links: tuple[str, ...] = ()
        self._history = History()
        self._ready, self._stopping = threading.Event(), threading.Event()
        self._mailbox, self._posted = Mailbox(), threading.Event()
        self._task: tuple[Callable[[], Session], Array] | None = (make_session, np.array(q_start))
        self._child = child
        self._threads: list[threading.Thread] = []

    def begin(self) -> None:
        """Begin to make the session; `start` waits for it."""
        self._child = self._child or LoopChild()
        for work, name in ((self._receive, "snapshots"), (self._post, "commands")):
            thread = threading.Thread(target=work, args=(self._child,), name=name, daemon=True)
            thread.start()
            self._threads.append(thread)

    def start(self) -> None:
        """Begin, if it has not begun, and wait for the first snapshot.

        Raises:
            LoopError: The session could not be made.
        """
        if not self._threads:
            self.begin()
        self._ready.wait()
        if self.error is not None:
            raise LoopError(f"the simulation could not start: {self.error}") from self.error

    def stop(self) -> None:
        """End the child."""
        self._stopping.set()
        self._posted.set()
        if self._child is None:
            return
        if not self._threads or self._child.ended() is None:
            self._child.kill()
        for thread in self._threads:
            thread.join(_PATIENCE)

    def send(self, command: Command) -> None:
        """Send a command; it is obeyed before one of the next control steps.

        Raises:
            DbbError: It can never be obeyed (`command_check.checked`), or too many wait.
        """
        self._mailbox.put(checked(command, self.links))
        self._posted.set()

    def latest(self) -> Snapshot:
        """The newest snapshot."""
        return self._history.latest

    def history(self, after: float) -> list[Snapshot]:
        """Snapshots of the last 60 s with t > `after` [s], oldest first."""
        return self._history.after(after)

    def _post(self, child: LoopChild) -> None:
        """Hand commands on to the child; a flood waits here, where it shrinks, not in the pipe."""
        try:
            child.commands.send(self._task)
            self._task = None  # it holds the robot and its border
            while not self._stopping.is_set():
                self._posted.wait()
                self._posted.clear()
                for command in self._mailbox.take():
                    child.commands.send(command)
                self._stopping.wait(_POST_EVERY)
        except OSError:
            pass  # the end of the child, of which `_receive` tells
        except Exception as error:  # what cannot be pickled
            self.error = error
        finally:
            child.commands.close()

    def _receive(self, child: LoopChild) -> None:
        try:
            self._take_in(child.snapshots)
        except (EOFError, OSError):
            if self.error is None and not self._stopping.is_set():
                status = child.ended()
                self.error = LoopError(f"the process of the simulation ended with status {status}")
        finally:
            self._ready.set()

    def _take_in(self, snapshots: Connection) -> None:
        while True:
            received = snapshots.recv()
            if isinstance(received, Failure):
                received.error.__cause__ = RemoteTraceback(received.traceback)
                self.error = received.error
                return
            if isinstance(received, Started):
                self.links = received.links
                continue
            self._history.add(received)
            self._ready.set()
