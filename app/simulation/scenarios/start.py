"""Search for postures of the arm: for the start of a run, and at a door's handle."""

from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from functools import partial
from typing import NamedTuple

import coal
import numpy as np
import pinocchio as pin
from scipy.optimize import least_squares

from app.avoidance.closest_points import DistanceMonitor
from app.border.mobile import MobileBody
from app.errors import UnreachableError
from app.robot.link_pairs import LinkPairs
from app.robot.model import RobotModel, kept_per_model, length_bound
from app.robot.state import RobotState, at_rest, geometry_data
from app.simulation.plants.collision_shapes import FLOOR, geometry_with_floor
from app.simulation.plants.door import Door
from app.simulation.trace.columns import frozen
from app.simulation.trace.words import spoken
from app.strict import Array, Vector3

_MAX_EVALUATIONS = 60  # [-] largest number of evaluations of the residual
_JOINT_MARGIN = 0.03  # [-] margin to a limit in the least squares, relative to the joint's range
_TO_TARGET = 10.0  # [-] weight of the end-effector's position or pose
_TO_MIDDLE = 1e-5  # [-] weight of the middle of the joints' ranges
_PITCHES = np.radians([45, 60, 30, 75, 15, 90, 0, -15])  # [rad] below the horizon, best first
_SEEDS = 16  # starting points of the search for each pitch
_POSITION_TOLERANCE = 1e-5  # [m] tolerance of the end-effector's position
_DIRECTION_TOLERANCE = 0.02  # [-] tolerance of the end-effector's direction, a unit vector
_BUFFER_MARGIN = 0.005  # [m] required distance of each pair beyond d_b at the start
_FLOOR_MARGIN = 0.01  # [m] smallest distance between arm and floor
_LOST = 1e-3  # [m/rad or -] largest singular value that counts as a lost direction
_UPRIGHT = 0.94  # [-] smallest z component of an upright axis: a tilt of 20 degrees
_WAY_TOLERANCE = 0.01  # [-] largest weighted error of the end-effector on its path: 1 mm, 1 mrad
_SHARES = np.linspace(0.2, 1.0, 5)  # [-] shares of a line at which the path is checked
_CACHED = 100  # largest number of cached starts of a robot
_ROLLS = np.radians([0.0, 90.0, 180.0, -90.0])  # [rad] of the end-effector about its z axis
_ROLL_SEEDS = 80  # starting points of the search for each roll
_GRASP_TOLERANCE = 1e-4  # [m] and [rad] tolerance of the grasp
_LOOSE_TOLERANCE = 5e-3  # [m] and [rad] tolerance of the predicted poses on the path
_GRASP_MARGIN = 0.015  # [-] margin to a joint's limits, relative to the joint's range
_MAX_INSIDE = 0.07  # [m] largest depth of a pair in its buffer on the path
_AHEAD = np.radians(np.arange(3, 94, 3))  # [rad] further door angles that are checked
_CORRECTIONS = 4  # [-] Newton steps for each door angle
_TO_START = 0.5  # [-] share of the return to the starting posture in each step
OUT_OF_REACH = "out of the arm's reach"  # the reason if the end-effector misses its position

Judge = Callable[[Array], float | str]
"""Quality [-] of a posture (n_m,), above zero if it is valid; or the reason why it is invalid."""


class Target(NamedTuple):
    p: Array  # (3,) [m] position of the end-effector's origin, in the world
    z: Array | None = None  # (3,) unit vector of the end-effector's z axis, or None for any


class Found(NamedTuple):
    q_m: Array | None  # (n_m,) [rad or m] the best of the tried postures, or None if none is valid
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
        self.distances = self.monitor.distances  # [m] signed, of all pairs in the present posture
        below = pin.SE3(np.eye(3), np.array([0.0, 0.0, -0.5]))
        floor = pin.GeometryObject("floor", 0, 0, below, coal.Box(20.0, 20.0, 1.0))
        arm = {(FLOOR, name): "arm_floor" for name in model.body_names[1:]}
        self._floor, _ = geometry_with_floor(model, floor, arm)
        self._floor_data = geometry_data(self._floor)
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
        search for the `target`; without a target, they are the postures to judge. The arm is placed
        into a posture before `judge` is called. The search ends at the quality `enough` [-].
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
        For a pose, the error is the logarithm of the displacement to it in the end-effector's
        frame; for a `Target`, the error of the position and, if specified, of the direction.
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
        """[m] lower bound of the distance of a point p (3,) [m] from the workspace, ≤ 0 inside."""
        x, y, heading = self._base_pose
        at = pin.utils.rotate("z", heading) @ self._shoulder + [x, y, 0.0]
        return float(np.linalg.norm(p - at)) - self._length

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
        """A message that names the nearest pair as one inside its buffer."""
        pair = self.names[int(np.argmin(self.distances()))]
        return f"{pair} would be inside its buffer of {self.d_b:g} m"

    def joint_room(self, q_m: Array) -> float:
        """[-] smallest distance of a joint from a position limit, divided by the joint's range."""
        left = np.minimum(q_m - self.model.q_lower, self.model.q_upper - q_m)
        return float(np.min(left / self.span))


