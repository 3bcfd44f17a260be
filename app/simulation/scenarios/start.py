"""The start solver: an arm configuration with the hand where a run begins."""

from __future__ import annotations

from typing import NamedTuple
from weakref import WeakKeyDictionary

import coal
import numpy as np
import pinocchio as pin

from app.avoidance.distances import DistanceMonitor
from app.errors import UnreachableError
from app.robot.link_pairs import LinkPairs, Pair
from app.robot.model import RobotModel
from app.robot.state import RobotState, at_rest
from app.simulation.scenarios.posture import best_posture, manipulability

Array = np.ndarray

_PITCHES = np.radians([45, 60, 30, 75, 15, 90, 0, -15])  # below horizontal, best first
_SEEDS = 16  # starting points of the search per pitch
_POSITION_TOLERANCE = 1e-5  # [m]
_DIRECTION_TOLERANCE = 0.02  # [-] of a unit vector
_BUFFER_MARGIN = 0.005  # [m] beyond the buffer
_FLOOR_MARGIN = 0.01  # [m] between arm and floor
_LOST = 1e-3  # [m/rad or -] singular value of a direction in which the hand cannot move
_JOINT_MARGIN = 0.03  # [-] share of a joint's range kept from its limits
_KEPT = 100  # starts of a robot that are not searched again

OUT_OF_REACH = "out of the arm's reach"
"""The flaw of a try that did not even bring the hand to the place."""


class _Judgement(NamedTuple):
    quality: float
    """[-] above zero if the configuration may be used; more is better."""
    flaw: str
    """Why it may not, or an empty string."""


