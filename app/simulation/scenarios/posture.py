"""Search for the best of many postures of the arm, with or without a target of the end-effector."""

from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from typing import NamedTuple

import coal
import numpy as np
import pinocchio as pin
from scipy.optimize import least_squares

from app.avoidance.closest_points import DistanceMonitor
from app.robot.link_pairs import LinkPairs
from app.robot.model import RobotModel, length_bound
from app.robot.state import RobotState, at_rest, geometry_data
from app.simulation.trace.words import spoken
from app.strict import Array

_MAX_EVALUATIONS = 60  # [-] largest number of evaluations of the residual
_JOINT_MARGIN = 0.03  # [-] margin to a limit in the least squares, relative to the joint's range
_TO_TARGET = 10.0  # [-] weight of the end-effector's position or pose
_TO_MIDDLE = 1e-5  # [-] weight of the middle of the joints' ranges

Judge = Callable[[Array], float | str]
"""Quality [-] of a valid posture (n_m,), above zero; otherwise at most zero, or the reason."""


class Target(NamedTuple):
    """A position of the end-effector, and optionally a direction."""

    p: Array  # (3,) [m] position of the end-effector's origin, in the world
    z: Array | None = None  # (3,) unit vector of the end-effector's z axis, or None for any


class Found(NamedTuple):
    """The best of the tried postures."""

    q_m: Array | None  # (n_m,) [rad or m] joint positions, or None if no posture is valid
    quality: float  # [-] quality of the posture, 0 without a posture
    flaws: Counter[str]  # number of failed tries for each reason


class PostureSearch:
    """Tries postures of the arm, and evaluates them for a buffer distance `d_b` [m]."""

    def __init__(self, model: RobotModel, pairs: LinkPairs, d_b: float) -> None:
        self.model, self.d_b = model, d_b
        self.state = RobotState(model)  # state in the last posture
        self.span = model.q_upper - model.q_lower
        self.middle = (model.q_upper + model.q_lower) / 2  # (n_m,) [rad or m], as `span`
        self.names = [spoken(pair.name, model.body_names) for pair in pairs.all]
        self.monitor = DistanceMonitor(self.state, pairs.all)
        self._floor, self._floor_data = _with_floor(model)
        self._base_pose = np.zeros(3)
        self._placed: Array | None = None
        self._shoulder, self._length = _arm_length(model)

    def stand(self, base_pose: Array) -> None:
        """Set x, y [m] and heading [rad] of the base from the next `place` on; initially zero."""
        self._base_pose, self._placed = base_pose, None

    def place(self, q_m: Array) -> None:
        """Put the arm into a posture (n_m,) [rad or m]."""
        if self._placed is None or not np.array_equal(q_m, self._placed):
            self.state.update_kinematics(at_rest(self.model, q_m, self._base_pose))
            self._placed = q_m.copy()

    def guesses(self, rng: np.random.Generator, count: int) -> Iterator[Array]:
        """Draw random postures (n_m,) [rad or m], uniform within the joints' ranges."""
        for _ in range(count):
            yield self.middle + (rng.random(self.model.n_m) - 0.5) * self.span

    def best(
        self,
        guesses: Iterable[Array],
        judge: Judge,
        *,
        target: Target | pin.SE3 | None = None,
        enough: float = np.inf,
    ) -> Found:
        """Find the posture with the highest quality. `guesses` (n_m,) are starting points of the
        search for the `target`, or without a target the postures themselves. The arm is placed into
        each posture before `judge` is called. The search ends at the quality `enough` [-].
        """
        best = Found(None, 0.0, Counter())
        for guess in guesses:
            q_m = guess if target is None else self.reach(target, guess)
            self.place(q_m)
            worth = judge(q_m)
            if isinstance(worth, str):
                best.flaws[worth] += 1
            elif worth > best.quality:
                best = best._replace(q_m=q_m, quality=worth)
                if worth >= enough:
                    break
        return best

    def reach(self, target: Target | pin.SE3, guess: Array) -> Array:
        """Find the posture (n_m,) near a guess with the least squared error from the target."""

        def residual(q: Array) -> Array:
            drawn = _TO_MIDDLE * (q - self.middle) / self.span
            return np.concatenate([self.linearised(q, target)[0], drawn])

        def jacobian(q: Array) -> Array:
            return np.vstack([self.linearised(q, target)[1], np.diag(_TO_MIDDLE / self.span)])

        margin = _JOINT_MARGIN * self.span
        low, high = self.model.q_lower + margin, self.model.q_upper - margin
        return least_squares(
            residual,
            np.clip(guess, low + 1e-6, high - 1e-6),
            jacobian,  # pyright: ignore[reportArgumentType] - a function is valid
            bounds=(low, high),
            max_nfev=_MAX_EVALUATIONS,
        ).x

    def linearised(self, q_m: Array, target: Target | pin.SE3) -> tuple[Array, Array]:
        """`place` the arm; return the end-effector's weighted error (k,) and its Jacobian (k, n_m).
        The error from a pose is the logarithm of the displacement in the end-effector's frame; that
        from a `Target` is the error of the position and of the direction, if any.
        """
        self.place(q_m)
        at, J = self.state.T_world_ee, self.J_ee
        if isinstance(target, pin.SE3):
            error, R = pin.log6(at.actInv(target)).vector, at.rotation.T
            J = -pin.Jlog6(pin.exp6(-error)) @ np.vstack([R @ J[:3], R @ J[3:]])
            return _TO_TARGET * error, _TO_TARGET * J
        off = _TO_TARGET * (at.translation - target.p)
        if target.z is None:
            return off, _TO_TARGET * J[:3]
        z = at.rotation[:, 2]
        error = np.concatenate([off, z - target.z])
        return error, np.vstack([_TO_TARGET * J[:3], -pin.skew(z) @ J[3:]])

    @property
    def J_ee(self) -> Array:
        """(6, n_m) Jacobian of the end-effector for the arm's joints, in axes of the world."""
        return self.state.J_ee[:, self.model.n_b :]

    def beyond(self, p: Array) -> float:
        """[m] lower bound of the distance of a point p (3,) [m] from the workspace; ≤ 0 inside."""
        x, y, heading = self._base_pose
        at = pin.utils.rotate("z", heading) @ self._shoulder + [x, y, 0.0]
        return float(np.linalg.norm(p - at)) - self._length

    def distances(self) -> tuple[float, ...]:
        """[m] signed distances of all pairs in the present posture."""
        return self.monitor.distances()

    def beyond_buffer(self) -> float:
        """[m] smallest distance of a pair, minus d_b; infinite without pairs."""
        return min(self.distances(), default=np.inf) - self.d_b

    def above_floor(self) -> float:
        """[m] smallest signed distance between the arm and the floor."""
        floor, data = self._floor, self._floor_data
        pin.updateGeometryPlacements(self.model.pin, self.state.data, floor, data)
        pin.computeDistances(floor, data)
        return min(result.min_distance for result in data.distanceResults)

    def flaw(self, floor: float = 0.0, margin: float = 0.0) -> str:
        """The reason why the present posture is invalid, or an empty string if it is valid. The arm
        must be above `floor` [m], and each pair's distance above d_b + `margin` [m].
        """
        if self.above_floor() <= floor:
            return "the arm would touch the floor"
        return "" if self.beyond_buffer() > margin else self.buffer_flaw()

    def buffer_flaw(self) -> str:
        """The text that the nearest pair would be inside its buffer."""
        pair = self.names[int(np.argmin(self.distances()))]
        return f"{pair} would be inside its buffer of {self.d_b:g} m"

    def joint_room(self, q_m: Array) -> float:
        """[-] smallest distance of a joint from a position limit, divided by the joint's range."""
        left = np.minimum(q_m - self.model.q_lower, self.model.q_upper - q_m)
        return float(np.min(left / self.span))


