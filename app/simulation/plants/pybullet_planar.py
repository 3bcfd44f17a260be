"""The default plant: pybullet with the base on planar joints that follow the drive's velocity.

Velocity motors on x, y and yaw hold the base to the drive with at most the traction of the wheels;
the wheels themselves are only animated. The base cannot tip.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from app.control.drive import Drive
from app.robot.model import RobotModel
from app.robot.state import Measurement
from app.robot.urdf import PLANAR_JOINTS
from app.simulation.plants.bullet_world import BulletWorld, pybullet
from app.simulation.plants.contact_pairs import link_contact_pairs
from app.simulation.plants.door import OpenDoor
from app.simulation.plants.interface import Contacts, Push
from app.simulation.plants.planar import base_twist, world_twist
from app.simulation.plants.pybullet_arm import BulletArm
from app.simulation.plants.pybullet_door import BulletDoor
from app.simulation.plants.pybullet_urdf import planar_plant_urdf

Array = np.ndarray


class PybulletPlanar:
    """`Physics` with an ideal contact of the wheels up to their traction."""

    def __init__(
        self,
        model: RobotModel,
        *,
        dt: float = 0.001,
        outer: Sequence[str] | None = None,
        door: OpenDoor | None = None,
    ) -> None:
        """Load the robot at rest in its ready position.

        Args:
            model: The robot.
            dt: [s] one step.
            outer: Names of the bodies of L_m on the arm; by default all that
                have a reachability.
            door: A door that the hand holds from each reset on, or None.

        Raises:
            AssetError: A mesh is missing, or pybullet cannot load the robot.
            UnknownNameError: `outer` names a body that the arm does not have.
        """
        description, self.dt = model.description, dt
        contacts = link_contact_pairs(description, outer)
        self.world = BulletWorld(planar_plant_urdf(description), dt)
        self.world.allow_contacts(contacts)
        self.arm = BulletArm(self.world, model)
        self.door = None if door is None else BulletDoor(self.world, model, door)
        self._planar = [self.world.joints[name] for name in PLANAR_JOINTS]
        self._joints = [*self._planar, *self.arm.joints]
        self._drive = Drive(description.base, dt)
        self._T = description.base.T
        self._heading: float | None = None  # [rad] as measured since the last step
        traction = description.base.traction_limit_n
        self._limits = [traction, traction, description.base.yaw_limit_nm]
        self.reset(np.zeros(3), np.array(description.arm.ready_position))

    def reset(self, base_pose: Array, q_m: Array) -> None:
        """See `Physics.reset`."""
        if self.door is not None:
            self.door.release()
        self.world.rewind()
        for joint, position in zip(self._planar, np.asarray(base_pose).tolist(), strict=True):
            pybullet.resetJointState(
                self.world.robot, joint, position, 0.0, physicsClientId=self.world.client
            )
        self._heading = None
        self.arm.reset(q_m)
        self._drive.reset()
        if self.door is not None:
            self.door.reset()

    def measure(self) -> Measurement:
        """See `Physics.measure`."""
        states = pybullet.getJointStates(
            self.world.robot, self._joints, physicsClientId=self.world.client
        )
        q = np.array([state[0] for state in states])
        qd = [state[1] for state in states]
        self._heading = heading = states[2][0]
        velocity = self._T.T @ base_twist(qd[:3], heading)
        return Measurement(q[:3], velocity, q[3:], np.array(qd[3:]), self._drive.state.copy())

    def step(
        self, u_a: Array, base_velocity: Array, hand_force: Array, pushes: Sequence[Push] = ()
    ) -> None:
        """See `Physics.step`."""
        velocity = self._drive.step(base_velocity)
        twist = world_twist((self._T @ velocity).tolist(), self._heading_now(), self.dt)
        pybullet.setJointMotorControlArray(
            self.world.robot,
            self._planar,
            pybullet.VELOCITY_CONTROL,
            targetVelocities=twist,
            forces=self._limits,
            physicsClientId=self.world.client,
        )
        self.arm.drive(u_a)
        self.arm.push(hand_force, pushes)
        self.world.step()
        self._heading = None

    def contacts(self) -> Contacts:
        """See `Physics.contacts`."""
        contacts = self.world.contacts()
        if self.door is None:
            return contacts
        return contacts._replace(door_base=self.door.touches_base())

    def close(self) -> None:
        """See `Physics.close`."""
        self.world.close()

    def _heading_now(self) -> float:
        """[rad]; that of the last reading if the base has not moved since."""
        if self._heading is not None:
            return self._heading
        return pybullet.getJointState(
            self.world.robot, self._planar[2], physicsClientId=self.world.client
        )[0]
