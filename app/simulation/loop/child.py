"""The child process of a `ProcessLoop`, and the pipes to it."""

from __future__ import annotations

import threading
from typing import TYPE_CHECKING

from app.jobs.process import starting_children
from app.simulation.loop.process import run_loop
from app.system import SPAWN

if TYPE_CHECKING:
    from typing_extensions import Self

_PATIENCE = 5.0  # [s] for the process to end by itself


class LoopChild:
    """A process that simulates what it is told to, once; it waits until then.

    Its imports take a second or two. Whoever knows early that there will be a simulation begins the
    process before anything else, and gives it to the `ProcessLoop` later. The process is spawned,
    so a script that uses it must guard its main part by `if __name__ == "__main__":`.

    Attributes:
        commands: Takes first what `run_loop` simulates, then commands.
        snapshots: Gives what `run_loop` posts.
    """

    def __init__(self) -> None:
        """Begin the process."""
        self.snapshots, theirs_out = SPAWN.Pipe(duplex=False)
        theirs_in, self.commands = SPAWN.Pipe(duplex=False)
        self._process = SPAWN.Process(
            target=run_loop, args=(theirs_in, theirs_out), name="simulation", daemon=True
        )
        self._one_waits = threading.Lock()  # of two threads that wait, one would learn nothing
        with starting_children():
            self._process.start()
        for connection in (theirs_in, theirs_out):  # else its end would not close the pipes
            connection.close()

    def __enter__(self) -> Self:
        """Nothing but itself."""
        return self

    def __exit__(self, *_: object) -> None:
        """End it if it has not ended."""
        self.kill()

    def ended(self) -> int | None:
        """Its exit status, once it has had time to end; None if it has not ended."""
        with self._one_waits:
            self._process.join(_PATIENCE)
            return self._process.exitcode

    def kill(self) -> None:
        """End it at once, whatever it does."""
        self._process.kill()
        self.ended()
