"""Drawing a case: the same for the same study and number, whatever else is drawn."""

from __future__ import annotations

import math

import numpy as np

from app.errors import StudyError
from app.studies.pulls.case import Case
from app.studies.pulls.draw_range import LOGARITHMIC, PARAMETERS, Interval, StudyRange
from app.studies.pulls.envelope import Envelope
from app.studies.pulls.parameters import StudyParameters
from app.studies.pulls.place import Start, draw_start
from app.studies.pulls.sources import StudySources

Array = np.ndarray

_TRIES = 10_000  # values drawn before none is said to lie in the envelope
_ALONG = 0.15  # [-] share of the pulls that go along the base
_ALONG_ANGLE = math.radians(45.0)  # of such a pull towards the base, at most
_LOWEST = 0.05  # [m] above the floor to which a hand is pulled
_TRAVEL = 0.15, 0.60  # [m] of a pull along the base; one towards it goes into it, 0.6 m at most
_HOLD = 1.0  # [s] after the pull, in which the base may still be hit
_PEAK = 1.5  # [-] largest speed of the cubic over its mean
_RELEASE = 0.3, 1.0  # [-] of the time of a pull, when the person lets go
_APART = 0.1, 0.9  # [-] of the time after the pull, for which the person does not hold the hand


def draw_case(
    parameters: StudyParameters,
    number: int,
    sources: StudySources,
    envelope: Envelope | None = None,
) -> Case:
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
    ranges = parameters.ranges
    drawn = _draw_values(ranges, envelope, rng)
    start, q_m, redraws = draw_start(sources, ranges.height, rng)
    move, along = _draw_move(start, rng)
    move, duration, moving = _timed(move, drawn["speed"], ranges.duration)
    release_at, regrasp_at = _draw_release(ranges, duration, moving, rng)
    return Case(
        study_seed=parameters.seed,
        number=number,
        kind=f"{start.sector}, along" if along else start.sector,
        redraws=redraws,
        robot=parameters.robot,
        controller=parameters.controller,
        physics=parameters.physics,
        start=_triple(start.p),
        move=_triple(move),
        duration=duration,
        moving=moving,
        release_at=release_at,
        regrasp_at=regrasp_at,
        q_m=tuple(q_m.tolist()),
        seed=int(rng.integers(2**32)),
        **drawn,
    )


def _draw_values(
    ranges: StudyRange, envelope: Envelope | None, rng: np.random.Generator
) -> dict[str, float]:
    """Speed, person and disturbances, by their names in `Case`."""
    intervals = {name: getattr(ranges, name) for name in ("speed", *PARAMETERS)}
    if envelope is not None:
        intervals = {name: envelope.within(name, each) for name, each in intervals.items()}
    for _ in range(_TRIES):
        drawn = {name: _draw(name, each, rng) for name, each in intervals.items()}
        if envelope is None or envelope.holds(drawn, force=drawn["hand_f_max"]):
            return drawn
    raise StudyError(
        f"none of {_TRIES} cases from these ranges lies in the stated envelope; "
        "dbb study --help tells how to choose others"
    )


def _draw(name: str, interval: Interval, rng: np.random.Generator) -> float:
    if name not in LOGARITHMIC:
        return float(rng.uniform(*interval))
    low, high = interval
    return float(np.clip(math.exp(rng.uniform(math.log(low), math.log(high))), low, high))


def _draw_move(start: Start, rng: np.random.Generator) -> tuple[Array, bool]:
    """(3,) [m] the pull, and whether it goes along the base instead of into it."""
    travel, along = rng.uniform(*_TRAVEL), rng.random() < _ALONG
    way, turn = rng.standard_normal(3), rng.uniform(0, _ALONG_ANGLE)
    o = start.outwards
    if not along:
        move = start.aim - start.p
        return move * min(1.0, _TRAVEL[1] / float(np.linalg.norm(move))), False
    way -= (way @ o) * o
    move = travel * (math.cos(turn) * way / np.linalg.norm(way) - math.sin(turn) * o)
    move[2] = max(move[2], _LOWEST - start.p[2])
    return move, True


def _timed(move: Array, speed: float, longest: float) -> tuple[Array, float, float]:
    """The pull, cut short if it takes too long, the run's duration [s] and the share of pulling."""
    hold = min(_HOLD, longest / 4)
    pulling = _PEAK * float(np.linalg.norm(move)) / speed
    if pulling > longest - hold:
        move = move * ((longest - hold) / pulling)
        pulling = longest - hold
    return move, pulling + hold, pulling / (pulling + hold)


def _draw_release(
    ranges: StudyRange, duration: float, moving: float, rng: np.random.Generator
) -> tuple[float | None, float | None]:
    """[s] when the person lets go and takes hold again, or None where not."""
    released, regrasped = rng.random() < ranges.released, rng.random() < ranges.regrasped
    release = duration * moving * rng.uniform(*_RELEASE)
    regrasp = release + duration * (1.0 - moving) * rng.uniform(*_APART)
    return (release if released else None), (regrasp if released and regrasped else None)


def _triple(p: Array) -> tuple[float, float, float]:
    x, y, z = p.tolist()
    return x, y, z
