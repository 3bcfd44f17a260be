"""Live loop: a thread that runs a session in real time, obeys commands and publishes snapshots."""

import threading
from collections.abc import Callable
from dataclasses import replace
from time import monotonic
from typing import Any

import numpy as np

from app.errors import DbbError, LoopError
from app.simulation.loop import commands
from app.simulation.loop.ensemble import Ensemble
from app.simulation.loop.pacing import Pacer
from app.simulation.people import held_links
from app.simulation.session import DT, Session, Step
from app.simulation.trace.snapshot import EVERY, Refusal, Snapshot, make_snapshot
from app.simulation.trace.trace import SNAPSHOTS_STORED, History, Stored
from app.strict import Array

_IDLE = 0.25  # [s] time between two heartbeats during a pause


class LoopHandle:
    """The dashboard's interface to the simulation; the loop can also run in another process."""

    error: BaseException | None = None  # the error that ended the loop, if any
    links: tuple[str, ...] = ()  # names of the arm's frames that people can pull, after the start

    def __init__(self, stored: int = SNAPSHOTS_STORED) -> None:
        """Start without commands; `stored` is the largest number of stored snapshots."""
        self._mailbox, self._history = commands.Mailbox(), History(stored)
        self._ready = threading.Event()
        self._begun = False
        self._alive = monotonic()  # [s] last heartbeat

    def begin(self) -> None:
        """Start the loop without waiting for its session; `start` waits."""
        self._begun = True

    def start(self) -> None:
        """Begin if necessary, and wait for the first snapshot; a failure raises a LoopError."""
        if not self._begun:
            self.begin()
        self._ready.wait()
        if self.error is not None:
            raise LoopError(f"the simulation could not start: {self.error}") from self.error

    def stop(self) -> None:
        """End the loop, and release the plant; a second `stop` has no effect."""

    @property
    def silence(self) -> float:
        """[s] time since the last heartbeat; short also while `Snapshot.busy` has a text."""
        return monotonic() - self._alive

    def send(self, command: commands.Command) -> None:
        """Send a command to the loop's `Mailbox`; raises the errors of `Mailbox.put`."""
        self._mailbox.put(command, self.links)

    def latest(self) -> Snapshot:
        return self._history.latest

    def history(self, after: float) -> list[Snapshot]:
        """Stored snapshots of the present run with t > `after` [s], oldest first."""
        return [stored.snapshot for stored in self.stored(after)]

    def stored(self, after: float = -1.0) -> list[Stored]:
        """The snapshots of `history`, each in the form in which it is stored (`Stored`)."""
        return self._history.after(after)


