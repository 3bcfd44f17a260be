"""A refrigerator in pybullet: a free-standing body, a door on a hinge, and the hand's grasp."""

from __future__ import annotations

import tempfile
from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np
import pinocchio as pin

from app.robot.model import RobotModel
from app.simulation.plants.bullet_world import BulletWorld, pybullet
from app.simulation.plants.cabinet import Cabinet
from app.simulation.plants.door import Door, OpenDoor
from app.simulation.plants.interface import Wrench
from app.simulation.plants.silence import silence

Array = np.ndarray

_AWAY = (100.0, 0.0)  # [m] where it is loaded, so that no robot that settles at the origin hits it
_SEAL_STIFFNESS = 2e4  # [N/m] of the door's edge
_SEAL_DAMPING = 500.0  # [N s/m]
_GRASP_FORCE = 1000.0  # [N] that the grasp can hold
_DOOR = 0  # pybullet's index of the door's link, and of its hinge


class BulletDoor:
    """The refrigerator's part of a pybullet plant. Only the base's links can touch the door.

    The hinge has dry friction and no stop. The body stands on the floor by its weight.
    """

    def __init__(self, world: BulletWorld, model: RobotModel, start: OpenDoor) -> None:
        """Put the refrigerator there.

        Args:
            world: The robot's world.
            model: The robot.
            start: The door, and how far it is open when the plant is reset.
        """
        self.door, self._start = start
        self._world = world
        description = model.description
        arm = description.arm
        self._hand = world.links[arm.end_effector_link]
        turn = pin.rpy.rpyToMatrix(*arm.end_effector_rpy_rad)
        self._T_link_ee = pin.SE3(turn, np.array(arm.end_effector_xyz_m))
        self._grasp: int | None = None
        self._cabinet = Cabinet(self.door)
        self.body = self._load()
        self._allow_contacts(description.mobile_body.covers)

    def release(self) -> None:
        """Let go of the door, if the hand holds it."""
        if self._grasp is not None:
            pybullet.removeConstraint(self._grasp, physicsClientId=self._world.client)
            self._grasp = None

    def reset(self) -> None:
        """The refrigerator at its place, its door at rest at the start; the hand takes hold."""
        client = self._world.client
        pose = pin.SE3ToXYZQUAT(self._cabinet.T_world)
        pybullet.resetBasePositionAndOrientation(
            self.body, pose[:3], pose[3:], physicsClientId=client
        )
        pybullet.resetBaseVelocity(self.body, (0, 0, 0), (0, 0, 0), physicsClientId=client)
        turn = -self.door.side * self._start
        pybullet.resetJointState(self.body, _DOOR, turn, 0.0, physicsClientId=client)
        self._take_hold()

    def angle(self) -> float:
        """[rad] how far the door is open."""
        state = pybullet.getJointState(self.body, _DOOR, physicsClientId=self._world.client)
        return -self.door.side * state[0]

    def wrench(self) -> Wrench:
        """What the hand exerted on the door in the last step; a force-torque sensor at the hand."""
        assert self._grasp is not None, "the hand does not hold the door"
        rows = pybullet.getConstraintState(self._grasp, physicsClientId=self._world.client)
        if not rows:  # before the first step
            return Wrench(np.zeros(3), np.zeros(3))
        R = self._hand_pose().rotation
        return Wrench(-np.array(rows[:3]), -R @ np.array(rows[3:]))

    def place(self) -> Array:
        """(3,) [m] the middle of the refrigerator's body."""
        client = self._world.client
        place, _ = pybullet.getBasePositionAndOrientation(self.body, physicsClientId=client)
        return np.array(place)

    def touches_base(self) -> bool:
        """Whether the door touched the mobile robot in the last step."""
        contacts = pybullet.getContactPoints(
            self._world.robot, self.body, linkIndexB=_DOOR, physicsClientId=self._world.client
        )
        return any(c[8] <= 0 or c[9] > 0 for c in contacts)

    def _load(self) -> int:
        client = self._world.client
        with tempfile.TemporaryDirectory(prefix="dbb-") as folder, silence(1):
            path = Path(folder) / "refrigerator.urdf"
            path.write_text(_refrigerator_urdf(self.door, self._cabinet), encoding="utf-8")
            body = pybullet.loadURDF(
                str(path),
                basePosition=(*_AWAY, self._cabinet.T_world.translation[2]),
                flags=pybullet.URDF_USE_INERTIA_FROM_FILE,
                physicsClientId=client,
            )
        pybullet.changeDynamics(
            body,
            _DOOR,
            contactStiffness=_SEAL_STIFFNESS,
            contactDamping=_SEAL_DAMPING,
            physicsClientId=client,
        )
        for i in (-1, _DOOR):
            pybullet.changeDynamics(
                body, i, linearDamping=0, angularDamping=0, jointDamping=0, physicsClientId=client
            )
        pybullet.setJointMotorControl2(
            body,
            _DOOR,
            pybullet.VELOCITY_CONTROL,
            targetVelocity=0.0,
            force=self.door.friction,
            physicsClientId=client,
        )
        return body

    def _allow_contacts(self, mobile_links: Iterable[str]) -> None:
        """Only the mobile robot's links can touch the door; nothing else of the robot does."""
        touching = {self._world.links[name] for name in mobile_links}
        for link in self._world.links.values():
            for part in (-1, _DOOR):
                pybullet.setCollisionFilterPair(
                    self._world.robot,
                    self.body,
                    link,
                    part,
                    int(part == _DOOR and link in touching),
                    physicsClientId=self._world.client,
                )

    def _take_hold(self) -> None:
        """Fix the hand to the door as the two are now; the frames stand at the end-effector."""
        self.release()
        robot, client = self._world.robot, self._world.client
        T_ee = self._hand_pose()
        links = (robot, self._hand), (self.body, _DOOR)
        frames = [pin.SE3ToXYZQUAT(self._com_pose(*link).inverse() * T_ee) for link in links]
        self._grasp = pybullet.createConstraint(
            robot,
            self._hand,
            self.body,
            _DOOR,
            pybullet.JOINT_FIXED,
            [0, 0, 0],
            *(frame[:3].tolist() for frame in frames),
            *(frame[3:].tolist() for frame in frames),
            physicsClientId=client,
        )
        pybullet.changeConstraint(self._grasp, maxForce=_GRASP_FORCE, physicsClientId=client)

    def _com_pose(self, body: int, link: int) -> pin.SE3:
        """Pose of a link's centre of mass, in which pybullet states the frames of a constraint."""
        state = pybullet.getLinkState(
            body, link, computeForwardKinematics=1, physicsClientId=self._world.client
        )
        return pin.XYZQUATToSE3([*state[0], *state[1]])

    def _hand_pose(self) -> pin.SE3:
        link = pybullet.getLinkState(
            self._world.robot,
            self._hand,
            computeForwardKinematics=1,
            physicsClientId=self._world.client,
        )
        return pin.XYZQUATToSE3([*link[4], *link[5]]) * self._T_link_ee


def _refrigerator_urdf(door: Door, cabinet: Cabinet) -> str:
    """A box with a board on a hinge; the root's frame is the centre of the box."""
    return f"""<robot name="refrigerator">
<link name="body">{_box(cabinet.size, cabinet.inertia)}</link>
<link name="door">{_box(door.size, cabinet.door_inertia)}</link>
<joint name="hinge" type="continuous">
<parent link="body"/><child link="door"/>
<origin xyz="{_words(cabinet.T_hinge.translation)}"/><axis xyz="0 0 1"/>
</joint></robot>"""


def _box(size: Sequence[float], inertia: pin.Inertia) -> str:
    moments = zip("xyz", inertia.inertia.diagonal().tolist(), strict=True)
    I = " ".join(f'i{2 * axis}="{i!r}"' for axis, i in moments)
    origin = f'<origin xyz="{_words(inertia.lever)}"/>'
    return f"""<inertial>{origin}<mass value="{inertia.mass!r}"/>
<inertia {I} ixy="0" ixz="0" iyz="0"/></inertial>
<collision>{origin}<geometry><box size="{_words(size)}"/></geometry></collision>"""


def _words(numbers: Sequence[float] | Array) -> str:
    return " ".join(repr(float(number)) for number in numbers)
