"""Where the hand of a case starts: a random place around or over the base that the arm reaches."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from app.config import Config
from app.errors import StudyError, UnreachableError
from app.simulation.start import StartSolver
from app.study.sources import Outline, StudySources
from app.study.study_range import Interval

Array = np.ndarray

SIDES = ("front", "front corner", "side", "rear side", "back corner", "above")
"""Where the hand starts, as seen from the base; each is as likely."""

_TRIES = 600  # places drawn before a case is given up
_PATIENCE = 60  # of them on one side
_GAP = 0.24, 0.50  # [m] from the base's outline to the hand, in plan
_CORNER_GAP = 0.0, 0.30  # [m] of the back corners, to which the arm reaches from above
_RISE = 0.22, 0.50  # [m] from the base's top to the hand over it, or over a back corner
_FRONT_PART = -0.3  # [-] of the half length: behind it begins the rear of a side


class Start(NamedTuple):
    """Where a case starts.

    Attributes:
        side: One of `SIDES`.
        p: (3,) [m] the hand, in the base's frame.
        outwards: (2,) unit vector away from the base in plan; zero above it.
    """

    side: str
    p: Array
    outwards: Array


def draw_start(
    sources: StudySources, heights: Interval, rng: np.random.Generator
) -> tuple[Start, Array, int]:
    """A start, the arm's joints (n_m,) there, and how many places were not reached before.

    Raises:
        StudyError: The arm reaches none at these heights.
    """
    solver = StartSolver(sources.model, sources.data.pairs, Config().border.d_b)
    side = ""
    for redraws in range(_TRIES):
        if redraws % _PATIENCE == 0:
            side = SIDES[rng.integers(len(SIDES))]
        start, seed = place(side, heights, sources.outline, rng), int(rng.integers(2**32))
        if not sources.reach.holds(start.p):
            continue
        try:
            x, y, z = start.p.tolist()
            return start, solver.solve((x, y, z), seed=seed), redraws
        except UnreachableError:
            continue
    raise StudyError(
        f"the arm of {sources.model.description.name} reaches none of {_TRIES} starts with its "
        f"hand {heights[0]:g} to {heights[1]:g} m above the floor; try other heights"
    )


def place(side: str, heights: Interval, outline: Outline, rng: np.random.Generator) -> Start:
    """A random place on that side, reached or not."""
    sign = 1.0 if rng.random() < 0.5 else -1.0
    gap, z, rise = rng.uniform(*_GAP), rng.uniform(*heights), rng.uniform(*_RISE)
    foot, outwards = rng.uniform(-1, 1, 2), np.zeros(2)  # foot: in halves of length and width
    if side == "front":
        foot[0], outwards = 1.0, np.array([1.0, 0.0])
    elif side == "front corner":
        angle = rng.uniform(0, np.pi / 2)
        foot, outwards = np.array([1.0, sign]), np.array([math.cos(angle), sign * math.sin(angle)])
    elif side in ("side", "rear side"):
        part = (_FRONT_PART, 1.0) if side == "side" else (-1.0, _FRONT_PART)
        foot, outwards = np.array([rng.uniform(*part), sign]), np.array([0.0, sign])
    elif side == "back corner":
        foot, outwards = np.array([-1.0, sign]), np.array([-1.0, sign]) / math.sqrt(2)
        gap, z = rng.uniform(*_CORNER_GAP), outline.top + rise
    else:
        z = outline.top + rise
    plan = outline.middle + outline.half * foot + gap * outwards
    return Start(side, np.array([*plan, z]), outwards)
