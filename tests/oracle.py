"""The control step from straightforward parts: numpy and pinocchio, nothing clever.

What the kernels compute has to agree with it. The parts stand in the controller's own frame, which
only puts them together.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pinocchio as pin
import pytest
from scipy.optimize import nnls

from app.avoidance.mobile_acceleration import ActingPointFinder
from app.avoidance.task import Distances, TaskRows
from app.border.cache import BorderData
from app.border.contours import Foot
from app.border.offset import OffsetContours
from app.border.score import ScoreField
from app.config import Config, TaskConfig
from app.control import controller as controller_module
from app.control.controller import Controller
from app.control.limits import ArmNow
from app.control.qp import Limits, Objective, TaskQP
from app.control.tasks import EndEffectorError, EqualityTask
from app.robot.model import RobotModel
from app.robot.state import Measurement, RobotState

Array = np.ndarray
AXES = pin.LOCAL_WORLD_ALIGNED
NONE = np.zeros(0)


class PlainState(RobotState):
    """Kinematics and dynamics by pinocchio's own functions and the matrix S."""

    def update(self, measurement: Measurement) -> None:
        model, data, S = self.model, self.data, self.model.S
        self.measurement = measurement
        wheels = np.linalg.solve(model.J_m, measurement.base_velocity)
        self.qd = np.concatenate([wheels, measurement.qd_m])
        q, v = model.configuration(measurement.base_pose, measurement.q_m), S @ self.qd
        pin.computeAllTerms(model.pin, data, q, v)
        self.M, self.h, self.g = S.T @ data.M @ S, S.T @ data.nle, S.T @ data.g
        pin.forwardKinematics(model.pin, data, q, v, np.zeros(model.pin.nv))
        self.T_world_ee = pin.updateFramePlacement(model.pin, data, model.ee_frame)
        self.J_ee = pin.getFrameJacobian(model.pin, data, model.ee_frame, AXES) @ S
        self.v_ee = self.J_ee @ self.qd
        self.Jdqd_ee = pin.getFrameClassicalAcceleration(
            model.pin, data, model.ee_frame, AXES
        ).vector
        self.R_world_base, self.p_o = data.oMi[1].rotation, data.oMi[1].translation

    def point_jacobian(self, joint: int, p_world: Array) -> Array:
        J = pin.getJointJacobian(self.model.pin, self.data, joint, AXES)
        lever = pin.skew(p_world - self.data.oMi[joint].translation)
        return (J[:3] - lever @ J[3:]) @ self.model.S

    def point_bias(self, joint: int, p_world: Array) -> Array:
        a = pin.getClassicalAcceleration(self.model.pin, self.data, joint, AXES)
        placement = self.data.oMi[joint]
        w = pin.skew(placement.rotation @ self.data.v[joint].angular)
        r = p_world - placement.translation
        return a.linear + pin.skew(a.angular) @ r + w @ (w @ r)

    def pair_motions(self, joints: Array, p: Array, n: Array) -> tuple[Array, Array, Array]:
        """As seen from the first body: nᵀ(a_b - a_a - 2 ω_a × v)."""
        rows = [self._pair_motion(*each) for each in zip(joints, p, n, strict=True)]
        J, bias, speed = (np.array(each) for each in zip(*rows, strict=True))
        return J, bias, speed

    def _pair_motion(self, joints: Array, p: Array, n: Array) -> tuple[Array, float, float]:
        joint_a, joint_b = joints.tolist()
        J = self.point_jacobian(joint_b, p) - self.point_jacobian(joint_a, p)
        v = J @ self.qd
        w = self.data.oMi[joint_a].rotation @ self.data.v[joint_a].angular
        bias = self.point_bias(joint_b, p) - self.point_bias(joint_a, p) - 2 * np.cross(w, v)
        return n @ J, float(n @ bias), float(n @ v)


class PlainSurface:
    """The nearest point of the border around one shape, by trying every edge of its contour."""

    def __init__(self, offset: OffsetContours) -> None:
        self._table = offset.table

    def nearest(self, p: Array) -> Foot | None:
        heights = self._table.heights
        z = float(np.clip(p[2], heights[0], heights[-1]))
        k = min(int(np.searchsorted(heights, z, side="right")) - 1, len(heights) - 2)
        share = (z - heights[k]) / (heights[k + 1] - heights[k])
        corners, tangents = (
            (1 - share) * rows[k] + share * rows[k + 1]
            for rows in (self._table.vertices, self._table.tangents)
        )
        to_p = complex(p[0], p[1]) - corners
        ahead = (to_p * tangents.conj()).real
        found = []
        for i in np.flatnonzero((ahead[:-1] >= 0) & (ahead[1:] < 0)):
            edge, turn = corners[i + 1] - corners[i], tangents[i + 1] - tangents[i]
            # (to_p - s edge) · (t + s turn) = 0, the root within the edge
            a, b, c = (
                dot(-edge, turn),
                dot(to_p[i], turn) - dot(edge, tangents[i]),
                dot(to_p[i], tangents[i]),
            )
            roots = np.roots([a, b, c])
            inside = [s.real for s in roots if abs(s.imag) < 1e-9 and -1e-9 <= s.real <= 1 + 1e-9]
            s = float(np.clip(inside[0], 0.0, 1.0)) if inside else 0.0
            found.append((abs(to_p[i] - s * edge), i, s))
        _, i, s = min(found)
        xy = corners[i] + s * (corners[i + 1] - corners[i])
        t = tangents[i] + s * (tangents[i + 1] - tangents[i])
        t /= abs(t)
        return Foot(np.array([xy.real, xy.imag, p[2]]), np.array([t.real, t.imag, 0.0]))


