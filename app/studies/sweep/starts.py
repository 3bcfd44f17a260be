"""Search for the starts of the paths: postures of the arm just outside all buffers."""

from collections import Counter
from collections.abc import Iterator
from dataclasses import replace
from itertools import islice, product, tee

import numpy as np

from app.avoidance.closest_points import ClosestPoints, DistanceMonitor
from app.border.cache import BorderData
from app.border.mobile import MobileBody
from app.errors import UnreachableError
from app.robot.model import RobotModel
from app.robot.state import RobotState, at_rest
from app.simulation.scenarios.start import OUT_OF_REACH, StartSolver
from app.strict import Array
from app.studies.sweep.plan import Approach, Start, exit_distance, point_of

_Posture = tuple[Array, Array]  # (3,) [m] the end-effector's origin, (n_m,) joint positions

_GAPS = (0.30, 0.24, 0.36, 0.20, 0.42)
"""[m] distances of the end-effector's origin from the base's outline or top, preferred first."""
_SEARCHES = tuple(
    (float(np.radians(turn)), k)
    for turn, k in ((0, 0), (0, 1), (40, 0), (-40, 0), (80, 0), (-80, 0))
)
"""[rad] horizontal angle of the end-effector from the outward direction, and a number that is added
to the seed; preferred first."""
_TRIES = 4  # [-] starting points of a search for each pitch of the end-effector
_MAX_POSTURES = 6  # [-] largest number of postures that are tried for a path
_SLIDE = 0.02  # [m] first step of the end-effector towards the desired distance
_FARTHEST_SLIDE = 0.25  # [m] sum of these steps after which no further step is made
_DISTANCE_TOLERANCE = 1e-4  # [m] tolerance of the distance at the start
_OFFSET_TOLERANCE = 1e-7  # [m] tolerance of the x coordinate of p_b, similar to that of distances
_OFFSET_TRIES = 40  # [-] largest number of corrections of p_b
_SMALL_OFFSET = 1e-4  # [m] error of p_b below which joint steps replace the search for postures


