"""Where a run begins: the arm with its hand at a place, or at the handle of a door."""

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
_BUFFER_MARGIN = 0.005  # [m] beyond the buffer
_FLOOR_MARGIN = 0.01  # [m] between arm and floor
_LOST = 1e-3  # [m/rad or -] singular value of a direction in which the hand cannot move
_UPRIGHT = 0.94  # [-] of an axis, by its z: it leans by 20 degrees at most
_WAY_TOLERANCE = 0.01  # [-] weighted error of the hand on its way: 1 mm
_SHARES = np.linspace(0.2, 1.0, 5)  # [-] of a line, where the way is looked at
_KEPT = 100  # starts of a robot that are not searched again

_ROLLS = np.radians([0.0, 90.0, 180.0, -90.0])  # of the hand about its own axis
_ROLL_SEEDS = 80  # starting points of the search per roll
_GRASP_TOLERANCE = 1e-4  # [m] and [rad]
_LOOSE_TOLERANCE = 5e-3  # [m] and [rad] of the look ahead
_GRASP_MARGIN = 0.015  # [-] share of a joint's range kept from its limits
_MOST_INSIDE = 0.07  # [m] that a pair may be inside of its buffer on the way
_AHEAD = np.radians(np.arange(3, 94, 3))  # of the door's turning for which there has to be room
_CORRECTIONS = 4  # [-] steps of Newton's method for each turn of the door
_TO_START = 0.5  # [-] share of the way back to the starting posture in each of them

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
        # Of less than six directions of motion some are lost, and "away from the mount" is what an
        # arm reaches whose first axis is upright: else the hand points as it has to.
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

        With a way to go the posture is one that has room for it, too: its joints keep away from
        their limits while the hand passes the places, pointing as it does at the start, over a base
        that stands. The base's own motion adds to that.

        Args:
            p_ee: Where the hand shall be.
            seed: Of the starting points of the search.
            turn: [rad] by how much the hand points to the left of straight away from the mount.
            tries: Starting points of the search per pitch of the hand.
            along: (3,) [m] each, places that the hand comes to afterwards, in their order.

        Raises:
            UnreachableError: There is none; says what stands in the way.
        """
        target = np.array(p_ee, dtype=float)
        if not (np.isfinite(target).all() and target[2] > 0.0):
            raise UnreachableError(
                f"start {_text(p_ee)}: the floor is z = 0, the hand must be above"
            )
        if (beyond := self._search.beyond(target)) > 0.0:
            raise UnreachableError(
                f"start {_text(p_ee)}: {OUT_OF_REACH} by {beyond:.2f} m at least", {OUT_OF_REACH: 1}
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
            f"start {_text(p_ee)}: no configuration of the arm brings the hand there: {told}", flaws
        )

    def _guesses(self, rng: np.random.Generator, tries: int) -> Iterator[Array]:
        for k, anywhere in enumerate(self._search.guesses(rng, tries)):
            yield np.array(self._model.description.arm.ready_position) if k == 0 else anywhere

    def _try(self, target: Target, guesses: Iterable[Array], along: Sequence[Array] = ()) -> Found:
        return self._search.best(guesses, lambda q: self._judge(q, target, along), target=target)

    def slide(self, p_ee: tuple[float, float, float], q_m: Array) -> Array:
        """(n_m,) the posture near another, the hand pointing as there, its origin at `p_ee` (3,)
        [m].

        From q_m (n_m,) the place can be reached without a change of branch.

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
        """[m] from the hand to its target."""
        return float(np.linalg.norm(self._search.state.T_world_ee.translation - target.p))

    def _judge(self, q: Array, target: Target, along: Sequence[Array]) -> float | str:
        search = self._search
        if self._off(target) > _POSITION_TOLERANCE:
            return OUT_OF_REACH
        points = search.state.T_world_ee.rotation[:, 2]
        if target.z is not None and np.linalg.norm(points - target.z) > _DIRECTION_TOLERANCE:
            return "out of reach with the hand pointing away from the mount"
        if search.above_floor() < _FLOOR_MARGIN:
            return "the arm would touch the floor"
        clearance = np.inf
        for closest in search.monitor.find_closest_points():
            if closest.d < search.d_b + _BUFFER_MARGIN:
                return f"{closest.pair.name} would be inside its buffer"
            clearance = min(clearance, closest.d - search.d_b)
        return self._room(q, along) + min(clearance, 0.1)

    def _room(self, q_m: Array, along: Sequence[Array]) -> float:
        """[-] what joint ranges and the hand's mobility leave at a posture, and on the way."""
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
    """(n_m,) arm configuration as `StartSolver.solve` finds it, read-only; some are kept.

    So a run that begins again, such as with another controller, does not wait for the search.
    After it the hand follows a line, its `move` (3,) [m], pointing as at the start.

    Raises:
        UnreachableError: There is none; says what stands in the way.
    """
    along = () if move is None else [np.add(p_ee, share * np.array(move)) for share in _SHARES]
    return _frozen(StartSolver(model, pairs, d_b).solve(p_ee, seed=seed, along=along))


