"""Trails: where base and hand have been, with a point for each centimetre."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable

import numpy as np
import viser

from app.dashboard.scene.colours import TRAIL_BASE, TRAIL_HAND
from app.dashboard.scene.lines import hidden_line, set_polyline
from app.dashboard.view import View
from app.simulation.trace.snapshot import Snapshot

Array = np.ndarray

_COLOURS = {"base": TRAIL_BASE, "hand": TRAIL_HAND}
SPACING = 0.01  # [m] between two points of a trail
_LONGEST = 1500  # points of a trail
_LIFT = 0.004  # [m] of the base's trail above the floor


class Track:
    """A line of bounded length, with the time at which each of its points was passed."""

    def __init__(self) -> None:
        self._points: deque[tuple[float, Array]] = deque(maxlen=_LONGEST)

    def add(self, t: float, p: Array) -> None:
        """Take in a place (3,) [m] at a time [s], if it is not the last one still."""
        if not self._points or np.linalg.norm(p - self._points[-1][1]) >= SPACING:
            self._points.append((t, np.array(p)))

    def until(self, t: float) -> Array:
        """(K, 3) [m] the points passed until a time [s]."""
        passed = [p for at, p in self._points if at <= t]
        return np.array(passed).reshape(-1, 3)

    def clear(self) -> None:
        """Forget all."""
        self._points.clear()


class Tracks:
    """The tracks of base and hand, common to all viewers.

    Attributes:
        last: [s] time of the newest snapshot that was taken in, -1 if there is none.
    """

    def __init__(self) -> None:
        self.base, self.hand = Track(), Track()
        self.last = -1.0

    def extend(self, snapshots: Iterable[Snapshot], now: float) -> None:
        """Take in what is new; if `now` [s] lies before `last`, all began anew."""
        if now < self.last:
            self.base.clear()
            self.hand.clear()
            self.last = -1.0
        for snapshot in snapshots:
            self.base.add(snapshot.t, np.append(snapshot.base_pose[:2], _LIFT))
            self.hand.add(snapshot.t, snapshot.p_ee)
            self.last = snapshot.t


class Trails:
    """Both tracks in a scene."""

    def __init__(self, scene: viser.SceneApi, tracks: Tracks) -> None:
        """Hidden until there is something to see.

        Args:
            scene: Where to draw.
            tracks: What to draw.
        """
        self._tracks = tracks
        self._lines = {
            name: hidden_line(scene, f"/trails/{name}", colour, 2.5)
            for name, colour in _COLOURS.items()
        }
        self._drawn = {"base": b"", "hand": b""}

    def update(self, snapshot: Snapshot, view: View) -> None:
        """Draw what was passed until the snapshot."""
        for name, track in (("base", self._tracks.base), ("hand", self._tracks.hand)):
            points = track.until(snapshot.t)
            line = self._lines[name]
            line.visible = view.trails and len(points) > 1
            ends = points[[0, -1]].tobytes() if line.visible else b""
            if ends != self._drawn[name]:
                self._drawn[name] = ends
                if ends:
                    set_polyline(line, points, _COLOURS[name])
