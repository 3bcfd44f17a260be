"""Postures of a new robot: the ready pose, and where guiding by hand begins and ends."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from itertools import product
from typing import Any, NamedTuple

import numpy as np

from app.border.mobile import MobileBody
from app.errors import UnreachableError
from app.robot.link_pairs import LinkPairs
from app.robot.model import RobotModel
from app.simulation.scenarios.posture import PostureSearch, manipulability
from app.simulation.scenarios.start import StartSolver

Array = np.ndarray

RULE = (
    "chosen: of random poses within the middle 80 % of each joint's range, the one with the most "
    "clearance (counted up to 0.15 m beyond the buffer), manipulability (against the best), hand "
    "in front of or beside the base, forwards or down, and joints near their middle"
)
_SAMPLES = 6000
_KEPT = 0.1  # [-] share of a joint's range kept from either limit
_ENOUGH = 0.15  # [m] beyond the buffer
_FLOOR = 0.1  # [m] between the arm and the floor
_BAD = 1e3  # [-] makes the worth of the worst pose more than zero: a pose is always chosen


class Ready(NamedTuple):
    """A pose and what is near in it.

    Attributes:
        q_m: (n_m,) [rad or m]
        clearance: [m] least distance of a pair beyond the buffer; negative inside of it.
        nearest: Name of that pair.
        manipulability: √det(J Jᵀ) of the hand.
    """

    q_m: Array
    clearance: float
    nearest: str
    manipulability: float


def find_ready(model: RobotModel, pairs: LinkPairs, *, d_b: float, seed: int) -> Ready:
    """The best of random poses by the rule.

    Args:
        model: The robot with its bodies.
        pairs: The pairs that avoidance watches.
        d_b: [m] buffer distance.
        seed: Of the poses.
    """
    rng, judge = np.random.default_rng(seed), _Judge(model, pairs, d_b)
    search, middle = judge.search, judge.search.middle
    span = np.minimum(search.span, 2 * np.pi)  # nobody waits with a joint wound up
    poses = middle + (rng.random((_SAMPLES, model.n_m)) - 0.5) * (1 - 2 * _KEPT) * span
    best = max(map(judge.manipulability, poses)) or 1.0

    def worth(q_m: Array) -> float:
        ready = judge.look(q_m)
        return (
            _BAD
            + 1.5 * min(ready.clearance, _ENOUGH) / _ENOUGH
            + ready.manipulability / best
            + judge.placed()
            - 0.5 * float(np.mean(np.abs(q_m - middle) / span))
        )

    found = search.best(poses, worth).q_m
    assert found is not None
    return judge.look(np.round(found, 2))


def judge_ready(model: RobotModel, pairs: LinkPairs, q_m: Array, *, d_b: float) -> Ready:
    """What is near in a pose that was given."""
    return _Judge(model, pairs, d_b).look(np.asarray(q_m, dtype=float))


class _Judge:
    def __init__(self, model: RobotModel, pairs: LinkPairs, d_b: float) -> None:
        self.search = PostureSearch(model, pairs, d_b)
        self._names = [pair.name for pair in pairs.all]
        self._mount = model.p_base()

    def look(self, q_m: Array) -> Ready:
        """What is near in a pose."""
        m = self.manipulability(q_m)
        distances = self.search.distances()
        i = int(np.argmin(distances)) if distances else -1
        clearance = distances[i] - self.search.d_b if distances else np.inf
        return Ready(q_m, float(clearance), self._names[i] if distances else "", m)

    def manipulability(self, q_m: Array) -> float:
        """√det(J Jᵀ) of the hand in a pose, of its place alone with fewer than six joints."""
        self.search.place(q_m)
        return manipulability(self.search.J_hand if len(q_m) >= 6 else self.search.J_hand[:3])

    def placed(self) -> float:
        """[-] how well the hand is placed: up to 1.2, far below 0 where it cannot be used."""
        at = self.search.state.T_world_ee
        out = at.translation - self._mount
        away = float(np.hypot(*out[:2]))
        if self.search.above_floor() < _FLOOR or away < 0.05:
            return -10.0
        ahead = out[0] / away  # 1 in front, 0 beside, -1 behind
        points = at.rotation[:, 2]
        outwards = max(float(points[:2] @ out[:2]) / away, -float(points[2]))
        return 0.5 * max(ahead, 0.6 if ahead > -0.3 else ahead) + 0.7 * outwards


Point = tuple[float, float, float]

_OUT = (0.425, 0.375, 0.35, 0.325, 0.30, 0.275, 0.25)  # [m] from the base's side, farthest first
_LEFT_OVER = 0.125  # [m] to the base's side at the end, if the base stood still
_TRIES = 4


class Place(NamedTuple):
    """A line of guiding.

    Attributes:
        start, move: [m] as the scenario has them.
        source: In words.
    """

    start: Point
    move: Point
    source: str

    def content(self) -> dict[str, Any]:
        """As a description has it."""
        source = {"start_m": self.source, "move_m": self.source}
        return {"start_m": self.start, "move_m": self.move, "source": source}


def find_places(
    model: RobotModel,
    pairs: LinkPairs,
    d_b: float,
    *,
    on_progress: Callable[[float], None] = lambda _: None,
) -> dict[str, Place]:
    """Lines towards the base from its side and its front, by the scenario's name.

    From 0.43 m beside the box around l_m (0.25 m where the arm is short) to 0.125 m, as with the
    paper's robot, at the height nearest to 0.8 of the box at which the arm can start. A side that
    the arm does not reach has none.

    Args:
        model: The robot.
        pairs: Its pairs.
        d_b: [m] buffer distance.
        on_progress: Called with the share of the places that was looked at, 0 to 1.
    """
    solver = StartSolver(model, pairs, d_b)
    body, mount = MobileBody(model), model.p_base()
    top = float(body.upper[2])
    reachable = min(top, float(mount[2]) + 0.4)
    heights = [round(h, 3) for h in _heights(reachable)]
    found: dict[str, Place] = {}
    ways = {"guiding-lateral": _lateral(body, mount), "guiding-front": _front(body, mount)}
    for k, (name, lines) in enumerate(ways.items()):
        place = _first(
            solver, list(lines), heights, lambda share, k=k: on_progress((k + share) / len(ways))
        )
        if place is not None:
            found[name] = place
    return found


def _heights(top: float) -> list[float]:
    return [0.8 * top, 0.65 * top, top, top + 0.1, 0.5 * top, top + 0.2, top + 0.35]


def _lateral(body: MobileBody, mount: Array) -> Iterator[tuple[Array, Array]]:
    """Starts and moves in plan, beside the mount, left before right."""
    x = float(np.clip(mount[0], body.lower[0] + 0.05, body.upper[0] - 0.05))
    for out in _OUT:
        for side, edge in ((1.0, body.upper[1]), (-1.0, body.lower[1])):
            yield np.array([x, edge + side * out]), np.array([0.0, -side * (out - _LEFT_OVER)])


def _front(body: MobileBody, mount: Array) -> Iterator[tuple[Array, Array]]:
    """Starts and moves in plan, ahead of the mount or at either edge."""
    low, high = float(body.lower[1]), float(body.upper[1])
    beside = float(np.clip(mount[1], low, high)) + 0.1
    for y in (min(beside, high), low + 0.05, high - 0.05):
        for out in _OUT:
            yield np.array([body.upper[0] + out, y]), np.array([-(out - _LEFT_OVER), 0.0])


def _first(
    solver: StartSolver,
    lines: list[tuple[Array, Array]],
    heights: list[float],
    on_progress: Callable[[float], None],
) -> Place | None:
    for k, ((start, move), z) in enumerate(product(lines, heights)):
        on_progress(k / (len(lines) * len(heights)))
        p = _point([*np.round(start, 3), z])
        if not solver.reaches(p):
            continue
        try:
            solver.solve(p, tries=_TRIES)
        except UnreachableError:
            continue
        return Place(
            p,
            _point([*np.round(move, 3), 0.0]),
            "chosen: the first place, from far to near, where the arm can start clear of the "
            "buffers; it leads to 0.125 m beside the base",
        )
    return None


def _point(values: list[float]) -> Point:
    x, y, z = (float(v) + 0.0 for v in values)
    return x, y, z
