"""The start solver: an arm configuration with the hand where a run begins."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from weakref import WeakKeyDictionary

import numpy as np
import pinocchio as pin

from app.errors import UnreachableError
from app.robot.link_pairs import LinkPairs, Pair
from app.robot.model import RobotModel
from app.simulation.scenarios.posture import Found, PostureSearch, Target, manipulability

Array = np.ndarray

_PITCHES = np.radians([45, 60, 30, 75, 15, 90, 0, -15])  # below horizontal, best first
_SEEDS = 16  # starting points of the search per pitch
_POSITION_TOLERANCE = 1e-5  # [m]
_DIRECTION_TOLERANCE = 0.02  # [-] of a unit vector
_BUFFER_MARGIN = 0.005  # [m] beyond the buffer
_FLOOR_MARGIN = 0.01  # [m] between arm and floor
_LOST = 1e-3  # [m/rad or -] singular value of a direction in which the hand cannot move
_KEPT = 100  # starts of a robot that are not searched again

OUT_OF_REACH = "out of the arm's reach"
"""The flaw of a try that did not even bring the hand to the place."""


class StartSolver:
    """Finds an arm configuration for a position of the hand, the base at the origin facing +x.

    The hand points away from the arm's mount and downwards where it can; every pair is outside its
    buffer, the arm above the floor, each joint away from its limits. An arm that cannot point its
    hand everywhere points it as it can where it cannot point it so.
    """

    def __init__(self, model: RobotModel, pairs: LinkPairs, d_b: float) -> None:
        """Prepare for a robot and a buffer distance [m]."""
        self._model = model
        self._search = PostureSearch(model, pairs, d_b)
        # Of less than six directions of motion some are lost: the hand points as it has to then.
        J = self._search.J_hand
        self._points_anywhere = bool(np.linalg.matrix_rank(J, tol=_LOST) == 6)

    def solve(
        self,
        p_ee: tuple[float, float, float],
        *,
        seed: int = 0,
        turn: float = 0.0,
        tries: int = _SEEDS,
    ) -> Array:
        """(n_m,) arm configuration with the end-effector at `p_ee` [m] in the world.

        Args:
            p_ee: Where the hand shall be.
            seed: Of the starting points of the search.
            turn: [rad] by how much the hand points to the left of straight away from the mount.
            tries: Starting points of the search per pitch of the hand.

        Raises:
            UnreachableError: There is none; says what stands in the way.
        """
        target = np.array(p_ee, dtype=float)
        if not (np.isfinite(target).all() and target[2] > 0.0):
            raise UnreachableError(
                f"start {_text(p_ee)}: the floor is z = 0, the hand must be above"
            )
        rng = np.random.default_rng(seed)
        flaws: dict[str, int] = {}
        directions: list[Array | None] = [
            pin.utils.rotate("z", turn) @ self._direction(target, pitch) for pitch in _PITCHES
        ]
        if not self._points_anywhere:
            directions.append(None)
        for direction in directions:
            found = self._try(Target(target, direction), self._guesses(rng, tries))
            if found.q_m is not None:
                return found.q_m
            for flaw, count in found.flaws.items():
                flaws[flaw] = flaws.get(flaw, 0) + count
        raise UnreachableError(
            f"start {_text(p_ee)}: no configuration of the arm brings the hand there: "
            f"{self._summary(flaws)}",
            flaws,
        )

    def _guesses(self, rng: np.random.Generator, tries: int) -> Iterator[Array]:
        """The ready pose, then random ones."""
        for k, anywhere in enumerate(self._search.guesses(rng, tries)):
            yield np.array(self._model.description.arm.ready_position) if k == 0 else anywhere

    def _try(self, target: Target, guesses: Iterable[Array]) -> Found:
        return self._search.best(guesses, lambda q: self._judge(q, target), target=target)

    def slide(self, p_ee: tuple[float, float, float], q_m: Array) -> Array:
        """(n_m,) the posture near another, the hand pointing as there, its origin at `p_ee` [m].

        Args:
            p_ee: (3,) in the world.
            q_m: (n_m,) a posture from which the place can be reached without a change of branch.

        Raises:
            UnreachableError: That posture cannot be used; says why.
        """
        self._search.place(q_m)
        direction = self._search.state.T_world_ee.rotation[:, 2].copy()
        found = self._try(Target(np.array(p_ee, dtype=float), direction), [q_m])
        if found.q_m is None:
            raise UnreachableError(f"start {_text(p_ee)}: {next(iter(found.flaws))}", found.flaws)
        return found.q_m

    def reaches(self, p_ee: tuple[float, float, float], *, seed: int = 0, tries: int = 4) -> bool:
        """Whether the hand comes to `p_ee` [m] within the joints' limits, however it points."""
        target = Target(np.array(p_ee, dtype=float))
        guesses = self._search.guesses(np.random.default_rng(seed), tries)
        found = self._search.best(
            guesses,
            lambda _: float(self._off(target) < _POSITION_TOLERANCE),
            target=target,
            enough=1.0,
        )
        return found.q_m is not None

    def _direction(self, target: Array, pitch: float) -> Array:
        """Unit vector from the mount outwards, tilted `pitch` below the horizon."""
        outwards = target[:2] - self._model.p_base()[:2]
        length = np.hypot(*outwards)
        outwards = outwards / length if length > 1e-6 else np.array([1.0, 0.0])
        return np.array([*(np.cos(pitch) * outwards), -np.sin(pitch)])

    def _off(self, target: Target) -> float:
        """[m] from the hand to its target."""
        return float(np.linalg.norm(self._search.state.T_world_ee.translation - target.p))

    def _judge(self, q: Array, target: Target) -> float | str:
        search = self._search
        if self._off(target) > _POSITION_TOLERANCE:
            return OUT_OF_REACH
        points = search.state.T_world_ee.rotation[:, 2]
        if target.z is not None and np.linalg.norm(points - target.z) > _DIRECTION_TOLERANCE:
            return "out of reach with the hand pointing away from the mount"
        if search.above_floor() < _FLOOR_MARGIN:
            return "the arm would touch the floor"
        clearance = np.inf
        for closest in search.closest():
            if closest.d < search.d_b + _BUFFER_MARGIN:
                return f"{closest.pair.name} would be inside its buffer"
            clearance = min(clearance, closest.d - search.d_b)
        joints, J = search.joint_room(q), search.J_hand
        return min(joints, 0.15) + min(manipulability(J), 0.1) + min(clearance, 0.1)

    @staticmethod
    def _summary(flaws: dict[str, int]) -> str:
        ordered = sorted(flaws, key=lambda flaw: -flaws[flaw])
        return "; ".join(f"{flaw} ({flaws[flaw]} tries)" for flaw in ordered[:3])


