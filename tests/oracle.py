"""A second implementation of the control step, from the paper and docs/method.md alone.

This module shares no formula with `app.control`. It computes all quantities of the table
`app.control.quantities` except those in `NOT_COMPARED` of test_oracle.py. Numbers in brackets are
equations of the paper.
"""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any, NamedTuple

import coal
import numpy as np
import pinocchio as pin

from app.border.cache import BorderData
from app.config import Config
from app.control import CONTROLLERS
from app.control.tasks import Reference
from app.robot.model import RobotModel
from app.robot.state import Measurement, at_rest
from tests.oracle_base import OracleBase
from tests.oracle_estimate import Estimate
from tests.oracle_geometry import Body, Border, closest_points
from tests.oracle_qp import change, solve_qp

Array = np.ndarray
AXES = pin.LOCAL_WORLD_ALIGNED
ORACLES = tuple(name for name in CONTROLLERS if name != "hqp")  # hqp has its own tests
DBB, REPULSIVE, BARRIER, NONE = ORACLES


class Row(NamedTuple):
    """A distance between the bodies a and b, or between one convex part of a and the body b."""

    a: Body
    b: Body
    part: slice
    mobile: bool
    """Whether the pair is one of arm and base (L_m)."""


class Limits(NamedTuple):
    """l ≤ C q̈ ≤ u; each row has a `softness` (ε² of docs/method.md), 0 is hard."""

    C: Array
    l: Array
    u: Array
    softness: Array


STALLED = 200  # [periods] age of the readings that test_oracle.py sets before the NaN reading


