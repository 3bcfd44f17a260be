"""The live loop in a child process, where drawing and network traffic cannot delay its thread."""

import gc
import math
import sys
import threading
import traceback
from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace
from multiprocessing.connection import Connection
from time import monotonic

import numpy as np

from app.errors import LoopError
from app.jobs.process import Child, Outcome, portable
from app.simulation.loop.loop import LoopHandle, SimulationLoop
from app.simulation.loop.pacing import gc_frozen
from app.simulation.session import Session
from app.strict import Array
from app.system import raise_priority, return_freed_memory_early

_PATIENCE = 5.0  # [s] timeout for the end of a thread or of the process
_SEND_EVERY = 0.002  # [s] time between two transmissions of commands
_POST_EVERY = 0.01  # [s] time between two checks for a snapshot; at speed 1 one comes every 0.02 s
_UNSENT = 100  # [-] largest number of unsent snapshots; the parent stores those that are sent
_BEAT_EVERY = 0.25  # [s] time between two heartbeats without a snapshot
_HUNG = 0.5  # [s] time without a heartbeat after which the loop's thread counts as hung
_SWITCH = 2e-4  # [s] time after which the posting thread yields to the loop's thread
_NICENESS = -10  # [-] desired niceness; browsers use -8 for drawing


def loop_child() -> Child:
    """Start a process that imports the simulation, and then waits for a session to simulate.
    It receives `make_session` and `q_start` of `ProcessLoop`, then commands. It sends an `Outcome`
    with `LoopHandle.links` after the start, then snapshots, None as a heartbeat, and at last the
    `Outcome` of a failure.
    """
    return Child(_run_loop)


class ProcessLoop(LoopHandle):
    """Runs a session in a child process, with the interface of `SimulationLoop`."""

    def __init__(
        self, make_session: Callable[[], Session], q_start: Array, child: Child | None = None
    ) -> None:
        """Prepare the loop, as in `SimulationLoop`; `make_session` must be picklable. `child` is a
        result of `loop_child`; without `child`, `begin` starts a new process.
        """
        super().__init__()
        self._stopping = threading.Event()
        self._task: tuple[Callable[[], Session], Array] | None = (make_session, np.array(q_start))
        self._child = child
        self._threads: list[threading.Thread] = []

    def begin(self) -> None:
        super().begin()
        self._child = self._child or loop_child()
        for work, name in ((self._receive, "snapshots"), (self._send, "commands")):
            thread = threading.Thread(target=work, args=(self._child,), name=name, daemon=True)
            thread.start()
            self._threads.append(thread)

    def stop(self) -> None:
        self._stopping.set()
        self._mailbox.filled.set()
        if self._child is None:
            return
        if not self._threads or self._child.ended(_PATIENCE) is None:
            self._child.end(at_once=True)
        for thread in self._threads:
            thread.join(_PATIENCE)

    def _send(self, child: Child) -> None:
        """Send `make_session` and `q_start`; then send all waiting commands at intervals."""
        try:
            child.sender.send(self._task)
            self._task = None  # frees the robot and its border
            while not self._stopping.is_set():
                self._mailbox.filled.wait()
                for command in self._mailbox.take():
                    child.sender.send(command)
                self._stopping.wait(_SEND_EVERY)
        except OSError:
            pass  # the child has ended; `_receive` reports it
        except Exception as error:  # for example, `make_session` cannot be pickled
            self.error = error
        finally:
            child.sender.close()

    def _receive(self, child: Child) -> None:
        try:
            self._take_in(child.receiver)
        except (EOFError, OSError):
            if self.error is None and not self._stopping.is_set():
                status = child.ended(_PATIENCE)
                self.error = LoopError(f"the process of the simulation ended with status {status}")
        finally:
            self._ready.set()

    def _take_in(self, snapshots: Connection) -> None:
        while True:
            received = snapshots.recv()
            self._alive = monotonic()
            if isinstance(received, Outcome):
                try:
                    self.links = received.value()
                except BaseException as error:  # the owner of the loop reports it
                    self.error = error
                    return
            elif received is not None:
                if self._ready.is_set() and received.config == self.latest().config:
                    # Snapshots with equal parameters share one configuration in memory.
                    received = replace(received, config=self.latest().config)
                self._history.add(received)
                self._ready.set()


def _run_loop(commands: Connection, snapshots: Connection) -> None:
    """Main function of the child: run a loop until it fails or the parent closes `commands`."""
    return_freed_memory_early()
    sys.setswitchinterval(_SWITCH)
    raise_priority(_NICENESS)
    try:
        make_session, q_start = commands.recv()
    except (EOFError, OSError):
        return  # the parent has ended, or needs no simulation
    loop = SimulationLoop(make_session, q_start, stored=_UNSENT)
    try:
        with suppress(LoopError):  # `_post` sends this error
            loop.start()
            snapshots.send(Outcome(loop.links))
        gc.collect()  # otherwise `gc_frozen` would keep present garbage
        with gc_frozen(), suppress(EOFError, OSError):
            _post(loop, commands, snapshots)
    finally:
        loop.stop()


def _post(loop: SimulationLoop, commands: Connection, snapshots: Connection) -> None:
    """Forward commands, snapshots and at last the loop's error; a closed pipe raises an error."""
    posted, beat = None, monotonic()
    while loop.error is None:
        if (latest := loop.latest()) is not posted:
            last = posted.t if posted is not None and latest.follows(posted) else -math.inf
            for posted in loop.history(last) or [latest]:
                snapshots.send(posted)
            beat = monotonic()
        elif monotonic() - beat > _BEAT_EVERY and loop.silence < _HUNG:
            snapshots.send(None)
            beat = monotonic()
        if commands.poll(_POST_EVERY):
            with suppress(LoopError):  # too many commands wait; this command is lost
                loop.send(commands.recv())
    trace = "".join(traceback.format_exception(loop.error))
    snapshots.send(Outcome((), portable(loop.error), trace))
