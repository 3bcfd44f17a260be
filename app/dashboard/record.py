"""The last minute as the plots need it: one table for all viewers, in bounded memory."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable
from typing import NamedTuple

import numpy as np

from app.simulation.trace.snapshot import Snapshot

Array = np.ndarray

KEPT = 60.0
"""[s] how far back the table goes."""
PERIOD = 0.04
"""[s] least time between two rows."""


class Curve(NamedTuple):
    """One line of a plot.

    Attributes:
        label: In the plot's legend.
        value: Its value at a snapshot.
    """

    label: str
    value: Callable[[Snapshot], float]


class Record:
    """Values of curves over time.

    Attributes:
        last: [s] time of the newest snapshot that was taken in, -1 if there is none.
    """

    def __init__(self, curves: Iterable[Curve]) -> None:
        """An empty table.

        Args:
            curves: Its columns, after the time.
        """
        self._curves = tuple(curves)
        self._rows: deque[Array] = deque(maxlen=int(KEPT / PERIOD) + 2)
        self.last = -1.0

    def extend(self, snapshots: Iterable[Snapshot], now: float) -> None:
        """Take in what is new.

        Args:
            snapshots: In order of time.
            now: [s] time of the newest snapshot; if it is before `last`, the simulation has begun
                anew, and so does the table.
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
                values = [curve.value(snapshot) for curve in self._curves]
                self._rows.append(np.array([snapshot.t, *values]))

    def columns(self, until: float, length: float) -> Array:
        """The rows of a stretch of time as columns.

        Args:
            until: [s] its end.
            length: [s] of it.

        Returns:
            (1 + C, N) times [s] and the curves' values, N ≥ 1.
        """
        if not self._rows:
            return np.zeros((1 + len(self._curves), 1))
        table = np.array(self._rows).T
        inside = (table[0] >= until - length) & (table[0] <= until)
        return table[:, inside] if inside.any() else table[:, :1]
