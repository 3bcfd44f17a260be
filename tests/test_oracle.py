"""The quantities of the control step agree with those of a second implementation."""

from __future__ import annotations

from collections.abc import Iterator
from functools import cache
from typing import NamedTuple

import numpy as np
import pinocchio as pin
import pytest

from app.border.cache import BorderData
from app.config import Config
from app.control.controller import Controller
from app.control.quantities import QUANTITIES, ControlStep
from app.control.tasks import Reference
from app.robot.model import RobotModel
from app.robot.shapes import Box
from app.robot.state import Measurement
from tests.bases import KINDS, robot_on
from tests.oracle import ORACLES, STALLED, Oracle
from tests.robots import with_mobile_shapes

Array = np.ndarray

STEPS, DT = 200, 0.004  # [s]
NOISE = 1e-5  # [rad] of the measured positions
GAP = 120
"""The step with a NaN reading."""
RECONFIGURED = 40
"""From this step on, the buffer is wider, and the effective buffer distance follows."""
AGREES = 1e-6
"""[-] tolerance relative to the largest entry of the quantity along the path."""
STILL = 1e-3
"""Smallest scale (SI units) of the base's quantities: at rest they are only rounding errors."""

NOT_COMPARED = {"q_pin", "v_pin"} | {q.name for q in QUANTITIES if q.name.startswith("qp_")}
NOT_COMPARED |= {q.name for q in QUANTITIES if q.source in ("readings", "references")} - {"valid"}
"""Pinocchio's coordinates, quantities of QPs that Python solves, and records of readings and
references, which here are new in every step except `GAP`."""
TRACKING_ONLY = {"x_ref", "v_ref", "a_ref", "e_ee", "b_ee", "lm_damping"}
ACTIVE_ONLY = {"tangent", "alpha"}
OF_BASE = {"a_base_free", "a_base_des", "a_base_cmd", "a_base_meas", "a_sum", "v_cmd", "v_before"}
LIMITS = {"C", "l", "u", "softness"}

DECK = Box(type="box", size_m=(0.99, 0.69, 0.3803), xyz_m=(0.0, 0.0, 0.0579))
WALL = Box(type="box", size_m=(0.30, 0.10, 0.50), xyz_m=(0.30, 0.30, 0.50))
PARTS = "of two parts"


class Path(NamedTuple):
    """A controller, a base and a path."""

    controller: str
    base: str
    way: str
    """"beside": tracked from the side into the buffer and out again; "folded": tracked with the
    end-effector towards the arm's first link; "pulled": guided from the side by a person."""


PATHS = [
    *(Path(name, "differential", way) for name in ORACLES for way in ("beside", "pulled")),
    *(Path(name, "differential", "folded") for name in ("dbb", "repulsive")),
    *(Path("dbb", base, way) for base in (*KINDS[1:], PARTS) for way in ("beside", "pulled")),
    Path("barrier", PARTS, "beside"),
]


@cache
def robot_of(base: str) -> RobotModel:
    """The paper's arm on a base of this kind, or with a deck and a wall as l_m."""
    return with_mobile_shapes((DECK, WALL)) if base == PARTS else robot_on(base)


