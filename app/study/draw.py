"""Drawing a case: the same for the same study and number, whatever else is drawn."""

from __future__ import annotations

import math

import numpy as np

from app.errors import StudyError
from app.study.case import Case
from app.study.envelope import Envelope
from app.study.parameters import StudyParameters
from app.study.place import Start, draw_start
from app.study.sources import Outline, StudySources
from app.study.study_range import PARAMETERS, StudyRange

Array = np.ndarray

_TRIES = 1000  # values drawn before none is said to lie in the envelope
_ALONG = 0.15  # [-] share of the pulls from around the base that go along it
_ALONG_ANGLE = math.radians(25.0)  # of such a pull towards the base, at most
_INNER = 0.9  # [-] part of the base's plan that is aimed at
_AIM_HEIGHTS = -0.35, 0.10  # [m] of the aim above the start
_LOWEST = 0.05  # [m] above the floor to which a hand is pulled
_BENEATH = 0.5  # [-] of the way in plan to an aim, for a hand that comes from above
_DEEP = 0.10  # [m] below the base's top to which a hand from above is pulled
_TRAVEL = 0.15, 0.50  # [m] of a pull
_HOLD = 1.5  # [s] after the pull, in which the base may still be hit
_PEAK = 1.5  # [-] largest speed of the cubic over its mean


def draw_case(
    parameters: StudyParameters, number: int, sources: StudySources,
    envelope: Envelope | None = None,
) -> Case:  # fmt: skip
    """The case of that number.

    Its random numbers come from a stream of its own, so it depends on the study and its number
    alone, not on who draws it or when. A start that the arm does not reach with all of its pairs
    clear of their buffers is drawn again from the same stream.

    Args:
        parameters: Of the study.
        number: From 0.
        sources: The study's robot.
        envelope: In which the case has to lie, or None.

    Raises:
        StudyError: The arm reaches no start at that height, or no case lies in the envelope.
    """
    rng = np.random.default_rng(np.random.SeedSequence(parameters.seed, spawn_key=(number,)))
    drawn = _draw_values(parameters.ranges, envelope, rng)
    start, q_m, redraws = draw_start(sources, parameters.ranges.height, rng)
    move, along = _draw_move(start, sources.outline, rng)
    move, duration, moving = _timed(move, drawn["speed"], parameters.ranges.duration)
    return Case(
        study_seed=parameters.seed, number=number,
        kind=f"{start.side}, along" if along else start.side, redraws=redraws,
        robot=parameters.robot, controller=parameters.controller, physics=parameters.physics,
        start=_triple(start.p), move=_triple(move), duration=duration, moving=moving,
        q_m=tuple(q_m.tolist()), seed=int(rng.integers(2**32)), **drawn,
    )  # fmt: skip


def _draw_values(
    ranges: StudyRange, envelope: Envelope | None, rng: np.random.Generator
) -> dict[str, float]:
    """Speed and disturbances, by their names in `Case`."""
    intervals = {name: getattr(ranges, name) for name in ("speed", *PARAMETERS)}
    for _ in range(_TRIES):
        drawn = {name: float(rng.uniform(*interval)) for name, interval in intervals.items()}
        if envelope is None or envelope.holds(drawn):
            return drawn
    raise StudyError(
        f"none of {_TRIES} cases from these ranges lies in the stated envelope; "
        "dbb study --help tells how to choose others"
    )


def _draw_move(start: Start, outline: Outline, rng: np.random.Generator) -> tuple[Array, bool]:
    """(3,) [m] the pull, and whether it goes along the base."""
    travel, along = rng.uniform(*_TRAVEL), rng.random() < _ALONG
    left, turn = 1.0 if rng.random() < 0.5 else -1.0, rng.uniform(0, _ALONG_ANGLE)
    inside = outline.middle + _INNER * outline.half * rng.uniform(-1, 1, 2)
    rise = rng.uniform(*_AIM_HEIGHTS)
    if start.side == "above":
        plan = _BENEATH * (inside - start.p[:2])
        way = np.array([*plan, outline.top - _DEEP - start.p[2]])
    elif start.side == "back corner":  # over the rim and down
        way = np.array([*(inside - start.p[:2]), outline.top + rise - start.p[2]])
    elif along:
        o = start.outwards
        tangent = left * np.array([-o[1], o[0]])
        return travel * np.array([*(math.cos(turn) * tangent - math.sin(turn) * o), 0.0]), True
    else:
        z = max(start.p[2] + rise, _LOWEST)
        way = np.array([*(inside - start.p[:2]), z - start.p[2]])
    return way * min(1.0, travel / float(np.linalg.norm(way))), False


def _timed(move: Array, speed: float, longest: float) -> tuple[Array, float, float]:
    """The pull, cut short if it takes too long, the run's duration [s] and the share of pulling."""
    hold = min(_HOLD, longest / 4)
    pulling = _PEAK * float(np.linalg.norm(move)) / speed
    if pulling > longest - hold:
        move = move * ((longest - hold) / pulling)
        pulling = longest - hold
    return move, pulling + hold, pulling / (pulling + hold)


def _triple(p: Array) -> tuple[float, float, float]:
    x, y, z = p.tolist()
    return x, y, z
