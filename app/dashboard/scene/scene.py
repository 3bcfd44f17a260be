"""Scene: all layers, and how a snapshot is drawn on them."""

from __future__ import annotations

from collections.abc import Mapping

import viser

from app.border.cloud import Cloud
from app.dashboard.scene.borders import BorderCloud, Borders, BorderSlice
from app.dashboard.scene.colours import GHOSTS
from app.dashboard.scene.door import DoorScene
from app.dashboard.scene.forces import ActingPoints, Motion
from app.dashboard.scene.legend import Legend
from app.dashboard.scene.pair_lines import PairLines
from app.dashboard.scene.robot import RobotParts, RobotScene
from app.dashboard.scene.theme import set_floor, set_lights
from app.dashboard.scene.trails import Tracks, Trails
from app.dashboard.view import View
from app.robot.model import RobotModel
from app.simulation.loop.loop import LoopHandle
from app.simulation.trace.snapshot import Snapshot


class Ghosts:
    """Up to two robots; their meshes are sent when the first snapshot has them."""

    def __init__(self, scene: viser.SceneApi, parts: RobotParts) -> None:
        """None yet.

        Args:
            scene: Where to draw.
            parts: The robot that all of them are.
        """
        self._scene, self._parts = scene, parts
        self._robots: list[RobotScene] = []
        self._shown = 0

    def update(self, snapshot: Snapshot) -> None:
        """Move the ghosts of a snapshot, hide the others."""
        while len(self._robots) < len(snapshot.ghosts):
            i = len(self._robots)
            self._robots.append(
                RobotScene(self._scene, self._parts, f"/ghost_{i}", ghost=GHOSTS[i % len(GHOSTS)])
            )
            self._shown = len(self._robots)
        if len(snapshot.ghosts) != self._shown:
            self._shown = len(snapshot.ghosts)
            for i, robot in enumerate(self._robots):
                robot.show(meshes=i < self._shown, bodies=False)
        for robot, ghost in zip(self._robots, snapshot.ghosts, strict=False):
            robot.update(ghost.base_pose, ghost.q_m, ghost.wheel_angles)


class SceneData:
    """What scenes are drawn from; `update` takes in what is new.

    Attributes:
        loop: Gives the snapshots.
        model: The robot.
        clouds: P_i of every pair of L_m, by the pair's name.
        pairs: Names of all link pairs, in the order of the snapshots.
        mobile: Names of those of L_m.
        parts: The robot's meshes.
        borders: Its borders.
        tracks: Where base and hand have been.
    """

    def __init__(
        self,
        loop: LoopHandle,
        model: RobotModel,
        clouds: Mapping[str, Cloud],
        parts: RobotParts | None = None,
    ) -> None:
        """Load what scenes need.

        Args:
            loop: Has a snapshot already.
            model: The robot of the snapshots.
            clouds: P_i of every pair of L_m, by the pair's name.
            parts: The robot's meshes if they have been read already.
        """
        first = loop.latest()
        self.loop, self.model, self.clouds = loop, model, clouds
        self.pairs = [pair.name for pair in first.pairs]
        self.mobile = [pair.name for pair in first.pairs if pair.mobile]
        self.parts = parts or RobotParts(model)
        self.borders = Borders(model, clouds)
        self.tracks = Tracks()

    def update(self) -> list[Snapshot]:
        """Extend the tracks.

        Returns:
            The new snapshots, or all that are kept if time went back.
        """
        newest, last = self.loop.latest(), self.tracks.last
        new = self.loop.history(last if newest.t >= last else -1.0)
        self.tracks.extend(new, newest.t)
        return new


class Scene:
    """The robot and what explains its motion, without any widget."""

    def __init__(self, scene: viser.SceneApi, data: SceneData, view: View) -> None:
        """Send what does not change.

        Args:
            scene: Of a viewer, or of a server that all see alike.
            data: What is drawn.
            view: What is to be seen; read at each drawing.
        """
        self._scene, self._view = scene, view
        set_lights(scene)
        self.robot = RobotScene(scene, data.parts)
        self._border = BorderCloud(scene, data.borders)
        self._slice = BorderSlice(scene, data.borders, data.mobile)
        self._lines = PairLines(scene, data.pairs)
        self._acting = ActingPoints(scene, data.mobile, data.borders.top)
        self._motion = Motion(scene, data.borders.top, data.model.description.base.axes)
        self._trails = Trails(scene, data.tracks)
        self._ghosts = Ghosts(scene, data.parts)
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
