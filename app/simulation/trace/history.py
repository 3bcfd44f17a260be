"""Snapshots of the last minute, written by one thread and read by others."""

from __future__ import annotations

from collections import deque

from app.simulation.trace.snapshot import Snapshot

SNAPSHOTS_KEPT = 3000
"""60 s at 50 Hz."""


class History:
    """A bounded record in order of time; when time goes back, it begins anew."""

    def __init__(self, kept: int = SNAPSHOTS_KEPT) -> None:
        """Empty; the newest snapshots stay, so many of them."""
        self._kept: deque[Snapshot] = deque(maxlen=kept)
        self._latest: Snapshot | None = None

    @property
    def latest(self) -> Snapshot:
        """The newest snapshot; there must be one."""
        assert self._latest is not None, "start the loop first"
        return self._latest

    def add(self, snapshot: Snapshot) -> None:
        """Append a snapshot; one of the same time as the newest takes its place."""
        newest = self._latest
        if newest is not None and snapshot.t < newest.t:
            self._kept.clear()
        elif newest is not None and snapshot.t == newest.t:
            self._kept.pop()
        self._kept.append(snapshot)
        self._latest = snapshot

    def after(self, t: float) -> list[Snapshot]:
        """Snapshots later than `t` [s], oldest first."""
        found = []
        for snapshot in reversed(tuple(self._kept)):
            if snapshot.t <= t:
                break
            found.append(snapshot)
        return found[::-1]
