"""The torque-controlled arm in pybullet, the same on every base, and the hand that pulls it."""

from __future__ import annotations

import numpy as np

from app.robot.model import RobotModel
from app.simulation.bullet_world import BulletWorld, pybullet

Array = np.ndarray


class BulletArm:
    """The arm's part of a pybullet plant."""

    def __init__(self, world: BulletWorld, model: RobotModel) -> None:
        self._world = world
        arm = model.description.arm
        self.joints = [world.joints[name] for name in arm.joints]
        self._hand = world.links[arm.end_effector_link]
        self._tool = arm.end_effector_xyz_m
        # pybullet puts a holding motor on every joint: torque control needs it off, once.
        pybullet.setJointMotorControlArray(
            world.robot, self.joints, pybullet.VELOCITY_CONTROL, forces=[0.0] * len(self.joints),
            physicsClientId=world.client,
        )  # fmt: skip

    def reset(self, q_m: Array) -> None:
        """Put the arm at rest at joints `q_m`, (n_m,) [rad or m]."""
        for joint, position in zip(self.joints, np.asarray(q_m).tolist(), strict=True):
            pybullet.resetJointState(
                self._world.robot, joint, position, 0.0, physicsClientId=self._world.client
            )

    def drive(self, u_a: Array) -> None:
        """Torques (n_m,) [N m or N] for the next step."""
        pybullet.setJointMotorControlArray(
            self._world.robot, self.joints, pybullet.TORQUE_CONTROL, forces=u_a,
            physicsClientId=self._world.client,
        )  # fmt: skip

    def push(self, force: Array) -> None:
        """Force (3,) [N] of the world on the end-effector's origin for the next step."""
        fx, fy, fz = np.asarray(force).tolist()
        if fx == fy == fz == 0.0:
            return
        robot, client = self._world.robot, self._world.client
        # Without fresh kinematics both the point and the lever would be those of a step ago.
        link = pybullet.getLinkState(
            robot, self._hand, computeForwardKinematics=1, physicsClientId=client
        )
        origin, _ = pybullet.multiplyTransforms(link[4], link[5], self._tool, (0, 0, 0, 1))
        pybullet.applyExternalForce(
            robot, self._hand, (fx, fy, fz), origin, pybullet.WORLD_FRAME, physicsClientId=client
        )
