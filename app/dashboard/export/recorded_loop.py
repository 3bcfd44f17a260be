"""Snapshots in place of a simulation: what has been recorded is shown, and nothing can be told."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Sequence

from app.simulation.loop.commands import Command
from app.simulation.trace.snapshot import Snapshot


class Film:
    """The interface of the simulation's loop over recorded snapshots.

    Attributes:
        error: Always None: nothing runs that could end.
        links: None: nobody can pull.
        snapshots: In order of time.
    """

    def __init__(self, snapshots: Sequence[Snapshot]) -> None:
        """Stand at the first of the snapshots, of which there is at least one."""
        self.error: BaseException | None = None
        self.links: tuple[str, ...] = ()
        self.snapshots = tuple(snapshots)
        self._times = [snapshot.t for snapshot in self.snapshots]
        self._at = 0

    def go_to(self, t: float) -> Snapshot:
        """Stand at the last snapshot that is not later than a time [s], or at the first."""
        self._at = max(bisect_right(self._times, t + 1e-9) - 1, 0)
        return self.latest()

    def send(self, command: Command) -> None:
        """Nothing can be told to what has been."""

    def latest(self) -> Snapshot:
        """The snapshot at which the film stands."""
        return self.snapshots[self._at]

    def history(self, after: float) -> list[Snapshot]:
        """Snapshots with t > `after` [s] up to the one at which the film stands, oldest first."""
        return list(self.snapshots[bisect_right(self._times, after) : self._at + 1])
