"""A refrigerator in MuJoCo: a free-standing body, a door on a hinge, and the hand's grasp."""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np
import pinocchio as pin

from app.simulation.plants.cabinet import Cabinet
from app.simulation.plants.door import OpenDoor
from app.simulation.plants.interface import Wrench
from app.simulation.plants.mujoco_robot import RobotSpec
from app.simulation.plants.mujoco_spec import FLOOR
from app.simulation.plants.mujoco_world import MujocoWorld

Array = np.ndarray

_AWAY = 100.0  # [m] where it waits while a base settles on its wheels
_SEAL = 0.02, 1.0  # [s] time constant and [-] damping ratio of the door's edge
_GRASP: dict[str, Any] = {"solref": [0.002, 1.0], "solimp": [0.999, 0.9999, 0.001, 0.5, 2.0]}
_BODY, _DOOR, _HINGE, _GRIP = "refrigerator", "door", "hinge", "grip"


class MujocoDoor:
    """The refrigerator's part of a plant in MuJoCo. Only the base's links can touch the door.

    The hinge has dry friction and no stop. The hand is welded to a body without mass that is fixed
    to the door; between the two a sensor of force and torque stands at the end-effector.
    """

    def __init__(self, robot: RobotSpec, start: OpenDoor) -> None:
        """Add it to a specification whose motors are complete.

        Args:
            robot: The specification.
            start: The door, and how far it is open when the hand takes hold.
        """
        self.door, self._start = start
        self._cabinet = cabinet = Cabinet(self.door)
        source = robot.model.pin
        tool = source.frames[robot.model.ee_frame]
        self._hand, self._tool = source.names[tool.parentJoint], tool.placement.translation.copy()
        box = mujoco.mjtGeom.mjGEOM_BOX
        body = robot.add_body(robot.spec.worldbody, _BODY, cabinet.T_world, cabinet.inertia)
        body.add_freejoint(name=_BODY)
        robot.add_geom(body, _BODY, box, np.array(cabinet.size) / 2)
        door = robot.add_body(body, _DOOR, cabinet.T_hinge, cabinet.door_inertia)
        door.add_joint(
            name=_HINGE,
            type=mujoco.mjtJoint.mjJNT_HINGE,
            axis=[0, 0, 1],
            **robot.friction(self.door.friction),
        )
        robot.add_geom(door, _DOOR, box, np.array(self.door.size) / 2, cabinet.T_centre)
        robot.allow(None, [FLOOR], [_BODY])
        robot.allow("door_base", [_DOOR], robot.geoms(*robot.mobile), firmness=_SEAL)
        robot.add_body(door, _GRIP, pin.SE3.Identity(), pin.Inertia.Zero()).add_site(name=_GRIP)
        robot.spec.add_equality(
            name=_GRIP,
            type=mujoco.mjtEq.mjEQ_WELD,
            objtype=mujoco.mjtObj.mjOBJ_BODY,
            name1=self._hand,
            name2=_GRIP,
            **_GRASP,
        )
        for kind in (mujoco.mjtSensor.mjSENS_FORCE, mujoco.mjtSensor.mjSENS_TORQUE):
            robot.spec.add_sensor(type=kind, objtype=mujoco.mjtObj.mjOBJ_SITE, objname=_GRIP)

    def put_away(self, world: MujocoWorld) -> None:
        """Far off, and nobody holds it."""
        world.data.eq_active[0] = 0
        world.data.joint(_BODY).qpos[0] += _AWAY

    def take_hold(self, world: MujocoWorld) -> None:
        """The refrigerator at its place, its door at rest at the start; the hand takes hold."""
        model, data = world.model, world.data
        self._data = data
        data.joint(_BODY).qpos[:] = pin.SE3ToXYZQUAT(self._cabinet.T_world)[[0, 1, 2, 6, 3, 4, 5]]
        data.joint(_BODY).qvel[:] = 0.0
        data.joint(_HINGE).qpos[0] = -self.door.side * self._start
        data.joint(_HINGE).qvel[0] = 0.0
        data.eq_active[0] = 1
        mujoco.mj_kinematics(model, data)
        hand, grip = (_placement(data.body(name)) for name in (self._hand, _GRIP))
        p_grip = grip.actInv(hand.act(self._tool))
        sensor = model.site(_GRIP).id
        model.site_pos[sensor], model.site_sameframe[sensor] = p_grip, 0
        between = pin.Quaternion(hand.rotation.T @ grip.rotation).coeffs()[[3, 0, 1, 2]]
        model.eq_data[0, :10] = [*p_grip, *self._tool, *between]

    def angle(self) -> float:
        """[rad] how far the door is open."""
        return -self.door.side * float(self._data.joint(_HINGE).qpos[0])

    def place(self) -> Array:
        """(3,) [m] the middle of the refrigerator's body."""
        return self._data.joint(_BODY).qpos[:3].copy()

    def wrench(self) -> Wrench:
        """What the hand exerted on the door in the last step; a force-torque sensor at the hand."""
        R = self._data.site(_GRIP).xmat.reshape(3, 3)
        read = self._data.sensordata  # of the door on what holds it
        return Wrench(-R @ read[:3], -R @ read[3:])


def _placement(body: Any) -> pin.SE3:
    return pin.SE3(body.xmat.reshape(3, 3).copy(), body.xpos.copy())
