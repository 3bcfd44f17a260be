"""The joints that move one body of the arm as a chain, and all inverse kinematics solutions of it.

They are found by formulas if there are any, else by restarts.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import combinations
from typing import Any

import numpy as np
import pinocchio as pin
from scipy.optimize import root

from app.errors import ConfigError, DescriptionError
from app.robot.model import RobotModel

try:
    from eaik.IK_HP import HPRobot
except ModuleNotFoundError:  # it has no wheels for CPython 3.14
    HPRobot = None

Array = np.ndarray

_TRIALS = 4  # [-] configurations in which a chain is asked for its rank
_SINGULAR = 1e-6  # [m/rad or -] singular value of a lost direction
_LEAST_JOINTS = 3  # fewer do not fill a volume
_POSE_TOLERANCE = 1e-6  # [m, rad] by which a solution may miss its pose
_SAME = 1e-3  # [rad or m] solutions nearer to each other than this are one
_FREE_TRIALS = 20  # [-] configurations with which a choice of free joints is tried out
_LOST = 1e-9  # determinants below this are zero


def reach_bodies(model: RobotModel) -> list[str]:
    """Names of the bodies that at least three joints of the arm move, the outermost first."""
    names = model.body_names[:0:-1]
    return [name for name in names if len(_moving_joints(model, name)) >= _LEAST_JOINTS]


class Chain:
    """A body's joints, the base at the origin, then unlimited ones for what its pose leaves open.

    The body that carries the end-effector has the end-effector's pose; any other has the position
    of the middle of its first shape and the direction of that shape's z axis, which is a capsule's
    own. With k joints the pose has six numbers (k ≥ 6), five, the direction without the turn about
    it (k = 5), or three, the position (k = 3, 4); fewer where the
    joints lose a direction for good. What is not asked for is given to one or three unlimited
    joints at the body's point, so that the chain always has to meet a full pose.

    Attributes:
        body: Name of the body.
        pin: pinocchio's model of the chain: the arm's joints, then the unlimited ones.
        joints: Indices within the arm of the joints that move the body.
        asked: Numbers of the pose: 6, 5 or 3.
        free: How many joints have to be given before the others are determined.
        lower, upper: (n,) [rad or m] limits; infinite for the unlimited joints.
        turns: (n,) whether a joint is revolute.
    """

    def __init__(self, model: RobotModel, body: str) -> None:
        """Cut the chain of a body out of the robot.

        Raises:
            ConfigError: Fewer than three joints move the body; lists those that can be asked for.
        """
        joints = _moving_joints(model, body)
        if len(joints) < _LEAST_JOINTS:
            raise ConfigError(
                f"{body}: only {len(joints)} of the arm's joints move it, a reachability needs "
                f"{_LEAST_JOINTS}; choose from: {', '.join(reach_bodies(model)) or '(none)'}"
            )
        self.body = body
        self.joints = [joint - 2 for joint in joints]
        still = [j for j in range(1, model.pin.njoints) if j not in joints]
        for self.asked in [numbers for numbers in (6, 5, 3) if numbers <= len(joints)]:
            self.pin = pin.buildReducedModel(model.pin, still, pin.neutral(model.pin))
            self._end, self._placement = len(joints), _carrier(model, body)[1]
            self._add_unlimited()
            if self._meets_poses():
                break
        self.free = len(joints) - self.asked
        open_ends = np.full(6 - self.asked, np.inf)
        self.lower = np.concatenate([model.q_lower[self.joints], -open_ends])
        self.upper = np.concatenate([model.q_upper[self.joints], open_ends])
        self.turns = np.array([_is_revolute(joint) for joint in self.pin.joints][1:])
        self._data = self.pin.createData()

    @property
    def size(self) -> int:
        """Joints of the chain, the unlimited ones included."""
        return len(self.lower)

    def pose(self, q: Array) -> pin.SE3:
        """T_base_point at joint positions (n,)."""
        pin.forwardKinematics(self.pin, self._data, q)
        return self._data.oMi[self._end] * self._placement

    def pose_and_jacobian(self, q: Array) -> tuple[pin.SE3, Array]:
        """The same and the (6, n) Jacobian, linear over angular, in the point's own axes."""
        J = pin.computeJointJacobians(self.pin, self._data, q)
        at = self._data.oMi[self._end] * self._placement
        return at, at.inverse().action @ J

    def axes(self) -> tuple[Array, Array]:
        """The joints' directions (n, 3) and points (n, 3) [m] on them at q = 0, in the base frame.

        Every joint must be revolute.
        """
        q = np.zeros(self.size)
        J = pin.computeJointJacobians(self.pin, self._data, q)
        points = np.array([at.translation for at in self._data.oMi[1:]])
        return J[3:].T.copy(), points

    def longest(self, p_base: Array) -> float:
        """[m] bound of the distance between the mount and the body's point."""
        pin.forwardKinematics(self.pin, self._data, np.zeros(self.size))
        first = float(np.linalg.norm(self._data.oMi[1].translation - p_base))
        links = [np.linalg.norm(at.translation) for at in self.pin.jointPlacements[2:]]
        slides = np.maximum(np.abs(self.lower), np.abs(self.upper))[~self.turns]
        return first + float(
            sum(links) + slides.sum() + np.linalg.norm(self._placement.translation)
        )

    def random(self, rng: np.random.Generator) -> Array:
        """(n,) joint positions within the limits; a joint of more than one turn within one turn."""
        low = np.where(np.isfinite(self.lower), self.lower, -np.pi)
        high = np.where(np.isfinite(self.upper), self.upper, np.pi)
        return rng.uniform(low, np.where(self.turns, np.minimum(high, low + 2 * np.pi), high))

    def within(self, q: Array) -> Array:
        """(K, n) those rows of q (K, n) that are within the limits, whole turns apart."""
        limited = np.isfinite(self.lower)
        q = q.copy()
        wraps = limited & self.turns
        q[:, wraps] = self.lower[wraps] + (q[:, wraps] - self.lower[wraps]) % (2 * np.pi)
        q[:, ~limited] = 0.0
        slack = 1e-9  # [rad or m] of rounding
        inside = (q >= self.lower - slack) & (q <= self.upper + slack)
        return q[inside.all(axis=1)]

    def _meets_poses(self) -> bool:
        """Whether the chain moves its point in all six directions somewhere."""
        data, rng = self.pin.createData(), np.random.default_rng(0)
        for _ in range(_TRIALS):
            J = pin.computeJointJacobians(self.pin, data, rng.uniform(-1, 1, self.pin.nq))
            if np.linalg.matrix_rank(J, tol=_SINGULAR) == 6:
                return True
        return False

    def _add_unlimited(self) -> None:
        """One joint about the body's axis, or three about its point."""
        kinds = {
            6: (),
            5: (pin.JointModelRZ,),
            3: (pin.JointModelRZ, pin.JointModelRY, pin.JointModelRX),
        }[self.asked]
        for i, kind in enumerate(kinds):
            self._end = self.pin.addJoint(self._end, kind(), self._placement, f"unlimited_{i}")
            self._placement = pin.SE3.Identity()