def dot(a: complex, b: complex) -> float:
    """Of two vectors x + iy."""
    return (a * b.conjugate()).real


class PlainField(ScoreField):
    """(9), (10) and the gradient as they stand, R bent below 0.05 C."""

    def at_point(self, p: Array) -> tuple[float, Array]:
        out = p - self.p_base
        rho, R_1 = float(np.linalg.norm(out)), 0.05 * self.C
        R, slope = self.C - self.A * (rho - self.B) ** 2, 1.0
        if R < R_1:
            R, slope = R_1**2 / (2 * R_1 - R), (R_1 / (2 * R_1 - R)) ** 2
        signed, by_point = self.base.singularity(p)
        by_rho = -2 * self.A * (rho - self.B) * slope
        return float(signed * R), signed * by_rho * out / rho + by_point * R


class PlainQP(TaskQP):
    """The optimum by least distance programming: one non-negative least-squares problem.

    Attributes:
        limited: How many answers met a limit.
    """

    limited = 0

    def solve(self, objective: Objective, limits: Limits, given: Array = NONE) -> Array:
        k, (C, l, u, softness) = len(given), limits
        if k:  # the same over the others
            H, c = objective
            rest = Objective(H[k:, k:], c[k:] + H[k:, :k] @ given)
            there = C[:, :k] @ given
            limits = Limits(C[:, k:], l - there, u - there, softness)
            return np.concatenate([given, self.solve(rest, limits)])
        H, c = objective
        free = np.linalg.solve(H, -c)
        if ((C @ free >= l) & (C @ free <= u)).all():
            return free
        self.limited += 1
        L, inverse = np.linalg.cholesky(H), np.linalg.inv(H)
        own = np.diag(C @ inverse @ C.T)
        own = min(own[softness > 0.0].min(initial=np.inf), 1e9)
        A = np.hstack([C @ np.linalg.inv(L).T, np.diag(np.sqrt(softness * own))[:, softness > 0.0]])
        G, h = np.vstack([A, -A]), np.concatenate([l - C @ free, C @ free - u])
        length = np.linalg.norm(G, axis=1)
        kept = np.isfinite(h)
        G, h = (G / length[:, None])[kept], (h / length)[kept]
        E = np.vstack([G.T, h / h.max()])
        r = E @ nnls(E, np.eye(len(E))[-1])[0] - np.eye(len(E))[-1]
        z = -h.max() * r[:-1] / r[-1]
        return free + np.linalg.solve(L.T, z[: len(free)])

    def change(self, objective: Objective, limits: Limits, given: Array) -> Array:
        """The change of what is given, from the least with it and without limits."""
        (H, c), (C, l, u, softness), k = objective, limits, len(given)
        free = np.concatenate([given, np.linalg.solve(H[k:, k:], -c[k:] - H[k:, :k] @ given)])
        beyond = Limits(C, l - C @ free, u - C @ free, softness)
        return self.solve(Objective(H, np.zeros(len(c))), beyond)[:k]


def plain_rows(
    objective: Objective, rows: Sequence[TaskRows], softness: float, given: int = 0
) -> Objective:
    """Springs with compliances (1 - β + ε)/β times J_i H⁻¹ J_iᵀ, over what is not given."""
    H, c = objective
    inverse, H, c = np.zeros_like(H), H.copy(), c.copy()
    inverse[given:, given:] = np.linalg.inv(H[given:, given:])
    for row in rows:
        for J, b in zip(row.J, row.xdd - row.Jdqd, strict=True):
            if row.beta > 0.0:
                w = row.beta / ((1.0 - row.beta + softness) * (J @ inverse @ J))
                H += w * np.outer(J, J)
                c -= w * b * J
    return Objective(H, c)