class StartSolver(PostureSearch):
    """Finds a posture of the arm for an end-effector position; the base at the origin faces +x.
    The end-effector points away from the arm's mount and, without a path, preferably downwards. If
    no such posture exists or follows the whole path, an arm that cannot point everywhere may use
    any direction. Every pair is outside its buffer, the arm is above the floor, and each joint is
    away from its position limits.
    """

    def __init__(self, model: RobotModel, pairs: LinkPairs, d_b: float) -> None:
        super().__init__(model, pairs, d_b)
        # With fewer than six directions of motion, or without an upright first axis, the arm
        # cannot choose the direction of the end-effector.
        J = self.J_ee
        first = next((axis for axis in J[3:].T if axis.any()), np.zeros(3))
        full = np.linalg.matrix_rank(J, tol=_LOST) == 6
        self._points_anywhere = bool(full and abs(first[2]) > _UPRIGHT)

    def solve(
        self,
        p_ee: Vector3,
        *,
        seed: int = 0,
        turn: float = 0.0,
        tries: int = _SEEDS,
        along: Sequence[Array] = (),
    ) -> Array:
        """Find the best posture of the arm (n_m,) with the end-effector at `p_ee` (3,) [m] in the
        world. `along` has further positions (3,) [m], a path. From the best posture, the arm
        follows the longest part of this path while the base is at rest and the orientation of the
        end-effector is constant. `turn` [rad] is the horizontal angle, positive to the left, from
        the direction away from the mount to that of the end-effector; `tries` is the number of
        starting points for each direction. If the search finds no posture, this raises an
        UnreachableError with the reasons.
        """
        target, start = np.array(p_ee, dtype=float), f"start {point_text(p_ee)}"
        if not (np.isfinite(target).all() and target[2] > 0.0):
            why = "the end-effector must be at a finite position above the floor, z = 0"
            raise UnreachableError(f"{start}: {why}")
        if (beyond := self.beyond(target)) > 0.0:
            why = f"{start}: {OUT_OF_REACH} by {beyond:.2f} m or more"
            raise UnreachableError(why, {OUT_OF_REACH: 1})
        outwards = target[:2] - self.model.p_base()[:2]  # horizontal, from the mount
        length = np.hypot(*outwards)
        outwards = outwards / length if length > 1e-6 else np.array([1.0, 0.0])
        tilted = [np.array([*(np.cos(p) * outwards), -np.sin(p)]) for p in _PITCHES]
        turned, rng = pin.utils.rotate("z", turn), np.random.default_rng(seed)
        directions = [turned @ direction for direction in tilted]
        best, flaws = Found(None, 0.0, Counter()), Counter[str]()
        for direction in (*directions, *([] if self._points_anywhere else [None])):
            if best.quality > len(along) and (direction is None or not along):
                break
            _, *others = self.guesses(rng, tries)
            guesses = np.array(self.model.description.arm.ready_position), *others
            found = self._try(Target(target, direction), guesses, along)
            best = max(best, found, key=lambda each: each.quality)
            flaws.update(found.flaws)
        if best.q_m is None:
            why = f"{start}: no posture of the arm reaches it: {_reasons(flaws)}"
            raise UnreachableError(why, flaws)
        return best.q_m

    def _try(self, target: Target, guesses: Iterable[Array], along: Sequence[Array] = ()) -> Found:
        return self.best(guesses, lambda q: self._judge(q, target, along), target=target)

    def slide(self, p_ee: Vector3, q_m: Array) -> Array:
        """Find the posture (n_m,) near `q_m` (n_m,) with the end-effector at `p_ee` (3,) [m] in the
        same direction. An invalid posture raises an UnreachableError with the reason.
        """
        self.place(q_m)
        direction = self.state.T_world_ee.rotation[:, 2].copy()
        found = self._try(Target(np.array(p_ee, dtype=float), direction), [q_m])
        if found.q_m is None:
            why = f"start {point_text(p_ee)}: {next(iter(found.flaws))}"
            raise UnreachableError(why, found.flaws)
        return found.q_m

    def reaches(self, p_ee: Vector3, *, seed: int = 0, tries: int = 4) -> bool:
        """Whether a search with at most `tries` tries finds a posture that reaches `p_ee` (3,) [m].
        The end-effector can have any direction; distances of pairs and floor are not checked.
        """
        target = Target(np.array(p_ee, dtype=float))
        if self.beyond(target.p) > 0.0:
            return False
        guesses = self.guesses(np.random.default_rng(seed), tries)
        found = self.best(
            guesses,
            lambda _: float(self._off(target) < _POSITION_TOLERANCE),
            target=target,
            enough=1.0,
        )
        return found.q_m is not None

    def _off(self, target: Target) -> float:
        """[m] distance of the end-effector from its target position."""
        return float(np.linalg.norm(self.state.T_world_ee.translation - target.p))

    def _judge(self, q: Array, target: Target, along: Sequence[Array]) -> float | str:
        if self._off(target) > _POSITION_TOLERANCE:
            return OUT_OF_REACH
        points = self.state.T_world_ee.rotation[:, 2]
        if target.z is not None and np.linalg.norm(points - target.z) > _DIRECTION_TOLERANCE:
            return "out of reach with the end-effector pointing away from the mount"
        if flaw := self.flaw(_FLOOR_MARGIN, _BUFFER_MARGIN):
            return flaw
        return self._room(q, along) + min(self.beyond_buffer(), 0.1)

    def _room(self, q_m: Array, along: Sequence[Array]) -> float:
        """[-] number of positions reached along the path, plus joint margin and manipulability."""
        R = self.state.T_world_ee.rotation.copy()
        joints, mobility, followed = self.joint_room(q_m), manipulability(self.J_ee), 0
        for p in along:
            target = pin.SE3(R, p)
            q_m = self.reach(target, q_m)
            if np.abs(self.linearised(q_m, target)[0]).max() > _WAY_TOLERANCE:
                break
            joints = min(joints, self.joint_room(q_m))
            mobility = min(mobility, manipulability(self.J_ee))
            followed += 1
        return followed + min(joints, 0.15) + min(mobility, 0.1)


