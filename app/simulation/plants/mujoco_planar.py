"""The planar plant in MuJoCo: the base on planar joints that follow the drive's velocity.

Motors on x, y and yaw hold the base to the drive with at most the traction of the wheels; the
wheels themselves are only animated. The base cannot tip.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from app.control.drive import Drive
from app.robot.model import RobotModel
from app.robot.state import Measurement
from app.simulation.plants.door import OpenDoor
from app.simulation.plants.interface import Contacts, Push
from app.simulation.plants.mujoco_door import MujocoDoor
from app.simulation.plants.mujoco_robot import RobotSpec
from app.simulation.plants.mujoco_world import MujocoWorld
from app.simulation.plants.planar import base_twist, world_twist

Array = np.ndarray


class MujocoPlanar:
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
            UnknownNameError: `outer` names a body that the arm does not have.
        """
        description, self.dt = model.description, dt
        robot = RobotSpec(model, dt, outer)
        self.door = None if door is None else MujocoDoor(robot, door)
        self.world = MujocoWorld(robot)
        self._drive = Drive(description.base, dt)
        self._T, self._T_t = description.base.T, description.base.T.T.copy()
        self.reset(np.zeros(3), np.array(description.arm.ready_position))

    def reset(self, base_pose: Array, q_m: Array) -> None:
        """See `Physics.reset`."""
        world = self.world
        world.rewind()
        world.q[:3] = base_pose
        world.q[world.arm_q] = q_m
        self._drive.reset()
        if self.door is not None:
            self.door.take_hold(world)

    def measure(self) -> Measurement:
        """See `Physics.measure`."""
        world = self.world
        q, v = world.q.copy(), world.v.copy()
        velocity = self._T_t.dot(base_twist(v[:3].tolist(), q.item(2)))
        return Measurement(
            q[:3], velocity, q[world.arm_q], v[world.arm_v], self._drive.state.copy()
        )

    def step(
        self, u_a: Array, base_velocity: Array, hand_force: Array, pushes: Sequence[Push] = ()
    ) -> None:
        """See `Physics.step`."""
        velocity = self._drive.step(base_velocity)
        twist = world_twist(self._T.dot(velocity).tolist(), self.world.q.item(2), self.dt)
        self.world.step(u_a, twist, hand_force, pushes)

    def contacts(self) -> Contacts:
        """See `Physics.contacts`."""
        return self.world.contacts()

    def close(self) -> None:
        """See `Physics.close`."""
