"""The high-fidelity plant: MuJoCo with wheels that roll and slip, and a free base that can tip.

All wheels are driven, and have the same friction along and across. A base with wheels on several
axles is skid-steered; a turn on the spot at the start calibrates its drive, because the effective
track depends on the load of each wheel. A base with all wheels on one axle also stands on casters,
frictionless and slightly soft: the spheres at the floor in the URDF, or one at each corner.
"""

import math
from collections.abc import Sequence
from itertools import product
from typing import Any

import coal
import mujoco
import numpy as np
import pinocchio as pin

from app.border.mobile import MobileBody
from app.robot.assets import bare_urdf
from app.robot.bases.differential import DifferentialBase, mobile_jacobian
from app.robot.description import differential
from app.robot.model import RobotModel
from app.robot.state import Measurement
from app.simulation.plants.collision_shapes import FLOOR
from app.simulation.plants.door import OpenDoor
from app.simulation.plants.interface import GRAVITY, Contacts, Drive, Physics, Push
from app.simulation.plants.mujoco_world import MujocoWorld, RobotSpec
from app.strict import Array

_TREAD = 0.25  # [-] half width of a wheel in radii; the ellipsoid touches the floor in one point
_LOAD_RESERVE = 2.0
"""[-] factor of the wheels' friction, because casters carry a part of the weight; without casters,
factor of each motor's torque limit, relative to an equal share of the traction limit."""
_SPRING = [0.02, 1.0]  # [s] time constant and [-] damping ratio of casters and sliding tyres
_TYRE: dict[str, Any] = {
    "solref": _SPRING,
    "solimp": [0.5, 0.5, 0.001, 0.5, 2.0],
    "solreffriction": [0.2, 1.0],
}
"""A tyre that deforms by about a millimetre, and whose friction has a time constant of 0.2 s. With
stiffer contacts and faster friction in MuJoCo, the wheels would hop in turns of the base."""
_AT_FLOOR = 0.01  # [m] a shape of the base that reaches down to this height counts as on the floor
_MIN_MASS = 0.005  # [-] assumed mass of a wheel without a mass, relative to the base's mass
_SETTLING_TIME = 0.3  # [s] time in which the base sinks onto its wheels after a reset
_FROZEN = 1e6  # [kg m²] armature that fixes the arm's joints
_TURNING = 1.0  # [s] duration of the calibrating turn; the second half is evaluated
_TURN_RATE = 0.4  # [rad/s] commanded rate of the calibrating turn


class Wheels:
    """The driven wheels in the frame of the root link; the origin of this frame is on the floor."""

    def __init__(self, model: RobotModel) -> None:
        """Read the wheels from the URDF; if the description names none, assume one on each side."""
        base = differential(model.description)
        self.radius = r = base.wheel_radius_m
        full = pin.buildModelFromXML(bare_urdf(model.description))
        data = full.createData()
        pin.forwardKinematics(full, data, pin.neutral(full))
        ids = [full.getJointId(n) for n in (*base.right_wheel_joints, *base.left_wheel_joints)]
        moved = [frame for frame in full.frames if frame.parentJoint in ids]
        # Names of the links that turn with the wheels.
        self.links = {frame.name for frame in moved if frame.type == pin.FrameType.BODY}
        places = [data.oMi[i].translation[:2] for i in ids]
        places = places or [(0.0, -base.half_track_m), (0.0, base.half_track_m)]
        self.centres = np.array([[x, y, r] for x, y in places])  # (n, 3) [m]
        self.right = self.centres[:, 1] < 0.0  # (n,) whether each wheel is on the right side
        own = [pin.SE3(data.oMi[i].rotation, np.zeros(3)).act(full.inertias[i]) for i in ids]
        small = pin.Inertia.FromSphere(_MIN_MASS * model.pin.inertias[1].mass, r)
        # Inertias in frames at the wheels' centres, with the root's axes.
        self.inertias = [I if I.mass > 0.0 else small for I in own] or [small] * len(places)
        self.root = model.pin.inertias[1]  # inertia of the root without the wheels
        for centre, inertia in zip(self.centres, self.inertias, strict=True):
            self.root = self.root - pin.SE3(np.eye(3), centre).act(inertia)
        self.spans = bool(np.ptp(self.centres[:, 0]) > r)  # whether it needs no casters