class StartFinder:
    """Finds the starts of a robot's paths; the base is at the origin and faces +x."""

    def __init__(self, model: RobotModel, data: BorderData, d_b: float) -> None:
        """Prepare the search for a robot, its border data and a buffer distance `d_b` [m]."""
        self.model, self.data = model, data
        self._solver = StartSolver(model, data.pairs, d_b)
        self._state = RobotState(model)
        self._monitor = DistanceMonitor(self._state, data.pairs.mobile)
        self._body = MobileBody(model)
        self._searched: tuple[Approach, int] | None = None
        self._found: Iterator[_Posture] = iter(())
        self._flaws: Counter[str] = Counter()

    def find(self, approach: Approach, distance: float, *, seed: int = 0) -> Start:
        """Find the start of a path, or the reasons why there is none.

        Args:
            approach: The path.
            distance: [m] desired distance between arm and base. If the arm cannot reach it on the
                path's line, the start has the distance at which the search ended.
            seed: Seed of the search.
        """
        refused: Counter[str] = Counter()
        for posture in islice(self._postures(approach, seed), _MAX_POSTURES):
            try:
                p_ee, q_m = self._slide_to_distance(approach, *posture, distance)
                if approach.kind == "wheel_axis":
                    q_m = self._slide_to_offset(p_ee, q_m, approach.offset)
            except UnreachableError as error:
                refused[str(error)] += 1
                continue
            closest = self._closest(q_m)
            p_ee, p_b = point_of(self._state.T_world_ee.translation), point_of(closest.p_b)
            return Start(approach, tuple(q_m.tolist()), p_ee, p_b, float(closest.d))
        return Start(approach, reason=_summary(refused or self._flaws))

    def _postures(self, approach: Approach, seed: int) -> Iterator[_Posture]:
        """Postures for a path; paths that differ only in `offset` share them."""
        key = replace(approach, offset=0.0), seed
        if key != self._searched:
            self._searched, self._flaws = key, Counter()
            self._found = self._search(approach, seed, self._flaws)
        self._found, postures = tee(self._found)  # stores the found postures for the next path
        return postures

    def _search(self, approach: Approach, seed: int, flaws: Counter[str]) -> Iterator[_Posture]:
        """Search for postures outside all buffers; `flaws` counts the failed tries by reason."""
        places = [self._place(approach, gap) for gap in _GAPS]
        reached = [p for p in places if self._solver.reaches(point_of(p), seed=seed)]
        if len(reached) < len(places):
            flaws[OUT_OF_REACH] = len(places) - len(reached)
        for (turn, k), p_ee in product(_SEARCHES, reached):
            try:
                q_m = self._solver.solve(point_of(p_ee), seed=seed + k, turn=turn, tries=_TRIES)
            except UnreachableError as error:
                flaws.update(error.flaws)
                continue
            yield p_ee, q_m

    def _place(self, approach: Approach, gap: float) -> Array:
        """(3,) [m] position of the end-effector at a gap [m] from the base's outline or top."""
        lower, upper = self._body.lower, self._body.upper
        if approach.kind == "above":
            return np.array([*approach.place, upper[2] + gap])
        centre, outwards = (lower + upper)[:2] / 2, -approach.inwards[:2]
        x, y = centre + (exit_distance(centre, outwards, lower[:2], upper[:2]) + gap) * outwards
        return np.array([x, y, approach.height])

    def _slide_to_distance(
        self, approach: Approach, p_ee: Array, q_m: Array, distance: float
    ) -> tuple[Array, Array]:
        """Move the end-effector along the path's line towards the desired distance [m].

        Returns:
            Position (3,) [m] of the end-effector, and joint positions (n_m,) of the arm.
        """
        excess = self._closest(q_m).d - distance
        step, moved = np.sign(excess) * _SLIDE, 0.0
        while abs(excess) > _DISTANCE_TOLERANCE and abs(step) > _DISTANCE_TOLERANCE / 8:
            if moved > _FARTHEST_SLIDE:
                break
            p_new = p_ee + step * approach.inwards
            try:
                q_new = self._solver.slide(point_of(p_new), q_m)
            except UnreachableError:
                step /= 2
                continue
            new_excess = self._closest(q_new).d - distance
            if new_excess * excess < 0:  # the step was too long
                step /= 2
                continue
            p_ee, q_m, excess, moved = p_new, q_new, new_excess, moved + abs(step)
        return p_ee, q_m

    def _slide_to_offset(self, p_ee: Array, q_m: Array, x: float) -> Array:
        """Find joint positions (n_m,) for which the arm's closest point p_b has the coordinate x.

        Args:
            p_ee: (3,) [m] position of the end-effector at `q_m`. The search shifts this position
                along the base's x axis, and makes the last small correction by the joints alone.
            q_m: (n_m,) [rad or m] joint positions at the start of the search.
            x: [m] desired x coordinate of p_b in the base's frame.

        Raises:
            UnreachableError: The search has found no such posture.
        """
        smallest = np.inf
        for _ in range(_OFFSET_TRIES):
            closest = self._closest(q_m)
            error = float(closest.p_b[0]) - x
            if abs(error) < _OFFSET_TOLERANCE:
                return q_m
            smallest = min(smallest, abs(error))
            if abs(error) > _SMALL_OFFSET:
                p_ee = p_ee - [error, 0.0, 0.0]
                q_m = self._solver.slide(point_of(p_ee), q_m)
            else:  # the smallest joint step, which is finer than the search for postures
                joint = self._state.model.body_joints[closest.pair.b]
                row = self._state.point_jacobian(joint, closest.p_b)[0, self._state.model.n_b :]
                q_m = q_m - row * error / (row @ row)
        raise UnreachableError(
            f"x of the arm's closest point p_b differs by at least {smallest:.1e} m"
        )

    def _closest(self, q_m: Array) -> ClosestPoints:
        """The closest points of the nearest pair of L_m at a posture; sets the state to it."""
        self._state.update(at_rest(self._state.model, q_m))
        return min(self._monitor.find_closest_points(), key=lambda closest: closest.d)


def _summary(flaws: Counter[str]) -> str:
    """The three most frequent reasons of failed tries, as a text."""
    ordered = sorted(flaws.items(), key=lambda item: (-item[1], item[0]))
    return "; ".join(f"{flaw} ({count} tries)" for flaw, count in ordered[:3])