class SimulationLoop(LoopHandle):
    """Runs a session in a background thread."""

    def __init__(
        self, make_session: Callable[[], Session], q_start: Array, *, stored: int = SNAPSHOTS_STORED
    ) -> None:
        """Prepare the loop, whose thread calls `make_session` once and closes the session. The arm
        is at `q_start` (n_m,) [rad or m] at the start, and after a `Reset` without a posture.
        """
        super().__init__(stored)
        self._make_session, self._q_start = make_session, np.array(q_start)
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, name="simulation", daemon=True)
        self._paused, self._watched, self._speed = False, True, 1.0
        self._runs = 0
        self._refusal: Refusal | None = None

    def begin(self) -> None:
        super().begin()
        self._thread.start()

    def stop(self) -> None:
        self._stop.set()
        self._mailbox.filled.set()
        if self._thread.is_alive():
            self._thread.join(timeout=5.0)

    @property
    def silence(self) -> float:
        return 0.0 if self.latest().busy else super().silence

    def _run(self) -> None:
        owner: Session | Ensemble | None = None
        try:
            owner = session = self._make_session()
            owner = ensemble = Ensemble(session, self._q_start)
            self.links = held_links(session.model)
            self._publish_first(ensemble)
            self._ready.set()
            while not self._stop.is_set():
                self._alive = monotonic()
                self._obey(ensemble)
                if self._paused or not self._watched:
                    self._mailbox.filled.wait(_IDLE)
                    continue
                step = ensemble.step()
                self._pacer.worked(step.duration)
                if round(step.t / DT) % EVERY == 0:
                    self._publish(ensemble, step)
                self._pacer.wait()
        except BaseException as error:  # the owner of the loop reports it
            self.error: BaseException | None = error
        finally:
            self._ready.set()
            if owner is not None:
                owner.close()

    def _publish_first(self, ensemble: Ensemble) -> None:
        self._pacer = Pacer(DT, self._speed)
        self._runs += 1
        self._publish(ensemble, ensemble.step())

    def _publish(self, ensemble: Ensemble, step: Step) -> None:
        ghosts = tuple(ghost.reading() for ghost in ensemble.ghosts)
        fields = self._loop_fields(ensemble) | {"ghosts": ghosts, "scores": ensemble.scores()}
        self._history.add(make_snapshot(ensemble.main, step, self._pacer, **fields))

    def _loop_fields(self, ensemble: Ensemble) -> dict[str, Any]:
        return {
            "run": self._runs,
            "paused": self._paused,
            "scenario": ensemble.leading,
            "scenario_ends": ensemble.ends,
            "changing": ensemble.changing,
            "same": ensemble.comparison.same if ensemble.ghosts else "",
            "speed": self._speed,
            "refusal": self._refusal,
            "case": ensemble.case,
        }

    def _obey(self, ensemble: Ensemble) -> None:
        waiting = self._mailbox.take()
        for command in waiting:
            try:
                self._carry_out(command, ensemble)
            except DbbError as error:
                number = 1 if self._refusal is None else self._refusal.number + 1
                self._refusal = Refusal(number, str(error))
        if waiting:  # the newest snapshot gets the present settings, also during a pause
            main, latest = ensemble.main, self._history.latest
            present = {"config": main.config, "controller": main.controller.name, "busy": ""}
            no_ghosts = {} if ensemble.ghosts else {"ghosts": (), "scores": ()}
            present |= self._loop_fields(ensemble) | no_ghosts
            self._history.add(replace(latest, **present))

    def _carry_out(self, command: commands.Command, ensemble: Ensemble) -> None:
        if isinstance(command, commands.Pull):
            ensemble.pull(command)
        elif isinstance(command, commands.Release):
            ensemble.release(command.who)
        elif isinstance(command, commands.Configure):
            ensemble.configure(command.config)
        elif isinstance(command, commands.Choose):
            ensemble.main.controller.use(command.controller)
        elif isinstance(command, commands.Pause):
            self._paused = command.paused
            self._pacer.restart()
        elif isinstance(command, commands.Watch):
            self._watched = command.watched
            self._pacer.restart()
        elif isinstance(command, commands.Speed):
            self._pacer.speed = self._speed = command.factor
            self._pacer.restart()
        elif isinstance(command, commands.StepOnce):
            self._step_once(command.seconds, ensemble)
        else:
            self._start_again(command, ensemble)

    def _step_once(self, seconds: float, ensemble: Ensemble) -> None:
        """Pause, and step until `seconds` [s] after the newest snapshot; publish the last step."""
        self._paused = True
        due = self._history.latest.t + seconds
        step = ensemble.step()
        while step.t < due - 0.5 * DT:
            step = ensemble.step()
        self._publish(ensemble, step)

    def _start_again(self, command: commands.Command, ensemble: Ensemble) -> None:
        if isinstance(command, commands.Play):
            self._announce(f"preparing {command.scenario.name}")
            ensemble.play(command.scenario)
            self._paused = False
        elif isinstance(command, commands.Compare):
            self._announce("preparing the comparison")
            ensemble.compare(command)
            if not ensemble.ghosts:
                return
        elif isinstance(command, commands.Restart):
            if ensemble.scenario is not None:
                self._announce(f"preparing {ensemble.scenario.name}")
            ensemble.restart()
        elif isinstance(command, commands.Reset):
            ensemble.reset(command.q_m, command.base_pose)
        self._publish_first(ensemble)

    def _announce(self, operation: str) -> None:
        self._history.add(replace(self._history.latest, busy=operation))
