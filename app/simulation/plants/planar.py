"""The planar plant, with pybullet or MuJoCo: motors of limited force move planar joints."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Literal

import numpy as np

from app.robot.model import RobotModel
from app.robot.state import Measurement
from app.simulation.plants.door import OpenDoor
from app.simulation.plants.interface import Contacts, Drive, Physics, Push
from app.strict import Array

if TYPE_CHECKING:
    from app.simulation.plants.bullet_world import BulletRobot
    from app.simulation.plants.mujoco_world import MujocoWorld


class Planar(Physics):
    """The plant whose base cannot tip; traction limits the motors of its joints x, y and yaw."""

    def __init__(
        self,
        engine: Literal["pybullet", "mujoco"],
        model: RobotModel,
        *,
        dt: float = 0.001,
        door: OpenDoor | None = None,
    ) -> None:
        """Load the robot into an engine; arguments, posture and errors as in `make_physics`."""
        # Imported here, because each engine must work without the other engine's library.
        if engine == "pybullet":
            from app.simulation.plants.bullet_world import BulletRobot

            self.world: BulletRobot | MujocoWorld = BulletRobot(model, dt, door)
        else:
            from app.simulation.plants.mujoco_world import MujocoWorld, RobotSpec

            self.world = MujocoWorld(RobotSpec(model, dt), door)
        self.dt, self.door, self._S = dt, self.world.door, model.S
        base = model.description.base
        self._drive, self._T = Drive(base, dt), base.T
        self.reset(np.zeros(3), np.array(model.description.arm.ready_position))

    def reset(self, base_pose: Array, q_m: Array) -> None:
        self.world.reset(np.concatenate([base_pose, q_m]))
        self._drive.reset()
        self._heading: float | None = None  # [rad] heading, if measured since the last step

    def measure(self) -> Measurement:
        pose, v, q_m, qd_m = self.world.read()
        self._heading = heading = pose.item(2)
        c, s = math.cos(heading), math.sin(heading)
        x, y, w = v
        velocity = np.array([c * x + s * y, c * y - s * x, w]) @ self._T
        return Measurement(pose, velocity, q_m, qd_m, self._drive.state)

    def step(
        self, u_a: Array, base_velocity: Array, hand_force: Array, pushes: Sequence[Push] = ()
    ) -> None:
        heading = self.world.read()[0].item(2) if self._heading is None else self._heading
        twist = (self._T @ self._drive.step(base_velocity)).tolist()
        self.world.step(u_a, world_twist(twist, heading, self.dt), hand_force, pushes)
        self._heading = None

    def contacts(self) -> Contacts:
        return self.world.contacts()

    def mass_and_bias(self, q_m: Array, qd: Array) -> tuple[Array, Array]:
        """M (n, n) and C q̇ + g (n,) of (26) from the engine, at q_m and q̇, with the heading 0."""
        S, v = self._S, self._S @ qd  # at heading 0 the axes of base and world coincide
        M, h = self.world.mass_and_bias(np.concatenate([np.zeros(3), q_m]), v)
        # The world's axes do not turn with the base: v̇ = S q̈ + (-ω v_y, ω v_x, 0).
        turning = np.array([-v[2] * v[1], v[2] * v[0], *np.zeros(len(q_m) + 1)])
        return S.T @ M @ S, S.T @ (h + M @ turning)

    def close(self) -> None:
        self.world.close()


def world_twist(twist: Sequence[float], heading: float, dt: float) -> list[float]:
    """The base's `twist` during a step, v_x, v_y [m/s] and ω [rad/s], in the axes of the world at
    the heading in the middle of the step. `twist` is constant in the base's frame, `heading` [rad]
    the base's heading at the start of the step of `dt` [s].
    """
    x, y, w = twist
    phi = heading + 0.5 * w * dt
    c, s = math.cos(phi), math.sin(phi)
    return [x * c - y * s, x * s + y * c, w]
