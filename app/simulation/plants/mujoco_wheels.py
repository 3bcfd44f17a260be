"""The high-fidelity plant: MuJoCo with a free base on its own wheels, that roll, slip and tip.

A skid-steer base stands on all its wheels, each driven, each with the same friction along and
across. How far apart it acts as if they were is the balance of their drags, which depends on the
load that each carries: the base turns once on the spot when it is made, and its drive is calibrated
by that. A base with two wheels stands on casters too, which are frictionless and give a little:
the spheres at the floor that the URDF has, or else four corners.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import pinocchio as pin

from app.control.drive import Drive
from app.robot.bases.differential import mobile_jacobian
from app.robot.description import differential
from app.robot.model import RobotModel
from app.robot.state import Measurement
from app.simulation.plants.door import OpenDoor
from app.simulation.plants.interface import Contacts, Push
from app.simulation.plants.mujoco_door import MujocoDoor
from app.simulation.plants.mujoco_robot import RobotSpec
from app.simulation.plants.mujoco_stand import add_casters_and_hull, add_wheels
from app.simulation.plants.mujoco_world import MujocoWorld
from app.simulation.plants.wheels import Wheels

Array = np.ndarray

_SETTLING_TIME = 0.3  # [s] for the base to sink onto its wheels after a reset
_FROZEN = 1e6  # [kg m²] armature of the arm's joints meanwhile
_TURNING = 1.0  # [s] of the calibration's turn, of which the last half counts
_TURN_RATE = 0.4  # [rad/s]


class MujocoWheels:
    """`Physics` with wheels that push on the floor."""

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
            model: The robot, on a differential base.
            dt: [s] one step.
            outer: Names of the bodies of L_m on the arm; by default all that
                have a reachability.
            door: A door that the hand holds from each reset on, or None.

        Raises:
            UnknownNameError: `outer` names a body that the arm does not have.
        """
        description, self.dt = model.description, dt
        self.wheels = wheels = Wheels(model)
        root = wheels.root_without(model.pin.inertias[1])
        robot = RobotSpec(model, dt, outer, free_root=root)
        add_wheels(robot, wheels, differential(description))
        add_casters_and_hull(robot, wheels)
        self.door = None if door is None else MujocoDoor(robot, door)
        self.world = MujocoWorld(robot)
        self._drive = Drive(description.base, dt)
        turning = [self.world.model.joint(name).qposadr[0] for name in robot.motors]
        self._angles = np.array(turning)
        self._calibrate(differential(description).half_track_m)
        ready = np.array(description.arm.ready_position)
        self.reset(np.zeros(3), ready)
        if wheels.spans:
            self._calibrate(self._turned_half_track())
            self.reset(np.zeros(3), ready)

    @property
    def wheel_angles(self) -> Array:
        """(2,) [rad] of the right and the left side, on average."""
        angles, right = self.world.q[self._angles], self.wheels.right
        return np.array([angles[right].mean(), angles[~right].mean()])

    def reset(self, base_pose: Array, q_m: Array) -> None:
        """See `Physics.reset`; the base stands on its wheels as the arm's weight tilts it."""
        world = self.world
        world.rewind()
        self._drive.reset()
        if self.door is not None:
            self.door.put_away(world)
        world.q[world.arm_q] = q_m
        self._frozen(math.ceil(_SETTLING_TIME / self.dt), [0.0] * len(self._rolling))
        x, y, phi = np.asarray(base_pose).tolist()
        settled, z = self._turn(), world.q[2]
        level = pin.rpy.rpyToMatrix(0.0, 0.0, phi - _heading(settled)) @ settled
        world.rewind()
        world.q[:7] = x, y, z, *pin.Quaternion(level).coeffs()[[3, 0, 1, 2]]
        world.q[world.arm_q] = q_m
        if self.door is not None:
            self.door.take_hold(world)

    def measure(self) -> Measurement:
        """See `Physics.measure`; the pose of the root link, seen from above."""
        world = self.world
        q, v = world.q.copy(), world.v.copy()
        R = self._turn()
        phi, turning = _heading(R), float(R[2] @ v[3:6])
        forward = math.cos(phi) * v[0] + math.sin(phi) * v[1]
        return Measurement(
            np.array([q[0], q[1], phi]),
            np.array([forward, turning]),
            q[world.arm_q],
            v[world.arm_v],
        )

    def step(
        self, u_a: Array, base_velocity: Array, hand_force: Array, pushes: Sequence[Push] = ()
    ) -> None:
        """See `Physics.step`."""
        speeds = (self._rolling @ self._drive.step(base_velocity)).tolist()
        self.world.step(u_a, speeds, hand_force, pushes)

    def tilt(self) -> float:
        """[rad] angle between the base's vertical axis and the world's; 0 stands level."""
        return math.acos(min(1.0, self._turn()[2, 2]))

    def contacts(self) -> Contacts:
        """See `Physics.contacts`."""
        return self.world.contacts()

    def close(self) -> None:
        """See `Physics.close`."""

    def _turn(self) -> Array:
        """(3, 3) orientation of the root."""
        w, x, y, z = self.world.q[3:7]
        return pin.Quaternion(w, x, y, z).toRotationMatrix()

    def _calibrate(self, half_track: float) -> None:
        """Turn the wheels as those at a half track [m] have to."""
        self.half_track = half_track
        right, left = np.linalg.inv(mobile_jacobian(self.wheels.radius, half_track))
        self._rolling = np.array([right if is_right else left for is_right in self.wheels.right])

    def _turned_half_track(self) -> float:
        """[m] the half track that a turn on the spot shows."""
        steps = math.ceil(_TURNING / self.dt)
        speeds = (self._rolling @ [0.0, _TURN_RATE]).tolist()
        rates = self._frozen(steps, speeds)[steps // 2 :]
        return self.half_track * _TURN_RATE / float(np.mean(rates))

    def _frozen(self, steps: int, speeds: Sequence[float]) -> list[float]:
        """Turn the wheels while the arm stands still; the base's rates [rad/s] at each step."""
        world = self.world
        armature, rates = world.model.dof_armature[world.arm_v], []
        armature[:] = _FROZEN
        for _ in range(steps):
            world.step(np.zeros(len(armature)), speeds, np.zeros(3))
            rates.append(float(world.v[5]))
        armature[:] = 0.0
        return rates


def _heading(R: Array) -> float:
    """[rad] angle of the x axis of an orientation, seen from above."""
    return math.atan2(R[1, 0], R[0, 0])
