"""Distances: lines between the closest points of all link pairs, with labels on demand."""

from __future__ import annotations

from typing import Literal

import numpy as np
import viser

from app.dashboard.scene.colours import NEAR, distance_colour, linear
from app.dashboard.view import View
from app.simulation.trace.snapshot import PairReading, Snapshot

Array = np.ndarray

NODE = "/distances"
LIFT = np.array([0.0, 0.0, 0.07])  # [m] of a label over its point, clear of the acting points
_ANCHORS: tuple[Literal["bottom-left", "top-left", "bottom-right", "top-right"], ...] = (
    "bottom-left",
    "top-left",
    "bottom-right",
    "top-right",
)
"""Quarters in which the labels stand in turn: those of one point do not overlap."""
TOGETHER = 0.15  # [m] nearer labels stand at one point
_END_ANCHORS: tuple[tuple[str, Literal["bottom-right", "top-left"]], ...] = (
    ("p_a", "bottom-right"),
    ("p_b", "top-left"),
)
"""Points of a pair, and the side on which each one's name stands."""


class PairLines:
    """Thin lines for pairs outside of their buffer, thick ones for those inside."""

    def __init__(self, scene: viser.SceneApi, names: list[str]) -> None:
        """Lines and labels of the pairs of these names, hidden until the first update."""
        nothing = np.zeros((len(names), 2, 3))
        self._thin, self._thick = (
            scene.add_line_segments(
                f"{NODE}/{kind}",
                nothing,
                np.zeros((len(names), 2, 3), np.uint8),
                thickness=pixels,
                thickness_units="screen",
                visible=False,
            )
            for kind, pixels in (("outside", 1.5), ("inside", 4.0))
        )
        self._scene = scene
        self._labels: dict[str, viser.LabelHandle] = {}
        self._ends: dict[str, tuple[list, list]] = {}
        for name in names:
            self._add(name)

    def _add(self, name: str) -> None:
        anchor = _ANCHORS[len(self._labels) % len(_ANCHORS)]
        self._labels[name] = self._scene.add_label(
            f"{NODE}/label_{name}", name, visible=False, anchor=anchor, font_screen_scale=0.85
        )
        self._ends[name] = _ends(self._scene, f"{NODE}/{name}")

    def update(self, snapshot: Snapshot, view: View, *, texts: bool) -> None:
        """Move the lines; renew the labels' texts only if `texts`, at the panels' lower rate."""
        d_b, d_full = snapshot.config.border.d_b, snapshot.config.activation.d_full
        self._thin.visible = view.distances
        self._thick.visible = view.distances
        if view.distances:
            colours = linear(np.array([distance_colour(p.d, d_b, d_full) for p in snapshot.pairs]))
            for lines, inside in ((self._thin, False), (self._thick, True)):
                lines.colors = np.repeat(colours[:, None, :], 2, axis=1)
                lines.points = segments(snapshot.pairs, d_b, inside=inside)
        self._hide_others({pair.name for pair in snapshot.pairs})
        for pair in snapshot.pairs:
            if pair.name not in self._labels:  # of what the hand has taken, as a door
                self._add(pair.name)
        self._update_labels(snapshot.pairs, view, d_b, texts=texts)
        for pair in snapshot.pairs:
            self._update_ends(pair, shown=view.distances and view.names and pair.d < d_b)

    def _hide_others(self, names: set[str]) -> None:
        for name in self._labels.keys() - names:
            self._labels[name].visible = False
            for handle in (*self._ends[name][0], *self._ends[name][1]):
                handle.visible = False

    def _update_ends(self, pair: PairReading, *, shown: bool) -> None:
        for point, mark, label in zip((pair.p_a, pair.p_b), *self._ends[pair.name], strict=True):
            mark.visible = label.visible = shown
            if shown:
                mark.position = label.position = point

    def _update_labels(
        self, pairs: tuple[PairReading, ...], view: View, d_b: float, *, texts: bool
    ) -> None:
        places: list[Array] = []
        sides: list[str] = []
        for pair in pairs:
            label = self._labels[pair.name]
            label.visible = view.distances and (
                view.labels == "all" or (view.labels == "active" and pair.d < d_b)
            )
            if label.visible:
                # Between the base and the arm stand the acting points with their own labels.
                place = pair.p_a + LIFT if pair.mobile else (pair.p_a + pair.p_b) / 2
                place = beside(place, label.anchor, places, sides)
                places.append(place)
                sides.append(label.anchor)
                label.position = place
                if texts:
                    label.text = f"{pair.name}  {1000 * pair.d:.0f} mm"


def beside(place: Array, side: str, places: list[Array], sides: list[str]) -> Array:
    """Where a label stands: with others near it at one point, in a quarter of its own.

    Args:
        place: (3,) [m] where it belongs.
        side: Its anchor.
        places: (3,) [m] each, of the labels that stand already.
        sides: Their anchors.
    """
    for there in places:
        if np.linalg.norm(there - place) < TOGETHER:
            taken = {s for p, s in zip(places, sides, strict=True) if p is there}
            if side not in taken:
                return there
    return place


def _ends(scene: viser.SceneApi, node: str) -> tuple[list, list]:
    """Marks of p_a and p_b, and their names; hidden."""
    marks = [
        scene.add_icosphere(
            f"{node}/{key}", radius=0.009, color=NEAR, visible=False, cast_shadow=False
        )
        for key in ("p_a", "p_b")
    ]
    labels = [
        scene.add_label(
            f"{node}/{key}_label", key, anchor=anchor, visible=False, font_screen_scale=0.85
        )
        for key, anchor in _END_ANCHORS
    ]
    return marks, labels


def segments(pairs: tuple[PairReading, ...], d_b: float, *, inside: bool) -> Array:
    """(N, 2, 3) [m] one segment a pair; a pair of the other kind shrinks to a point.

    Args:
        pairs: All pairs.
        d_b: [m] buffer distance.
        inside: Whether the pairs inside of their buffer are wanted, or those outside.
    """
    ends = np.array([(pair.p_a, pair.p_b) for pair in pairs], dtype=float).reshape(-1, 2, 3)
    unwanted = np.array([(pair.d < d_b) != inside for pair in pairs], dtype=bool)
    ends[unwanted, 1] = ends[unwanted, 0]
    return ends