class Oracle:
    """One controller with its own memory; `step` returns its quantities by the table's names."""

    def __init__(
        self, model: RobotModel, data: BorderData, config: Config, name: str, dt: float
    ) -> None:
        """Prepare the controller `name`; dt [s] is the control period."""
        self.model, self.name, self.dt = model, name, dt
        self.base, self.pin_data = OracleBase(model.description.base), model.pin.createData()
        self.n_b, self.n_m, self.n_mob = model.n_b, model.n_m, len(data.pairs.mobile)
        self.S = np.zeros((3 + self.n_m, self.n_b + self.n_m))
        self.S[:3, : self.n_b] = self.base.T @ self.base.J_m
        self.S[3:, self.n_b :] = np.eye(self.n_m)
        self._list_rows(data)
        self.estimate = Estimate(model.qd_max, self.n_b, dt)
        self.w: Any = SimpleNamespace(
            d_b=np.nan,
            u_a=np.full(self.n_m, np.nan),
            q_posture=np.full(self.n_m, np.nan),
            a_sum=np.zeros(self.n_b),
            t_sum=0.0,
            v_cmd=np.zeros(self.n_b),
            v_before=np.zeros(self.n_b),
            failures=0,
            given_up=0,
        )
        self.configure(config)
        self._take(at_rest(model, np.array(model.description.arm.ready_position)))
        M = self.pin_data.M  # of the ready posture
        inertia = 1 / np.diag(np.linalg.inv(np.triu(M) + np.triu(M, 1).T))[3:]
        self.inertia = inertia
        self.blind_time, self.v_error = dt, np.zeros(self.n_m)
        self.row, self.age = np.zeros(self.n_m), 0

    def configure(self, config: Config) -> None:
        """Use other parameters; the present buffer distance follows at 0.1 m/s."""
        self.config = config
        self.border = Border(self.model, config.border.d_b)

    def step(
        self,
        measurement: Measurement,
        reference: Reference | None = None,
        base_acceleration: Array | None = None,
    ) -> dict[str, Any]:
        """Algorithm 2: one control step. Return the values of all quantities by their names."""
        w = self.w
        self._estimate(measurement)
        self._closest_points()
        self._desired_base_acceleration()
        self._avoidance_task()
        self._tasks(reference)
        self._base()
        w.a_base_meas = w.a_base_cmd if base_acceleration is None else base_acceleration
        self._arm()
        self._command()
        return {name: np.array(value, dtype=float) for name, value in vars(w).items()}

    def _list_rows(self, data: BorderData) -> None:
        bodies = {name: Body(self.model, name) for name in self.model.body_names}
        pairs = [
            Row(bodies[p.a], bodies[p.b], slice(None), p in data.pairs.mobile)
            for p in data.pairs.all
        ]
        self.rows, self.pairs, self.convex = list(pairs), len(pairs), []
        for k, pair in enumerate(pairs):
            count = len(pair.a.geometries)
            first = len(self.rows)
            self.rows += [pair._replace(part=slice(i, i + 1)) for i in range(count) if count > 1]
            self.convex += list(range(first, len(self.rows))) or [k]

    # Line 2: UpdateKinematics

    def _estimate(self, m: Measurement) -> None:
        w, n_b, goal = self.w, self.n_b, self.config.border.d_b
        w.d_b = (
            goal
            if np.isnan(w.d_b)
            else w.d_b + np.clip(goal - w.d_b, -0.1 * self.dt, 0.1 * self.dt)
        )
        w.valid = all(np.isfinite(each).all() for each in m[:5])
        if not w.valid:
            self.estimate.gap()
            self.age = STALLED + 1
            known = np.linalg.solve(w.M[n_b:, n_b:], w.u_a - w.h[n_b:])
            x = self.estimate.x
            now = x[1] + self.dt * (known + x[2])  # estimate.x stays at the last valid reading
            fades = np.exp(-self.dt / self.config.estimate.noise_window)
            w.x_est = np.array([x[0] + self.dt * now, now, fades * x[2]])
            w.qd = np.append(w.qd[:n_b], now)
            w.P_est, w.noise_var, w.q_last = (
                self.estimate.P,
                self.estimate.variances,
                self.estimate.last,
            )
            w.samples, w.v_last = self.estimate.samples, self.estimate.v_last
            return
        qdd_b = self.base.to_q @ (m.base_velocity - self.estimate.v_last) / self.dt
        known = w.u_a - w.h[n_b:] - w.M[n_b:, :n_b] @ qdd_b
        known = np.linalg.solve(w.M[n_b:, n_b:], known)
        self.row = known if np.isfinite(known[0]) else self.row
        before = self.estimate.x if self.age == 0 else w.x_est
        predicted = before[1] + self.dt * (self.row + before[2])
        self.estimate.update(m, known, self.blind_time, self.config.estimate)
        self._doubt(np.abs(self.estimate.x[1] - predicted))
        if np.isnan(w.q_posture[0]):
            w.q_posture = m.q_m.copy()
        self._take(m._replace(q_m=self.estimate.x[0], qd_m=self.estimate.x[1]))
        e = self.estimate
        w.x_est, w.P_est, w.noise_var, w.q_last = e.x, e.P, e.variances, e.last
        w.samples, w.v_last = e.samples, e.v_last

    def _doubt(self, errors: Array) -> None:
        """Update v_error and blind_time; `errors` (n_m,) [rad/s] are of predicted velocities."""
        steps, window = 1 + self.age, self.config.estimate.noise_window
        first, errors = np.isnan(self.w.q_posture[0]), errors * (not self.estimate.jumped)
        if not first:
            blind = errors if steps > 1 else 0.0 * errors
            self.v_error = np.maximum(blind, np.exp(-steps * self.dt / window) * self.v_error)
            if self.estimate.jumped or (errors > 60 * self.dt * self.model.qd_max).any():
                self.blind_time = max(self.blind_time, min(steps * self.dt, 0.1) + 0.024)
        self.blind_time = max(self.dt, np.exp(-self.dt / window) * self.blind_time)
        self.age = 0

    @property
    def _fastest(self) -> float:
        return 0.5 / self.blind_time if self.blind_time > self.dt else np.inf

    @property
    def _margin(self) -> Array:
        return np.minimum(3 * self.v_error, 0.5 * self.model.qd_max)

    def _take(self, m: Measurement) -> None:
        """Compute kinematics and dynamics at the state m with pinocchio."""
        w, model, data, S, n_b = self.w, self.model.pin, self.pin_data, self.S, self.n_b
        w.base_pose, w.base_velocity, w.q_m, w.qd_m = (each.copy() for each in m[:4])
        w.qd = self.measured_qd = np.append(self.base.to_q @ w.base_velocity, w.qd_m)
        x, y, phi = w.base_pose
        q, v = np.array([x, y, np.cos(phi), np.sin(phi), *w.q_m]), S @ w.qd
        pin.computeAllTerms(model, data, q, v)
        w.M, w.h, w.g = S.T @ data.M @ S, S.T @ data.nle, S.T @ data.g
        w.L_aa = np.linalg.cholesky(w.M[n_b:, n_b:])
        pin.forwardKinematics(model, data, q, v, np.zeros(model.nv))
        frame = self.model.ee_frame
        T = pin.updateFramePlacement(model, data, frame)
        w.R_ee, w.p_ee = T.rotation.copy(), T.translation.copy()
        w.J_ee = pin.getFrameJacobian(model, data, frame, AXES) @ S
        w.v_ee = w.J_ee @ w.qd
        w.Jdqd_ee = pin.getFrameClassicalAcceleration(model, data, frame, AXES).vector
        w.R_base, w.p_o = data.oMi[1].rotation.copy(), data.oMi[1].translation.copy()
        joints = range(model.njoints)
        w.twists = np.array([pin.getVelocity(model, data, j, pin.WORLD).vector for j in joints])
        w.biases = np.array([pin.getAcceleration(model, data, j, pin.WORLD).vector for j in joints])

    def _jacobian(self, joint: int, p: Array) -> Array:
        """(3, n) Jacobian of the point p (3,) [m] in the world, fixed to a joint's body."""
        J = pin.getJointJacobian(self.model.pin, self.pin_data, joint, AXES)
        lever = pin.skew(p - self.pin_data.oMi[joint].translation)
        return (J[:3] - lever @ J[3:]) @ self.S

    def _bias(self, joint: int, p: Array) -> Array:
        """(3,) [m/s²] acceleration of the point p, fixed to a joint's body, at q̈ = 0."""
        a = pin.getClassicalAcceleration(self.model.pin, self.pin_data, joint, AXES)
        w, r = self._turning(joint), p - self.pin_data.oMi[joint].translation
        return a.linear + np.cross(a.angular, r) + np.cross(w, np.cross(w, r))

    def _turning(self, joint: int) -> Array:
        return pin.getVelocity(self.model.pin, self.pin_data, joint, AXES).angular

    # Lines 4 and 9: FindClosestPoints

    def _closest_points(self) -> None:
        w = self.w
        w.d = np.array([self._distance(row) for row in self.rows])
        points = np.array([self._points(row) for row in self.rows])
        w.p_a, w.p_b, w.normal, w.core = np.swapaxes(points, 0, 1)
        motions = zip(self.rows, w.core, w.normal, strict=True)
        w.J, w.Jdqd, w.d_dot = map(np.array, zip(*[self._motion(*m) for m in motions], strict=True))
        d = w.d[: self.pairs]
        s = np.clip((w.d_b - d) / (w.d_b - self.config.activation.d_full), 0.0, 1.0)
        w.beta = 3 * s**2 - 2 * s**3  # Figure 10
        w.beta_m = w.beta[: self.n_mob].max()  # (28)

    def _placed(self, body: Body) -> pin.SE3:
        return self.pin_data.oMi[body.joint]

    def _distance(self, row: Row) -> float:
        """[m] smallest signed distance between the shapes of both bodies, by coal."""
        return min(
            coal.distance(
                one,
                coal.Transform3s(T_a.rotation, T_a.translation),
                other,
                coal.Transform3s(T_b.rotation, T_b.translation),
                coal.DistanceRequest(),
                coal.DistanceResult(),
            )
            for one, (_, T_a) in row.a.placed(self._placed(row.a))[row.part]
            for other, (_, T_b) in row.b.placed(self._placed(row.b))
        )

    def _points(self, row: Row) -> Array:
        T_a, T_b, blend = (
            self._placed(row.a),
            self._placed(row.b),
            self.config.activation.closest_point_smoothing,
        )
        a, b = row.a.shapes(T_a)[row.part], row.b.shapes(T_b)
        return closest_points(a, row.a.core(T_a)[0], b, row.b.core(T_b), blend)

    def _motion(self, row: Row, p: Array, n: Array) -> tuple[Array, float, float]:
        """(21): J_r, J̇_r q̇ and ḋ of the distance along n, which is fixed to the body a."""
        a, b = row.a.joint, row.b.joint
        J = self._jacobian(b, p) - self._jacobian(a, p)
        v = J @ self.measured_qd
        bias = self._bias(b, p) - self._bias(a, p) - 2 * np.cross(self._turning(a), v)
        return n @ J, n @ bias, n @ v

    # Lines 5 and 6: FindActingPoint, GenerateMobAcc

    def _desired_base_acceleration(self) -> None:
        w, n, force = self.w, self.n_mob, self.config.force
        w.p_n, w.p_t, w.p_act, w.tangent = np.full((4, n, 3), np.nan)
        w.alpha, w.f = np.full(n, np.nan), np.zeros((n, 3))
        for i in np.flatnonzero(w.beta[:n]):
            p_b, normal = w.R_base.T @ (w.p_b[i] - w.p_o), w.R_base.T @ w.normal[i]
            w.p_n[i], w.tangent[i] = self.border.nearest(p_b)
            S, up = self._score(i, w.p_n[i])
            S_0, d = force.alpha_gain, max(w.d[i], 0.0)
            alpha = S_0 * d / (abs(S) / self.base.score_unit + S_0 / 2)  # (13)
            w.alpha[i] = np.clip(alpha, force.alpha_min, force.alpha_max)
            w.p_t[i] = w.p_n[i] + w.alpha[i] * (up @ w.tangent[i]) * w.tangent[i]  # (12)
            w.p_act[i], _ = self.border.nearest(w.p_t[i])
            share = np.clip(1 - w.d[i] / w.d_b, 0.0, 1.0) * np.linalg.norm(normal[:2])
            way = p_b - w.p_act[i]
            if np.linalg.norm(way) < 1e-6:
                way = -normal * [1, 1, 0]
            w.f[i] = force.f_max * share * way / np.linalg.norm(way)  # (14)
        torque = np.nansum(w.p_act[:, 0] * w.f[:, 1] - w.p_act[:, 1] * w.f[:, 0])
        w.xdd_m = self.base.acceleration(*w.f.sum(axis=0)[:2], torque)  # (15) to (18)

    def _score(self, i: int, p: Array) -> tuple[float, Array]:
        """The score (10) of pair i at p (3,) [m] in the base's frame; its unit gradient (3,)."""
        reach = self.model.description.reachability[self.rows[i].b.name]
        A, B, C = reach.A_per_m2, reach.B_m, reach.C
        out = p - self.model.p_base()
        rho, R_1 = np.linalg.norm(out), 0.05 * C
        R, slope = C - A * (rho - B) ** 2, -2 * A * (rho - B)  # (9)
        if R < R_1:
            R, slope = R_1**2 / (2 * R_1 - R), slope * (R_1 / (2 * R_1 - R)) ** 2
        measure, by_x = self.base.measure(p[0])
        gradient = measure * slope * out / rho + np.array([by_x * R, 0, 0])
        length = np.linalg.norm(gradient)
        return measure * R, gradient / length if length else np.array([1.0, 0.0, 0.0])

    # Lines 10 to 13: GenerateRepAcc, GenerateAvoidanceTask

    def _avoidance_task(self) -> None:
        w, n_b, n, rep = self.w, self.n_b, self.n_mob, self.config.repulsion
        links = slice(n, self.pairs)
        base = np.hstack([self.base.J_m, np.zeros((n_b, self.n_m))])  # (19)
        pushed = [self._pushed(i) for i in range(n)]
        w.J_sca = np.vstack([base, w.J[links], *(J for J, _ in pushed)])  # (25)
        xdd_r = rep.k_p - rep.k_v * w.d_dot[links]  # (20)
        w.b_sca = np.concatenate([w.xdd_m, xdd_r - w.Jdqd[links], *(b for _, b in pushed)])  # (24)
        w.B = np.concatenate(
            [
                np.full(n_b, w.beta_m) * (self.name == DBB),
                w.beta[links] * (self.name in (DBB, REPULSIVE)),
                np.repeat(w.beta[:n], 3) * (self.name == REPULSIVE),
            ]
        )  # (27)
        w.activation = w.B.max()

    def _pushed(self, i: int) -> tuple[Array, Array]:
        """J and b of T_rep (controller `repulsive`): p_b of pair i moves away from the base."""
        w, joint, rep = self.w, self.rows[i].b.joint, self.config.repulsion
        J = self._jacobian(joint, w.p_b[i])
        J[:, : self.n_b] = 0.0
        xdd = rep.k_p * w.normal[i] - rep.k_v * J @ w.qd
        return J, xdd - self._bias(joint, w.p_b[i])

    # Line 14: the tasks below

    def _tasks(self, reference: Reference | None) -> None:
        w, model, n_b = self.w, self.model, self.n_b
        w.tracking = reference is not None
        age = self.blind_time if self.w.valid else self.dt
        damping = np.minimum(model.joint_damping, self.inertia / (3 * age))
        w.u_free = w.g[n_b:] - damping * w.qd[n_b:]
        last = w.u_free if np.isnan(w.u_a[0]) else w.u_a
        at, most = (
            np.clip(last, -model.tau_max, model.tau_max),
            self.config.limit.torque_rate * self.dt,
        )
        w.u_min = np.maximum(at - most, -model.tau_max)
        w.u_max = np.minimum(at + most, model.tau_max)
        if reference is None:
            self._guided()
            w.H, w.c = w.H_low, w.c_low
            return
        self._posture()
        pose, w.v_ref, w.a_ref = reference
        w.x_ref = np.vstack([pose.rotation.T, pose.translation])
        w.e_ee = np.append(pose.translation - w.p_ee, pin.log3(pose.rotation @ w.R_ee.T))
        w.b_ee, w.lm_damping = self._end_effector(1.0)
        w.H, w.c = self._tracking(1.0, w.lm_damping, self.config.task.ee_weight)

    def _guided(self) -> None:
        """Min (u − u_0)ᵀ M_aa⁻¹ (u − u_0); u_0 has the force f_arm on the arm, only for `dbb`."""
        w, n_b = self.w, self.n_b
        f = self.config.force.f_arm * (self.name == DBB)
        share = np.clip(1 - w.d[: self.n_mob] / w.d_b, 0.0, 1.0)
        u_0 = w.u_free + f * share @ w.J[: self.n_mob, n_b:]
        w.H_low, w.c_low = w.M, np.append(np.zeros(n_b), w.h[n_b:] - u_0)

    def _posture(self) -> None:
        """½ ‖q̈_m − k (q_p − q) + k_d q̇ + k_c h σ⁵‖² + ½ w_b ‖q̈_b + k_b q̇_b‖²."""
        w, task, (low, high) = self.w, self.config.task, self.model.q_limits
        half = (high - low) / 2
        s = (w.q_m - (low + high) / 2) / half
        weight = np.append(np.full(self.n_b, task.base_weight), np.ones(self.n_m))
        damped = task.posture_damping * w.qd[self.n_b :]
        arm = task.posture_stiffness * (w.q_posture - w.q_m) - damped
        wanted = np.append(
            -task.base_damping * w.qd[: self.n_b], arm - task.joint_centering * half * s**5
        )
        w.H_low, w.c_low = np.diag(weight), -weight * wanted

    def _end_effector(self, slowness: float) -> tuple[Array, float]:
        """(26): ẍ_d − J̇ q̇ + k_v ė + [k_p e], with [k_p e] limited by `task.ee_speed`; and λ."""
        w, task = self.w, self.config.task
        k_p, k_v = task.ee_stiffness / slowness**2, task.ee_damping / slowness
        most = k_v * task.ee_speed
        halves = [
            k_p * e * min(1.0, most / max(k_p * np.linalg.norm(e), 1e-12))
            for e in np.split(w.e_ee, 2)
        ]
        pull = np.concatenate(halves)
        b = w.a_ref - w.Jdqd_ee + k_v * (w.v_ref - w.v_ee) + pull
        return b, float(pull @ pull) / k_p**2

    def _tracking(self, slowness: float, give: float, weight: float) -> tuple[Array, Array]:
        """Posture task plus ½ w (‖J q̈ − b‖² + λ ‖q̈ + k_v q̇‖²), λ term in posture's metric."""
        w, k_v = self.w, self.config.task.ee_damping / slowness
        b, _ = self._end_effector(slowness)
        H = w.H_low + weight * (give * w.H_low + w.J_ee.T @ w.J_ee)
        return H, w.c_low + weight * (give * k_v * w.H_low @ w.qd - w.J_ee.T @ b)

    def _with_rows(
        self, H: Array, c: Array, rows: slice, b: Array, fixed: int = 0
    ) -> tuple[Array, Array]:
        """(29): add springs of compliance (1 − β + `task.slack_weight`)/β times J H⁻¹ Jᵀ."""
        w, softness = self.w, self.config.task.slack_weight
        inverse = np.linalg.inv(H[fixed:, fixed:])
        H, c = H.copy(), c.copy()
        for J, b_i, beta in zip(w.J_sca[rows], b, w.B[rows], strict=True):
            if beta > 0.0:
                give = J[fixed:] @ inverse @ J[fixed:] + 1e-12  # as in `insert_rows`
                stiffness = beta / ((1 - beta + softness) * give)
                H, c = H + stiffness * np.outer(J, J), c - stiffness * b_i * J
        return H, c

    # Limits

    def _limits(self, slowness: float, distances: str, for_arm: bool = False) -> Limits:
        """All limits; `distances`: "none", "all" or "buffers" (d_min = d_b within the arm)."""
        w, model, n_b = self.w, self.model, self.n_b
        low, high = (w.u_min, w.u_max) if for_arm else (-model.tau_max, model.tau_max)
        pushed = w.x_est[2] if for_arm else np.zeros(self.n_m)
        bounds = self._joint_bounds(slowness, for_arm)
        if for_arm:
            bounds = self._reachable(*bounds, pushed)
        unit = model.qd_max
        rows = [] if distances == "none" else list(self.convex)
        least = np.array(
            [self._barrier(k, slowness, distances == "buffers", for_arm) for k in rows]
        )
        J = w.J[rows].reshape(-1, model.n)
        arm = np.hstack([np.zeros((self.n_m, n_b)), np.diag(1 / unit)])
        count = self.n_m + len(rows)
        return Limits(
            np.vstack([w.M[n_b:], arm, J]),
            np.concatenate(
                [low - w.h[n_b:], (bounds[0] - pushed) / unit, least - J[:, n_b:] @ pushed]
            ),
            np.concatenate(
                [high - w.h[n_b:], (bounds[1] - pushed) / unit, np.full(len(rows), np.inf)]
            ),
            np.append(np.zeros(self.n_m), np.full(count, self.config.task.slack_weight**2)),
        )

    def _joint_bounds(self, slowness: float, for_arm: bool) -> Array:
        """Lower and upper bounds on q̈_m from positions and velocities."""
        w, model, limit = self.w, self.model, self.config.limit
        rate = limit.position_rate / slowness
        speed_rate = limit.velocity_rate if slowness == 1.0 else rate
        top = model.qd_max - (self._margin if for_arm else 0.0)
        lower, upper = [], []
        for fastest in (np.inf, self._fastest if for_arm else np.inf):
            slow = min(rate, fastest)
            position = slow**2 * (model.q_limits - w.q_m) - 2 * slow * w.qd_m
            velocity = min(speed_rate, fastest) * (np.array([-top, top]) - w.qd_m)
            lower += [position[0], velocity[0]]
            upper += [position[1], velocity[1]]
        return np.sort([np.max(lower, axis=0), np.min(upper, axis=0)], axis=0)

    def _reachable(self, lower: Array, upper: Array, pushed: Array) -> Array:
        """Limit bounds (n_m,) by torque rate (to brake before the speed limit) and own torque."""
        w, n_b, qd_max = self.w, self.n_b, self.model.qd_max - self._margin
        inverse = np.linalg.inv(w.M[n_b:, n_b:])
        moved = np.diag(inverse)
        room = np.maximum([w.qd_m + qd_max, qd_max - w.qd_m], 0.0)
        slower, faster = np.sqrt(2 * moved * self.config.limit.torque_rate * room)
        lower, upper = (
            np.maximum(lower, np.minimum(-slower, upper)),
            np.minimum(upper, np.maximum(faster, lower)),
        )
        acting = (
            (w.u_min + w.u_max) / 2 - w.h[n_b:] - w.M[n_b:, :n_b] @ self.base.to_q @ w.a_base_meas
        )
        there, own = pushed + inverse @ acting, moved * (w.u_max - w.u_min) / 2
        return np.array([np.minimum(lower, there + own), np.maximum(upper, there - own)])

    def _barrier(self, k: int, slowness: float, buffers: bool, for_arm: bool) -> float:
        """Bound of J_r q̈ of row k by ḧ + 2 λ ḣ + λ² h >= 0, with h = d − d_min and h >= −2 v/λ."""
        w, keep = self.w, self.config.barrier
        rate, leaving = keep.rate / slowness, keep.max_separation_speed / slowness
        d_min = w.d_b if buffers and not self.rows[k].mobile else keep.d_min
        d_dot, rates = w.d_dot[k], [rate]
        if for_arm:
            d_dot = d_dot - np.linalg.norm(w.J[k, self.n_b :] * self._margin)
            rates.append(min(rate, self._fastest))
        return max(
            -2 * each * d_dot - each**2 * max(w.d[k] - d_min, -2 * leaving / each) - w.Jdqd[k]
            for each in rates
        )

    # Line 15: base, then arm

    def _base(self) -> None:
        w, n_b, task = self.w, self.n_b, self.config.task
        w.a_base_free = -task.base_damping * w.base_velocity
        found = True
        if w.valid and (w.tracking or self.name == BARRIER):
            qdd = self._free_motion()
            found = qdd is not None
            if qdd is None:
                w.given_up += 1
                w.B[:n_b] = 0.0
            else:
                w.a_base_free = self.base.J_m @ qdd[:n_b]
        w.a_base_des = w.B[0] * w.xdd_m + (1 - w.B[0]) * w.a_base_free  # (29)
        w.a_base_cmd = self._undragged() if w.B[0] > 0.0 else w.a_base_des
        if w.valid and w.tracking and found:
            self._make_room()
        if w.valid:
            w.a_base_cmd = np.clip(w.a_base_cmd, -self.base.a_max, self.base.a_max)

    def _free_motion(self) -> Array | None:
        """q̈ of the slow QP of base and arm without the base's rows; None without a solution."""
        w, n_b, task, rep = self.w, self.n_b, self.config.task, self.config.repulsion
        slow = task.base_time_scale
        if w.tracking:
            H, c = self._tracking(slow, 0.0, task.ee_weight)
        else:
            M_a, inverse = w.M[n_b:], np.linalg.inv(w.M[n_b:, n_b:])
            rest = np.diag(np.append(np.full(n_b, task.base_weight), np.zeros(self.n_m)))
            H = M_a.T @ inverse @ M_a + rest
            c = M_a.T @ inverse @ w.c_low[n_b:] + task.base_damping * rest @ w.qd
        links = slice(self.n_mob, self.pairs)
        b = rep.k_p / slow**2 - rep.k_v / slow * w.d_dot[links] - w.Jdqd[links]
        H, c = self._with_rows(H, c, slice(n_b, n_b + len(b)), b)
        limits = self._limits(1.0, "all" if self.name == BARRIER else "none")
        own = np.hstack([self.base.J_m, np.zeros((n_b, self.n_m))])
        both = (own, -self.base.a_max, self.base.a_max, np.zeros(n_b))
        return solve_qp(
            H, c, tuple(np.concatenate(each) for each in zip(limits, both, strict=True))
        )

    def _undragged(self) -> Array:
        """Base acceleration near a_des that drags the end-effector little (`ee_hold`)."""
        w, base, hold = self.w, self.base, self.config.ee_hold
        reach = w.J_ee[:3, self.n_b :] * self.model.qd_max / hold.min_speed
        follows = reach @ reach.T
        moved = w.J_ee[:3, : self.n_b] @ base.to_q
        drag = np.linalg.inv(np.eye(3) + follows @ follows) @ moved * self._gain()
        a_hold = w.a_base_free / self._gain() + self._drag() * w.base_velocity
        wanted = np.clip(w.a_base_des, -base.a_max, base.a_max)
        I, mass = np.diag(base.inertia), w.B[0] * hold.weight * base.mass
        return np.linalg.solve(I + mass * drag.T @ drag, I @ wanted + mass * drag.T @ drag @ a_hold)

    def _make_room(self) -> None:
        """Change a_base_cmd by the least amount with which the arm can fulfil T_2 in its limits."""
        w, n_b, task = self.w, self.n_b, self.config.task
        slow = task.base_time_scale
        _, give = self._end_effector(slow)
        H, c = self._tracking(slow, give, task.base_weight * task.ee_weight)
        H, c = self._with_rows(H, c, slice(n_b), w.b_sca[:n_b])
        response = self._gain() * (w.a_base_cmd - self._drag() * w.base_velocity)
        fixed = self.base.to_q @ response
        limits = self._limits(slow, "buffers" if self.name == DBB else "none")
        qdd = change(H, c, limits, fixed)
        if qdd is None:
            w.given_up += 1
            w.a_base_des = w.a_base_cmd = -task.base_damping * w.base_velocity
        else:
            w.a_base_cmd = w.a_base_cmd + self.base.J_m @ (qdd[:n_b] - fixed) / self._gain()

    def _arm(self) -> None:
        w, n_b = self.w, self.n_b
        w.qdd, w.solved = np.full(self.model.n, np.nan), False
        if w.valid:
            rows = slice(n_b, None)
            H, c = self._with_rows(w.H, w.c, rows, w.b_sca[rows], n_b)
            kept = "all" if self.name in (DBB, BARRIER) else "none"
            w.C, w.l, w.u, w.softness = limits = self._limits(1.0, kept, for_arm=True)
            w.n_limits = len(w.l)
            qdd = solve_qp(H, c, limits, self.base.to_q @ w.a_base_meas)
            if qdd is not None:
                w.qdd, w.solved = qdd, True
        u = w.M[n_b:] @ w.qdd + w.h[n_b:] if w.solved else w.u_free  # (26)
        if not w.solved:
            w.failures += 1
            moving = w.base_velocity if w.valid else w.v_cmd
            w.a_base_cmd = -self.config.task.base_damping * moving
        w.u_cmd = np.clip(u, w.u_min, w.u_max)
        if not np.isnan(w.q_posture[0]):
            w.u_a = w.u_cmd

    # §4.1: the admittance law

    def _drag(self) -> Array:
        law = self.config.admittance
        return self.base.by_axis(law.damping / law.mass, law.angular_damping / law.inertia)

    def _gain(self) -> Array:
        """(1 − e^−x)/x over a command period: the law's mean response to an acceleration."""
        x = self._drag() * self.config.admittance.period
        return np.where(x > 1e-12, -np.expm1(-x) / np.maximum(x, 1e-12), 1.0)

    def _command(self) -> None:
        w, base, law = self.w, self.base, self.config.admittance
        w.a_sum, w.t_sum = w.a_sum + w.a_base_cmd * self.dt, w.t_sum + self.dt
        w.command_due = w.t_sum >= law.period - self.dt / 2
        if not w.command_due:
            return
        T, largest = w.t_sum, np.minimum(base.v_max, base.by_axis(law.v_max, law.omega_max))
        decay = np.exp(-self._drag() * T)  # v̇ = a − (D/M) v over T
        rest = w.a_sum / T / self._drag()
        step = np.clip((1 - decay) * (rest - w.v_cmd), -base.a_max * T, base.a_max * T)
        w.v_before, v = w.v_cmd, np.clip(w.v_cmd + step, -largest, largest)
        v = base.admissible(v, w.v_before)
        w.v_cmd = v / max(1.0, np.max(np.abs(v) / largest))
        w.a_sum, w.t_sum = np.zeros(self.n_b), 0.0
