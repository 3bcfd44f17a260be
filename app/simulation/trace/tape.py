"""Snapshots of a run that nobody watches, as many as the dashboard gets, the same each time."""

from __future__ import annotations

import math
from collections.abc import Callable, Generator, Iterable, Sequence
from contextlib import closing
from dataclasses import replace

from app.simulation.scenarios.leading import Scenario
from app.simulation.session import DT, Session, Step
from app.simulation.trace.publishing import make_snapshot
from app.simulation.trace.snapshot import Snapshot

EVERY = 20  # control steps between two snapshots: 50 Hz, as the loop publishes them


class NoClock:
    """A run that keeps to no clock has nothing to tell about it, and is then the same each time.

    Attributes:
        overruns: No step was missed.
    """

    overruns = 0

    @property
    def realtime_factor(self) -> float:
        """Not a number."""
        return math.nan

    @property
    def step_time_us(self) -> float:
        """Not a number."""
        return math.nan


class Tape:
    """Takes every control step; hands on a snapshot of each twentieth, the first among them."""

    def __init__(
        self, take: Callable[[Snapshot], None], scenario: Scenario, also: Iterable[int] = ()
    ) -> None:
        """A tape of a run.

        Args:
            take: Called with each snapshot.
            scenario: Which leads the hand from the first step to the last.
            also: Numbers of further control steps of which a snapshot is wanted.
        """
        self._take = take
        self._scenario = scenario
        self._also = frozenset(also)
        self._clock = NoClock()

    def add(self, session: Session, step: Step) -> None:
        """Look at one control step."""
        k = round(step.t / DT)
        if k % EVERY == 0 or k in self._also:
            snapshot = make_snapshot(session, step, self._clock, paused=False)
            name, ends = self._scenario.name, self._scenario.duration
            self._take(replace(snapshot, scenario=name, scenario_ends=ends))


def filmed(
    steps: Generator[tuple[Session, Step], None, None],
    scenario: Scenario,
    times: Sequence[float],
    on_progress: Callable[[float], None] = lambda _: None,
) -> list[Snapshot]:
    """Snapshots of a run up to the last of some times, those of the times themselves among them.

    Args:
        steps: The run, as `app.simulation.run.steps_of` gives it; it is ended here.
        scenario: Which leads the hand.
        times: [s] within the scenario's duration.
        on_progress: Called now and then with the simulated time [s].
    """
    last = round(scenario.duration / DT) - 1
    wanted = {min(round(t / DT), last) for t in times}
    snapshots: list[Snapshot] = []
    tape = Tape(snapshots.append, scenario, wanted)
    with closing(steps):
        for k, (session, step) in enumerate(steps):
            tape.add(session, step)
            if k % 100 == 0:
                on_progress(step.t)
            if k == max(wanted):
                break
    return snapshots
