"""Where the robot is now: kinematics and dynamics computed once a step, then only read."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import pinocchio as pin

from app.errors import MeasurementError
from app.robot import motion
from app.robot.model import RobotModel

Array = np.ndarray


class Measurement(NamedTuple):
    """What the robot's sensors give, once a control step.

    Attributes:
        base_pose: (3,) x, y [m] and heading φ [rad] of the base's centre in the world.
        base_velocity: (n_b,) [m/s or rad/s] along the base's axes: v and ω of a differential one.
        q_m: (n_m,) [rad or m] the arm's joint positions.
        qd_m: (n_m,) [rad/s or m/s] the arm's joint velocities.
        drive: (n_d,) what the base's drive has besides, such as a steering angle [rad]; if it is
            left out, it counts as at rest.
    """

    base_pose: Array
    base_velocity: Array
    q_m: Array
    qd_m: Array
    drive: Array = np.zeros(0)


def checked(measurement: Measurement, model: RobotModel) -> Measurement:
    """The same with arrays of floats.

    Raises:
        MeasurementError: One of them is not that many numbers; the message names it.
    """
    sizes = (3, model.n_b, model.n_m, model.n_m)
    if all(
        isinstance(each, np.ndarray) and each.dtype == np.float64 and each.shape == (size,)
        for each, size in zip(measurement, sizes, strict=False)
    ):
        return measurement
    found: dict[str, Array] = {}
    for name, each, size in zip(Measurement._fields, measurement, sizes, strict=False):
        try:
            array = np.asarray(each, dtype=float)
        except (TypeError, ValueError):
            array = np.empty(0)
        if array.shape != (size,):
            raise MeasurementError(f"measurement.{name} must be {size} numbers, was {each!r}")
        found[name] = array
    return measurement._replace(**found)


def is_finite(measurement: Measurement) -> bool:
    """Whether no reading is infinite or not a number."""
    return motion.all_finite(*measurement[:4])


def at_rest(model: RobotModel, q_m: Array, base_pose: Array | None = None) -> Measurement:
    """What the sensors of a robot at rest give, its base at the origin if no pose is given."""
    pose = np.zeros(3) if base_pose is None else base_pose
    base = model.description.base
    return Measurement(pose, np.zeros(model.n_b), q_m, np.zeros(model.n_m), base.drive_at_rest())


class RobotState:
    """Kinematics and dynamics at one instant, in the reduced coordinates q̇ = (q̇_b, q̇_m).

    Attributes:
        measurement: What it was updated with.
        qd: (n,) reduced velocity q̇: the base's, wheel speeds [rad/s] of a differential one, then
            the arm's joints.
        M: (n, n) inertia matrix M of (26).
        h: (n,) C q̇ + g of (26).
        g: (n,) g of (26).
        T_world_ee: Pose of the end-effector.
        J_ee: (6, n) Jacobian of the end-effector, linear over angular, in axes of the world.
        v_ee: (6,) J_ee q̇.
        Jdqd_ee: (6,) J̇_ee q̇.
        R_world_base: (3, 3) rotation of the base.
        p_o: (3,) [m] the base's centre on the floor, in the world.
    """

    def __init__(self, model: RobotModel) -> None:
        self.model = model
        self.data = model.pin.createData()
        self._pin = model.pin
        self._B = np.ascontiguousarray(model.S[:3, : model.n_b])
        self.R_world_base = np.eye(3)
        self.p_o = np.zeros(3)
        self.update(at_rest(model, np.array(model.description.arm.ready_position)))

    def scale_arm_inertias(self, factor: float) -> None:
        """Compute with other masses and inertias of the arm from the next update on.

        What is fixed to the base, the arm's first link too, keeps its own. The model that others
        share is not changed.

        Args:
            factor: [-] of each mass and inertia about the same centre of mass; 1 is the model's.
        """
        if factor == 1.0:
            self._pin = self.model.pin
            return
        self._pin = self.model.pin.copy()
        for joint in range(2, self._pin.njoints):  # 1 is the planar joint of the base
            Y = self.model.pin.inertias[joint]
            self._pin.inertias[joint] = pin.Inertia(factor * Y.mass, Y.lever, factor * Y.inertia)

    def update(self, measurement: Measurement) -> None:
        """Recompute everything; Algorithm 2, line 2 (UpdateKinematics)."""
        q, v = self._take(measurement)
        data = self.data
        pin.computeAllTerms(self._pin, data, q, v)
        self.M, self.h, self.g = motion.reduced_dynamics(data.M, data.nle, data.g, self._B)
        self._update_motion(v)

    def update_kinematics(self, measurement: Measurement) -> None:
        """Recompute all but M, h and g, which stay those of the last `update`."""
        q, v = self._take(measurement)
        pin.computeJointJacobians(self._pin, self.data, q)
        self._update_motion(v)

    def _take(self, measurement: Measurement) -> tuple[Array, Array]:
        """Pinocchio's configuration and velocity."""
        self.measurement = measurement
        self.qd, q, v = motion.coordinates(*measurement[:4], self._B, self.model.J_m_inv)
        return q, v

    def _update_motion(self, v: Array) -> None:
        """Placements, velocities and accelerations, with the Jacobians already there."""
        data, frame = self.data, self.model.ee_frame
        self._J = data.J
        self._twists, self._biases = motion.chain_motion(self._J, v)
        self.T_world_ee = pin.updateFramePlacement(self._pin, data, frame)
        self.J_ee, self.v_ee, self.Jdqd_ee = motion.tip_motion(
            self._J, self._B, self._twists, self._biases, self.T_world_ee.translation
        )
        root = data.oMi[1]
        self.R_world_base = root.rotation
        self.p_o = root.translation

    def to_base(self, p_world: Array) -> Array:
        """(3,) a point of the world in the base's frame."""
        return self.R_world_base.T @ (p_world - self.p_o)

    def to_world(self, p_base: Array) -> Array:
        """(3,) a point of the base's frame in the world."""
        return self.R_world_base @ p_base + self.p_o

    def point_jacobian(self, joint: int, p_world: Array) -> Array:
        """(3, n) Jacobian of the point of a joint's body that is now at `p_world`."""
        return motion.point_jacobian(self._J, self._B, joint, p_world)

    def point_velocity(self, joint: int, p_world: Array) -> Array:
        """(3,) [m/s] velocity of that point."""
        return np.array(motion.point_velocity(self._twists[joint], p_world))

    def point_bias(self, joint: int, p_world: Array) -> Array:
        """(3,) J̇ q̇ of that point: its acceleration at q̈ = 0."""
        return np.array(motion.point_bias(self._twists[joint], self._biases[joint], p_world))

    def pair_motion(
        self, joint_a: int, joint_b: int, p: Array, n: Array
    ) -> tuple[Array, float, float]:
        """How a point of one body moves along a normal that is fixed to another one.

        Args:
            joint_a: Joint of the body with the normal.
            joint_b: Joint of the body with the point.
            p: (3,) [m] the point, in the world.
            n: (3,) unit normal, in the world.

        Returns:
            (n,) its Jacobian nᵀ(J_b - J_a); [m/s²] its acceleration at q̈ = 0, with the turning of
            the normal; [m/s] its speed.
        """
        return motion.pair_motion(
            self._J, self._B, self._twists, self._biases, joint_a, joint_b, p, n
        )