class MujocoWheels(Physics):
    """A plant whose wheels drive the base by friction on the floor."""

    def __init__(
        self, model: RobotModel, *, dt: float = 0.001, door: OpenDoor | None = None
    ) -> None:
        """Load a robot with a differential base in its ready posture; see `make_physics`."""
        description, self.dt = model.description, dt
        self.wheels = wheels = Wheels(model)
        robot = RobotSpec(model, dt, free_root=wheels.root)
        _add_wheels(robot, wheels, differential(description))
        _add_casters_and_hull(robot, wheels)
        self.world = MujocoWorld(robot, door)
        self.door = self.world.door
        self._drive = Drive(description.base, dt)
        self._calibrate(differential(description).half_track_m)
        ready = np.zeros(3), np.array(description.arm.ready_position)
        if wheels.spans:
            self._stand(*ready)
            steps = math.ceil(_TURNING / dt)
            turning = self._frozen(steps, (self._rolling @ [0.0, _TURN_RATE]).tolist())
            measured = float(np.mean(turning[steps // 2 :]))
            self._calibrate(self.half_track * _TURN_RATE / measured)
        self.reset(*ready)

    def reset(self, base_pose: Array, q_m: Array) -> None:
        """Put the robot at rest on its wheels, tilted by the arm's weight; grasp any door."""
        self._stand(base_pose, q_m)
        self._drive.reset()
        if self.door is not None:
            self.door.take_hold(self.world)

    def _stand(self, base_pose: Array, q_m: Array) -> None:
        """Put the robot at rest, as `reset`, but with any door far away."""
        world = self.world
        self._rewind()
        world.q[world.arm_q] = q_m
        self._frozen(math.ceil(_SETTLING_TIME / self.dt), [0.0] * len(self._rolling))
        x, y, phi = np.asarray(base_pose).tolist()
        settled, z = self._turn(), world.q[2]
        level = pin.rpy.rpyToMatrix(0.0, 0.0, phi - _heading(settled)) @ settled
        self._rewind()
        world.q[:7] = x, y, z, *pin.Quaternion(level).coeffs()[[3, 0, 1, 2]]
        world.q[world.arm_q] = q_m
        self._phi = phi

    def _rewind(self) -> None:
        self.world.rewind()
        if self.door is not None:
            self.door.put_away(self.world)

    def measure(self) -> Measurement:
        """The robot's state; the base's pose is that of the root link, projected on the floor."""
        world = self.world
        q, v, R = world.q.copy(), world.v.copy(), self._turn()
        # The measured heading is continuous; that of R jumps at ±π.
        self._phi = phi = self._phi + math.remainder(_heading(R) - self._phi, math.tau)
        forward = math.cos(phi) * v[0] + math.sin(phi) * v[1]
        velocity = np.array([forward, float(R[2] @ v[3:6])])
        return Measurement(np.array([q[0], q[1], phi]), velocity, q[world.arm_q], v[world.arm_v])

    def step(
        self, u_a: Array, base_velocity: Array, hand_force: Array, pushes: Sequence[Push] = ()
    ) -> None:
        speeds = (self._rolling @ self._drive.step(base_velocity)).tolist()
        self.world.step(u_a, speeds, hand_force, pushes)

    def contacts(self) -> Contacts:
        return self.world.contacts()

    def _turn(self) -> Array:
        """(3, 3) orientation of the root."""
        w, x, y, z = self.world.q[3:7]
        return pin.Quaternion(w, x, y, z).toRotationMatrix()

    def _calibrate(self, half_track: float) -> None:
        """Set the effective half track [m], and the matrix from (v, ω) to the wheel speeds."""
        self.half_track = half_track
        right, left = np.linalg.inv(mobile_jacobian(self.wheels.radius, half_track))
        self._rolling = np.array([right if is_right else left for is_right in self.wheels.right])

    def _frozen(self, steps: int, speeds: Sequence[float]) -> list[float]:
        """Run steps with fixed arm and constant wheel speeds (n,) [rad/s]; return the yaw rates."""
        world = self.world
        armature, rates = world.model.dof_armature[world.arm_v], []
        armature[:] = _FROZEN
        for _ in range(steps):
            world.step(np.zeros(len(armature)), speeds, np.zeros(3))
            rates.append(float(world.v[5]))
        armature[:] = 0.0
        return rates


def _heading(R: Array) -> float:
    """[rad] horizontal direction of the x axis of an orientation R (3, 3)."""
    return math.atan2(R[1, 0], R[0, 0])


def _add_wheels(robot: RobotSpec, wheels: Wheels, base: DifferentialBase) -> None:
    """Add the driven wheels; friction and motor torques follow from the base's traction limit."""
    weight = GRAVITY * pin.computeTotalMass(robot.model.pin)  # [N]
    r, limit = wheels.radius, base.traction_limit_n
    mu, torque = limit / weight, limit * r / len(wheels.centres)
    if wheels.spans:
        torque *= _LOAD_RESERVE
    else:
        mu *= _LOAD_RESERVE
    for i, (centre, inertia) in enumerate(zip(wheels.centres, wheels.inertias, strict=True)):
        name = f"wheel_{i}"
        wheel = robot.add_body(robot.root, name, pin.SE3(np.eye(3), centre), inertia)
        robot.add_motor(wheel, name, mujoco.mjtJoint.mjJNT_HINGE, (0, 1, 0), torque)
        robot.add_geom(wheel, name, mujoco.mjtGeom.mjGEOM_ELLIPSOID, (r, _TREAD * r, r))
        robot.allow(FLOOR, name, friction=mu, **(_TYRE if wheels.spans else {}))


def _add_casters_and_hull(robot: RobotSpec, wheels: Wheels) -> None:
    """Add casters, if needed; let the base's higher shapes touch the floor, if the base tips."""
    casters: list[Array] = []  # (3,) [m] centre of each; its height is the radius
    for i, shape in enumerate(robot.shapes):
        if shape.part not in robot.mobile or shape.part in wheels.links:
            continue
        if shape.lowest > _AT_FLOOR:
            robot.allow(FLOOR, f"{shape.part}/{i}")
        elif isinstance(shape.geometry, coal.Sphere):
            casters.append(np.array([*shape.T.translation[:2], shape.geometry.radius]))
    if not wheels.spans:
        body, r = MobileBody(robot.model), wheels.radius
        sides = zip(body.lower[:2] + r, body.upper[:2] - r, strict=True)
        corners = [np.array([*place, r]) for place in product(*sides)]
        for i, centre in enumerate(casters or corners):
            name, place = f"caster_{i}", pin.SE3(np.eye(3), centre)
            robot.add_geom(robot.root, name, mujoco.mjtGeom.mjGEOM_SPHERE, centre[2:], place)
            robot.allow(FLOOR, name, friction=0.0, solref=_SPRING)
