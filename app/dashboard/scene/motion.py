"""What the robot is asked to do: forces of the people who pull, and accelerations of the base."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import viser

from app.dashboard.scene.arrows import HEAD_LENGTH, arrow, hidden_arrow
from app.dashboard.scene.colours import ACCELERATION, PERSON
from app.dashboard.scene.lines import hidden_line, set_polyline
from app.dashboard.scene.robot import ROOT
from app.dashboard.scene.scales import (
    LEAST_FORCE,
    METRES_PER_ACCELERATION,
    RADIANS_PER_ACCELERATION,
)
from app.dashboard.view import View
from app.robot.bases.kind import Axis, planar
from app.simulation.trace.snapshot import Snapshot

Array = np.ndarray

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