@kept_per_model(_CACHED)
def find_start(
    model: RobotModel,
    pairs: LinkPairs,
    d_b: float,
    p_ee: Vector3,
    *,
    seed: int = 0,
    move: Vector3 | None = None,
) -> Array:
    """The posture (n_m,) of `StartSolver.solve`, read-only and cached. With `move` (3,) [m], the
    path of `solve` is the straight line of this displacement from `p_ee` (3,) [m].
    """
    along = () if move is None else [np.add(p_ee, share * np.array(move)) for share in _SHARES]
    return frozen(StartSolver(model, pairs, d_b).solve(p_ee, seed=seed, along=along))


@kept_per_model(_CACHED)
def find_grasp(
    model: RobotModel,
    pairs: LinkPairs,
    d_b: float,
    base_pose: Vector3,
    door: Door,
    angle: float,
    *,
    seed: int = 0,
) -> tuple[Array, pin.SE3]:
    """The arm's best posture (n_m,) at a door's handle, and the end-effector's pose; both cached.
    The end-effector is horizontal and points into the door; every pair is outside its buffer. From
    the best posture, which is read-only, the arm can follow the door over the largest range of
    further angles while the base moves back. `base_pose` is x, y [m] and heading [rad], `angle`
    [rad] the opening angle. If the search finds no posture, this raises an UnreachableError.
    """
    q_m, T_ee = _GraspSearch(model, pairs, d_b).grasp(np.array(base_pose), door, angle, seed)
    return frozen(q_m), T_ee


