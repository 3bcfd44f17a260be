"""What pages keep of the past: curves, ways of base and hand, and what happened when."""

from bisect import bisect_left, bisect_right
from collections import deque
from collections.abc import Callable, Iterable, Sequence
from typing import NamedTuple

import numpy as np

from app.config import tunable
from app.dashboard.panels import phrases as words
from app.dashboard.verdict import judge
from app.simulation.case import RunCase
from app.simulation.trace.snapshot import Snapshot
from app.simulation.trace.words import Outcome, outcome
from app.strict import Array

KEPT = 600.0  # [s] how far back a viewer can look
PERIOD = 0.04  # [s] least time between two rows of them
SPACING = 0.01  # [m] between two points of a track
_LONGEST = 1500  # points of a track
BIN = 0.1  # [s] of which the time line keeps the least distance and the largest activation
_QUIET = 1.0  # [s] after which the same happening is another event
_MOST_EVENTS = 400


class Rows:
    """What snapshots say over time, in bounded memory."""

    def __init__(
        self,
        values: Callable[[Snapshot], Sequence[float] | Array],
        longest: int,
        is_due: Callable[[Array, Array], bool],
    ) -> None:
        """An empty table.

        A row is a time and its values; so many of the newest are kept. `is_due` says of two rows
        whether the second one is taken in after the first.
        """
        self._values, self._is_due, self._longest = values, is_due, longest
        self.begin()

    def begin(self) -> None:
        """An empty table."""
        self._rows: list[Array] = []
        self._times: list[float] = []

    def add(self, snapshot: Snapshot) -> None:
        """Take it in if it is due."""
        row = np.array([snapshot.t, *self._values(snapshot)])
        if not self._rows or self._is_due(self._rows[-1], row):
            self._rows.append(row)
            self._times.append(snapshot.t)
            del self._rows[: -self._longest], self._times[: -self._longest]

    def table(self) -> Array:
        """(N, 1 + C) times [s] and values."""
        return np.array(self._rows)


class Curve(NamedTuple):
    """One line of a plot: its label in the legend, and its value at a snapshot."""

    label: str
    value: Callable[[Snapshot], float]


class Record(Rows):
    """Values of curves over time."""

    def __init__(self, curves: Iterable[Curve]) -> None:
        """An empty table, whose columns after the time are the curves."""
        curves = tuple(curves)
        self._width = 1 + len(curves)
        super().__init__(
            lambda snapshot: [curve.value(snapshot) for curve in curves],
            int(KEPT / PERIOD) + 2,
            # Half a millisecond of grace: times are sums of floats.
            lambda before, row: row[0] >= before[0] + PERIOD - 5e-4,
        )

    def columns(self, until: float, length: float) -> Array:
        """(1 + C, N) times [s] and values of a stretch of time, N ≥ 1.

        It ends at a time [s], and has a length [s].
        """
        if not self._rows:
            return np.zeros((self._width, 1))
        begin, end = bisect_left(self._times, until - length), bisect_right(self._times, until)
        return np.array(self._rows[begin:end] or self._rows[:1]).T


class Track(Rows):
    """A line with a point for each centimetre."""

    def __init__(self, place: Callable[[Snapshot], Array]) -> None:
        """No points yet; `place` gives them, (3,) [m]."""
        super().__init__(
            place,
            _LONGEST,
            lambda before, row: bool(np.linalg.norm(row[1:] - before[1:]) >= SPACING),
        )

    def until(self, t: float) -> Array:
        """(K, 3) [m] the points passed until a time [s]."""
        table = self.table().reshape(-1, 4)
        return table[table[:, 0] <= t, 1:]


class Course:
    """The scenario that was begun last, and what it has come to.

    Attributes:
        name: Of the scenario; empty at the free start.
        running: Whether it leads the hand.
        duration: [s] at which it ends.
        until: [s] how long it led, as far as snapshots say; one may be missing.
        stopped: Whether it ended before its time.
        least: [m] the least distance of all pairs.
        pull: [N] the largest pull.
        speed: [m/s] peak speed of the hand.
        path: [m] travel of the base.
        touched: Whether anything has come to touch, or into something else.
        inside: Whether something did so at the beginning, and has not stopped since.
        left: Whether something did so at the beginning, and has stopped.
        case: What it takes to play again what was played last, or None.
    """

    def __init__(self) -> None:
        self.begin()

    def begin(self) -> None:
        """No scenario has begun."""
        self.case: RunCase | None = None
        self.name, self.running = "", False
        self.duration = self.until = self.pull = self.speed = self.path = 0.0
        self.least, self.touched, self.inside, self.left = np.inf, False, False, False
        self.contact = False  # reported by the plant
        self._place: Array | None = None

    def add(self, snapshot: Snapshot) -> None:
        """Take it in."""
        ended = self.running and not snapshot.scenario
        self.running, self.case = bool(snapshot.scenario), snapshot.case or self.case
        if ended and snapshot.t >= self.duration:
            self.until = self.duration
        if not self.running:
            return
        place, touches = np.array(snapshot.base_pose[:2]), judge(snapshot).state == "contact"
        if self._place is None:
            self.inside = touches
        else:
            self.path += float(np.linalg.norm(place - self._place))
        self._place, self.name, self.until = place, snapshot.scenario, snapshot.t
        self.duration = snapshot.scenario_ends or snapshot.t
        exact = [score.clearance for score in snapshot.scores[:1]]  # of each control step
        self.least = min(self.least, snapshot.nearest.d, *exact)
        self.pull = max(self.pull, pulled(snapshot))
        self.speed = max(self.speed, snapshot.hand_speed)
        self.left = self.left or (self.inside and not touches)
        self.inside = self.inside and touches
        self.touched = self.touched or (touches and not self.inside)
        self.contact = self.contact or snapshot.touches

    @property
    def stopped(self) -> bool:
        return not self.running and self.until < self.duration

    @property
    def outcome(self) -> Outcome:
        """In a word; contact counts where the plant reports it."""
        return outcome(self.least, touched=self.contact)


