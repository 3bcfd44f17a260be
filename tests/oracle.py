"""The control step from straightforward parts: numpy and pinocchio, nothing clever.

What the kernels compute has to agree with it. The parts stand in the controller's own frame, which
only puts them together.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from app.control.hqp import EqualityTask, HierarchicalQP, Limits, Objective, Solution

from app.avoidance.acting_point import ActingPointFinder
from app.border.cache import BorderData
from app.border.dbb import construct_dbb
from app.border.offset import RAYS, OffsetContours
from app.border.score import ScoreField
from app.border.surface import BorderSurface, Foot
from app.config import Config, LimitConfig
from app.control import controller as controller_module
from app.control.controller import Controller
from app.control.limits import position_bounds, velocity_bounds
from app.control.tasks import free_arm_torque
from app.control.transition import TaskTransition
from app.robot.model import RobotModel
from app.robot.state import Measurement, RobotState

Array = np.ndarray
AXES = pin.LOCAL_WORLD_ALIGNED


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

    def pair_motion(
        self, joint_a: int, p_a: Array, joint_b: int, p_b: Array, n: Array
    ) -> tuple[Array, float, float, float]:
        J = self.point_jacobian(joint_b, p_b) - self.point_jacobian(joint_a, p_a)
        velocity = J @ self.qd
        bias = self.point_bias(joint_b, p_b) - self.point_bias(joint_a, p_a)
        across = velocity - (n @ velocity) * n
        return n @ J, float(n @ bias), float(n @ velocity), float(across @ across)

    def pair_speed(self, *pair: Any) -> float:
        return self.pair_motion(*pair)[2]


class PlainSurface:
    """The nearest point of a border by trying every edge of its contour."""

    def __init__(self, surface: BorderSurface, offset: OffsetContours) -> None:
        self._gap, self._offset = surface.gap, offset

    def nearest(self, p: Array) -> Foot | None:
        heights = self._offset.heights
        z = float(np.clip(p[2], heights[0], heights[-1]))
        k = min(int(np.searchsorted(heights, z, side="right")) - 1, len(heights) - 2)
        share = (z - heights[k]) / (heights[k + 1] - heights[k])
        corners, tangents = (
            (1 - share) * rows[k] + share * rows[k + 1]
            for rows in (self._offset.tables.vertices, self._offset.tables.tangents)
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
            found.append((abs(to_p[i] - s * edge), i + s))
        ray = min(found)[1] if found else float(np.abs(to_p[:-1]).argmin())
        centre, half = ((1 - share) * values[k] + share * values[k + 1] for values in self._gap)
        inside_gap = (ray - centre + RAYS / 2) % RAYS - RAYS / 2
        if abs(inside_gap) < half:
            ray = (centre + (half if inside_gap >= 0 else -half)) % RAYS
        i, s = int(ray) % RAYS, ray % 1.0
        xy = corners[i] + s * (corners[i + 1] - corners[i])
        t = tangents[i] + s * (tangents[i + 1] - tangents[i])
        t /= abs(t)
        return Foot(np.array([xy.real, xy.imag, p[2]]), np.array([t.real, t.imag, 0.0]))


def dot(a: complex, b: complex) -> float:
    """Of two vectors x + iy."""
    return (a * b.conjugate()).real


class PlainField(ScoreField):
    """Score and gradient each by its own formula."""

    def at_point(self, p: Array) -> tuple[float, Array]:
        return float(self.score(p)), self.gradient(p)


class PlainHQP(HierarchicalQP):
    """Levels by the singular value decomposition; ProxQP, begun anew, where a limit is met."""

    def solve(
        self, levels: Sequence[EqualityTask], objective: Objective, limits: Limits, *,
        slot: str = "",
    ) -> Solution:  # fmt: skip
        self._qps.clear()  # begun anew
        del slot
        x, Z = np.zeros(self._n), np.eye(self._n)
        for p, (J, b) in enumerate(levels):
            JZ, residual = J @ Z, b - J @ x
            U, s, Vt = np.linalg.svd(JZ)
            rank = int((s > 1e-7).sum())
            candidate = x + Z @ (Vt[:rank].T / s[:rank]) @ U[:, :rank].T @ residual
            if not _kept(limits, candidate):
                found = self._solve_qp("", p, JZ.T @ JZ, -(JZ.T @ residual), x, Z, limits)
                candidate = x + Z @ found.polished(least_squares_from(JZ, residual))
            x, Z = candidate, Z @ Vt[rank:].T
        if Z.shape[1]:
            H, c = Z.T @ objective.H @ Z, Z.T @ (objective.H @ x + objective.c)
            candidate = x - Z @ np.linalg.solve(H, c)
            if not _kept(limits, candidate):
                found = self._solve_qp("", len(levels), H, c, x, Z, limits)
                candidate = x + Z @ found.polished(minimum_from(H, c))
            x = candidate
        return Solution(x, tuple(b - J @ x for J, b in levels))


def minimum_from(H: Array, c: Array) -> Callable[[Array, Array], Array]:
    return lambda y, N: y - N @ np.linalg.solve(N.T @ H @ N, N.T @ (H @ y + c))


def least_squares_from(J: Array, b: Array) -> Callable[[Array, Array], Array]:
    return lambda y, N: y + N @ np.linalg.lstsq(J @ N, b - J @ y, rcond=None)[0]


def _kept(limits: Limits, x: Array) -> bool:
    reached = limits.C @ x
    return bool(((reached >= limits.l - 1e-8) & (reached <= limits.u + 1e-8)).all())


def plain_limits(state: RobotState, config: LimitConfig, qdd_b: Array) -> Limits:
    """Rows of torques, of joints, of the base, as `robot_limits` says."""
    model, n_m = state.model, state.model.n_m
    M_a, h_a = state.M[2:], state.h[2:]
    bounds = np.array([position_bounds(state, config), velocity_bounds(state, config)])
    lower, upper = np.sort([bounds[:, 0].max(axis=0), bounds[:, 1].min(axis=0)], axis=0)
    tau = np.array([-model.tau_max - h_a, model.tau_max - h_a])
    coupling, tamest = M_a[:, :2] @ qdd_b, np.clip(0.0, lower, upper)
    wanted = M_a[:, 2:] @ tamest + coupling
    possible = np.clip(wanted, *tau)
    if (possible != wanted).any():
        tamest = np.linalg.solve(M_a[:, 2:], possible - coupling)
        lower, upper = np.minimum(lower, tamest), np.maximum(upper, tamest)
    C = np.zeros((2 * n_m + 2, model.n))
    C[:n_m], C[n_m : 2 * n_m, 2:], C[2 * n_m :, :2] = M_a, np.eye(n_m), model.J_m
    a = model.base_acceleration_max
    return Limits(C, np.concatenate([tau[0], lower, -a]), np.concatenate([tau[1], upper, a]))


def plain_guided(state: RobotState, base: tuple[Array, Array] | None = None) -> Objective:
    """½ (u_a - u_0)ᵀ M_aa⁻¹ (u_a - u_0) multiplied out, and what the base costs."""
    M_a, inverse = state.M[2:], np.linalg.inv(state.M[2:, 2:])
    c_a = state.h[2:] - free_arm_torque(state)
    H, c = M_a.T @ inverse @ M_a, M_a.T @ inverse @ c_a
    H_b, c_b = base if base is not None else (np.eye(2), np.zeros(2))
    H[:2, :2] += H_b
    c[:2] += c_b
    return Objective(H, c)


def plain_controller(
    model: RobotModel, data: BorderData, config: Config, monkeypatch: pytest.MonkeyPatch
) -> Controller:
    """A controller of these parts, as long as the patch lasts."""
    monkeypatch.setattr(controller_module, "RobotState", PlainState)
    monkeypatch.setattr(controller_module, "HierarchicalQP", PlainHQP)
    plain = Controller(model, data, config)
    offset = OffsetContours(model, config.border.d_b)
    for pair in data.pairs.mobile:
        border = construct_dbb(data.clouds[pair.name], config.border.d_b, config.border.eps)
        surface = PlainSurface(BorderSurface(border, offset), offset)
        field = PlainField(**vars(ScoreField.of(model, pair.b)))
        plain._avoidance._finders[pair.name] = ActingPointFinder(surface, field)
    assert isinstance(plain._transition, TaskTransition)
    return plain


def use_plain_parts(monkeypatch: pytest.MonkeyPatch) -> None:
    """While a plain controller steps: its limits and its guided arm's objective."""
    monkeypatch.setattr(controller_module, "robot_limits", plain_limits)
    monkeypatch.setattr(controller_module, "guided_arm_objective", plain_guided)
