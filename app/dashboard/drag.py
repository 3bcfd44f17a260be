"""Drag: a viewer pulls the end-effector by a gizmo, or any link of the arm by itself."""

from __future__ import annotations

from typing import NamedTuple, Protocol

import numpy as np
import pinocchio as pin
import viser

from app.dashboard.notifications import Notifier
from app.dashboard.scene.colours import PERSON
from app.dashboard.scene.lines import hidden_line, set_polyline
from app.dashboard.scene.robot import RobotScene
from app.simulation.loop.commands import Command, Pull, Release
from app.simulation.people import PullReading
from app.simulation.trace.snapshot import Snapshot

Array = np.ndarray

GIZMO = "/hand"
"""Scene node of the gizmo."""
SCALE = 0.26  # [m] length of the gizmo's arrows
LEAST_STRETCH = 0.002  # [m] shorter rubber bands are not drawn
_MOST_BANDS = 4  # people who pull at once that are drawn


class Sink(Protocol):
    """Where commands go."""

    def send(self, command: Command) -> None:
        """Take a command."""
        ...


class Hold(NamedTuple):
    """Where a person holds the robot.

    Attributes:
        link: Name of the joint that moves the link; None for the end-effector.
        point: (3,) [m] in that joint's frame; None for the end-effector.
    """

    link: str | None = None
    point: tuple[float, float, float] | None = None


class Grip:
    """What one viewer holds. Several may pull at once: their forces add."""

    def __init__(self, sink: Sink, notifier: Notifier, who: int) -> None:
        """Nothing held.

        Args:
            sink: Where pulls go.
            notifier: For what is not possible.
            who: Number of the viewer.
        """
        self._sink, self._notifier, self._who = sink, notifier, who
        self._hold: Hold | None = None
        self._warned = False

    @property
    def holds_hand(self) -> bool:
        """Whether the end-effector is held by this viewer's gizmo."""
        return self._hold is not None and self._hold.link is None

    @property
    def holds_anything(self) -> bool:
        """Whether the viewer pulls at all."""
        return self._hold is not None

    def take(self, hold: Hold) -> None:
        """Take hold of the robot; of what was held before, the person lets go."""
        if self._hold is not None:
            self.release()
        self._hold, self._warned = hold, False

    def pull(self, target: Array, client: viser.ClientHandle | None) -> None:
        """Pull what is held to a place (3,) [m] in the world, or to the floor below it."""
        if self._hold is None:
            return
        x, y, z = (float(value) for value in target)
        if z < 0.0 and not self._warned:
            self._warned = True  # once a drag, not twenty times a second
            self._notifier.warn(client, "The floor is at z = 0: the hand stays above it.")
        self._sink.send(Pull((x, y, max(z, 0.0)), *self._hold, who=self._who))

    def release(self) -> None:
        """Let go."""
        if self._hold is not None:
            self._hold = None
            self._sink.send(Release(self._who))


class DragHandles:
    """Gizmo on the end-effector, links that can be dragged, and the rubber bands of all pulls."""

    def __init__(
        self,
        scene: viser.SceneApi,
        robot: RobotScene,
        grip: Grip,
        notifier: Notifier,
        arm_joints: dict[int, str],
    ) -> None:
        """Put the gizmo into the scene and listen to it and to the arm's links.

        Args:
            scene: Of the viewer.
            robot: Whose links may be dragged.
            grip: What the viewer holds.
            notifier: For what goes wrong.
            arm_joints: Names of the arm's joints, by their index in the drawn model.
        """
        self.grip = grip
        self._gizmo = scene.add_transform_controls(
            GIZMO, scale=SCALE, disable_rotations=True, depth_test=False, opacity=0.7
        )
        self._gizmo.on_update(notifier.guard(self._drag_gizmo))  # type: ignore[arg-type]
        for joint, mesh in robot.links:
            if joint in arm_joints:
                self._listen(mesh, robot, joint, arm_joints[joint], notifier)
        self._bands = [hidden_line(scene, f"/pull/{i}", PERSON, 3.0) for i in range(_MOST_BANDS)]
        self._labels = [
            scene.add_label(
                f"/pull/label_{i}", "", visible=False, anchor="top-left", font_screen_scale=0.85
            )
            for i in range(_MOST_BANDS)
        ]

    def update(self, snapshot: Snapshot, *, texts: bool) -> None:
        """Let the gizmo follow the hand unless this viewer drags it; draw the rubber bands."""
        if not self.grip.holds_hand:
            self._gizmo.position = snapshot.p_ee
        stretched = [
            pull
            for pull in snapshot.pulls
            if np.linalg.norm(pull.target - pull.point) > LEAST_STRETCH
        ]
        for i, (band, label) in enumerate(zip(self._bands, self._labels, strict=True)):
            band.visible = label.visible = i < len(stretched)
            if i < len(stretched):
                self._draw(band, label, stretched[i], texts=texts)

    @staticmethod
    def _draw(
        band: viser.LineSegmentsHandle, label: viser.LabelHandle, pull: PullReading, *, texts: bool
    ) -> None:
        set_polyline(band, np.array([pull.point, pull.target]), PERSON)
        label.position = (pull.point + pull.target) / 2
        if texts:
            label.text = f"{np.linalg.norm(pull.force):.0f} N"

    def _drag_gizmo(self, event: viser.TransformControlsEvent) -> None:
        """One event of the gizmo: start, update or end."""
        if event.phase == "end":
            self.grip.release()
            return
        if event.phase == "start":
            self.grip.take(Hold())
        if self.grip.holds_hand:
            self.grip.pull(np.asarray(event.target.position), event.client)

    def _listen(
        self, mesh: viser.MeshHandle, robot: RobotScene, joint: int, name: str, notifier: Notifier
    ) -> None:
        def dragged(event: viser.SceneNodeDragEvent) -> None:
            if event.phase == "end":
                self.grip.release()
                return
            if event.phase == "start":
                T: pin.SE3 = robot.world_pose(joint)
                point = T.actInv(np.array(event.start_position))
                self.grip.take(Hold(name, (float(point[0]), float(point[1]), float(point[2]))))
            self.grip.pull(np.array(event.end_position), event.client)

        mesh.on_drag(notifier.guard(dragged))  # type: ignore[arg-type]
