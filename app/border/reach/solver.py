"""All inverse kinematics solutions of a pose: by formulas if there are any, else by restarts."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import combinations
from typing import Any, Protocol

import numpy as np
import pinocchio as pin
from scipy.optimize import root

from app.border.reach.chain import Chain
from app.errors import DescriptionError

try:
    from eaik.IK_HP import HPRobot
except ModuleNotFoundError:  # it has no wheels for CPython 3.14
    HPRobot = None

Array = np.ndarray

_POSE_TOLERANCE = 1e-6  # [m, rad] by which a solution may miss its pose
_SAME = 1e-3  # [rad or m] solutions nearer to each other than this are one
_TRIALS = 20  # [-] configurations with which a choice of free joints is tried out
_SINGULAR = 1e-9  # determinants below this are zero


class Solver(Protocol):
    """Gives the solutions of a chain whose free joints are held.

    Attributes:
        method: Its name.
        free: Indices within the chain of the free joints.
    """

    method: str
    free: tuple[int, ...]

    def solve(self, target: pin.SE3, held: Array, rng: np.random.Generator) -> Array:
        """(K, n) [rad or m] distinct solutions, joint limits not yet regarded.

        Args:
            target: T_base_point.
            held: (len(free),) [rad or m] positions of the free joints.
            rng: For what starts at random.
        """
        ...


def make_solver(chain: Chain, restarts: int) -> Solver:
    """The solver of a chain; of the choices of free joints it takes the outermost that works.

    Args:
        chain: The chain.
        restarts: Restarts in a row that find nothing new before a pose counts as done.

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
        for q in (self._chain.random(rng) for _ in range(_TRIALS)):
            found = self.solve(self._chain.pose(q).copy(), q[held], rng)
            if not (_gaps(found, q, self._chain) < _SAME).any():
                return False
        return True

    def solve(self, target: pin.SE3, held: Array, rng: np.random.Generator) -> Array:
        """(K, n) solutions, as `Solver.solve`; nothing here is random."""
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
        """(K, n) solutions, as `Solver.solve`; those of a small basin may be missed."""
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
    jacobians = [chain.pose_and_jacobian(chain.random(rng))[1] for _ in range(_TRIALS)]
    for free in reversed(list(combinations(arm, chain.free))):
        square = [np.delete(J, free, axis=1) for J in jacobians]
        if max(abs(np.linalg.det(J)) for J in square) > _SINGULAR:
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