def plain_limits(
    state: RobotState,
    config: Config,
    kept: Distances | None = None,
    *,
    arm: ArmNow | None = None,
) -> Limits:
    """Rows of torques, of joints, of barriers, as `robot_limits` says."""
    M, h_a, m, model = state.M, state.h[2:], state.measurement, state.model
    low, high = model.tau_limits if arm is None else arm.torque
    limit, softness = config.limit, config.task.softness
    rate = limit.position_rate
    position = rate**2 * (model.q_limits - m.q_m) - 2 * rate * m.qd_m
    velocity = limit.velocity_rate * (model.qd_limits - m.qd_m)
    both = np.maximum(position[0], velocity[0]), np.minimum(position[1], velocity[1])
    lower, upper = np.sort(both, axis=0)
    extra, inverse = np.zeros(model.n_m), np.linalg.inv(M[2:, 2:])
    if arm is not None:  # no joint asks for more than its own torque gives, or takes back in time
        extra, own = arm.pushed, np.diag(inverse) * (high - low) / 2
        room = np.maximum((model.qd_limits - m.qd_m) * np.array([[-1.0], [1.0]]), 0.0)
        slower, faster = np.sqrt(2.0 * np.diag(inverse) * limit.torque_rate * room)
        lower, upper = (
            np.maximum(lower, np.minimum(-slower, upper)),
            np.minimum(upper, np.maximum(faster, lower)),
        )
        there = inverse @ ((low + high) / 2 - M[2:, :2] @ arm.qdd_b - h_a) + extra
        lower, upper = np.minimum(lower, there + own), np.maximum(upper, there - own)
    n = model.n_m
    most = model.qd_max  # joints' rows are in shares of it
    J, least = np.zeros((0, n + 2)), NONE
    if kept is not None:
        J, keep = kept.J, config.barrier
        h = np.maximum(kept.d, -keep.leaving / keep.rate)
        least = -2 * keep.rate * kept.speed - keep.rate**2 * h - kept.Jdqd
    C, least = np.vstack([M[2:], np.eye(n + 2)[2:] / most[:, None], J]), least - J[:, 2:] @ extra
    return Limits(
        C,
        np.concatenate([low - h_a, (lower - extra) / most, least]),
        np.concatenate([high - h_a, (upper - extra) / most, np.full(len(least), np.inf)]),
        np.repeat([0.0, softness**2], [n, n + len(least)]),
    )


def plain_posture(state: RobotState, q_posture: Array, config: TaskConfig) -> Objective:
    """½ ‖q̈_m - k (q_p - q) + d q̇ + z s⁵‖² + ½ w_b ‖q̈_b + k q̇_b‖²."""
    m, (lower, upper) = state.measurement, state.model.q_limits
    out = (2.0 * m.q_m - lower - upper) / (upper - lower)
    heavy = np.diag([config.base_weight] * 2 + [1.0] * state.model.n_m)
    wanted = np.concatenate(
        [
            -config.base_damping * state.qd[:2],
            config.posture_stiffness * (q_posture - m.q_m)
            - config.posture_damping * m.qd_m
            - config.centring * (upper - lower) / 2 * out**5,
        ]
    )
    return Objective(heavy, -heavy @ wanted)


def plain_tracking(posture: Objective, task: EqualityTask, weight: float) -> Objective:
    """The posture and ½ w (‖J q̈ - b‖² + λ ‖q̈ + k_v q̇‖²), λ in its weights."""
    J, b, give, drag = task
    H = (1.0 + weight * give) * posture.H + weight * J.T @ J
    return Objective(H, posture.c - weight * (b @ J - give * posture.H @ drag))


def plain_ee_task(state: RobotState, error: EndEffectorError, config: TaskConfig) -> EqualityTask:
    """k_v ė + k_p e beside ẍ_d - J̇ q̇, each half of k_p e no longer than is allowed."""
    k_p, k_v = config.ee_stiffness, config.ee_damping
    halves = np.split(k_p * error.pose, 2)
    most = k_v * config.ee_speed
    pull = np.concatenate([h / max(1.0, np.linalg.norm(h) / most) for h in halves])
    b = error.acceleration + k_v * error.velocity + pull
    return EqualityTask(state.J_ee, b, float(np.sum((pull / k_p) ** 2)), k_v * state.qd)


def plain_torque_range(last: Array, most: Array, change: float) -> Array:
    at = np.clip(last, -most, most)
    return np.array([np.maximum(at - change, -most), np.minimum(at + change, most)])


def plain_carried(state: RobotState, speed: float) -> Array:
    J = state.J_ee[:3, 2:] @ np.diag(state.model.qd_max)
    follows = J @ J.T / speed**2
    return (
        np.linalg.inv(np.eye(3) + follows @ follows)
        @ state.J_ee[:3, :2]
        @ np.linalg.inv(state.model.J_m)
    )


def plain_controller(
    model: RobotModel, data: BorderData, config: Config, monkeypatch: pytest.MonkeyPatch
) -> Controller:
    """A controller of these parts, as long as the patch lasts."""
    monkeypatch.setattr(controller_module, "RobotState", PlainState)
    monkeypatch.setattr(controller_module, "TaskQP", PlainQP)
    plain = Controller(model, data, config)
    surface = PlainSurface(OffsetContours(model, config.border.d_b))
    for pair in data.pairs.mobile:
        field = PlainField(**vars(ScoreField.of(model, pair.b)))
        plain._avoidance._finders[pair.name] = ActingPointFinder(surface, field)
    return plain


def use_plain_parts(monkeypatch: pytest.MonkeyPatch) -> None:
    """While a plain controller steps: its rows, limits and objectives."""
    for name, part in (
        ("insert_rows", plain_rows),
        ("robot_limits", plain_limits),
        ("posture_objective", plain_posture),
        ("end_effector_task", plain_ee_task),
        ("torque_range", plain_torque_range),
        ("tracking_objective", plain_tracking),
        ("carried", plain_carried),
    ):
        monkeypatch.setattr(controller_module, name, part)
