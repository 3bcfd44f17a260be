"""The starts of the paths: a clear posture of the arm, just outside of its buffer."""

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
from app.studies.sweep.plan import Approach, Start, point_of, way_out

_Posture = tuple[Array, Array]  # (3,) [m] the end-effector's origin, (n_m,) joint positions

_GAPS = (0.30, 0.24, 0.36, 0.20, 0.42)  # [m] from end-effector to the base's outline, best first
_SEARCHES = tuple(
    (float(np.radians(turn)), k)
    for turn, k in ((0, 0), (0, 1), (40, 0), (-40, 0), (80, 0), (-80, 0))
)
"""[rad] rotation of the end-effector from straight outwards, and seed offset; best first."""
_TRIES = 4  # starting points of a search per pitch of the end-effector
_MAX_POSTURES = 6  # attempts for one path
_SLIDE = 0.02  # [m] from one posture to the next towards the desired distance
_FARTHEST_SLIDE = 0.25  # [m]
_DISTANCE_TOLERANCE = 1e-4  # [m] of the distance at the start
_OFFSET_TOLERANCE = 1e-7  # [m] of p_b along the base, about that of the distances
_OFFSET_TRIES = 40
_NEARLY = 1e-4  # [m]


class StartFinder:
    """Finds the starts of a robot's paths; the base is at the origin and faces +x."""

    def __init__(self, model: RobotModel, data: BorderData, d_b: float) -> None:
        """Prepare for a robot and a buffer distance [m]."""
        self.model, self.data = model, data
        self._solver = StartSolver(model, data.pairs, d_b)
        self._state = RobotState(model)
        self._monitor = DistanceMonitor(self._state, data.pairs.mobile)
        self._body = MobileBody(model)
        self._searched: tuple[Approach, int] | None = None
        self._found: Iterator[_Posture] = iter(())
        self._flaws: Counter[str] = Counter()

    def find(self, approach: Approach, distance: float, *, seed: int = 0) -> Start:
        """The start of a path with a distance [m] between arm and base, exactly or nearly."""
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
        """Postures for a path; all paths along the wheel axis try the same ones first."""
        asked = replace(approach, offset=0.0), seed
        if asked != self._searched:
            self._searched, self._flaws = asked, Counter()
            self._found = self._search(approach, seed, self._flaws)
        self._found, postures = tee(self._found)  # reuses earlier results of the search
        return postures

    def _search(self, approach: Approach, seed: int, flaws: Counter[str]) -> Iterator[_Posture]:
        """Clear postures with the end-effector beside the base; counts the reasons of failures."""
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
        """(3,) [m] place of the end-effector at a gap from the base's outline, or above its top."""
        lower, upper = self._body.lower, self._body.upper
        if approach.kind == "above":
            return np.array([*approach.place, upper[2] + gap])
        centre, outwards = (lower + upper)[:2] / 2, -approach.inwards[:2]
        reach = way_out(centre, outwards, lower[:2], upper[:2]) + gap
        x, y = centre + reach * outwards
        return np.array([x, y, approach.height])

    def _slide_to_distance(
        self, approach: Approach, p_ee: Array, q_m: Array, distance: float
    ) -> tuple[Array, Array]:
        """Move along the path's line to the posture with the distance nearest to that."""
        gap = self._closest(q_m).d - distance
        step, gone = np.sign(gap) * _SLIDE, 0.0
        while abs(gap) > _DISTANCE_TOLERANCE and abs(step) > _DISTANCE_TOLERANCE / 8:
            if gone > _FARTHEST_SLIDE:
                break
            try:
                moved = p_ee + step * approach.inwards
                q_new = self._solver.slide(point_of(moved), q_m)
                new_gap = self._closest(q_new).d - distance
            except UnreachableError:
                step /= 2
                continue
            if new_gap * gap < 0:  # too far: halve the step
                step /= 2
                continue
            p_ee, q_m, gap, gone = moved, q_new, new_gap, gone + abs(step)
        return p_ee, q_m

    def _slide_to_offset(self, p_ee: Array, q_m: Array, x: float) -> Array:
        """(n_m,) the posture moved along the base until p_b has the given x.

        Raises:
            UnreachableError: The arm cannot reach it.
        """
        nearest = np.inf
        for _ in range(_OFFSET_TRIES):
            closest = self._closest(q_m)
            off = float(closest.p_b[0]) - x
            if abs(off) < _OFFSET_TOLERANCE:
                return q_m
            nearest = min(nearest, abs(off))
            if abs(off) > _NEARLY:
                p_ee = p_ee - [off, 0.0, 0.0]
                q_m = self._solver.slide(point_of(p_ee), q_m)
            else:  # finer than the search of postures: the shortest joint step
                joint = self._state.model.body_joints[closest.pair.b]
                along = self._state.point_jacobian(joint, closest.p_b)[0, self._state.model.n_b :]
                q_m = q_m - along * off / (along @ along)
        raise UnreachableError(f"p_b comes no nearer to its place than {nearest:.1e} m")

    def _closest(self, q_m: Array) -> ClosestPoints:
        """The closest points of the nearest pair of L_m; leaves the state at that posture."""
        self._state.update(at_rest(self._state.model, q_m))
        return min(self._monitor.find_closest_points(), key=lambda closest: closest.d)


def _summary(flaws: Counter[str]) -> str:
    """The reasons of the failures, the most frequent first."""
    ordered = sorted(flaws.items(), key=lambda item: (-item[1], item[0]))
    return "; ".join(f"{flaw} ({count} tries)" for flaw, count in ordered[:3])
