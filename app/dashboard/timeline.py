"""Which instant one viewer sees: now, or one of the last 60 s."""

from __future__ import annotations

from app.errors import LogError
from app.simulation.loop.loop import LoopHandle
from app.simulation.trace.snapshot import Snapshot

REACH = 60.0
"""[s] how far back a viewer can look."""
FRAME = 0.02
"""[s] between two snapshots."""


class Timeline:
    """The place of one viewer in time; the simulation does not notice.

    Attributes:
        begin, end: [s] the marked interval; None if it is not marked.
    """

    def __init__(self, loop: LoopHandle) -> None:
        """Begin with now.

        Args:
            loop: Gives the newest snapshot and those of the last 60 s.
        """
        self._loop = loop
        self._shown: Snapshot | None = None
        self._reference = 0.0
        self.begin: float | None = None
        self.end: float | None = None

    @property
    def live(self) -> bool:
        """Whether the newest snapshot is shown."""
        return self._shown is None

    def shown(self) -> Snapshot:
        """The snapshot to be drawn; after a restart of the simulation always the newest."""
        newest = self._loop.latest()
        if self._shown is not None and newest.t < self._shown.t:
            self.go_live()
        if self.begin is not None and newest.t < self.begin:
            self.begin = self.end = None
        return newest if self._shown is None else self._shown

    def look_back(self, seconds: float) -> None:
        """Show what was so many seconds before the instant at which the viewer stopped.

        Args:
            seconds: [s] 0 goes to that instant, not to now.
        """
        if self._shown is None:
            self._reference = self._loop.latest().t
        self._go_to(self._reference - min(max(seconds, 0.0), REACH))

    def step(self, seconds: float) -> None:
        """Go on (or back, if negative) by so many seconds, within what is kept."""
        self._go_to(self.shown().t + seconds)

    def go_live(self) -> None:
        """Show the newest snapshot again, from now on."""
        self._shown = None

    @property
    def back(self) -> float:
        """[s] how far back the viewer is, as `look_back` takes it."""
        return 0.0 if self._shown is None else max(self._reference - self._shown.t, 0.0)

    def mark_begin(self) -> None:
        """The marked interval begins at the instant that is shown."""
        self.begin = self.shown().t
        if self.end is not None and self.end <= self.begin:
            self.end = None

    def mark_end(self) -> None:
        """The marked interval ends at the instant that is shown."""
        self.end = self.shown().t
        if self.begin is not None and self.begin >= self.end:
            self.begin = None

    def interval(self) -> list[Snapshot]:
        """The snapshots of the marked interval, or all that are kept, oldest first.

        Raises:
            LogError: Nothing of the interval is kept any more.
        """
        kept = self._loop.history(-1.0)
        low = -1.0 if self.begin is None else self.begin
        high = kept[-1].t if self.end is None else self.end
        marked = [snapshot for snapshot in kept if low - 1e-9 <= snapshot.t <= high + 1e-9]
        if not marked:
            raise LogError(
                f"the marked interval ended at {high:.1f} s, and only the last {REACH:.0f} s are "
                f"kept, from {kept[0].t:.1f} s on: mark another"
            )
        return marked

    def _go_to(self, t: float) -> None:
        kept = self._loop.history(-1.0)
        if self._shown is None:
            self._reference = kept[-1].t
        self._shown = min(kept, key=lambda snapshot: abs(snapshot.t - t))
        self._reference = max(self._reference, self._shown.t)
