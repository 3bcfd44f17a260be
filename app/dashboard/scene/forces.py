"""Forces and accelerations: acting points, people's forces, and what the base is asked to do."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

import numpy as np
import viser

from app.dashboard.scene.colours import ACCELERATION, ACTING, PERSON
from app.dashboard.scene.lines import (
    HEAD_LENGTH,
    LEAST_FORCE,
    METRES_PER_ACCELERATION,
    METRES_PER_NEWTON,
    RADIANS_PER_ACCELERATION,
    arrow,
    hidden_arrow,
    hidden_line,
    set_polyline,
)
from app.dashboard.scene.robot import ROOT
from app.dashboard.view import View
from app.robot.bases.kind import Axis, planar
from app.simulation.trace.snapshot import ActingReading, Snapshot

Array = np.ndarray

LIFT = 0.08  # [m] of an arrow over the base's top
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

    def __init__(self, scene: viser.SceneApi, name: str, top: float) -> None:
        node, self._top = f"/acting/{name}", top
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
        self.stem = hidden_line(scene, f"{node}/stem", ACTING, 2.0)

    def hide(self) -> None:
        for handle in (*self.points.values(), *self.labels.values(), self.arrow, self.stem):
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
        self.arrow.visible = self.stem.visible = force >= LEAST_FORCE
        if self.arrow.visible:
            points = pushing_arrow(reading.p_act, reading.f, self._top)
            self.arrow.points = points
            set_polyline(self.stem, np.array([reading.p_act, points[0, 1]]), ACTING)
            self.labels["p_act"].position = points[0, 0]


class ActingPoints:
    """Marks of all pairs of L_m, shown while the pair has an acting point."""

    def __init__(self, scene: viser.SceneApi, names: list[str], top: float) -> None:
        """Hidden marks.

        Args:
            scene: Where to draw.
            names: Of the pairs.
            top: [m] height of the base's top.
        """
        self._scene, self._top = scene, top
        self._marks = {name: _Marks(scene, name, top) for name in names}

    def update(self, snapshot: Snapshot, view: View, *, texts: bool) -> None:
        """Move what is active, hide the rest; texts change only if `texts`."""
        readings = {reading.name: reading for reading in snapshot.acting} if view.acting else {}
        for name in readings.keys() - self._marks.keys():  # of what the hand has taken, as a door
            self._marks[name] = _Marks(self._scene, name, self._top)
        for name, marks in self._marks.items():
            if name in readings:
                marks.update(readings[name], names=view.names, texts=texts)
            else:
                marks.hide()


def pushing_arrow(p_act: Array, force: Array, top: float) -> Array:
    """(1, 2, 3) [m] start and end of the arrow of a force on the base that acts at p_act.

    It ends there, for the base would hide one that began there; and below the base's top it is
    drawn straight above p_act, for the arm would hide it.

    Args:
        p_act: (3,) [m] in the world.
        force: (3,) [N].
        top: [m] height of the base's top.
    """
    end = np.array([p_act[0], p_act[1], max(float(p_act[2]), top + LIFT)])
    return arrow(end - METRES_PER_NEWTON * np.asarray(force), force)


_LEAST = 0.02  # [m/s²] and [rad/s²] smaller ones are not drawn
_MOST_ARC = np.deg2rad(300.0)  # [rad] longer arcs would close
_RADIUS = 0.22  # [m] of the arc
_LIFT = 0.06  # [m] of both over the base's top
_ARC_POINTS = 24


class Motion:
    """Arrows of forces in the world and of accelerations over the base."""

    def __init__(self, scene: viser.SceneApi, top: float, axes: Sequence[Axis]) -> None:
        """Hidden arrows.

        Args:
            scene: Where to draw.
            top: [m] height of the base's top.
            axes: Of the base, along which its accelerations are.
        """
        self._axes = axes
        self._z = top + _LIFT
        self._person = hidden_arrow(scene, "/person", PERSON)
        self._v = hidden_arrow(scene, f"{ROOT}/v", ACCELERATION)
        self._w_arc = hidden_line(scene, f"{ROOT}/w_arc", ACCELERATION, 4.0)
        self._w_head = hidden_arrow(scene, f"{ROOT}/w_head", ACCELERATION)

    def update(self, snapshot: Snapshot, view: View) -> None:
        """Draw what a snapshot says."""
        force = snapshot.hand_force
        pulls = snapshot.hand_target is not None and float(np.linalg.norm(force)) >= LEAST_FORCE
        self._person.visible = view.motion and pulls
        if self._person.visible:
            self._person.points = arrow(snapshot.p_ee, force)
        forward, left, w = planar(self._axes, snapshot.base_acceleration)
        self._v.visible = view.motion and np.hypot(forward, left) > _LEAST
        if self._v.visible:
            x, y = METRES_PER_ACCELERATION * forward, METRES_PER_ACCELERATION * left
            self._v.points = np.array([[[0.0, 0.0, self._z], [x, y, self._z]]])
        turns = view.motion and abs(w) > _LEAST
        self._w_arc.visible = self._w_head.visible = turns
        if turns:
            points = arc(w, self._z)
            set_polyline(self._w_arc, points, ACCELERATION)
            self._w_head.points = head(points)


def arc(w: float, z: float) -> Array:
    """(K, 3) [m] the arc of an acceleration ω̇ [rad/s²] around the base's axis, begun ahead."""
    angle = float(np.clip(RADIANS_PER_ACCELERATION * w, -_MOST_ARC, _MOST_ARC))
    along = np.linspace(0.0, angle, _ARC_POINTS)
    return np.column_stack(
        [_RADIUS * np.cos(along), _RADIUS * np.sin(along), np.full(len(along), z)]
    )


def head(points: Array) -> Array:
    """(1, 2, 3) [m] an arrow no longer than its head, at the end of a curve (K, 3)."""
    direction = points[-1] - points[-2]
    direction = direction / max(float(np.linalg.norm(direction)), 1e-9)
    return np.array([[points[-1], points[-1] + HEAD_LENGTH * direction]])