class Plant:
    """A rigid robot whose base follows commands by its drive; a force can pull its end-effector."""

    def __init__(self, robot: RobotModel, way: str) -> None:
        self._robot, self._base, self._data = robot, robot.description.base, robot.pin.createData()
        self._rng, self._follow = np.random.default_rng(0), self._base.follower(DT)
        self.pose, self.v, self.drive = np.zeros(3), np.zeros(robot.n_b), self._base.drive_at_rest()
        self.v_cmd = np.zeros(robot.n_b)
        self.q = np.array(robot.description.arm.ready_position)
        self._side = 0.68 if len(robot.description.mobile_body.shapes) > 1 else 0.60
        if way != "folded":
            self.q = self._beside()
        J = self.jacobian()[:3]
        self.qd = np.linalg.pinv(J) @ [0.0, -0.3 if way == "pulled" else 0.0, 0.0]
        self.qd += 0.02 * self._rng.normal(size=robot.n_m)

    def _beside(self) -> Array:
        """Joint positions with the end-effector pointing down beside the base."""
        goal = pin.SE3(pin.utils.rotate("x", np.pi), np.array([0.30, self._side, 0.30]))
        for _ in range(200):
            at = self.place()
            e = np.append(
                goal.translation - at.translation, pin.log3(goal.rotation @ at.rotation.T)
            )
            J = self.jacobian()
            step = J.T @ np.linalg.solve(J @ J.T + 1e-3 * np.eye(6), e)
            self.q = np.clip(
                self.q + 0.3 * step, self._robot.q_lower + 0.1, self._robot.q_upper - 0.1
            )
        return self.q

    def place(self) -> pin.SE3:
        """Pose of the end-effector in the world."""
        q = self._robot.configuration(self.pose, self.q)
        pin.computeJointJacobians(self._robot.pin, self._data, q)
        return pin.updateFramePlacement(self._robot.pin, self._data, self._robot.ee_frame).copy()

    def jacobian(self) -> Array:
        """(6, n_m) Jacobian of the end-effector for the arm's joints, in axes of the world."""
        self.place()
        axes = pin.LOCAL_WORLD_ALIGNED
        robot = self._robot
        return pin.getFrameJacobian(robot.pin, self._data, robot.ee_frame, axes)[:, 3:]

    def measure(self) -> Measurement:
        """The readings; those of the joint positions and velocities have white noise."""
        q = self.q + NOISE * self._rng.normal(size=len(self.q))
        qd = self.qd + 100 * NOISE * self._rng.normal(size=len(self.q))
        return Measurement(self.pose.copy(), self.v.copy(), q, qd, self.drive.copy())

    def acceleration(self) -> Array:
        """(n_b,) [m/s², rad/s²] current acceleration of the drive."""
        return self._base.drive_acceleration(self.v, self.drive, self.v_cmd)

    def move(self, u: Array, v_cmd: Array, force: Array) -> None:
        """Advance one control period with torques u and a force (3,) [N] on the end-effector."""
        model, n_b = self._robot, self._robot.n_b
        q = model.configuration(self.pose, self.q)
        twist = self._base.T @ self.v
        a = self._base.T @ self.acceleration()
        v = np.append(twist, self.qd)
        M = pin.crba(model.pin, self._data, q)
        M = np.triu(M) + np.triu(M, 1).T
        h = pin.nonLinearEffects(model.pin, self._data, q, v)
        pull = self.jacobian()[:3].T @ force
        self.qd = self.qd + DT * np.linalg.solve(M[3:, 3:], u + pull - h[3:] - M[3:, :3] @ a)
        self.q, self.v_cmd = self.q + DT * self.qd, v_cmd.copy()
        v_b, self.drive = self._follow(self.v.tolist(), self.drive, v_cmd.tolist())
        cos, sin = np.cos(self.pose[2]), np.sin(self.pose[2])
        self.pose = self.pose + DT * np.array([[cos, -sin, 0], [sin, cos, 0], [0, 0, 1]]) @ twist
        self.v = np.array(v_b)
        assert len(self.v) == n_b


def reference_at(t: float, start: pin.SE3, way: str) -> Reference | None:
    """The reference at t [s], in and out along the direction `way`; None if `way` is "pulled"."""
    if way == "pulled":
        return None
    along = np.array([0.0, -0.12, 0.0] if way == "beside" else [-0.08, 0.0, -0.03])
    w = 2 * np.pi / (STEPS * DT)
    share, speed, change = (1 - np.cos(w * t)) / 2, w * np.sin(w * t) / 2, w**2 * np.cos(w * t) / 2
    pose = pin.SE3(
        start.rotation @ pin.exp3(0.1 * share * np.ones(3)), start.translation + share * along
    )
    still = np.zeros(3)
    return Reference(pose, np.append(speed * along, still), np.append(change * along, still))


def along(
    path: Path, data: BorderData, steps: int = STEPS
) -> Iterator[tuple[ControlStep, dict[str, Array]]]:
    """Both results at each step of a path; the robot follows the commands of the controller."""
    robot, config = robot_of(path.base), Config()
    controller = Controller(robot, data, config, name=path.controller, dt=DT)
    oracle = Oracle(robot, data, config, path.controller, DT)
    plant = Plant(robot, path.way)
    start = plant.place()
    for k in range(steps):
        if k == RECONFIGURED:
            for each in (controller, oracle):
                each.configure(config.replace("border.d_b", 0.17))
        m = plant.measure()
        if k == GAP:
            m = m._replace(q_m=m.q_m * np.nan)
            controller.last.age[...] = (
                STALLED  # periods without a reading, too many for a prediction
            )
        given = m, reference_at(k * DT, start, path.way)
        a = plant.acceleration() if k % 50 < 25 else None
        step = controller.step(*given, base_acceleration=a)
        yield step, oracle.step(*given, base_acceleration=a)
        force = np.array([0.0, -20.0 if k < STEPS / 2 else 40.0, 0.0]) * (path.way == "pulled")
        plant.move(step.u_cmd, step.v_cmd, force)


