"""Refrigerator: case, door and handle."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import viser

from app.dashboard.scene.colours import Rgb
from app.dashboard.scene.robot import to_viser
from app.simulation.plants.door import Door
from app.simulation.trace.snapshot import DoorView

_BOARD: Rgb = (225, 228, 232)
_CASE: Rgb = (190, 196, 204)
_HANDLE: Rgb = (70, 76, 84)
_DEPTH = 0.55  # [m] of the case behind the door
_WALL = 0.01  # [m] between door and case
_BAR = 0.30  # [m] length of the handle


class DoorScene:
    """Case, board and handle; nothing while there is no door."""

    def __init__(self, scene: viser.SceneApi) -> None:
        self._scene = scene
        self._door: Door | None = None
        self._root: viser.FrameHandle | None = None
        self._leaf: viser.FrameHandle | None = None

    def update(self, view: DoorView | None) -> None:
        """Turn the door, or put another one up, or none."""
        door = None if view is None else view.door
        if door != self._door:
            self._take_away()
            if door is not None:
                self._put_up(door)
            self._door = door
        if view is not None and self._leaf is not None:
            self._leaf.position, self._leaf.wxyz = to_viser(view.door.pose(view.angle))

    def _take_away(self) -> None:
        if self._root is not None:
            self._root.remove()
            self._root = self._leaf = None

    def _put_up(self, door: Door) -> None:
        scene = self._scene
        self._root = scene.add_frame("/door", show_axes=False)
        self._leaf = scene.add_frame("/door/leaf", show_axes=False)
        scene.add_box("/door/leaf/board", dimensions=door.size, color=_BOARD, position=door.centre)
        handle = door.pose(0.0).actInv(door.handle(0.0)).translation
        scene.add_box(
            "/door/leaf/handle", dimensions=(0.02, 0.02, _BAR), color=_HANDLE, position=handle
        )
        depth = door.thickness / 2 + _WALL + _DEPTH / 2
        T = door.pose(0.0) * pin.SE3(np.eye(3), door.centre + np.array([depth, 0.0, 0.0]))
        position, wxyz = to_viser(T)
        scene.add_box(
            "/door/case",
            dimensions=(_DEPTH, door.width, door.height),
            color=_CASE,
            opacity=0.5,
            position=position,
            wxyz=wxyz,
        )
