"""The last seconds of the simulation, as the plots need them, in bounded memory."""

from __future__ import annotations

from collections import deque

import numpy as np

from app.simulation.snapshot import Snapshot

Array = np.ndarray

LENGTH = 20.0
"""[s] how far back the plots look."""
PERIOD = 0.04
"""[s] least time between two rows: 500 rows fill the window."""


class Window:
    """Rows of numbers with their times; older ones than `LENGTH` are dropped."""

    def __init__(self, pairs: int) -> None:
        """An empty window for so many link pairs."""
        self._pairs = pairs
        self._rows: deque[Array] = deque(maxlen=int(LENGTH / PERIOD) + 2)
        self.last = -1.0
        """[s] time of the newest snapshot that was taken in, −1 if there is none."""

    def extend(self, snapshots: list[Snapshot], now: float) -> None:
        """Take in what is new.

        Args:
            snapshots: In order of time.
            now: [s] time of the newest snapshot; if it is before `last`, the simulation has begun
                anew, and so does the window.
        """
        if now < self.last:
            self._rows.clear()
            self.last = -1.0
        for snapshot in snapshots:
            if snapshot.t <= self.last:
                continue
            self.last = snapshot.t
            # Half a millisecond of grace: times are sums of floats.
            if not self._rows or snapshot.t >= self._rows[-1][0] + PERIOD - 5e-4:
                self._rows.append(row(snapshot))

    def columns(self) -> Array:
        """(4 + P, N) time [s], P distances [m], β_m, β v̇ and β ω̇; N ≥ 1, the newest last."""
        if not self._rows:
            return np.zeros((4 + self._pairs, 1))
        table = np.array(self._rows).T
        return table[:, table[0] >= table[0, -1] - LENGTH]


def row(snapshot: Snapshot) -> Array:
    """(4 + P,) t, the distances of all pairs, β_m, and the avoidance accelerations of the base."""
    distances = [pair.d for pair in snapshot.pairs]
    return np.array([snapshot.t, *distances, snapshot.beta_m, *snapshot.avoidance_acceleration])