class Event(NamedTuple):
    """What happened, for a mark on the time line."""

    t: float
    """[s] when it began."""
    kind: str
    """One of "scenario", "parameter", "person", "buffer", "limit" and "contact"."""
    text: str


class Strip:
    """What happened when: the least distance and β of each `BIN`, events, and a thinned past."""

    def __init__(self, chain: Sequence[str]) -> None:
        """Nothing yet; `chain` names the robot's bodies, the mobile one first."""
        self._chain, self.runs = chain, -1
        """How often time has begun anew."""
        self.begin()

    def begin(self) -> None:
        """Forget all but how often that was done."""
        self.runs += 1
        self.rows: deque[tuple[float, float, float]] = deque(maxlen=round(KEPT / BIN))
        """Time [s] at which a bin begins, least distance [m] and largest β in it."""
        self.closed = self._numbered = 0
        """How many rows, and events, there have been, also those that are kept no longer."""
        self.events: dict[int, Event] = {}
        """By their number, in order."""
        self._seen: dict[tuple[str, str], tuple[int, float]] = {}
        self.past: deque[Snapshot] = deque(maxlen=round(KEPT / BIN / 2))
        """Snapshots, that of the least distance of each two bins."""
        self.nearest: Snapshot | None = None
        self.hardest: Snapshot | None = None
        """Snapshots of the least distance and of the hardest pull so far."""
        self._bin: list[Snapshot] = []
        self._before: Snapshot | None = None

    def add(self, snapshot: Snapshot) -> None:
        """Take it in."""
        if self._bin and int(snapshot.t / BIN + 1e-6) != int(self._bin[0].t / BIN + 1e-6):
            self._close()
        self._bin.append(snapshot)
        if self.nearest is None or snapshot.nearest.d < self.nearest.nearest.d:
            self.nearest = snapshot
        if pulled(snapshot) > (0.0 if self.hardest is None else pulled(self.hardest)):
            self.hardest = snapshot
        for kind, subject, text in happenings(self._before, snapshot, self._chain):
            self._note(snapshot.t, kind, subject, text)
        self._before = snapshot

    def _close(self) -> None:
        nearest = min(self._bin, key=lambda snapshot: snapshot.nearest.d)
        self.rows.append((self._bin[0].t, nearest.nearest.d, max(s.beta_m for s in self._bin)))
        self.closed += 1
        if self.closed % 2 or nearest.nearest.d < self.past[-1].nearest.d:
            if self.closed % 2 == 0:
                self.past.pop()
            self.past.append(nearest)
        self._bin = []

    def _note(self, t: float, kind: str, subject: str, text: str) -> None:
        """A new event, or the same one that goes on, whose text is renewed."""
        number, seen = self._seen.get((kind, subject), (-1, -np.inf))
        if t - seen <= _QUIET and number in self.events:
            self.events[number] = self.events[number]._replace(text=text)
        else:
            number = self._numbered
            self._numbered += 1
            self.events[number] = Event(t, kind, text)
            self.events.pop(number - _MOST_EVENTS, None)
        self._seen[kind, subject] = number, t


def pulled(snapshot: Snapshot) -> float:
    """[N] of the hardest pull at any point of the robot."""
    forces = [np.linalg.norm(pull.force) for pull in snapshot.pulls]
    return float(max([np.linalg.norm(snapshot.hand_force), *forces]))


def happenings(
    before: Snapshot | None, now: Snapshot, chain: Sequence[str]
) -> list[tuple[str, str, str]]:
    """What has begun between two snapshots: kind, subject and text of each event."""
    if before is None:
        return [("scenario", "", f"{now.scenario} starts")] if now.scenario else []
    found = []
    if now.scenario != before.scenario:
        said = f"{now.scenario} starts" if now.scenario else f"{before.scenario} ends"
        found.append(("scenario", "", said))
    if now.controller != before.controller:
        found.append(("parameter", "controller", f"controller: {now.controller}"))
    if before.config is not now.config:
        for path, value in now.config.changes(before.config).items():
            text = value if isinstance(value, str) else f"{value:.4g}"
            found.append(("parameter", path, f"{tunable(path).title}: {text}"))
    held, holds = ({pull.who for pull in s.pulls if pull.who >= 0} for s in (before, now))
    if held != holds:
        text = "pulls" if holds - held else "releases"
        found.append(("person", text, f"a person {text} the robot"))
    for old, pair in zip(before.pairs, now.pairs, strict=True):
        if pair.beta > 0.0 and old.beta == 0.0:
            text = f"{words.spoken(pair.name, chain)} inside the buffer"
            found.append(("buffer", pair.name, text))
    met, meets = (
        {words.bound(bound, chain) for bound in s.explanation.bounds} if s.explanation else set()
        for s in (before, now)
    )
    found += [("limit", text, text) for text in sorted(meets - met)]
    spoken = {pair.name: words.spoken(pair.name, chain) for pair in now.pairs}
    if (touching := judge(now, spoken).touching) and not judge(before).touching:
        found.append(("contact", "", touching))
    return found
