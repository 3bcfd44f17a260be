"""The loop: a thread owns the session, keeps to real time, obeys commands, publishes snapshots.

Whoever draws sees only `LoopHandle`: commands in, immutable snapshots out, nothing shared. So the
thread may live in another process without a change on the other side.
"""

from __future__ import annotations

import queue
import threading
from collections.abc import Callable
from dataclasses import replace
from time import sleep
from typing import Protocol

import numpy as np

from app.control.controller import CONTROLLERS
from app.errors import LoopError, UnknownNameError
from app.simulation.history import History
from app.simulation.leading import Leader, Scenario
from app.simulation.pacing import Pacer
from app.simulation.person import checked_target
from app.simulation.publishing import make_snapshot
from app.simulation.session import DT, Session, Step
from app.simulation.snapshot import Choose, Command, Configure, Pause, Play, Pull, Reset, Snapshot

Array = np.ndarray

_PUBLISH_EVERY = 20  # control steps between two snapshots: 50 Hz
_IDLE = 0.01  # [s] between two looks at the queue while paused


def checked(command: Command) -> Command:
    """The command, if it can be obeyed.

    Raises:
        TargetError: The person's hand would be below the floor.
        UnknownNameError: No controller has that name.
    """
    if isinstance(command, Pull) and command.target is not None:
        checked_target(command.target)
    if isinstance(command, Choose) and command.controller not in CONTROLLERS:
        raise UnknownNameError("controller", command.controller, CONTROLLERS)
    return command


class LoopHandle(Protocol):
    """What the dashboard knows of the simulation."""

    error: BaseException | None
    """Why the loop ended, if it did."""

    def send(self, command: Command) -> None:
        """Put a command in the queue; it is obeyed before the next control step."""
        ...

    def latest(self) -> Snapshot:
        """The newest snapshot."""
        ...

    def history(self, after: float) -> list[Snapshot]:
        """Snapshots of the last 60 s with t > `after` [s], oldest first."""
        ...


class SimulationLoop:
    """Runs a session in a background thread.

    Attributes:
        error: The exception that ended the thread, or None.
    """

    def __init__(self, make_session: Callable[[], Session], q_start: Array) -> None:
        """Prepare; `start` begins.

        Args:
            make_session: Called once, in the loop's own thread, which then owns the session.
            q_start: (n_m,) arm configuration at the start and after each reset.
        """
        self.error: BaseException | None = None
        self._make_session = make_session
        self._q_start = np.array(q_start)
        self._commands: queue.SimpleQueue[Command] = queue.SimpleQueue()
        self._history = History()
        self._ready = threading.Event()
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, name="simulation", daemon=True)
        self._pull: Array | None = None
        self._leader: Leader | None = None
        self._led_until = 0.0  # [s]
        self._paused = False

    def start(self) -> None:
        """Begin, and wait for the first snapshot.

        Raises:
            LoopError: The session could not be made.
        """
        self._thread.start()
        self._ready.wait()
        if self.error is not None:
            raise LoopError(f"the simulation could not start: {self.error}") from self.error

    def stop(self) -> None:
        """End the thread and release the plant."""
        self._stop.set()
        if self._thread.is_alive():
            self._thread.join(timeout=5.0)

    def send(self, command: Command) -> None:
        """Put a command in the queue; it is obeyed before the next control step.

        Raises:
            TargetError: The person's hand would be below the floor.
            UnknownNameError: No controller has that name.
        """
        self._commands.put(checked(command))

    def latest(self) -> Snapshot:
        """The newest snapshot."""
        return self._history.latest

    def history(self, after: float) -> list[Snapshot]:
        """Snapshots of the last 60 s with t > `after` [s], oldest first."""
        return self._history.after(after)

    def _run(self) -> None:
        session: Session | None = None
        try:
            session = self._make_session()
            self._reset(session)
            self._ready.set()
            while not self._stop.is_set():
                self._obey(session)
                if self._paused:
                    sleep(_IDLE)
                else:
                    self._advance(session)
        except BaseException as error:  # handed to the user by whoever holds the loop
            self.error = error
        finally:
            self._ready.set()
            if session is not None:
                session.close()

    def _reset(self, session: Session, scenario: Scenario | None = None) -> None:
        session.reset(self._q_start)
        self._pull = self._leader = None
        if scenario is not None:
            self._leader, self._led_until = scenario.leader(session), scenario.duration
        self._pacer = Pacer(DT)
        self._publish(session, self._step(session))

    def _step(self, session: Session) -> Step:
        """One control step, led by a scenario while one is played, else by the person."""
        if self._leader is not None and session.t > self._led_until - 0.5 * DT:
            self._leader = None
        if self._leader is not None:
            return session.step(*self._leader(session))
        return session.step(pull=self._pull)

    def _advance(self, session: Session) -> None:
        step = self._step(session)
        self._pacer.worked(step.duration)
        if round(step.t / DT) % _PUBLISH_EVERY == 0:
            self._publish(session, step)
        self._pacer.wait()

    def _publish(self, session: Session, step: Step) -> None:
        self._history.add(make_snapshot(session, step, self._pacer, paused=self._paused))

    def _obey(self, session: Session) -> None:
        while True:
            try:
                command = self._commands.get_nowait()
            except queue.Empty:
                return
            if isinstance(command, Pull):
                self._pull = None if command.target is None else np.array(command.target)
                self._leader = None
            elif isinstance(command, Configure):
                session.configure(command.config)
                self._refresh(session)
            elif isinstance(command, Choose):
                session.controller.use(command.controller)
                self._refresh(session)
            elif isinstance(command, Pause):
                self._paused = command.paused
                self._pacer.restart()
                self._refresh(session)
            elif isinstance(command, Reset):
                self._reset(session)
            elif isinstance(command, Play):
                self._reset(session, command.scenario)

    def _refresh(self, session: Session) -> None:
        """Publish a change that must be seen although no step follows while paused."""
        latest = self._history.latest
        self._history.add(
            replace(
                latest, config=session.config, controller=session.controller.name,
                paused=self._paused,
            )
        )  # fmt: skip
