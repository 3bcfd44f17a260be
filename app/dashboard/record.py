"""History for the page: paths, results of a scenario, events, and each viewer's point in time."""

import threading
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from time import monotonic
from typing import NamedTuple

import numpy as np

from app.config import tunable
from app.dashboard import phrases as words
from app.dashboard.verdict import touching
from app.errors import LogError
from app.simulation.case import RunCase
from app.simulation.loop.loop import LoopHandle
from app.simulation.trace.snapshot import Snapshot
from app.simulation.trace.trace import Stored
from app.simulation.trace.words import Outcome, outcome
from app.strict import Array, check_range

HISTORY = 600.0  # [s] length of the history
SPACING = 0.01  # [m] smallest distance between two successive points of a track
_LONGEST = 1500  # [-] largest number of points of a track
BIN = 0.1  # [s] length of a bin of the timeline
_QUIET = 1.0  # [s] after a pause of this length, the same event counts as a new one
REPLAY = 0.1, 4.0  # [-] limits of the replay speed, relative to real time
AGAIN = 10.0  # [s] length of a replay that is started at the newest snapshot
MOST_MARKED = 120.0  # [s] largest length of a marked interval


class Track:
    """The last `_LONGEST` points of a path."""

    def __init__(self, place: Callable[[Snapshot], Array]) -> None:
        """Start without points; `place` returns the position (3,) [m] in a snapshot."""
        self._place = place
        self.begin()

    def begin(self) -> None:
        self._points: deque[tuple[float, Array]] = deque(maxlen=_LONGEST)

    def add(self, snapshot: Snapshot) -> None:
        """Add the position of a snapshot if it is at least `SPACING` from the last added one."""
        place = np.array(self._place(snapshot))
        if not self._points or np.linalg.norm(place - self._points[-1][1]) >= SPACING:
            self._points.append((snapshot.t, place))

    def until(self, t: float) -> Array:
        """Return the positions (K, 3) [m] up to time `t` [s]."""
        return np.array([place for at, place in tuple(self._points) if at <= t]).reshape(-1, 3)


class Course:
    """Results of the last scenario; a touch is a contact in the plant or an overlap of bodies."""

    def __init__(self) -> None:
        self.case: RunCase | None = None  # of the last scenario, as at its start
        self.last: Snapshot | None = None  # of the last scenario, with changes during it
        self.begin()

    def begin(self) -> None:
        """Begin a run: reset all results except `case` and `last`."""
        self.name, self.running = "", False  # the name is empty if no scenario has started
        self.duration = self.until = 0.0  # [s] end of the scenario; time until which it has run
        self.least = np.inf  # [m] smallest distance of all pairs
        self.pull = self.speed = 0.0  # [N] largest external force; [m/s] peak end-effector speed
        self.path = 0.0  # [m] length of the base's path
        self.inside = self.left = False  # whether a touch of the first snapshot lasts; has ended
        self.touched = self.contact = False  # whether another began; the plant reported a contact
        self._place: Array | None = None

    def add(self, snapshot: Snapshot) -> None:
        """Add a snapshot; one without a scenario only shows that the last scenario has ended."""
        ended = self.running and not snapshot.scenario
        self.running, self.case = bool(snapshot.scenario), snapshot.case or self.case
        if ended and snapshot.t >= self.duration:
            self.until = self.duration
        if not self.running:
            return
        place, touches = np.array(snapshot.base_pose[:2]), bool(touching(snapshot))
        if self._place is None:
            self.inside = touches
        else:
            self.path += float(np.linalg.norm(place - self._place))
        self._place, self.name, self.last = place, snapshot.scenario, snapshot
        self.until, self.duration = snapshot.t, snapshot.scenario_ends or snapshot.t
        self.least = min(self.least, snapshot.nearest.d)
        for score in snapshot.scores[:1]:  # of all steps, not of snapshots only
            self.least, self.path = min(self.least, score.clearance), score.base_path
        self.pull = max(self.pull, pulled(snapshot))
        self.speed = max(self.speed, snapshot.ee_speed)
        self.left |= self.inside and not touches
        self.inside &= touches
        self.touched |= touches and not self.inside
        self.contact |= snapshot.touches

    @property
    def outcome(self) -> Outcome:
        """The outcome in words; a contact counts only if the plant has reported it."""
        return outcome(self.least, touched=self.contact)


class Event(NamedTuple):
    t: float  # [s] time of its start
    kind: str  # "scenario", "parameter", "person", "buffer", "limit" or "contact"
    text: str


