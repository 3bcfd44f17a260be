"""The high-fidelity plant: pybullet with a free base that rolls on the floor, slips and tips.

Two driven spheres at the half track b carry the base; four frictionless spheres under the wheels
keep it level. So the effective track is b whatever the friction, which four skidding cylinders
would not give. Over its sides the base tips about the driven spheres at ±b, farther out than the
real wheels are.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import pinocchio as pin

from app.control.drive import Drive
from app.robot.description import differential
from app.robot.model import RobotModel
from app.robot.state import Measurement
from app.simulation.bullet_world import GRAVITY, BulletWorld, pybullet
from app.simulation.contact_pairs import link_contact_pairs
from app.simulation.door import OpenDoor
from app.simulation.physics import Contacts, Push
from app.simulation.pybullet_arm import BulletArm
from app.simulation.pybullet_door import BulletDoor
from app.simulation.pybullet_urdf import CASTERS, DRIVE_SPHERES, contact_plant_urdf

Array = np.ndarray

_LOAD_RESERVE = 2.0
"""[-] Friction of the driven spheres over that of the traction limit under the whole weight.

A pull at the hand shifts weight onto the casters, where a real base would have driven wheels too.
Along the base the motors' torque holds the traction limit, across it the friction does.
"""
_SETTLING_TIME = 0.2  # [s] for the base to sink onto its spheres after a reset
_BRAKE_TORQUE = 1e4  # [N m] that holds the arm meanwhile


class PybulletContact:
    """`Physics` with wheels that push on the floor."""

    def __init__(
        self, model: RobotModel, *, dt: float = 0.001, outer: Sequence[str] | None = None,
        door: OpenDoor | None = None,
    ) -> None:  # fmt: skip
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
        base = differential(description)
        contacts = link_contact_pairs(description, outer)
        self.world = BulletWorld(contact_plant_urdf(model), dt, fixed_root=False)
        wheels = {*base.left_wheel_joints, *base.right_wheel_joints}
        hull = set(description.mobile_body.covers) - self._children(wheels)
        self.world.allow_contacts(contacts, on_floor=(*DRIVE_SPHERES, *CASTERS, *hull))
        self.arm = BulletArm(self.world, model)
        self.door = None if door is None else BulletDoor(self.world, model, door)
        self._spheres = [self.world.joints[name] for name in DRIVE_SPHERES]
        self._joints = [*self._spheres, *self.arm.joints]
        self._drive = Drive(description.base, dt)
        self._rolling = model.J_m_inv
        self._torque_limits = [0.5 * base.traction_limit_n * base.wheel_radius_m] * 2  # [N m]
        weight = GRAVITY * pin.computeTotalMass(model.pin)  # [N]
        self._set_friction(_LOAD_RESERVE * base.traction_limit_n / weight)
        info = pybullet.getDynamicsInfo(self.world.robot, -1, physicsClientId=self.world.client)
        self._root_to_com = pin.XYZQUATToSE3([*info[3], *info[4]])
        self._com_to_root = pybullet.invertTransform(info[3], info[4])
        self.reset(np.zeros(3), np.array(description.arm.ready_position))

    @property
    def wheel_angles(self) -> Array:
        """(2,) [rad] of the right and the left side."""
        return self._sphere_angles() - self._angles_at_reset

    def reset(self, base_pose: Array, q_m: Array) -> None:
        """See `Physics.reset`; the base stands on its spheres as the arm's weight tilts it."""
        if self.door is not None:
            self.door.release()
        self.world.rewind()
        self._drive.reset()
        self.arm.reset(q_m)
        self._place(pin.SE3.Identity())
        self._settle()
        x, y, phi = np.asarray(base_pose).tolist()
        settled = self._pose()
        turn = pin.rpy.rpyToMatrix(0.0, 0.0, phi - self.measure().base_pose[2])
        self._place(pin.SE3(turn @ settled.rotation, np.array([x, y, settled.translation[2]])))
        self.arm.reset(q_m)
        self._angles_at_reset = self._sphere_angles()
        if self.door is not None:
            self.door.reset()

    def measure(self) -> Measurement:
        """See `Physics.measure`; the pose of the root link, seen from above."""
        robot, client = self.world.robot, self.world.client
        com, turn = pybullet.getBasePositionAndOrientation(robot, physicsClientId=client)
        (vx, vy, _), (wx, wy, wz) = pybullet.getBaseVelocity(robot, physicsClientId=client)
        (x, y, z), turn = pybullet.multiplyTransforms(com, turn, *self._com_to_root)
        rx, ry, rz = x - com[0], y - com[1], z - com[2]
        vx, vy = vx + wy * rz - wz * ry, vy + wz * rx - wx * rz  # of the root's origin
        phi = _heading(turn)
        states = pybullet.getJointStates(robot, self.arm.joints, physicsClientId=client)
        return Measurement(
            np.array([x, y, phi]),
            np.array([math.cos(phi) * vx + math.sin(phi) * vy, wz]),
            np.array([state[0] for state in states]),
            np.array([state[1] for state in states]),
        )

    def step(
        self, u_a: Array, base_velocity: Array, hand_force: Array, pushes: Sequence[Push] = ()
    ) -> None:
        """See `Physics.step`."""
        wheels = self._rolling @ self._drive.step(base_velocity)
        pybullet.setJointMotorControlArray(
            self.world.robot, self._spheres, pybullet.VELOCITY_CONTROL,
            targetVelocities=wheels, forces=self._torque_limits,
            physicsClientId=self.world.client,
        )  # fmt: skip
        self.arm.drive(u_a)
        self.arm.push(hand_force, pushes)
        self.world.step()

    def tilt(self) -> float:
        """[rad] angle between the base's vertical axis and the world's; 0 stands level."""
        return math.acos(min(1.0, self._pose().rotation[2, 2]))

    def contacts(self) -> Contacts:
        """See `Physics.contacts`."""
        contacts = self.world.contacts()
        if self.door is None:
            return contacts
        return contacts._replace(door_base=self.door.touches_base())

    def close(self) -> None:
        """See `Physics.close`."""
        self.world.close()

    def _children(self, joints: set[str]) -> set[str]:
        """Links that hang on these joints."""
        indices = {self.world.joints[name] for name in joints}
        return {link for link, index in self.world.links.items() if index in indices}

    def _set_friction(self, mu: float) -> None:
        """Friction of the driven spheres on the floor; pybullet multiplies both sides'."""
        robot, client = self.world.robot, self.world.client
        pybullet.changeDynamics(self.world.floor, -1, lateralFriction=1.0, physicsClientId=client)
        for names, value in ((DRIVE_SPHERES, mu), (CASTERS, 0.0)):
            for name in names:
                pybullet.changeDynamics(
                    robot, self.world.links[name], lateralFriction=value, physicsClientId=client
                )

    def _settle(self) -> None:
        robot, client, n = self.world.robot, self.world.client, len(self._joints)
        hold = {"targetVelocities": [0.0] * n, "physicsClientId": client}
        forces = [*self._torque_limits, *[_BRAKE_TORQUE] * (n - 2)]
        pybullet.setJointMotorControlArray(
            robot, self._joints, pybullet.VELOCITY_CONTROL, forces=forces, **hold
        )
        for _ in range(math.ceil(_SETTLING_TIME / self.dt)):
            self.world.step()
        pybullet.setJointMotorControlArray(
            robot, self._joints, pybullet.VELOCITY_CONTROL, forces=[0.0] * n, **hold
        )

    def _place(self, pose: pin.SE3) -> None:
        """Put the root link at rest at a pose."""
        x = pin.SE3ToXYZQUAT(pose * self._root_to_com)
        pybullet.resetBasePositionAndOrientation(
            self.world.robot, x[:3], x[3:], physicsClientId=self.world.client
        )
        pybullet.resetBaseVelocity(
            self.world.robot, (0, 0, 0), (0, 0, 0), physicsClientId=self.world.client
        )
        for joint in self._spheres:
            pybullet.resetJointState(
                self.world.robot, joint, 0.0, 0.0, physicsClientId=self.world.client
            )

    def _pose(self) -> pin.SE3:
        position, xyzw = pybullet.getBasePositionAndOrientation(
            self.world.robot, physicsClientId=self.world.client
        )
        return pin.XYZQUATToSE3([*position, *xyzw]) * self._root_to_com.inverse()

    def _sphere_angles(self) -> Array:
        states = pybullet.getJointStates(
            self.world.robot, self._spheres, physicsClientId=self.world.client
        )
        return np.array([state[0] for state in states])


def _heading(xyzw: Sequence[float]) -> float:
    """[rad] angle of the x axis of an orientation, seen from above."""
    x, y, z, w = xyzw
    return math.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))