_Place = tuple[float, float, float]
_Asked = tuple[tuple[Pair, ...], float, _Place, int]
_found: WeakKeyDictionary[RobotModel, dict[_Asked, Array]] = WeakKeyDictionary()


def find_start(
    model: RobotModel, pairs: LinkPairs, d_b: float, p_ee: _Place, *, seed: int = 0
) -> Array:
    """(n_m,) arm configuration as `StartSolver.solve` finds it; some that were found are kept.

    So a run that begins again, such as with another controller, does not wait for the search.

    Args:
        model: The robot.
        pairs: Those that have to be outside of their buffers.
        d_b: [m] the buffer distance.
        p_ee: [m] where the hand shall be, in the world.
        seed: Of the starting points of the search.

    Raises:
        UnreachableError: There is none; says what stands in the way.
    """
    kept = _found.setdefault(model, {})
    asked = (pairs.all, d_b, (p_ee[0], p_ee[1], p_ee[2]), seed)
    q = kept.get(asked)
    if q is None:
        q = kept[asked] = StartSolver(model, pairs, d_b).solve(p_ee, seed=seed)
        if len(kept) > _KEPT:
            kept.pop(next(iter(kept)), None)
    return q.copy()


def _text(point: tuple[float, float, float]) -> str:
    return "(" + ", ".join(f"{x:g}" for x in point) + ") m"