class Strip:
    """Data of the dashboard's timeline, in bins of `BIN` seconds."""

    def __init__(self, chain: Sequence[str]) -> None:
        """Create an empty history; `chain` has the names of the robot's bodies, the base first."""
        self._chain, self.runs = chain, -1
        self.begin()

    def begin(self) -> None:
        """Delete all data, and increase `runs`, the number of restarts, by one."""
        self.runs += 1
        self.rows: deque[tuple[float, ...]] = deque(maxlen=round(HISTORY / BIN))
        """For each bin: start [s], smallest distance [m], largest β, and d_b [m]."""
        self.closed = self._numbered = 0  # numbers of all rows and events since the restart
        self.events: dict[int, Event] = {}  # by their numbers, in order
        self._seen: dict[tuple[str, str], tuple[int, float]] = {}
        self.past: deque[Stored] = deque(maxlen=round(HISTORY / BIN / 2))  # see `_close`
        self.nearest: Snapshot | None = None  # with the least distance since the restart
        self.hardest: Snapshot | None = None  # with the largest external force above 0
        self._bin: list[Snapshot] = []
        self._before: Snapshot | None = None

    def add(self, snapshot: Snapshot) -> None:
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
        """Add a bin's row; of each pair of bins, store the snapshot with the least distance."""
        nearest = min(self._bin, key=lambda snapshot: snapshot.nearest.d)
        beta = max((pair.beta for s in self._bin for pair in s.pairs), default=0.0)
        self.rows.append((self._bin[0].t, nearest.nearest.d, beta, nearest.d_b))
        self.closed += 1
        if self.closed % 2 == 0:
            nearer = min(self._last, nearest, key=lambda snapshot: snapshot.nearest.d)
            self.past.append(Stored(nearer).pack())
        self._bin, self._last = [], nearest

    def _note(self, t: float, kind: str, subject: str, text: str) -> None:
        """Add an event, or update the text of one of equal kind and subject within `_QUIET`."""
        number, seen = self._seen.get((kind, subject), (-1, -np.inf))
        if t - seen <= _QUIET and number in self.events:
            self.events[number] = self.events[number]._replace(text=text)
        else:
            number = self._numbered
            self._numbered += 1
            self.events[number] = Event(t, kind, text)
            self.events.pop(number - 400, None)  # at most 400 are stored
        self._seen[kind, subject] = number, t


def pulled(snapshot: Snapshot) -> float:
    """Return the largest force [N] of people or a held door on any point of the robot."""
    forces = [np.linalg.norm(pull.force) for pull in snapshot.pulls]
    return float(max([np.linalg.norm(snapshot.hand_force), *forces]))


def happenings(
    before: Snapshot | None, now: Snapshot, chain: Sequence[str]
) -> Iterator[tuple[str, str, str]]:
    """Yield kind, subject and text of events since `before`; without it, a scenario's start."""
    earlier = before.scenario if before else ""
    if now.scenario != earlier:
        yield "scenario", "", f"{now.scenario} starts" if now.scenario else f"{earlier} ends"
    if before is None:
        return
    if now.controller != before.controller:
        yield "parameter", "controller", f"controller: {now.controller}"
    if before.config is not now.config:
        for path, value in now.config.changes(before.config).items():
            text = value if isinstance(value, str) else f"{value:.4g}"
            yield "parameter", path, f"{tunable(path).title}: {text}"
    held, holds = ({pull.who for pull in s.pulls if pull.who >= 0} for s in (before, now))
    if held != holds:
        text = "pulls" if holds - held else "releases"
        yield "person", text, f"a person {text} the robot"
    spoken = {pair.name: words.spoken(pair.name, chain) for pair in now.pairs}
    for old, pair in zip(before.pairs, now.pairs, strict=True):
        if pair.beta > 0.0 and old.beta == 0.0:
            yield "buffer", pair.name, f"{spoken[pair.name]} inside the buffer"
    both = before.explanation, now.explanation
    met, meets = ({words.bound(b, chain) for b in why.bounds} if why else set() for why in both)
    yield from (("limit", text, text) for text in sorted(meets - met))
    if (text := touching(now, spoken)) and not touching(before):
        yield "contact", "", text