def _moving_joints(model: RobotModel, body: str) -> list[int]:
    """Pinocchio's joints of the arm between the base and a body's point."""
    return [joint for joint in model.pin.supports[_carrier(model, body)[0]] if joint > 1]


def _carrier(model: RobotModel, body: str) -> tuple[int, pin.SE3]:
    """Pinocchio's joint that carries a body's point, and where the point's frame stands on it."""
    if model.description.arm.end_effector_link in model.description.body(body).covers:
        frame = model.pin.frames[model.ee_frame]
        return frame.parentJoint, frame.placement
    shape = model.geometry.geometryObjects[model.shape_ids[body][0]]
    return shape.parentJoint, shape.placement


def _is_revolute(joint: pin.JointModel) -> bool:
    return joint.shortname().startswith("JointModelR")


def make_solver(chain: Chain, restarts: int) -> AnalyticSolver | RestartSolver:
    """The solver of a chain; of the choices of free joints it takes the outermost that works.

    A pose counts as done after so many restarts in a row that find nothing new.

    Raises:
        DescriptionError: The arm's joints do not fill the space of the body's poses.
    """
    if HPRobot is not None and chain.turns.all():
        for free in _choices(chain):
            if (solver := _complete_analytic(chain, free)) is not None:
                return solver
    return RestartSolver(chain, free_joints(chain), restarts)


def free_joints(chain: Chain) -> tuple[int, ...]:
    """Indices of the outermost joints that may be held while the others meet a pose.

    Raises:
        DescriptionError: There are none with which they do.
    """
    free = next(_choices(chain), None)
    if free is None:
        raise DescriptionError(
            f"arm.joints: no pose determines the {len(chain.joints)} joints that move {chain.body}"
        )
    return free


def _complete_analytic(chain: Chain, free: tuple[int, ...]) -> AnalyticSolver | None:
    """The analytic solver of a choice of free joints, if there is one that finds everything."""
    try:
        solver = AnalyticSolver(chain, free)
        return solver if solver.is_complete() else None
    except RuntimeError:  # how EAIK says that it has no decomposition for these axes
        return None