def comparable(name: str, step: ControlStep, plain: dict[str, Array]) -> tuple[Array, Array]:
    """The comparable entries of a quantity: those of the controller and those of the oracle."""
    ours, theirs = np.atleast_1d(getattr(step, name)), np.atleast_1d(plain[name])
    if name in LIMITS:
        ours = ours[: len(theirs)]
    if name in ("J_sca", "b_sca"):  # rows of T_rep, only where they are active
        there = plain["B"] > 0.0
        there[: -3 * step.n_mob] = True
        return ours[there], theirs[there]
    if name in ACTIVE_ONLY:
        there = plain["beta"][: step.n_mob] > 0.0
        return ours[there], theirs[there]
    return ours, theirs


def differences(step: ControlStep, plain: dict[str, Array]) -> dict[str, tuple[float, float]]:
    """For each quantity its largest difference, infinite if only one is NaN, and its size."""
    found = {}
    for name in (q.name for q in QUANTITIES if q.name not in NOT_COMPARED):
        if name in TRACKING_ONLY and not plain["tracking"]:
            continue
        ours, theirs = comparable(name, step, plain)
        differ = (ours != theirs) & ~(np.isnan(ours) & np.isnan(theirs))
        away = np.abs(ours[differ] - theirs[differ]).max(initial=0.0)
        size = np.abs(theirs[np.isfinite(theirs)]).max(initial=0.0)
        found[name] = float(away if np.isfinite(away) else np.inf), float(size)
    return found


def first_disagreements(
    steps: list[dict[str, tuple[float, float]]],
) -> dict[str, tuple[int, float]]:
    """The quantities that differ, with the first such step and the largest relative difference."""
    found = {}
    for name in dict.fromkeys(name for step in steps for name in step):
        away, size = np.array([step.get(name, (0.0, 0.0)) for step in steps]).T
        share = away / max(size.max() or 1.0, STILL if name in OF_BASE else 0.0)
        if share.max() >= AGREES:
            found[name] = int(np.argmax(share >= AGREES)), float(share.max())
    return found


@pytest.mark.parametrize("path", PATHS, ids=["-".join(path).replace(" ", "_") for path in PATHS])
def test_every_quantity_agrees_along_a_path(path: Path, border_data: BorderData) -> None:
    steps, rows, failures, blind = [], [], 0.0, DT
    for step, plain in along(path, border_data):
        blind = max(blind, float(step.blind_time))
        steps.append(differences(step, plain))
        rows.append(np.append(plain["B"], plain["beta"]) > 0.0)
        failures = float(plain["failures"])
    assert first_disagreements(steps) == {}
    changes = np.diff(np.array(rows).astype(int), axis=0)
    assert np.array(rows).any(), "no row is active"
    assert changes.any() or path.controller != "dbb", "no row enters or leaves"
    assert failures == 1.0  # the NaN reading
    if path.way == "pulled" and path.controller != "none" and path.base != PARTS:
        assert blind > DT, "the rates of rare readings are not compared"


def test_every_quantity_of_the_table_is_compared(border_data: BorderData) -> None:
    """The oracle computes exactly the quantities outside `NOT_COMPARED`, and all are compared."""
    path = Path("dbb", "differential", "beside")
    step, plain = next(along(path, border_data, steps=1))
    named = {q.name for q in QUANTITIES} - NOT_COMPARED
    assert set(plain) == named
    assert set(differences(step, plain)) == named


def test_a_step_reads_only_the_listed_quantities_of_the_last_step(border_data: BorderData) -> None:
    """NaN in all other quantities of the last step does not change the results."""
    memory = {q.name for q in QUANTITIES if q.meaning.startswith("memory")}
    listed = {"M", "h", "L_aa", "J_ee", "v_ee", "p_ee", "p_o", "base_velocity", "a_base_meas"}
    others = [q.name for q in QUANTITIES if q.name not in memory | listed]
    path = Path("dbb", "differential", "beside")
    robot = robot_of(path.base)
    plain, spoiled = (Controller(robot, border_data, Config(), dt=DT) for _ in range(2))
    plant = Plant(robot, path.way)
    start = plant.place()
    for k in range(60):
        measured = plant.measure()
        jumps = measured.base_pose + np.array([0.05 * (k >= 45), 0.0, 0.0])  # of the localisation
        measured = measured._replace(base_pose=jumps)
        given = measured, reference_at(k * DT, start, path.way) if k % 20 < 10 else None
        a, b = (each.step_with_drive(*given) for each in (plain, spoiled))
        for name in memory | {"u_cmd", "v_cmd", "qdd", "a_base_cmd"}:
            np.testing.assert_array_equal(getattr(a, name), getattr(b, name), err_msg=name)
        plant.move(a.u_cmd, a.v_cmd, np.zeros(3))
        for name in others:
            getattr(spoiled.last, name)[...] = np.nan