class Timeline:
    """Point in time of one viewer; the simulation is not affected. All methods are thread-safe."""

    def __init__(self, loop: LoopHandle, strip: Strip) -> None:
        """Show the present; `loop` has the snapshots of the last 60 s, and `strip` older ones."""
        self._loop, self._strip = loop, strip
        self._shown: Snapshot | None = None
        self._replay: tuple[float, float, float] | None = None
        """[s] `monotonic` and [s] simulated time at the start of the replay, [-] its speed."""
        self._newest = loop.latest()
        self._marked: list[Stored] = []
        self._lock = threading.RLock()
        self.begin: float | None = None  # [s] start of the marked interval; None if not marked
        self.end: float | None = None  # [s] end of this interval; None if not marked

    @property
    def earlier(self) -> bool:
        """Whether the marked interval belongs to an earlier run."""
        with self._lock:
            return bool(self._marked) and self._marked[0].run != self._newest.run

    @property
    def live(self) -> bool:
        return self._shown is None

    def shown(self) -> Snapshot:
        """Return the snapshot to draw; continue a replay, and extend an interval without an end.

        After a restart, the newest snapshot is shown, and an interval without an end is removed.
        """
        with self._lock:
            newest = self._loop.latest()
            if not newest.follows(self._newest):
                self.go_live()
                if self.end is None:
                    self.unmark()
            self._newest = newest
            if self.begin is not None and self.end is None:
                self._marked += self._loop.stored(self._marked[-1].t)
                if self._marked[-1].t - self.begin > MOST_MARKED:
                    self._mark(self.begin, self.begin + MOST_MARKED)
            if (replay := self._replay) is not None:
                began, t, speed = replay
                t += (monotonic() - began) * speed
                if t >= newest.t:
                    self.go_live()
                else:
                    self.go_to(t)
                    self._replay = replay
            return self._shown or newest

    @property
    def plays(self) -> bool:
        return self._replay is not None

    def play(self, speed: float) -> None:
        """Stop the running replay; otherwise start one, `AGAIN` earlier if the present is shown.

        Raises `ConfigError` if the speed [-] is not within `REPLAY`.
        """
        check_range("replay speed", speed, *REPLAY, "× real time")
        with self._lock:
            if self.plays:
                self._replay = None
                return
            if self.live:
                self.step(-AGAIN)
            self._replay = monotonic(), self.shown().t, speed

    def go_to(self, t: float) -> None:
        """Show the stored snapshot that is nearest to time `t` [s]."""
        self.show(min(self._stored(), key=lambda stored: abs(stored.t - t)).snapshot)

    def show(self, snapshot: Snapshot) -> None:
        """Show a published snapshot, and stop a replay."""
        with self._lock:
            self._shown, self._replay = snapshot, None

    def step(self, seconds: float) -> None:
        """Go forward by a time [s], or back if it is negative; by at least one snapshot, if any."""
        t = self.shown().t
        ahead = [s for s in self._stored() if (s.t - t) * seconds > 0.0] or self._stored()
        self.show(min(ahead, key=lambda stored: abs(stored.t - t - seconds)).snapshot)

    def go_live(self) -> None:
        """Show the present, and stop a replay."""
        with self._lock:
            self._shown = self._replay = None

    def mark_begin(self) -> None:
        """Mark the shown instant as the start of the interval.

        A later end in the same run remains; if the interval would be longer than `MOST_MARKED`, its
        end moves to this length. Without such an end, the interval grows up to `MOST_MARKED`.
        """
        with self._lock:
            begin, end = self.shown().t, None if self.earlier else self.end
            end = None if end is None or end <= begin else min(end, begin + MOST_MARKED)
            self._mark(begin, end)

    def mark_end(self) -> None:
        """Mark the shown instant as the end of the interval; `LogError` if it is the start.

        An earlier start in this run remains, or moves to `MOST_MARKED` before the end. Without such
        a start, the interval begins at the oldest snapshot stored within `MOST_MARKED` of its end.
        """
        with self._lock:
            at = self.shown().t  # an interval without an end has all snapshots now
            if self.begin == at and not self.earlier:
                raise LogError("the end must be later than the start; show a later instant first")
            begin = self.begin
            if begin is None or self.earlier or begin > at:
                begin = min(self._stored(at - MOST_MARKED)[0].t, at)
            self._mark(max(begin, at - MOST_MARKED), at)

    def unmark(self) -> None:
        with self._lock:
            self.begin = self.end = None
            self._marked = []

    def interval(self) -> list[Snapshot]:
        """Return the marked snapshots, else those of the last 60 s; `LogError` for less than 2."""
        self.shown()
        with self._lock:
            found = list(self._marked) if self.begin is not None else self._loop.stored()
        if len(found) < 2:
            whole = "marked interval" if self.begin is not None else "run"
            raise LogError(f"the {whole} has no duration yet; mark a start and a later end")
        return [stored.snapshot for stored in found]

    def between(self, begin: float, end: float, spacing: float) -> list[Snapshot]:
        """Return the first stored snapshot of each `spacing` [s], from `begin` [s] to `end` [s]."""
        found = [stored for stored in self._stored(begin) if stored.t <= end]
        bins = np.floor([stored.t / spacing for stored in found])
        return [found[i].snapshot for i in np.flatnonzero(np.diff(bins, prepend=-1.0))]

    def _stored(self, begin: float = 0.0) -> list[Stored]:
        """Return the stored snapshots from a time [s] on; beyond the last 60 s, one per 0.2 s."""
        kept = self._loop.stored()
        old = [stored for stored in tuple(self._strip.past) if stored.t < kept[0].t]
        return [stored for stored in (*old, *kept) if stored.t >= begin]

    def _mark(self, begin: float, end: float | None) -> None:
        """Mark an interval [s]; it can use the snapshots of the previous interval of this run."""
        marked = [] if self.earlier else self._marked
        known = {stored.t: stored for stored in (*self._stored(begin), *marked)}
        last = np.inf if end is None else end + 1e-9
        self._marked = [known[t] for t in sorted(known) if begin <= t <= last]
        self.begin, self.end = begin, end
