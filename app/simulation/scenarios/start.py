"""The start of a run: the arm with its end-effector at a place, or at the handle of a door."""

from collections import Counter
from collections.abc import Iterable, Iterator, Sequence

import numpy as np
import pinocchio as pin

from app.border.mobile import MobileBody
from app.errors import UnreachableError
from app.robot.link_pairs import LinkPairs
from app.robot.model import RobotModel, kept_per_model
from app.simulation.plants.door import Door
from app.simulation.scenarios.posture import Found, PostureSearch, Target, manipulability
from app.strict import Array

_PITCHES = np.radians([45, 60, 30, 75, 15, 90, 0, -15])  # below horizontal, best first
_SEEDS = 16  # starting points of the search per pitch
_POSITION_TOLERANCE = 1e-5  # [m]
_DIRECTION_TOLERANCE = 0.02  # [-] of a unit vector
_BUFFER_MARGIN = 0.005  # [m] smallest distance beyond the buffer
_FLOOR_MARGIN = 0.01  # [m] between arm and floor
_LOST = 1e-3  # [m/rad or -] singular value of a lost direction of the end-effector
_UPRIGHT = 0.94  # [-] smallest z of an upright axis: a tilt of 20 degrees
_WAY_TOLERANCE = 0.01  # [-] weighted error of the end-effector on its path: 1 mm
_SHARES = np.linspace(0.2, 1.0, 5)  # [-] shares of a line at which the path is checked
_KEPT = 100  # cached starts of a robot

_ROLLS = np.radians([0.0, 90.0, 180.0, -90.0])  # of the end-effector about its own axis
_ROLL_SEEDS = 80  # starting points of the search per roll
_GRASP_TOLERANCE = 1e-4  # [m] and [rad]
_LOOSE_TOLERANCE = 5e-3  # [m] and [rad] tolerance of the prediction
_GRASP_MARGIN = 0.015  # [-] margin to a joint's limits, relative to its range
_MAX_INSIDE = 0.07  # [m] largest depth of a pair in its buffer on the path
_AHEAD = np.radians(np.arange(3, 94, 3))  # door angles that need room
_CORRECTIONS = 4  # [-] Newton steps for each door angle
_TO_START = 0.5  # [-] part of the return to the starting posture in each step

OUT_OF_REACH = "out of the arm's reach"
"""The reason of a try in which the end-effector did not reach the place."""


