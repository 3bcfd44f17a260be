"""Where guiding begins and ends with this robot: as the paper's, where it fits."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from itertools import product
from typing import NamedTuple

import numpy as np

from app.border.mobile import MobileBody
from app.errors import UnreachableError
from app.robot.link_pairs import LinkPairs
from app.robot.model import RobotModel
from app.simulation.scenarios.start import StartSolver

Array = np.ndarray
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
