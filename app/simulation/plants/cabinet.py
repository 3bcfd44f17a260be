"""The refrigerator that carries a door, as every engine builds it."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from app.simulation.plants.door import Door

_MASS = 60.0  # [kg]
_DEPTH = 0.60  # [m]
_GAP = 0.005  # [m] between the body and the closed door
_SINKING = 1e-5  # [m] of the body into the floor, where the engines let it rest


class Cabinet:
    """A box that stands on the floor by its weight; the frame is its centre's.

    Attributes:
        size: [m] depth, width and height.
        inertia: Of the box.
        T_world: Its pose.
        T_hinge: Pose of the closed door's frame in that of the box.
        T_centre: Pose of the board's centre in the door's frame.
        door_inertia: Of the door, in the door's frame.
    """

    def __init__(self, door: Door) -> None:
        """Put it behind a closed door."""
        height = door.bottom + door.height
        self.size = _DEPTH, door.width, height
        self.inertia = pin.Inertia.FromBox(_MASS, *self.size)
        back = door.thickness / 2 + _GAP + _DEPTH / 2
        self.T_world = door.pose(0.0) * pin.SE3(
            np.eye(3), np.array([back, door.centre[1], height / 2 - _SINKING])
        )
        self.T_hinge = self.T_world.inverse() * door.pose(0.0)
        self.T_centre = pin.SE3(np.eye(3), door.centre)
        self.door_inertia = self.T_centre.act(pin.Inertia.FromBox(door.mass, *door.size))
