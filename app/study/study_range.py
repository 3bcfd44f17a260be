"""What a study draws from: an interval for each thing that changes from case to case."""

from __future__ import annotations

from typing import Annotated

from pydantic import AfterValidator, Field

from app.config import parameter
from app.strict import Finite, Strict


def _ordered(interval: tuple[float, float]) -> tuple[float, float]:
    if interval[0] > interval[1]:
        raise ValueError("the first number must not be above the second")
    return interval


Interval = Annotated[tuple[Finite, Finite], AfterValidator(_ordered)]
"""Least and largest value; equal ones leave nothing to chance."""

PARAMETERS = {
    "delay": "disturbance.base_delay",
    "noise": "disturbance.encoder_noise",
    "mass_error": "disturbance.mass_error",
    "slip": "disturbance.slip",
    "base_speed": "admittance.v_max",
    "strength": "hand.f_max",
}
"""Which intervals are of a parameter of the configuration, by its path."""

_OWN = {"speed": (0.01, 1.5, "m/s"), "height": (0.05, 2.0, "m"), "duration": (0.05, 60.0, "s")}


class StudyRange(Strict):
    """The intervals; within each, every value is as likely."""

    speed: Interval = (0.05, 1.0)
    """[m/s] largest speed of the person's hand on its way."""
    delay: Interval = (0.0, 0.4)
    """[s] between a velocity command and the base's drive."""
    noise: Interval = (0.0, 0.003)
    """[rad] standard deviation of the noise of each joint's measured position."""
    mass_error: Interval = (-0.2, 0.2)
    """[-] by how much the controller takes the arm's masses for too large."""
    slip: Interval = (0.0, 0.3)
    """[-] share of the base's motion that is lost at the ground."""
    base_speed: Interval = (0.25, 1.0)
    """[m/s] v_max, the largest speed that the admittance law may command."""
    strength: Interval = (40.0, 40.0)
    """[N] largest force of the person; more than in the configuration is asked for expressly."""
    height: Interval = (0.12, 0.80)
    """[m] of the hand above the floor, at the start."""
    duration: Annotated[Finite, Field(ge=0.05, le=60.0)] = 12.0
    """[s] longest run of a case; a slow pull is cut short to fit."""


def bounds(name: str) -> tuple[float, float, str]:
    """Least and largest value that an interval may hold, and its unit.

    Args:
        name: Of a field of `StudyRange`.
    """
    if name in _OWN:
        return _OWN[name]
    known = parameter(PARAMETERS[name])
    return known.low, known.high, known.unit