class StartSolver:
    """Finds an arm configuration for a position of the hand, the base at the origin facing +x.

    The hand points away from the arm's mount and downwards where it can; every pair is outside its
    buffer, the arm above the floor, each joint away from its limits. An arm that cannot point its
    hand everywhere points it as it can where it cannot point it so.
    """

    def __init__(self, model: RobotModel, pairs: LinkPairs, d_b: float) -> None:
        """Prepare for a robot and a buffer distance [m]."""
        self._model = model
        self._d_b = d_b
        self._state = RobotState(model)
        self._placed = np.array(model.description.arm.ready_position)  # (n_m,) of the state
        self._monitor = DistanceMonitor(self._state, [*pairs.mobile, *pairs.manipulator])
        self._floor = FloorDistance(self._state)
        self._range = model.q_upper - model.q_lower
        self._middle = (model.q_upper + model.q_lower) / 2
        # Of less than six directions of motion some are lost: the hand points as it has to then.
        J = self._state.J_ee[:, self._model.n_b :]
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
        ready = np.array(self._model.description.arm.ready_position)
        flaws: dict[str, int] = {}
        directions: list[Array | None] = [
            pin.utils.rotate("z", turn) @ self._direction(target, pitch) for pitch in _PITCHES
        ]
        if not self._points_anywhere:
            directions.append(None)
        for direction in directions:
            best, best_quality = None, 0.0
            for k in range(tries):
                anywhere = self._middle + (rng.random(len(ready)) - 0.5) * self._range
                guess = ready if k == 0 else anywhere
                q = self._search(target, direction, guess)
                quality, flaw = self._judge(q, target, direction)
                if quality > best_quality:
                    best, best_quality = q, quality
                elif flaw:
                    flaws[flaw] = flaws.get(flaw, 0) + 1
            if best is not None:
                return best
        raise UnreachableError(
            f"start {_text(p_ee)}: no configuration of the arm brings the hand there: "
            f"{self._summary(flaws)}",
            flaws,
        )

    def slide(self, p_ee: tuple[float, float, float], q_m: Array) -> Array:
        """(n_m,) the posture near another, the hand pointing as there, its origin at `p_ee` [m].

        Args:
            p_ee: (3,) in the world.
            q_m: (n_m,) a posture from which the place can be reached without a change of branch.

        Raises:
            UnreachableError: That posture cannot be used; says why.
        """
        target = np.array(p_ee, dtype=float)
        self._place(q_m)
        direction = self._state.T_world_ee.rotation[:, 2].copy()
        q = self._search(target, direction, q_m)
        _, flaw = self._judge(q, target, direction)
        if flaw:
            raise UnreachableError(f"start {_text(p_ee)}: {flaw}", {flaw: 1})
        return q

    def _direction(self, target: Array, pitch: float) -> Array:
        """Unit vector from the mount outwards, tilted `pitch` below the horizon."""
        outwards = target[:2] - self._model.p_base()[:2]
        length = np.hypot(*outwards)
        outwards = outwards / length if length > 1e-6 else np.array([1.0, 0.0])
        return np.array([*(np.cos(pitch) * outwards), -np.sin(pitch)])

    def _place(self, q: Array) -> None:
        self._state.update_kinematics(at_rest(self._model, q))
        self._placed = q.copy()

    def reaches(self, p_ee: tuple[float, float, float], *, seed: int = 0, tries: int = 4) -> bool:
        """Whether the hand comes to `p_ee` [m] within the joints' limits, however it points."""
        rng = np.random.default_rng(seed)
        target = np.array(p_ee, dtype=float)
        for _ in range(tries):
            guess = self._middle + (rng.random(len(self._range)) - 0.5) * self._range
            self._place(self._search(target, None, guess))
            if np.linalg.norm(self._state.T_world_ee.translation - target) < _POSITION_TOLERANCE:
                return True
        return False

    def _search(self, target: Array, direction: Array | None, guess: Array) -> Array:
        """Least squares on position and direction, drawn a little to the joints' middle."""
        state = self._state
        pointed = 0.0 if direction is None else 1.0
        wanted = np.zeros(3) if direction is None else direction

        def residual(q: Array) -> Array:
            self._place(q)
            at = state.T_world_ee
            return np.concatenate(
                [
                    10.0 * (at.translation - target),
                    pointed * (at.rotation[:, 2] - wanted),
                    1e-5 * (q - self._middle) / self._range,
                ]
            )

        def jacobian(q: Array) -> Array:
            if not np.array_equal(q, self._placed):  # mostly the residual was asked just there
                self._place(q)
            J = state.J_ee[:, self._model.n_b :]
            pointing = -pointed * pin.skew(state.T_world_ee.rotation[:, 2]) @ J[3:]
            return np.vstack([10.0 * J[:3], pointing, 1e-5 * np.diag(1 / self._range)])

        margin = _JOINT_MARGIN * self._range
        bounds = (self._model.q_lower + margin, self._model.q_upper - margin)
        return best_posture(residual, jacobian, guess, bounds)

    def _judge(self, q: Array, target: Array, direction: Array | None) -> _Judgement:
        self._place(q)
        at = self._state.T_world_ee
        if np.linalg.norm(at.translation - target) > _POSITION_TOLERANCE:
            return _Judgement(0.0, OUT_OF_REACH)
        points = at.rotation[:, 2]
        if direction is not None and np.linalg.norm(points - direction) > _DIRECTION_TOLERANCE:
            return _Judgement(0.0, "out of reach with the hand pointing away from the mount")
        if self._floor.least() < _FLOOR_MARGIN:
            return _Judgement(0.0, "the arm would touch the floor")
        clearance = np.inf
        for closest in self._monitor.find_closest_points():
            if closest.d < self._d_b + _BUFFER_MARGIN:
                return _Judgement(0.0, f"{closest.pair.name} would be inside its buffer")
            clearance = min(clearance, closest.d - self._d_b)
        left = np.minimum(q - self._model.q_lower, self._model.q_upper - q)
        joints = float(np.min(left / self._range))
        J = self._state.J_ee[:, self._model.n_b :]
        return _Judgement(min(joints, 0.15) + min(manipulability(J), 0.1) + min(clearance, 0.1), "")

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


class FloorDistance:
    """Least signed distance of the arm's bodies to the floor."""

    def __init__(self, state: RobotState) -> None:
        self._state = state
        self._geometry = state.model.geometry.copy()
        slab = coal.Box(20.0, 20.0, 1.0)
        floor = self._geometry.addGeometryObject(
            pin.GeometryObject("floor", 0, 0, pin.SE3(np.eye(3), np.array([0.0, 0.0, -0.5])), slab)
        )
        for name in state.model.body_names[1:]:
            for shape in state.model.shape_ids[name]:
                self._geometry.addCollisionPair(pin.CollisionPair(floor, shape))
        self._data = pin.GeometryData(self._geometry)

    def least(self) -> float:
        """[m]"""
        pin.updateGeometryPlacements(
            self._state.model.pin, self._state.data, self._geometry, self._data
        )
        pin.computeDistances(self._geometry, self._data)
        return min(result.min_distance for result in self._data.distanceResults)


def _text(point: tuple[float, float, float]) -> str:
    return "(" + ", ".join(f"{x:g}" for x in point) + ") m"