class AnalyticSolver:
    """EAIK's decomposition into geometric subproblems, for chains of revolute joints.

    Without EAIK, which is not there on every Python, the restarts find the same, more slowly.

    Attributes:
        method: Its name.
        free: Indices within the chain of the joints that are held.
    """

    method = "analytic"

    def __init__(self, chain: Chain, free: tuple[int, ...]) -> None:
        """Derive the decomposition for a choice of free joints."""
        self.free = free
        self._chain = chain
        axes, points = chain.axes()
        end = chain.pose(np.zeros(chain.size))
        places = np.vstack([np.zeros(3), points, end.translation])
        self._axes, self._offsets = axes, np.diff(places, axis=0)
        self._unturned = end.rotation.T
        self._robot = None if free else self._held(np.empty(0))

    def is_complete(self) -> bool:
        """Whether it finds, for random configurations, each of them among its solutions.

        Raises:
            RuntimeError: EAIK knows no decomposition.
        """
        rng, held = np.random.default_rng(0), list(self.free)
        for q in (self._chain.random(rng) for _ in range(_FREE_TRIALS)):
            found = self.solve(self._chain.pose(q).copy(), q[held], rng)
            if not (_gaps(found, q, self._chain) < _SAME).any():
                return False
        return True

    def solve(self, target: pin.SE3, held: Array, rng: np.random.Generator) -> Array:
        """(K, n) [rad or m] distinct solutions, joint limits not yet regarded.

        Args:
            target: T_base_point.
            held: (len(free),) [rad or m] positions of the free joints.
            rng: For what starts at random, as nothing here does.
        """
        robot = self._robot or self._held(held)
        asked = target.homogeneous
        asked[:3, :3] = target.rotation @ self._unturned
        answer = robot.IK(asked)
        exact = ~np.asarray(answer.is_LS, dtype=bool)
        q = np.reshape(answer.Q, (len(exact), -1))[exact]
        if q.shape[1] < self._chain.size:
            full = np.empty((len(q), self._chain.size))
            full[:, list(self.free)] = held
            full[:, [i for i in range(self._chain.size) if i not in self.free]] = q
            q = full
        return _distinct([each for each in q if _meets(self._chain, each, target)], self._chain)

    def _held(self, held: Array) -> Any:
        assert HPRobot is not None
        fixed = [(i, float(value)) for i, value in zip(self.free, held, strict=True)]
        return HPRobot(self._axes, self._offsets, fixed)


class RestartSolver:
    """MINPACK's Powell hybrid method from random configurations, for any chain."""

    method = "restarts"

    def __init__(self, chain: Chain, free: tuple[int, ...], restarts: int) -> None:
        """Prepare for a choice of free joints."""
        self.free = free
        self._chain, self._restarts = chain, restarts
        self._sought = [i for i in range(chain.size) if i not in free]

    def solve(self, target: pin.SE3, held: Array, rng: np.random.Generator) -> Array:
        """(K, n) solutions, as of `AnalyticSolver`; those of a small basin may be missed."""
        found: list[Array] = []
        fruitless = 0
        while fruitless < self._restarts:
            start = self._chain.random(rng)
            start[list(self.free)] = held
            q = self._descend(target, start)
            more = [*found, q] if _meets(self._chain, q, target) else found
            distinct = list(_distinct(more, self._chain))
            fruitless = 0 if len(distinct) > len(found) else fruitless + 1
            found = distinct
        return np.reshape(found, (-1, self._chain.size))

    def _descend(self, target: pin.SE3, start: Array) -> Array:
        """The configuration at which one search ends."""
        q, chain, away = start.copy(), self._chain, target.inverse()

        def miss(x: Array) -> Array:
            q[self._sought] = x
            error = away * chain.pose(q)
            return np.concatenate([error.translation, pin.log3(error.rotation)])

        def slope(x: Array) -> Array:
            q[self._sought] = x
            at, J = chain.pose_and_jacobian(q)
            error = away * at
            J = J[:, self._sought]
            return np.vstack([error.rotation @ J[:3], pin.Jlog3(error.rotation) @ J[3:]])

        q[self._sought] = root(
            miss,
            start[self._sought],
            jac=slope,
            method="hybr",
            options={"maxfev": 80, "xtol": 1e-10},
        ).x
        return q


def _choices(chain: Chain) -> Iterator[tuple[int, ...]]:
    """Free joints that leave the others determined, the outermost first."""
    arm = range(len(chain.joints))
    rng = np.random.default_rng(0)
    jacobians = [chain.pose_and_jacobian(chain.random(rng))[1] for _ in range(_FREE_TRIALS)]
    for free in reversed(list(combinations(arm, chain.free))):
        square = [np.delete(J, free, axis=1) for J in jacobians]
        if max(abs(np.linalg.det(J)) for J in square) > _LOST:
            yield free


def _gaps(found: Array, q: Array, chain: Chain) -> Array:
    """(K,) largest difference of an arm's joint between each row and q, whole turns apart."""
    arm = len(chain.joints)
    apart = np.abs(np.reshape(found, (-1, len(q))) - q)[:, :arm]
    turned = np.minimum(apart % (2 * np.pi), -apart % (2 * np.pi))
    return np.where(chain.turns[:arm], turned, apart).max(axis=1)


def _distinct(found: list[Array], chain: Chain) -> Array:
    """(K, n) rows of which no two have the arm's joints in the same place."""
    kept: list[Array] = []
    for q in found:
        if not kept or _gaps(np.array(kept), q, chain).min() > _SAME:
            kept.append(q)
    return np.reshape(kept, (-1, chain.size))


def _meets(chain: Chain, q: Array, target: pin.SE3) -> bool:
    """Whether a configuration reaches a pose."""
    error = target.inverse() * chain.pose(q)
    return bool(
        np.abs(error.translation).max() < _POSE_TOLERANCE
        and np.abs(error.rotation - np.eye(3)).max() < _POSE_TOLERANCE
    )