class StartSolver:
    """Finds an arm configuration for an end-effector position, with the base at the origin facing
    +x.

    The end-effector points away from the arm's mount, and downwards if possible; every pair is
    outside its buffer, the arm above the floor, each joint away from its limits. If the arm cannot
    point its end-effector in all directions, it uses a possible direction.
    """

    def __init__(self, model: RobotModel, pairs: LinkPairs, d_b: float) -> None:
        """Prepare for a robot and a buffer distance [m]."""
        self._model = model
        self._search = PostureSearch(model, pairs, d_b)
        # With fewer than six directions of motion, or without an upright first axis, the arm
        # cannot choose the direction of the end-effector.
        J = self._search.J_hand
        first = next((axis for axis in J[3:].T if axis.any()), np.zeros(3))
        full = np.linalg.matrix_rank(J, tol=_LOST) == 6
        self._points_anywhere = bool(full and abs(first[2]) > _UPRIGHT)

    def solve(
        self,
        p_ee: tuple[float, float, float],
        *,
        seed: int = 0,
        turn: float = 0.0,
        tries: int = _SEEDS,
        along: Sequence[Array] = (),
    ) -> Array:
        """(n_m,) arm configuration with the end-effector at `p_ee` [m] in the world.

        With further places the posture has room for the path too: its joints are away from
        their limits while the end-effector passes the places with the direction of the start and
        the base does not move. The base's own motion adds to that.

        Args:
            p_ee: Position of the end-effector.
            seed: Seed of the starting points of the search.
            turn: [rad] angle of the end-effector to the left of straight away from the mount.
            tries: Starting points of the search per pitch of the end-effector.
            along: (3,) [m] each, further places of the end-effector, in order.

        Raises:
            UnreachableError: There is no configuration; names the reasons.
        """
        target = np.array(p_ee, dtype=float)
        if not (np.isfinite(target).all() and target[2] > 0.0):
            raise UnreachableError(
                f"start {_text(p_ee)}: the floor is z = 0, the end-effector must be above"
            )
        if (beyond := self._search.beyond(target)) > 0.0:
            raise UnreachableError(
                f"start {_text(p_ee)}: {OUT_OF_REACH} by {beyond:.2f} m or more", {OUT_OF_REACH: 1}
            )
        rng = np.random.default_rng(seed)
        flaws: Counter[str] = Counter()
        directions: list[Array | None] = [
            pin.utils.rotate("z", turn) @ self._direction(target, pitch) for pitch in _PITCHES
        ]
        if not self._points_anywhere:
            directions.append(None)
        best = Found(None, 0.0, Counter())
        for direction in directions:
            found = self._try(Target(target, direction), self._guesses(rng, tries), along)
            if found.quality > best.quality:
                best = found
            if best.q_m is not None and not along:
                break
            flaws.update(found.flaws)
        if best.q_m is not None:
            return best.q_m
        told = "; ".join(f"{flaw} ({count} tries)" for flaw, count in flaws.most_common(3))
        raise UnreachableError(
            f"start {_text(p_ee)}: no configuration of the arm reaches it: {told}", flaws
        )

    def _guesses(self, rng: np.random.Generator, tries: int) -> Iterator[Array]:
        for k, anywhere in enumerate(self._search.guesses(rng, tries)):
            yield np.array(self._model.description.arm.ready_position) if k == 0 else anywhere

    def _try(self, target: Target, guesses: Iterable[Array], along: Sequence[Array] = ()) -> Found:
        return self._search.best(guesses, lambda q: self._judge(q, target, along), target=target)

    def slide(self, p_ee: tuple[float, float, float], q_m: Array) -> Array:
        """(n_m,) the posture near another one with the end-effector's origin at `p_ee` (3,) [m].

        Its direction is that of q_m (n_m,), and the arm does not change its branch.

        Raises:
            UnreachableError: The posture is invalid; names the reason.
        """
        self._search.place(q_m)
        direction = self._search.state.T_world_ee.rotation[:, 2].copy()
        found = self._try(Target(np.array(p_ee, dtype=float), direction), [q_m])
        if found.q_m is None:
            raise UnreachableError(f"start {_text(p_ee)}: {next(iter(found.flaws))}", found.flaws)
        return found.q_m

    def reaches(self, p_ee: tuple[float, float, float], *, seed: int = 0, tries: int = 4) -> bool:
        """Whether the end-effector reaches `p_ee` [m] within the joint limits, in any direction."""
        target = Target(np.array(p_ee, dtype=float))
        if self._search.beyond(target.p) > 0.0:
            return False
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
        """[m] distance of the end-effector from its target."""
        return float(np.linalg.norm(self._search.state.T_world_ee.translation - target.p))

    def _judge(self, q: Array, target: Target, along: Sequence[Array]) -> float | str:
        search = self._search
        if self._off(target) > _POSITION_TOLERANCE:
            return OUT_OF_REACH
        points = search.state.T_world_ee.rotation[:, 2]
        if target.z is not None and np.linalg.norm(points - target.z) > _DIRECTION_TOLERANCE:
            return "out of reach with the end-effector pointing away from the mount"
        if search.above_floor() < _FLOOR_MARGIN:
            return "the arm would touch the floor"
        clearance = np.inf
        for closest in search.monitor.find_closest_points():
            if closest.d < search.d_b + _BUFFER_MARGIN:
                return f"{closest.pair.name} would be inside its buffer"
            clearance = min(clearance, closest.d - search.d_b)
        return self._room(q, along) + min(clearance, 0.1)

    def _room(self, q_m: Array, along: Sequence[Array]) -> float:
        """[-] margin of joint ranges and mobility at a posture, and on the path."""
        search = self._search
        R = search.state.T_world_ee.rotation.copy()
        joints, mobility = search.joint_room(q_m), manipulability(search.J_hand)
        for p in along:
            target = pin.SE3(R, p)
            q_m = search.reach(target, q_m)
            if np.abs(search.linearised(q_m, target)[0]).max() > _WAY_TOLERANCE:
                return 0.0
            joints = min(joints, search.joint_room(q_m))
            mobility = min(mobility, manipulability(search.J_hand))
        return min(joints, 0.15) + min(mobility, 0.1)


_Place = tuple[float, float, float]


@kept_per_model(_KEPT)
def find_start(
    model: RobotModel,
    pairs: LinkPairs,
    d_b: float,
    p_ee: _Place,
    *,
    seed: int = 0,
    move: _Place | None = None,
) -> Array:
    """(n_m,) arm configuration of `StartSolver.solve`, read-only and cached.

    Thus a run that starts again, for example with another controller, does not repeat the search.
    From the start the end-effector follows a line, its `move` (3,) [m], with a constant direction.

    Raises:
        UnreachableError: There is no configuration; names the reasons.
    """
    along = () if move is None else [np.add(p_ee, share * np.array(move)) for share in _SHARES]
    return _frozen(StartSolver(model, pairs, d_b).solve(p_ee, seed=seed, along=along))


