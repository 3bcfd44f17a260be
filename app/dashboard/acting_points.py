"""Acting points of the pairs inside their buffer: p_n, p_t, p_act and the force."""

from __future__ import annotations

from typing import Literal

import numpy as np
import viser

from app.dashboard.arrows import arrow, hidden_arrow
from app.dashboard.colours import ACTING
from app.dashboard.scales import LEAST_FORCE
from app.dashboard.view import View
from app.simulation.snapshot import ActingReading, Snapshot

Array = np.ndarray

LEAST_APART = 0.05  # [m] nearer to p_act the label of p_t would lie under that of p_act
_COLOURS = {"p_n": (240, 240, 245), "p_t": (32, 190, 200), "p_act": ACTING}
# Each label on its own side, the distance's to the upper right: they stay apart where points meet.
_ANCHORS: dict[str, Literal["bottom-right", "top-right", "top-left"]] = {
    "p_n": "bottom-right",
    "p_t": "top-right",
    "p_act": "top-left",
}


class _Marks:
    """What is drawn for one pair."""

    def __init__(self, scene: viser.SceneApi, name: str) -> None:
        node = f"/acting/{name}"
        self.points = {
            key: scene.add_icosphere(
                f"{node}/{key}", radius=0.011, color=colour, visible=False, cast_shadow=False
            )
            for key, colour in _COLOURS.items()
        }
        self.labels = {
            key: scene.add_label(
                f"{node}/{key}_label", key, anchor=anchor, visible=False, font_screen_scale=0.85
            )
            for key, anchor in _ANCHORS.items()
        }
        self.arrow = hidden_arrow(scene, f"{node}/force", ACTING)

    def hide(self) -> None:
        for handle in (*self.points.values(), *self.labels.values(), self.arrow):
            handle.visible = False

    def update(self, reading: ActingReading, *, names: bool, texts: bool) -> None:
        at = {"p_n": reading.p_n, "p_t": reading.p_t, "p_act": reading.p_act}
        for key, position in at.items():
            for handle in (self.points[key], self.labels[key]):
                handle.visible = True
                handle.position = position
        apart = float(np.linalg.norm(reading.p_t - reading.p_act))
        self.labels["p_n"].visible = names
        self.labels["p_t"].visible = names and apart > LEAST_APART
        force = float(np.linalg.norm(reading.f))
        if texts:
            self.labels["p_act"].text = f"p_act  {force:.0f} N" if names else f"{force:.0f} N"
        self.arrow.visible = force >= LEAST_FORCE
        if self.arrow.visible:
            self.arrow.points = arrow(reading.p_act, reading.f)


class ActingPoints:
    """Marks of all pairs of L_m, shown while the pair has an acting point."""

    def __init__(self, scene: viser.SceneApi, names: list[str]) -> None:
        """Hidden marks for the pairs of these names."""
        self._marks = {name: _Marks(scene, name) for name in names}

    def update(self, snapshot: Snapshot, view: View, *, texts: bool) -> None:
        """Move what is active, hide the rest; texts change only if `texts`."""
        readings = {reading.name: reading for reading in snapshot.acting} if view.acting else {}
        for name, marks in self._marks.items():
            if name in readings:
                marks.update(readings[name], names=view.names, texts=texts)
            else:
                marks.hide()
