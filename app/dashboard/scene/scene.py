"""All layers of the scene, and how a snapshot is drawn on them."""

from __future__ import annotations

import viser

from app.dashboard.scene.acting_points import ActingPoints
from app.dashboard.scene.border_cloud import BorderCloud
from app.dashboard.scene.border_slice import BorderSlice
from app.dashboard.scene.door import DoorScene
from app.dashboard.scene.ghosts import Ghosts
from app.dashboard.scene.legend import Legend
from app.dashboard.scene.motion import Motion
from app.dashboard.scene.pair_lines import PairLines
from app.dashboard.scene.robot import RobotScene
from app.dashboard.scene.theme import set_floor, set_lights
from app.dashboard.scene.trails import Trails
from app.dashboard.shared import Shared
from app.dashboard.view import View
from app.simulation.trace.snapshot import Snapshot


class Scene:
    """The robot and what explains its motion, without any widget."""

    def __init__(self, scene: viser.SceneApi, shared: Shared, view: View) -> None:
        """Send what does not change.

        Args:
            scene: Of a viewer, or of a server that all see alike.
            shared: Robot, borders and tracks.
            view: What is to be seen; read at each drawing.
        """
        self._scene, self._view = scene, view
        set_lights(scene)
        self.robot = RobotScene(scene, shared.parts)
        self._border = BorderCloud(scene, shared.borders)
        self._slice = BorderSlice(scene, shared.borders, shared.mobile)
        self._lines = PairLines(scene, shared.pairs)
        self._acting = ActingPoints(scene, shared.mobile, shared.borders.top)
        self._motion = Motion(scene, shared.borders.top, shared.model.description.base.axes)
        self._trails = Trails(scene, shared.tracks)
        self._ghosts = Ghosts(scene, shared.parts)
        self._door = DoorScene(scene)
        self._shown: tuple[bool, bool] | None = None
        self._dark: bool | None = None

    @property
    def legends(self) -> list[Legend]:
        """Of the borders that are drawn."""
        return self._border.legends

    def select_border(self, snapshot: Snapshot) -> bool:
        """Draw other borders if they have changed.

        Selecting takes milliseconds: call it outside of `atomic`, which holds up all sending.

        Returns:
            Whether `legends` is new.
        """
        return self._border.update(self._view, snapshot.config.border)

    def draw(self, snapshot: Snapshot, *, texts: bool) -> None:
        """Draw a snapshot.

        Args:
            snapshot: What is to be seen.
            texts: Whether labels and trails are due too.
        """
        view = self._view
        if self._dark != view.dark:
            self._dark = view.dark
            set_floor(self._scene, dark=view.dark)
        if self._shown != (view.meshes, view.bodies):
            self._shown = (view.meshes, view.bodies)
            self.robot.show(meshes=view.meshes, bodies=view.bodies)
        self.robot.update(snapshot.base_pose, snapshot.q_m, snapshot.wheel_angles)
        self._ghosts.update(snapshot)
        self._door.update(snapshot.door)
        self._slice.update(snapshot, view)
        self._lines.update(snapshot, view, texts=texts)
        self._acting.update(snapshot, view, texts=texts)
        self._motion.update(snapshot, view)
        if texts:
            self._trails.update(snapshot, view)
