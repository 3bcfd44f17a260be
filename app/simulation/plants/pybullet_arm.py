"""The torque-controlled arm in pybullet, the same on every base, and the hand that pulls it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from app.robot.model import RobotModel
from app.simulation.plants.bullet_world import BulletWorld, pybullet
from app.simulation.plants.interface import Push

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
            world.robot,
            self.joints,
            pybullet.VELOCITY_CONTROL,
            forces=[0.0] * len(self.joints),
            physicsClientId=world.client,
        )

    def reset(self, q_m: Array) -> None:
        """Put the arm at rest at joints `q_m`, (n_m,) [rad or m]."""
        for joint, position in zip(self.joints, np.asarray(q_m).tolist(), strict=True):
            pybullet.resetJointState(
                self._world.robot, joint, position, 0.0, physicsClientId=self._world.client
            )

    def drive(self, u_a: Array) -> None:
        """Torques (n_m,) [N m or N] for the next step."""
        pybullet.setJointMotorControlArray(
            self._world.robot,
            self.joints,
            pybullet.TORQUE_CONTROL,
            forces=u_a.tolist(),
            physicsClientId=self._world.client,
        )

    def push(self, force: Array, pushes: Sequence[Push] = ()) -> None:
        """Forces of the world for the next step.

        Args:
            force: (3,) [N] on the end-effector's origin.
            pushes: On other points of the arm.
        """
        self._press(self._hand, self._tool, force)
        for push in pushes:
            self._press(self._world.joints[push.joint], push.p.tolist(), push.force)

    def _press(self, link: int, point: Sequence[float], force: Array) -> None:
        """Force (3,) [N] in the world on a point [m] of a link's frame, which is its joint's."""
        fx, fy, fz = np.asarray(force).tolist()
        if fx == fy == fz == 0.0:
            return
        robot, client = self._world.robot, self._world.client
        # Without fresh kinematics both the point and the lever would be those of a step ago.
        state = pybullet.getLinkState(
            robot, link, computeForwardKinematics=1, physicsClientId=client
        )
        place, _ = pybullet.multiplyTransforms(state[4], state[5], point, (0, 0, 0, 1))
        pybullet.applyExternalForce(
            robot, link, (fx, fy, fz), place, pybullet.WORLD_FRAME, physicsClientId=client
        )
