"""Point in time that a viewer sees, and the interval that the viewer marks."""

import threading
from time import monotonic

import numpy as np

from app.dashboard.record import Strip
from app.errors import LogError
from app.simulation.loop.loop import LoopHandle
from app.simulation.trace.snapshot import Snapshot
from app.simulation.trace.trace import Stored
from app.strict import check_range

REPLAY = 0.1, 4.0  # [-] limits of the replay speed, relative to real time
AGAIN = 10.0  # [s] length of a replay that is started at the newest snapshot
MOST_MARKED = 120.0  # [s] largest length of a marked interval


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

        After a restart, the newest snapshot is shown, and such an interval is removed.
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
        """Go forward by a time [s], or back if negative; at least to the next snapshot there."""
        t = self.shown().t
        ahead = [s for s in self._stored() if (s.t - t) * seconds > 0.0] or self._stored()
        self.show(min(ahead, key=lambda stored: abs(stored.t - t - seconds)).snapshot)

    def go_live(self) -> None:
        """Show the present, and stop a replay."""
        with self._lock:
            self._shown = self._replay = None

    def mark_begin(self) -> None:
        """Mark the shown instant as the start of the interval.

        A later end in the same run remains, but it is at most `MOST_MARKED` after the start.
        """
        with self._lock:
            begin, end = self.shown().t, None if self.earlier else self.end
            end = None if end is None or end <= begin else min(end, begin + MOST_MARKED)
            self._mark(begin, end)

    def mark_end(self) -> None:
        """Mark the shown instant as the end of the interval; `LogError` if it is the start.

        An earlier start in this run remains, but it is at most `MOST_MARKED` before the end.
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
        """Return the snapshots of the interval, oldest first; without marks, of the last 60 s.

        Raises `LogError` for fewer than two snapshots.
        """
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
        """Mark an interval [s], with the snapshots of its previous marks in this run."""
        marked = [] if self.earlier else self._marked
        known = {stored.t: stored for stored in (*self._stored(begin), *marked)}
        last = np.inf if end is None else end + 1e-9
        self._marked = [known[t] for t in sorted(known) if begin <= t <= last]
        self.begin, self.end = begin, end
