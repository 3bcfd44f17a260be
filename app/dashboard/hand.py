"""The gizmo on the end-effector: who drags it pulls the hand, who lets go releases it."""

from __future__ import annotations

from typing import Protocol

import numpy as np
import viser

from app.dashboard.colours import PERSON
from app.dashboard.notices import Notices
from app.simulation.snapshot import Command, Pull, Snapshot

Array = np.ndarray

GIZMO = "/hand"
"""Scene node of the gizmo."""
SCALE = 0.26  # [m] length of the gizmo's arrows
LEAST_STRETCH = 0.002  # [m] shorter rubber bands are not drawn


class Sink(Protocol):
    """Where commands go."""

    def send(self, command: Command) -> None:
        """Take a command."""
        ...


class Grip:
    """Who holds the hand: the first client that grabs it, until it lets go or is gone."""

    def __init__(self, sink: Sink, notices: Notices) -> None:
        self._sink, self._notices = sink, notices
        self.holder: int | None = None
        """Client that drags, or None."""
        self._told = False

    def drag(self, event: viser.TransformControlsEvent) -> None:
        """One event of the gizmo: start, update or end."""
        if event.phase == "end":
            self.release(event.client_id)
            return
        if self.holder is None and event.phase == "start":
            self.holder, self._told = event.client_id, False
        if event.client_id != self.holder:
            if event.phase == "start":
                self._notices.warn(event.client, "Somebody else holds the hand just now.")
            return
        x, y, z = (float(value) for value in event.target.position)
        if z < 0.0 and not self._told:
            self._told = True  # once a drag, not twenty times a second
            self._notices.warn(event.client, "The floor is at z = 0: the hand stays above it.")
        self._sink.send(Pull((x, y, max(z, 0.0))))

    def release(self, client_id: int | None) -> None:
        """Let go, if it is this client that holds the hand."""
        if self.holder is not None and client_id == self.holder:
            self.holder = None
            self._sink.send(Pull(None))


class Hand:
    """Gizmo, and the rubber band from the hand to where the person pulls it."""

    def __init__(self, server: viser.ViserServer, sink: Sink, notices: Notices) -> None:
        """Put the gizmo into the scene and listen to it."""
        self.grip = Grip(sink, notices)
        self._gizmo = server.scene.add_transform_controls(
            GIZMO, scale=SCALE, disable_rotations=True, depth_test=False, opacity=0.7
        )
        self._band = server.scene.add_line_segments(
            "/pull/band", np.zeros((1, 2, 3)), PERSON, thickness=3.0, thickness_units="screen",
            visible=False,
        )  # fmt: skip
        self._label = server.scene.add_label(
            "/pull/label", "", visible=False, anchor="top-left", font_screen_scale=0.85
        )
        self._gizmo.on_update(notices.guard(self.grip.drag))  # type: ignore[arg-type]

        @server.on_client_disconnect
        async def _(client: viser.ClientHandle) -> None:
            self.grip.release(client.client_id)

    def update(self, snapshot: Snapshot, *, texts: bool) -> None:
        """Let the gizmo follow the hand unless somebody drags it; draw the rubber band."""
        if self.grip.holder is None:
            self._gizmo.position = snapshot.p_ee
        target = snapshot.hand_target
        stretched = target is not None and np.linalg.norm(target - snapshot.p_ee) > LEAST_STRETCH
        self._band.visible = self._label.visible = bool(stretched)
        if target is not None and stretched:
            self._band.points = np.array([[snapshot.p_ee, target]])
            self._label.position = (snapshot.p_ee + target) / 2
            if texts:
                self._label.text = f"{np.linalg.norm(snapshot.hand_force):.0f} N"
