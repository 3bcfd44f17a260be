"""Snapshots of a run that nobody watches, as many as the dashboard gets, the same each time."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

from app.simulation.leading import Scenario
from app.simulation.publishing import make_snapshot
from app.simulation.session import DT, Session, Step
from app.simulation.snapshot import Snapshot

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

    def __init__(self, take: Callable[[Snapshot], None], scenario: Scenario) -> None:
        """A tape of a run.

        Args:
            take: Called with each snapshot.
            scenario: Which leads the hand from the first step to the last.
        """
        self._take = take
        self._scenario = scenario
        self._clock = NoClock()

    def add(self, session: Session, step: Step) -> None:
        """Look at one control step."""
        if round(step.t / DT) % EVERY == 0:
            snapshot = make_snapshot(session, step, self._clock, paused=False)
            name, ends = self._scenario.name, self._scenario.duration
            self._take(replace(snapshot, scenario=name, scenario_ends=ends))