class GraspSolver:
    """Finds an arm configuration for a hand at a door's handle, with every pair outside its buffer.

    Of those found it takes the one that can follow the door farthest, and of these the one with
    the most room on the way, while the base backs off as far as the door makes it.
    """

    def __init__(self, model: RobotModel, pairs: LinkPairs, d_b: float) -> None:
        """Prepare for a robot and a buffer distance [m]."""
        self._search = PostureSearch(model, pairs, d_b)
        self._front = float(MobileBody(model).upper[0])

    def solve(
        self, base_pose: Array, door: Door, angle: float, *, seed: int = 0
    ) -> tuple[Array, pin.SE3]:
        """(n_m,) the arm at a door's handle, and the hand's pose: horizontal, its palm to the door.

        The base stands at x, y [m] and heading [rad], the door is open by an angle [rad].

        Raises:
            UnreachableError: There is none.
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
                f"no configuration of the arm brings the hand to the handle at "
                f"({x:.2f}, {y:.2f}, {z:.2f}) m from a base at ({base_pose[0]:.2f}, "
                f"{base_pose[1]:.2f}) m; place base and handle 0.7 to 1.1 m from each other"
            )
        return best.q_m, target

    def _judge(self, base_pose: Array, door: Door, angle: float, roll: float, q_m: Array) -> float:
        """What a posture at the handle is worth: the door's turns that it can follow, and room."""
        room = self._room(_rolled(door.handle(angle), roll), q_m, _GRASP_TOLERANCE, _BUFFER_MARGIN)
        if room > 0.0:
            room = self._room_ahead(base_pose, door, angle, roll, q_m, room)
            self._search.stand(base_pose)
        return room

    def _room_ahead(
        self, base_pose: Array, door: Door, angle: float, roll: float, q_start: Array, room: float
    ) -> float:
        """[-] one for each turn of the door that the arm can follow, plus the least room there.

        As the controller does, the arm holds on to its starting posture where the hand lets it.
        """
        q_m, followed = q_start, 0
        for turned in _AHEAD:
            target = _rolled(door.handle(angle + turned), roll)
            self._search.stand(self._backed_off(base_pose, door, angle + turned))
            for _ in range(_CORRECTIONS):
                q_m = self._corrected(target, q_m, q_start)
            if (there := self._room(target, q_m, _LOOSE_TOLERANCE, -_MOST_INSIDE)) <= 0.0:
                break
            followed, room = followed + 1, min(room, there)
        return followed + room

    def _backed_off(self, base_pose: Array, door: Door, angle: float) -> Array:
        """(3,) the base moved back until the door's free edge is outside of its front's buffer."""
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
        """[-] above zero and below one if the configuration may be used; more is better."""
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
    """The arm, read-only, and the hand as `GraspSolver.solve` finds them; some are kept.

    Raises:
        UnreachableError: There is none.
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
