"""Live loop: a thread owns the session, keeps to real time, obeys commands, publishes snapshots.

Whoever draws sees only `LoopHandle`: commands in, immutable snapshots out, nothing shared. So the
thread may live in another process without a change on the other side.
"""

from __future__ import annotations

import threading
from collections.abc import Callable
from dataclasses import replace
from time import sleep
from typing import Any, Protocol

import numpy as np

from app.errors import DbbError, LoopError
from app.simulation.loop.commands import (
    Choose,
    Command,
    Compare,
    Configure,
    Pause,
    Play,
    Pull,
    Release,
    Restart,
    Speed,
    StepOnce,
    check_command,
)
from app.simulation.loop.ensemble import Ensemble
from app.simulation.loop.mailbox import Mailbox
from app.simulation.loop.pacing import Pacer
from app.simulation.people import held_links
from app.simulation.session import DT, Session, Step
from app.simulation.trace.history import SNAPSHOTS_KEPT, History
from app.simulation.trace.publishing import ghost_reading, make_snapshot
from app.simulation.trace.snapshot import Refusal, Snapshot

Array = np.ndarray

_PUBLISH_EVERY = 20  # control steps between two snapshots: 50 Hz
_IDLE = 0.01  # [s] between two looks for commands while paused


class LoopHandle(Protocol):
    """What the dashboard knows of the simulation."""

    error: BaseException | None
    """Why the loop ended, if it did."""
    links: tuple[str, ...]
    """Names of the arm's frames that can be pulled, once it has started."""

    def send(self, command: Command) -> None:
        """Leave a command; it is obeyed before one of the next control steps.

        Of commands that replace one another, such as two pulls, only the newest is obeyed.

        Raises:
            UnknownNameError: A pull's link is none of `links`.
            LoopError: Too many commands wait.
        """
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
        links: Where the arm can be held, once it has started.
    """

    def __init__(
        self, make_session: Callable[[], Session], q_start: Array, *, kept: int = SNAPSHOTS_KEPT
    ) -> None:
        """Prepare; `start` begins.

        Args:
            make_session: Called once, in the loop's own thread, which then owns the session.
            q_start: (n_m,) arm configuration at the start and after each reset.
            kept: How many snapshots `history` goes back.
        """
        self.error: BaseException | None = None
        self.links: tuple[str, ...] = ()
        self._make_session = make_session
        self._q_start = np.array(q_start)
        self._mailbox = Mailbox()
        self._history = History(kept)
        self._ready = threading.Event()
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, name="simulation", daemon=True)
        self._paused, self._speed = False, 1.0
        self._refusal: Refusal | None = None

    def begin(self) -> None:
        """Begin to make the session; `start` waits for it."""
        self._thread.start()

    def start(self) -> None:
        """Begin, if it has not begun, and wait for the first snapshot.

        Raises:
            LoopError: The session could not be made.
        """
        if self._thread.ident is None:
            self.begin()
        self._ready.wait()
        if self.error is not None:
            raise LoopError(f"the simulation could not start: {self.error}") from self.error

    def stop(self) -> None:
        """End the thread and release the plant."""
        self._stop.set()
        if self._thread.is_alive():
            self._thread.join(timeout=5.0)

    def send(self, command: Command) -> None:
        """See `LoopHandle.send`."""
        check_command(command, self.links)
        self._mailbox.put(command)

    def latest(self) -> Snapshot:
        """See `LoopHandle.latest`."""
        return self._history.latest

    def history(self, after: float) -> list[Snapshot]:
        """See `LoopHandle.history`."""
        return self._history.after(after)

    def _run(self) -> None:
        owner: Session | Ensemble | None = None
        try:
            owner = session = self._make_session()
            owner = ensemble = Ensemble(session, self._q_start)
            self.links = held_links(session.model)
            self._begun(ensemble)
            self._ready.set()
            while not self._stop.is_set():
                self._obey(ensemble)
                if self._paused:
                    sleep(_IDLE)
                else:
                    self._advance(ensemble)
        except BaseException as error:  # handed to the user by whoever holds the loop
            self.error = error
        finally:
            self._ready.set()
            if owner is not None:
                owner.close()

    def _begun(self, ensemble: Ensemble) -> None:
        """Publish the first step after a beginning."""
        self._pacer = Pacer(DT, self._speed)
        self._publish(ensemble, ensemble.step())

    def _advance(self, ensemble: Ensemble) -> None:
        step = ensemble.step()
        self._pacer.worked(step.duration)
        if round(step.t / DT) % _PUBLISH_EVERY == 0:
            self._publish(ensemble, step)
        self._pacer.wait()

    def _publish(self, ensemble: Ensemble, step: Step) -> None:
        snapshot = make_snapshot(ensemble.main, step, self._pacer, paused=self._paused)
        ghosts = tuple(map(ghost_reading, ensemble.ghosts))
        self._history.add(
            replace(snapshot, ghosts=ghosts, scores=ensemble.scores(), **self._course(ensemble))
        )

    def _course(self, ensemble: Ensemble) -> dict[str, Any]:
        """What a snapshot says beyond the session."""
        return {
            "scenario": ensemble.leading,
            "scenario_ends": ensemble.ends,
            "same": ensemble.comparison.same if ensemble.ghosts else "",
            "speed": self._speed,
            "refusal": self._refusal,
        }

    def _obey(self, ensemble: Ensemble) -> None:
        commands = self._mailbox.take()
        for command in commands:
            try:
                self._carry_out(command, ensemble)
            except DbbError as error:
                number = 1 if self._refusal is None else self._refusal.number + 1
                self._refusal = Refusal(number, str(error))
        if commands:
            self._refresh(ensemble)

    def _carry_out(self, command: Command, ensemble: Ensemble) -> None:
        if isinstance(command, Pull):
            ensemble.pull(command)
        elif isinstance(command, Release):
            ensemble.release(command.who)
        elif isinstance(command, Configure):
            ensemble.configure(command.config)
        elif isinstance(command, Choose):
            ensemble.choose(command.controller)
        elif isinstance(command, Pause):
            self._paused = command.paused
            self._pacer.restart()
        elif isinstance(command, Speed):
            self._pacer.speed = self._speed = command.factor
        elif isinstance(command, StepOnce):
            self._step_once(command.seconds, ensemble)
        else:
            self._begin_anew(command, ensemble)

    def _step_once(self, seconds: float, ensemble: Ensemble) -> None:
        """Pause, and publish the step that comes so much after the newest snapshot."""
        self._paused = True
        due = self._history.latest.t + seconds
        step = ensemble.step()
        while step.t < due - 0.5 * DT:
            step = ensemble.step()
        self._publish(ensemble, step)

    def _begin_anew(self, command: Command, ensemble: Ensemble) -> None:
        if isinstance(command, Play):
            self._say_busy(f"preparing {command.scenario.name}")
            ensemble.play(command.scenario)
        elif isinstance(command, Compare):
            self._say_busy("preparing the comparison")
            ensemble.compare(command)
            if not ensemble.ghosts:
                return
        elif isinstance(command, Restart):
            ensemble.restart()
        else:
            ensemble.reset()
        self._begun(ensemble)

    def _say_busy(self, with_what: str) -> None:
        self._history.add(replace(self._history.latest, busy=with_what))

    def _refresh(self, ensemble: Ensemble) -> None:
        """Publish a change that must be seen although no step follows while paused."""
        main, latest = ensemble.main, self._history.latest
        compared = bool(ensemble.ghosts)
        self._history.add(
            replace(
                latest,
                config=main.config,
                controller=main.controller.name,
                paused=self._paused,
                busy="",
                ghosts=latest.ghosts if compared else (),
                scores=latest.scores if compared else (),
                **self._course(ensemble),
            )
        )
