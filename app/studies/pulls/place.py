"""Where the hand of a case starts: on a ray out of the base, in a direction of the whole sphere."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from app.config import Config
from app.errors import StudyError, UnreachableError
from app.simulation.scenarios.start import StartSolver
from app.studies.pulls.draw_range import Interval
from app.studies.pulls.sources import Outline, StudySources

Array = np.ndarray

SECTORS = ("front", "front corner", "side", "back", "above", "below")
"""Parts of the sphere of directions from the base to the hand; each is as likely. "above" is
steeper than 45°, "below" falls by more than 10°, the others are parts of what lies between."""

_TRIES = 600  # places drawn before a case is given up
_PATIENCE = 60  # of them in one sector
_SEARCHES = 2  # for a posture, per pitch of the hand; another place is sooner found than a third
_GAP = 0.22, 0.50  # [m] along the ray, from the base's box to the hand
_INNER = 0.9  # [-] part of the base's plan that is aimed at
_LOWEST = 0.05  # [m] above the floor to which a hand is pulled
_STEEP, _FALLING = math.sin(math.radians(45.0)), -math.sin(math.radians(10.0))
_FRONT, _CORNER, _SIDE = math.radians(30.0), math.radians(60.0), math.radians(120.0)


class Start(NamedTuple):
    """Where a case starts, and where the base is from there.

    Attributes:
        sector: One of `SECTORS`.
        p: (3,) [m] the hand, in the base's frame.
        aim: (3,) [m] a point in the base.
    """

    sector: str
    p: Array
    aim: Array

    @property
    def outwards(self) -> Array:
        """(3,) unit vector from the aim to the hand."""
        way = self.p - self.aim
        return way / np.linalg.norm(way)


def draw_start(
    sources: StudySources, heights: Interval, rng: np.random.Generator
) -> tuple[Start, Array, int]:
    """A start, the arm's joints (n_m,) there, and how many places were not reached before.

    Raises:
        StudyError: The arm reaches none at these heights.
    """
    solver = StartSolver(sources.model, sources.data.pairs, Config().border.d_b)
    sector = ""
    for redraws in range(_TRIES):
        if redraws % _PATIENCE == 0:
            sector = SECTORS[rng.integers(len(SECTORS))]
        start, seed = place(sector, sources.outline, rng), int(rng.integers(2**32))
        if not (heights[0] <= start.p[2] <= heights[1] and sources.reach.holds(start.p)):
            continue
        try:
            x, y, z = start.p.tolist()
            return start, solver.solve((x, y, z), seed=seed, tries=_SEARCHES), redraws
        except UnreachableError:
            continue
    raise StudyError(
        f"the arm of {sources.model.description.name} reaches none of {_TRIES} starts with its "
        f"hand {heights[0]:g} to {heights[1]:g} m above the floor; try other heights"
    )


def place(sector: str, outline: Outline, rng: np.random.Generator) -> Start:
    """A random place in that sector, reached or not."""
    plan = outline.middle + _INNER * outline.half * rng.uniform(-1, 1, 2)
    aim = np.array([*plan, rng.uniform(_LOWEST, outline.top)])
    outwards = _direction(sector, rng)
    way = _way_out(aim, outwards, outline) + rng.uniform(*_GAP)
    return Start(sector, aim + way * outwards, aim)


def sector_of(direction: Array) -> str:
    """The sector of a unit vector (3,) in the base's frame."""
    x, y, z = direction.tolist()
    if z > _STEEP:
        return "above"
    if z < _FALLING:
        return "below"
    azimuth = abs(math.atan2(y, x))
    edges = (("front", _FRONT), ("front corner", _CORNER), ("side", _SIDE))
    return next((name for name, edge in edges if azimuth < edge), "back")


def _direction(sector: str, rng: np.random.Generator) -> Array:
    """(3,) a unit vector, uniform over a sector of the sphere."""
    while True:
        v = rng.standard_normal(3)
        v /= np.linalg.norm(v)
        if sector_of(v) == sector:
            return v


def _way_out(p: Array, direction: Array, outline: Outline) -> float:
    """[m] from a point of the base's box to where a ray leaves the box."""
    lower, upper = np.array([*outline.lower, 0.0]), np.array([*outline.upper, outline.top])
    with np.errstate(divide="ignore"):
        ways = np.where(direction > 0.0, upper - p, lower - p) / direction
    return float(np.min(np.where(direction == 0.0, np.inf, ways)))
