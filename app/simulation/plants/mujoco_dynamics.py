"""The robot's dynamics as MuJoCo computes them, in the coordinates of the controller."""

from __future__ import annotations

import mujoco
import numpy as np

from app.robot.model import RobotModel
from app.simulation.plants.mujoco_robot import RobotSpec
from app.simulation.plants.mujoco_world import MujocoWorld
from app.simulation.plants.planar import reduced_dynamics

Array = np.ndarray


class MujocoDynamics:
    """Mass matrix and bias forces of the robot on a planar root, with the base facing +x."""

    def __init__(self, model: RobotModel) -> None:
        """Compile a robot."""
        self._S = model.S
        self._world = MujocoWorld(RobotSpec(model, 0.001, None))

    def mass_and_bias(self, q_m: Array, qd: Array) -> tuple[Array, Array]:
        """M (n, n) and C q̇ + g (n,) of (26).

        Args:
            q_m: (n_m,) [rad or m] the arm's joints.
            qd: (n,) reduced velocity q̇.
        """
        world, v = self._world, self._S @ qd  # at heading 0 the base's own axes are the world's
        world.rewind()
        world.q[world.arm_q], world.v[:] = q_m, v
        mujoco.mj_forward(world.model, world.data)
        return reduced_dynamics(self._S, world.mass_matrix(), world.data.qfrc_bias, v)

    def close(self) -> None:
        """As that of pybullet; nothing is to be released."""
