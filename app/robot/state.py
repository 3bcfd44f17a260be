"""Where the robot is now: kinematics and dynamics computed once a step, then only read."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import pinocchio as pin

from app.robot.model import RobotModel

Array = np.ndarray


class Measurement(NamedTuple):
    """What the robot's sensors give, once a control step.

    Attributes:
        base_pose: (3,) x, y [m] and heading φ [rad] of the base's centre in the world.
        base_velocity: (2,) v [m/s] along the base's x axis and ω [rad/s].
        q_m: (n_m,) [rad or m] the arm's joint positions.
        qd_m: (n_m,) [rad/s or m/s] the arm's joint velocities.
    """

    base_pose: Array
    base_velocity: Array
    q_m: Array
    qd_m: Array


class RobotState:
    """Kinematics and dynamics at one instant, in the reduced coordinates q̇ = (θ̇_r, θ̇_l, q̇_m).

    Attributes:
        measurement: What it was updated with.
        qd: (n,) reduced velocity q̇: wheel speeds [rad/s], then the arm's joints.
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
        self.geometry_data = pin.GeometryData(model.geometry)
        self._J_m_inv = np.linalg.inv(model.J_m)
        self._S_T = np.ascontiguousarray(model.S.T)
        self._zero = np.zeros(model.pin.nv)
        self.qd = np.zeros(model.n)
        self.R_world_base = np.eye(3)
        self.p_o = np.zeros(3)
        at_rest = Measurement(
            np.zeros(3), np.zeros(2), np.array(model.description.arm.ready_position),
            np.zeros(model.n_m),
        )  # fmt: skip
        self.update(at_rest)

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
        pin.computeAllTerms(self._pin, self.data, q, v)
        S, S_T = self.model.S, self._S_T
        self.M = S_T @ self.data.M @ S
        self.h = S_T @ self.data.nle
        self.g = S_T @ self.data.g
        self._update_motion(q, v)

    def update_kinematics(self, measurement: Measurement) -> None:
        """Recompute all but M, h and g, which stay those of the last `update`."""
        q, v = self._take(measurement)
        pin.computeJointJacobians(self._pin, self.data, q)
        self._update_motion(q, v)

    def _take(self, measurement: Measurement) -> tuple[Array, Array]:
        """Pinocchio's configuration and velocity."""
        self.measurement = measurement
        self.qd[:2] = self._J_m_inv @ measurement.base_velocity
        self.qd[2:] = measurement.qd_m
        q = self.model.configuration(measurement.base_pose, measurement.q_m)
        return q, self.model.S @ self.qd

    def _update_motion(self, q: Array, v: Array) -> None:
        """Placements, velocities and accelerations, with the Jacobians already there."""
        model, data = self._pin, self.data
        # The acceleration of every point at q̈ = 0, which is J̇ q̇; S is constant.
        pin.forwardKinematics(model, data, q, v, self._zero)
        pin.updateFramePlacement(model, data, self.model.ee_frame)
        self.T_world_ee = data.oMf[self.model.ee_frame]
        axes = pin.LOCAL_WORLD_ALIGNED
        self.J_ee = pin.getFrameJacobian(model, data, self.model.ee_frame, axes) @ self.model.S
        self.v_ee = self.J_ee @ self.qd
        self.Jdqd_ee = pin.getFrameClassicalAcceleration(
            model, data, self.model.ee_frame, axes
        ).vector
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
        data = self.data
        J = pin.getJointJacobian(self.model.pin, data, joint, pin.LOCAL_WORLD_ALIGNED)
        lever = pin.skew(p_world - data.oMi[joint].translation)
        return (J[:3] - lever @ J[3:]) @ self.model.S

    def point_bias(self, joint: int, p_world: Array) -> Array:
        """(3,) J̇ q̇ of that point: its acceleration at q̈ = 0."""
        data = self.data
        axes = pin.LOCAL_WORLD_ALIGNED
        a = pin.getClassicalAcceleration(self.model.pin, data, joint, axes)
        placement = data.oMi[joint]
        w = pin.skew(placement.rotation @ data.v[joint].angular)
        r = p_world - placement.translation
        return a.linear + pin.skew(a.angular) @ r + w @ (w @ r)
