"""The robots of other controllers, translucent, beside the real one."""

from __future__ import annotations

import viser

from app.dashboard.scene.colours import GHOSTS
from app.dashboard.scene.robot import RobotParts, RobotScene
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
