"""The robot's dynamics as pybullet computes them, in the coordinates of the controller."""

from __future__ import annotations

import numpy as np

from app.robot.model import RobotModel
from app.robot.urdf import PLANAR_JOINTS
from app.simulation.plants.bullet_world import BulletWorld, pybullet
from app.simulation.plants.planar import reduced_dynamics
from app.simulation.plants.pybullet_urdf import planar_plant_urdf

Array = np.ndarray


class BulletDynamics:
    """Mass matrix and bias forces of the robot on a planar root, with the base facing +x."""

    def __init__(self, model: RobotModel) -> None:
        """Load a robot.

        Raises:
            AssetError: A mesh is missing, or pybullet cannot load the robot.
        """
        self._model = model
        self._world = BulletWorld(planar_plant_urdf(model.description), 0.001)
        names = (*PLANAR_JOINTS, *model.description.arm.joints)
        self._joints = [self._world.joints[name] for name in names]
        moving = [
            i
            for i in sorted(self._world.joints.values())
            if pybullet.getJointInfo(self._world.robot, i, physicsClientId=self._world.client)[3]
            > -1
        ]
        self._order = [moving.index(joint) for joint in self._joints]

    def mass_and_bias(self, q_m: Array, qd: Array) -> tuple[Array, Array]:
        """M (n, n) and C q̇ + g (n,) of (26).

        Args:
            q_m: (n_m,) [rad or m] the arm's joints.
            qd: (n,) reduced velocity q̇.
        """
        S, world = self._model.S, self._world
        q = np.concatenate([np.zeros(3), q_m])
        v = S @ qd  # at heading 0 the base's own axes are the world's
        ordered = np.empty((2, len(q)))
        ordered[:, self._order] = q, v
        M = np.array(
            pybullet.calculateMassMatrix(
                world.robot, ordered[0].tolist(), physicsClientId=world.client
            )
        )
        nle = np.array(
            pybullet.calculateInverseDynamics(
                world.robot,
                ordered[0].tolist(),
                ordered[1].tolist(),
                [0.0] * len(q),
                physicsClientId=world.client,
            )
        )
        return reduced_dynamics(S, M[np.ix_(self._order, self._order)], nle[self._order], v)

    def close(self) -> None:
        """End pybullet's client."""
        self._world.close()
