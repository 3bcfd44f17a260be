"""Which instant a viewer sees, and the interval that they mark."""

import threading
from time import monotonic

from app.dashboard.record import Strip
from app.errors import LogError
from app.simulation.loop.loop import LoopHandle
from app.simulation.trace.snapshot import Snapshot
from app.strict import check_range

FRAME = 0.02  # [s] between two snapshots
REPLAY = 0.1, 4.0  # [-] speed of the past, over real time
AGAIN = 10.0  # [s] of the past that are played from now
MOST_MARKED = 300.0  # [s] of a marked interval, all of whose snapshots are kept for one viewer


class Timeline:
    """The place of one viewer in time; the simulation does not notice.

    Any thread may call any of the methods.
    """

    def __init__(self, loop: LoopHandle, strip: Strip) -> None:
        """Begin with now; the loop has every snapshot of the last 60 s, the strip older ones."""
        self._loop, self._strip = loop, strip
        self._shown: Snapshot | None = None
        self._replay: tuple[float, float, float] | None = None  # [s] begun, [s] there, [-] speed
        self._newest = loop.latest()
        self._marked: list[Snapshot] = []
        self._lock = threading.RLock()
        self.begin: float | None = None
        self.end: float | None = None
        """[s] the marked interval; None if it is not marked."""

    @property
    def live(self) -> bool:
        """Whether the newest snapshot is shown."""
        return self._shown is None

    def shown(self) -> Snapshot:
        """The snapshot to be drawn; after a restart of the simulation always the newest.

        An interval whose end is marked outlives the restart, until another one is marked.
        """
        with self._lock:
            newest = self._loop.latest()
            if not newest.follows(self._newest):
                self.go_live()
                if self.end is None:
                    self.unmark()
            self._newest = newest
            if self.begin is not None and self.end is None:
                self._hold()
            if self._replay is not None:
                self._go_on(self._replay, newest)
            return self._shown or newest

    @property
    def plays(self) -> bool:
        """Whether the past is played."""
        return self._replay is not None

    def play(self, speed: float) -> None:
        """Play the past from the instant that is shown, or stop; at now the last 10 s.

        Raises:
            ConfigError: The speed is not within `REPLAY`.
        """
        check_range("replay speed", speed, *REPLAY, "× real time")
        if self.plays:
            self._replay = None
            return
        if self.live:
            self.step(-AGAIN)
        self._replay = monotonic(), self.shown().t, speed

    def go_to(self, t: float) -> None:
        """Show the snapshot that is nearest to a time [s]."""
        self.show(min(self._kept(), key=lambda snapshot: abs(snapshot.t - t)))

    def show(self, snapshot: Snapshot) -> None:
        """Show this one, which has been published before."""
        self._shown, self._replay = snapshot, None

    def step(self, seconds: float) -> None:
        """Go forward by a time [s], or back if it is negative, within the stored interval."""
        self.go_to(self.shown().t + seconds)

    def go_live(self) -> None:
        """Show the newest snapshot again, from now on."""
        self._shown = self._replay = None

    def mark_begin(self) -> None:
        """The marked interval begins at the instant that is shown; its end is open."""
        with self._lock:
            self.begin, end = self.shown().t, self.end
            self.end = None
            self._marked = [s for s in self._kept() if s.t >= self.begin]
            if end is not None and end > self.begin:
                self._cut(end)

    def mark_end(self) -> None:
        """The marked interval ends at the instant that is shown.

        Without a marked start, the interval starts with the oldest stored snapshot.
        """
        with self._lock:
            at = self.shown().t
            if self.begin is None or self.begin >= at:
                self._marked = self._kept()
                self.begin = min(self._marked[0].t, at)
            elif self.end is None:
                self._hold()
            else:
                self._marked = [s for s in self._kept() if s.t >= self.begin] or self._marked
            self._cut(at)

    def unmark(self) -> None:
        """No interval is marked."""
        with self._lock:
            self.begin = self.end = None
            self._marked = []

    def interval(self) -> list[Snapshot]:
        """The snapshots of the marked interval, or all of the last 60 s, oldest first.

        Raises:
            LogError: The interval has a single snapshot.
        """
        self.shown()
        with self._lock:
            found = list(self._marked) if self.begin is not None else self._loop.history(-1.0)
        if len(found) < 2:
            raise LogError("the marked interval has no duration; mark a start and a later end")
        return found

    def _go_on(self, replay: tuple[float, float, float], newest: Snapshot) -> None:
        began, t, speed = replay
        t += (monotonic() - began) * speed
        if t >= newest.t:
            self.go_live()
        else:
            self.go_to(t)
            self._replay = replay

    def _kept(self) -> list[Snapshot]:
        """All there is to look at, older ones thinned."""
        kept = self._loop.history(-1.0)
        return [*(s for s in tuple(self._strip.past) if s.t < kept[0].t), *kept]

    def _hold(self) -> None:
        """Store the new snapshots of an interval whose end is open; a long one ends by itself."""
        self._marked += self._loop.history(self._marked[-1].t)
        if self.begin is not None and self._marked[-1].t - self.begin > MOST_MARKED:
            self._cut(self.begin + MOST_MARKED)

    def _cut(self, end: float) -> None:
        """Let the interval end at a time [s]."""
        self.end = end
        self._marked = [s for s in self._marked if s.t <= end + 1e-9]
