"""What makes a study the study that it is: what runs, and the intervals that it draws from."""

import hashlib
from functools import cache
from pathlib import Path

from pydantic import Field, model_validator
from typing_extensions import Self

from app.config import parameter
from app.errors import ConfigError
from app.simulation.plants import default_plant
from app.strict import Strict, check_range

Interval = tuple[float, float]  # least and largest value; equal ones leave nothing to chance

FAULTS = (
    "sensor_delay",
    "sensor_period",
    "dropped",
    "unknown_load",
    "stated_period",
)
"""Disturbances that the controller has to notice: one to three in a case that has any."""

PARAMETERS = {
    "base_delay": "disturbance.base_delay",
    "encoder_noise": "disturbance.encoder_noise",
    "mass_error": "disturbance.mass_error",
    "slip": "disturbance.slip",
    "v_max": "admittance.v_max",
    "hand_f_max": "hand.f_max",
    "hand_stiffness": "hand.stiffness",
    "hand_mass": "hand.mass",
    "payload": "payload.mass",
    **{name: f"disturbance.{name}" for name in FAULTS},
}
"""Which intervals are of a parameter of the configuration, by its path."""

LOGARITHMIC = ("hand_stiffness",)
"""Those in which every factor is as likely as every other, not every difference."""

_OWN = {
    "speed": (0.01, 1.5, "m/s"),
    "height": (0.05, 2.0, "m"),
    "duration": (0.05, 60.0, "s"),
    "faulty": (0.0, 1.0, ""),
    "fault_at": (0.0, 1.0, ""),
    "released": (0.0, 1.0, ""),
    "regrasped": (0.0, 1.0, ""),
}
_ROOMS = ("robot", "border", "avoidance", "control", "simulation")
_MODULES = ("case", "draw", "parameters")


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
    payload: Interval = (0.0, 1.0)
    """[kg] load in the hand that the controller knows."""
    sensor_delay: Interval = (0.0, 0.02)
    """[s] age of all readings."""
    sensor_period: Interval = (0.0, 0.033)
    """[s] for which each reading is repeated."""
    dropped: Interval = (0.0, 0.5)
    """[-] share of the readings that are lost."""
    unknown_load: Interval = (0.0, 3.0)
    """[kg] load in the hand that the controller does not know."""
    stated_period: Interval = (0.0005, 0.005)
    """[s] control period that the controller takes for true; 0.001 is."""
    faulty: float = 0.5
    """[-] share of the cases with one to three of these five; the others have none."""
    fault_at: Interval = (0.0, 0.5)
    """[-] of the time of a pull, when these begin; the period is wrong from the start."""
    duration: float = 8.0
    """[s] longest run of a case; a slow pull is cut short to fit."""
    released: float = 0.3
    """[-] share of the pulls in which the person lets go on the way."""
    regrasped: float = 0.5
    """[-] share of these in which the person takes hold again."""

    @model_validator(mode="after")
    def _within_bounds(self) -> Self:
        """Refuse what cannot be drawn, in the words of the options of `dbb study`.

        Raises:
            ConfigError: Names the option and its range.
        """
        for name, value in self:
            option = f"--{name.replace('_', '-')}"
            if name in _OWN:
                bounds = _OWN[name]
            else:
                known = parameter(PARAMETERS[name])
                bounds = known.low, known.high, known.unit
            ends = value if isinstance(value, tuple) else (value,)
            for end in ends:
                check_range(option, end, *bounds)
            if ends[0] > ends[-1]:
                raise ConfigError(f"{option}: LOW {ends[0]:g} is above HIGH {ends[-1]:g}")
        return self


class StudyParameters(Strict):
    """All that its cases follow from; how many of them are wanted is no part of it."""

    seed: int = 0
    """Seed of the study; case k follows from it and k alone."""
    robot: str = "husky_panda"
    """Name of the robot; `dbb robots` lists them."""
    controller: str = "dbb"
    """dbb, hqp (the controller that the paper prints; a slower step), one it is compared
    with (repulsive, barrier), or none: the stack without avoidance."""
    physics: str = Field(default_factory=default_plant)
    """planar, mujoco, mujoco-contact or kinematic."""
    ranges: StudyRange = StudyRange()
    inside: bool = False
    """Draw only cases inside of the envelope that the project states."""


@cache
def code_digest() -> str:
    """16 hexadecimal digits of all code that a case's figures depend on.

    Workers elsewhere, and a study that is gone on with, must have the same.
    """
    here = Path(__file__).parent
    root = here.parent.parent
    files = [root / "config.py", *(here / f"{name}.py" for name in _MODULES)]
    files += [path for room in _ROOMS for path in sorted((root / room).rglob("*.py"))]
    digest = hashlib.blake2b(digest_size=8)
    for path in files:
        digest.update(str(path.relative_to(root)).encode() + b"\0" + path.read_bytes() + b"\0")
    return digest.hexdigest()