class GraspSolver:
    """Finds a configuration with the end-effector at a door's handle and every pair outside its
    buffer.

    It chooses the one that can follow the door farthest, and among equals the one with
    the most room on the path, while the base moves back from the door.
    """

    def __init__(self, model: RobotModel, pairs: LinkPairs, d_b: float) -> None:
        """Prepare for a robot and a buffer distance [m]."""
        self._search = PostureSearch(model, pairs, d_b)
        self._front = float(MobileBody(model).upper[0])

    def solve(
        self, base_pose: Array, door: Door, angle: float, *, seed: int = 0
    ) -> tuple[Array, pin.SE3]:
        """(n_m,) the arm at a door's handle, and the end-effector's pose: horizontal, palm to the
        door.

        The base is at x, y [m] and heading [rad], the door is open by an angle [rad].

        Raises:
            UnreachableError: There is no configuration.
        """
        rng = np.random.default_rng(seed)
        best = Found(None, 0.0, Counter())
        target = pin.SE3.Identity()
        self._search.stand(base_pose)
        far = self._search.beyond(door.handle(angle).translation) > 0.0
        for roll in () if far else _ROLLS:
            rolled = _rolled(door.handle(angle), roll)
            self._search.stand(base_pose)
            found = self._search.best(
                self._search.guesses(rng, _ROLL_SEEDS),
                lambda q, roll=roll: self._judge(base_pose, door, angle, roll, q),
                target=rolled,
            )
            if found.quality > best.quality:
                best, target = found, rolled
        if best.q_m is None:
            x, y, z = door.handle(angle).translation
            raise UnreachableError(
                f"no configuration of the arm reaches the handle at "
                f"({x:.2f}, {y:.2f}, {z:.2f}) m from a base at ({base_pose[0]:.2f}, "
                f"{base_pose[1]:.2f}) m; place base and handle 0.7 to 1.1 m from each other"
            )
        return best.q_m, target

    def _judge(self, base_pose: Array, door: Door, angle: float, roll: float, q_m: Array) -> float:
        """Quality of a posture at the handle: the door angles that it can follow, and its room."""
        room = self._room(_rolled(door.handle(angle), roll), q_m, _GRASP_TOLERANCE, _BUFFER_MARGIN)
        if room > 0.0:
            room = self._room_ahead(base_pose, door, angle, roll, q_m, room)
            self._search.stand(base_pose)
        return room

    def _room_ahead(
        self, base_pose: Array, door: Door, angle: float, roll: float, q_start: Array, room: float
    ) -> float:
        """[-] one for each door angle that the arm can follow, plus the smallest room there.

        As in the controller, the arm stays near its starting posture in the task's null space.
        """
        q_m, followed = q_start, 0
        for turned in _AHEAD:
            target = _rolled(door.handle(angle + turned), roll)
            self._search.stand(self._backed_off(base_pose, door, angle + turned))
            for _ in range(_CORRECTIONS):
                q_m = self._corrected(target, q_m, q_start)
            if (there := self._room(target, q_m, _LOOSE_TOLERANCE, -_MAX_INSIDE)) <= 0.0:
                break
            followed, room = followed + 1, min(room, there)
        return followed + room

    def _backed_off(self, base_pose: Array, door: Door, angle: float) -> Array:
        """(3,) the base, moved back until the door's free edge is outside of its front's buffer."""
        edge = door.pose(angle).act(np.array([0.0, -door.side * door.width, 0.0]))
        x, y, heading = base_pose
        forwards = np.array([np.cos(heading), np.sin(heading)])
        gap = float((edge[:2] - [x, y]) @ forwards) - self._front
        return np.array(
            [*(np.array([x, y]) + min(gap - self._search.d_b, 0.0) * forwards), heading]
        )

    def _corrected(self, target: pin.SE3, q_m: Array, q_start: Array) -> Array:
        """(n_m,) one step towards the target, and in its null space towards a posture."""
        error, J = self._search.linearised(q_m, target)
        back = _TO_START * (q_start - q_m)
        return q_m + back - np.linalg.pinv(J, 1e-3) @ (error + J @ back)

    def _room(self, target: pin.SE3, q_m: Array, tolerance: float, clearance: float) -> float:
        """[-] above zero and below one if the configuration is valid; larger is better."""
        search = self._search
        search.place(q_m)
        if np.abs(pin.log6(search.state.T_world_ee.actInv(target)).vector).max() > tolerance:
            return 0.0
        beyond = min(search.distances()) - search.d_b
        joints = search.joint_room(q_m)
        if beyond < clearance or joints < _GRASP_MARGIN:
            return 0.0
        bending = manipulability(search.J_hand)
        return min(joints, 0.15) + 2 * min(bending, 0.05) + 5 * min(beyond - clearance, 0.1)


@kept_per_model(_KEPT)
def find_grasp(
    model: RobotModel,
    pairs: LinkPairs,
    d_b: float,
    base_pose: _Place,
    door: Door,
    angle: float,
    *,
    seed: int = 0,
) -> tuple[Array, pin.SE3]:
    """The arm, read-only, and the end-effector from `GraspSolver.solve`; cached.

    Raises:
        UnreachableError: There is no configuration.
    """
    q_m, T_ee = GraspSolver(model, pairs, d_b).solve(np.array(base_pose), door, angle, seed=seed)
    return _frozen(q_m), T_ee


def _frozen(q_m: Array) -> Array:
    q_m.flags.writeable = False
    return q_m


def _rolled(pose: pin.SE3, roll: float) -> pin.SE3:
    return pose * pin.SE3(pin.rpy.rpyToMatrix(0.0, 0.0, roll), np.zeros(3))


def _text(point: tuple[float, float, float]) -> str:
    return "(" + ", ".join(f"{x:g}" for x in point) + ") m"