class _GraspSearch(PostureSearch):
    def grasp(self, base_pose: Array, door: Door, angle: float, seed: int) -> tuple[Array, pin.SE3]:
        self._begin, self._door, self._angle = base_pose, door, angle
        self._front = float(MobileBody(self.model).upper[0])
        self.stand(base_pose)
        rng, best, target = np.random.default_rng(seed), Found(None, 0.0, Counter()), None
        handle, flaws = door.handle(angle).translation, Counter[str]()
        far = self.beyond(handle)
        for roll in () if far > 0.0 else _ROLLS:
            there, judge = self._grasp(angle, roll), partial(self._judge, roll)
            found = self.best(self.guesses(rng, _ROLL_SEEDS), judge, target=there)
            flaws.update(found.flaws)
            if found.quality > best.quality:
                best, target = found, there
        if best.q_m is None or target is None:
            (x, y, z), base = handle, base_pose
            why = f"{OUT_OF_REACH} by {far:.2f} m or more" if far > 0.0 else _reasons(flaws)
            raise UnreachableError(
                f"no posture of the arm reaches the handle at ({x:.2f}, {y:.2f}, {z:.2f}) m from a "
                f"base at ({base[0]:.2f}, {base[1]:.2f}) m: {why}; --base sets another place",
                flaws or {OUT_OF_REACH: 1},
            )
        return best.q_m, target

    def _grasp(self, angle: float, roll: float) -> pin.SE3:
        """End-effector pose at the handle, for a door angle and a roll about its z axis [rad]."""
        turn = pin.SE3(pin.rpy.rpyToMatrix(0.0, 0.0, roll), np.zeros(3))
        return self._door.handle(angle) * turn

    def _judge(self, roll: float, q_m: Array) -> float | str:
        """[-] `_room_ahead` of a posture at the handle, or the reason why it is no valid grasp."""
        room = self._room(self._grasp(self._angle, roll), q_m, _GRASP_TOLERANCE, _BUFFER_MARGIN)
        if not isinstance(room, str):
            room = self._room_ahead(roll, q_m, room)
            self.stand(self._begin)
        return room

    def _room_ahead(self, roll: float, q_start: Array, room: float) -> float:
        """[-] number of further door angles that the arm can reach, plus the smallest `_room`."""
        q_m, followed = q_start, 0
        for turned in _AHEAD:
            angle = self._angle + turned
            target = self._grasp(angle, roll)
            self.stand(self._backed_off(angle))
            for _ in range(_CORRECTIONS):  # to the target, and in its null space towards `q_start`
                error, J = self.linearised(q_m, target)
                back = _TO_START * (q_start - q_m)
                q_m = q_m + back - np.linalg.pinv(J, 1e-3) @ (error + J @ back)
            there = self._room(target, q_m, _LOOSE_TOLERANCE, -_MAX_INSIDE)
            if isinstance(there, str):
                break
            followed, room = followed + 1, min(room, there)
        return followed + room

    def _backed_off(self, angle: float) -> Array:
        """(3,) initial base pose, moved back if the door's free edge is within d_b of the base."""
        door, (x, y, heading) = self._door, self._begin
        edge = door.pose(angle).act(np.array([0.0, -door.side * door.width, 0.0]))
        forwards = np.array([np.cos(heading), np.sin(heading)])
        gap = float((edge[:2] - [x, y]) @ forwards) - self._front
        return np.add(self._begin, [*min(gap - self.d_b, 0.0) * forwards, 0.0])

    def _room(self, target: pin.SE3, q_m: Array, tolerance: float, least: float) -> float | str:
        """[-] margins of a posture at `target`, with pairs beyond d_b + `least` [m]; or a flaw."""
        self.place(q_m)
        if np.abs(pin.log6(self.state.T_world_ee.actInv(target)).vector).max() > tolerance:
            return "out of reach with the end-effector pointing into the door"
        beyond_buffer, joints = self.beyond_buffer(), self.joint_room(q_m)
        if beyond_buffer < least:
            return self.buffer_flaw()
        if joints < _GRASP_MARGIN:
            return "a joint would be at its limit"
        bending = manipulability(self.J_ee)
        return min(joints, 0.15) + 2 * min(bending, 0.05) + 5 * min(beyond_buffer - least, 0.1)


def _arm_length(model: RobotModel) -> tuple[Array, float]:
    """Position (3,) [m] of the arm's first joint, and an upper bound [m] of the arm's reach."""
    arm, ee = model.pin, model.pin.frames[model.ee_frame]
    chain = [j for j in arm.supports[ee.parentJoint] if j > 1]
    links = [*(arm.jointPlacements[j] for j in chain[1:]), ee.placement]
    slides = [arm.idx_vs[j] - 3 for j in chain if "JointModelP" in arm.joints[j].shortname()]
    limits = np.array([model.q_lower[slides], model.q_upper[slides]])
    return arm.jointPlacements[chain[0]].translation.copy(), length_bound(links, limits)


def manipulability(J: Array) -> float:
    """√det(J Jᵀ) of a Jacobian J (k, n_m); 0 at a singularity."""
    return float(np.sqrt(max(np.linalg.det(J @ J.T), 0.0)))


def _reasons(flaws: Counter[str]) -> str:
    return "; ".join(f"{flaw} ({count} tries)" for flaw, count in flaws.most_common(3))


def point_text(point: Vector3) -> str:
    """The coordinates of a point for a message."""
    return "(" + ", ".join(f"{x:g}" for x in point) + ") m"