def _arm_length(model: RobotModel) -> tuple[Array, float]:
    """Position (3,) [m] of the arm's first joint, and an upper bound [m] of the arm's reach."""
    arm, ee = model.pin, model.pin.frames[model.ee_frame]
    chain = [j for j in arm.supports[ee.parentJoint] if j > 1]
    links = [*(arm.jointPlacements[j] for j in chain[1:]), ee.placement]
    slides = [arm.idx_vs[j] - 3 for j in chain if "JointModelP" in arm.joints[j].shortname()]
    limits = np.array([model.q_lower[slides], model.q_upper[slides]])
    return arm.jointPlacements[chain[0]].translation.copy(), length_bound(links, limits)


def _with_floor(model: RobotModel) -> tuple[pin.GeometryModel, pin.GeometryData]:
    """The robot's bodies and the floor, with a pair of each body of the arm and the floor."""
    geometry, slab = model.geometry.copy(), coal.Box(20.0, 20.0, 1.0)
    place = pin.SE3(np.eye(3), np.array([0.0, 0.0, -0.5]))
    floor = geometry.addGeometryObject(pin.GeometryObject("floor", 0, 0, place, slab))
    for name in model.body_names[1:]:
        for shape in model.shape_ids[name]:
            geometry.addCollisionPair(pin.CollisionPair(floor, shape))
    return geometry, geometry_data(geometry)


def manipulability(J: Array) -> float:
    """√det(J Jᵀ) of a Jacobian J (k, n_m); 0 at a singularity."""
    return float(np.sqrt(max(np.linalg.det(J @ J.T), 0.0)))
