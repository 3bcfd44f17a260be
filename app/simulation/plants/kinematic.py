"""A simple plant without a physics engine, for tests and as a check of the engines.

The base moves exactly with its drive's velocity; the arm follows
M_aa q̈_a + M_ab q̈_b + h_a = u_a + J_aᵀ f with external forces f. Only joint limits stop the arm:
contacts cause no force.
"""

import math
from collections.abc import Sequence
from itertools import compress

import coal
import numpy as np
import pinocchio as pin

from app.robot.model import RobotModel
from app.robot.state import Measurement, RobotState, distance_view
from app.simulation.plants.collision_shapes import body_contact_pairs, geometry_with_floor
from app.simulation.plants.interface import Contacts, Drive, Physics, Push
from app.simulation.plants.planar import world_twist
from app.strict import Array


class Kinematic(Physics):
    """The plant `kinematic`, which uses pinocchio and coal."""

    door = None

    def __init__(self, model: RobotModel, *, dt: float = 0.001) -> None:
        """Start at rest in the robot's ready posture; `dt` [s] is the duration of one step."""
        self.dt = dt
        self._model, self._state, self._data = model, RobotState(model), model.pin.createData()
        floor = pin.GeometryObject("floor", 0, 0, pin.SE3.Identity(), coal.Halfspace(0, 0, 1, 0))
        pairs = body_contact_pairs(model.description)
        self._geometry, self._group_of = geometry_with_floor(model, floor, pairs)
        self._results = pin.GeometryData(self._geometry)
        self._distances = distance_view(self._results.distanceResults)
        self._drive = Drive(model.description.base, dt)
        self._T = model.description.base.T
        self.reset(np.zeros(3), np.array(model.description.arm.ready_position))

    def reset(self, base_pose: Array, q_m: Array) -> None:
        self._drive.reset()
        self._base_pose = np.array(base_pose, dtype=float)
        self._q, self._qd = np.array(q_m, dtype=float), np.zeros(self._model.n_m)
        self._stepped = False

    def measure(self) -> Measurement:
        velocity, q_m, qd_m = np.array(self._drive.velocity), self._q.copy(), self._qd.copy()
        return Measurement(self._base_pose.copy(), velocity, q_m, qd_m, self._drive.state)

    def step(
        self, u_a: Array, base_velocity: Array, hand_force: Array, pushes: Sequence[Push] = ()
    ) -> None:
        model, state, n_b, dt = self._model, self._state, self._model.n_b, self.dt
        state.update(self.measure())
        before, now = self._drive.velocity, self._drive.step(base_velocity)
        qdd_b = model.J_m_inv @ np.array([b - a for a, b in zip(before, now, strict=True)]) / dt
        felt = state.J_ee[:3, n_b:].T @ np.asarray(hand_force)  # J_aᵀ f of all forces
        for push in pushes:
            joint = model.pin.getJointId(push.joint)
            J = state.point_jacobian(joint, state.data.oMi[joint].act(push.p))
            felt = felt + J[:, n_b:].T @ push.force
        b = np.asarray(u_a, dtype=float) + felt - state.h[n_b:] - state.M[n_b:, :n_b] @ qdd_b
        self._move_arm(state.M[n_b:, n_b:].copy(), b)
        twist = world_twist((self._T @ now).tolist(), self._base_pose.item(2), dt)
        self._base_pose += np.array(twist) * dt
        self._stepped = True

    def contacts(self) -> Contacts:
        """Overlaps of the convex bodies, which are larger than the links; none before a step."""
        if not self._stepped:
            return Contacts()
        q, arm = self._model.configuration(self._base_pose, self._q), self._model.pin
        pin.computeDistances(arm, self._data, self._geometry, self._results, q)
        return Contacts.of(compress(self._group_of, self._distances <= 0.0))

    def _move_arm(self, A: Array, b: Array) -> None:
        """Integrate A q̈_a = b over one step within the joints' limits; A and b are overwritten."""
        q, qd, dt = self._q, self._qd, self.dt
        lower, upper = self._model.q_lower, self._model.q_upper
        if not math.isfinite(b.sum() + A.sum()):  # `solve` would raise an error
            q[:] = qd[:] = np.nan
            return
        stopped = np.zeros(len(q), bool)
        while True:
            qdd = np.linalg.solve(A, b)
            after = q + (qd + qdd * dt) * dt
            beyond = ~stopped & ((after < lower) | (after > upper))
            if not beyond.any():
                break
            # A joint that would leave its range moves to its nearer limit.
            limit = np.where(q - lower < upper - q, lower, upper)
            A[beyond] = np.eye(len(q))[beyond]
            b[beyond] = (((limit - q) / dt - qd) / dt)[beyond]
            stopped |= beyond
        qd += qdd * dt
        q += qd * dt
