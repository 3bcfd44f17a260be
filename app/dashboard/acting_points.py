"""Acting points of the pairs inside their buffer: p_n, p_t, p_act and the force."""

from __future__ import annotations

from typing import Literal

import numpy as np
import viser

from app.dashboard.colours import ACTING
from app.dashboard.view import View
from app.simulation.snapshot import ActingReading, Snapshot

Array = np.ndarray

METRES_PER_NEWTON = 1 / 400  # [m/N] length of a force's arrow: 0.1 m is 40 N
LEAST_FORCE = 0.5  # [N] weaker forces get no arrow, whose head would be longer than itself
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

    def __init__(self, server: viser.ViserServer, name: str) -> None:
        scene, node = server.scene, f"/acting/{name}"
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
        self.arrow = scene.add_arrows(
            f"{node}/force", np.zeros((1, 2, 3)), ACTING, visible=False,
            shaft_radius=0.008, head_radius=0.020, head_length=0.035,
        )  # fmt: skip

    def hide(self) -> None:
        for handle in (*self.points.values(), *self.labels.values(), self.arrow):
            handle.visible = False

    def update(self, reading: ActingReading, *, texts: bool) -> None:
        at = {"p_n": reading.p_n, "p_t": reading.p_t, "p_act": reading.p_act}
        for key, position in at.items():
            for handle in (self.points[key], self.labels[key]):
                handle.visible = True
                handle.position = position
        apart = float(np.linalg.norm(reading.p_t - reading.p_act))
        self.labels["p_t"].visible = apart > LEAST_APART
        force = float(np.linalg.norm(reading.f))
        if texts:
            self.labels["p_act"].text = f"p_act  {force:.0f} N"
        self.arrow.visible = force >= LEAST_FORCE
        if self.arrow.visible:
            self.arrow.points = arrow(reading.p_act, reading.f)


class ActingPoints:
    """Marks of all pairs of L_m, shown while the pair has an acting point."""

    def __init__(self, server: viser.ViserServer, names: list[str]) -> None:
        """Hidden marks for the pairs of these names."""
        self._marks = {name: _Marks(server, name) for name in names}

    def update(self, snapshot: Snapshot, view: View, *, texts: bool) -> None:
        """Move what is active, hide the rest; texts change only if `texts`."""
        readings = {reading.name: reading for reading in snapshot.acting} if view.acting else {}
        for name, marks in self._marks.items():
            if name in readings:
                marks.update(readings[name], texts=texts)
            else:
                marks.hide()


def arrow(start: Array, force: Array) -> Array:
    """(1, 2, 3) [m] start and end of the arrow of a force [N] that acts at `start`."""
    return np.array([[start, np.asarray(start) + METRES_PER_NEWTON * np.asarray(force)]])
