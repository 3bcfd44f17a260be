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

Share = Annotated[Finite, Field(ge=0.0, le=1.0)]

PARAMETERS = {
    "base_delay": "disturbance.base_delay",
    "encoder_noise": "disturbance.encoder_noise",
    "mass_error": "disturbance.mass_error",
    "slip": "disturbance.slip",
    "v_max": "admittance.v_max",
    "hand_f_max": "hand.f_max",
    "hand_stiffness": "hand.stiffness",
    "hand_mass": "hand.mass",
}
"""Which intervals are of a parameter of the configuration, by its path."""

LOGARITHMIC = ("hand_stiffness",)
"""Those in which every factor is as likely as every other, not every difference."""

_OWN = {
    "speed": (0.01, 1.5, "m/s"),
    "height": (0.05, 2.0, "m"),
    "duration": (0.05, 60.0, "s"),
    "released": (0.0, 1.0, ""),
    "regrasped": (0.0, 1.0, ""),
}


class StudyRange(Strict):
    """The intervals; within each, every value is as likely but in those that are `LOGARITHMIC`."""

    speed: Interval = (0.1, 1.2)
    """[m/s] largest speed of the person's hand on its way."""
    base_delay: Interval = (0.0, 0.4)
    """[s] between a velocity command and the base's drive."""
    encoder_noise: Interval = (0.0, 0.003)
    """[rad] standard deviation of the noise of each joint's measured position."""
    mass_error: Interval = (-0.2, 0.2)
    """[-] by how much the controller takes the arm's masses for too large."""
    slip: Interval = (0.0, 0.3)
    """[-] share of the base's motion that is lost at the ground."""
    v_max: Interval = (0.25, 1.0)
    """[m/s] the largest speed that the admittance law may command."""
    hand_f_max: Interval = (30.0, 100.0)
    """[N] largest force of the person's spring and damper."""
    hand_stiffness: Interval = (300.0, 3000.0)
    """[N/m] of that spring."""
    hand_mass: Interval = (0.0, 2.0)
    """[kg] of the person's hand and forearm."""
    height: Interval = (0.12, 0.90)
    """[m] of the hand above the floor, at the start."""
    duration: Annotated[Finite, Field(ge=0.05, le=60.0)] = 8.0
    """[s] longest run of a case; a slow pull is cut short to fit."""
    released: Share = 0.3
    """[-] share of the pulls in which the person lets go on the way."""
    regrasped: Share = 0.5
    """[-] share of these in which the person takes hold again."""


def bounds(name: str) -> tuple[float, float, str]:
    """Least and largest value that an interval may hold, and its unit.

    Args:
        name: Of a field of `StudyRange`.
    """
    if name in _OWN:
        return _OWN[name]
    known = parameter(PARAMETERS[name])
    return known.low, known.high, known.unit
