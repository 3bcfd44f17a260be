"""The identity of a study: its robot, controller and plant, and its random intervals."""

import hashlib
from functools import cache
from pathlib import Path

from pydantic import Field, model_validator
from typing_extensions import Self

from app.config import parameter
from app.errors import ConfigError
from app.simulation.plants import default_plant
from app.strict import Strict, check_range

Interval = tuple[float, float]  # smallest and largest value; equal ones fix the value

FAULTS = {
    "sensor_delay": "lag",
    "sensor_period": "repeated",
    "dropped": "repeated",
    "unknown_load": "load",
    "stated_period": "period",
}
"""Disturbances that the controller has to report, one to three in a case that has any; each with
the fault (`app.control.readings.FAULTS`) as which it does."""

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
"""Paths of the configuration's parameters among the intervals."""

LOGARITHMIC = ("hand_stiffness",)
"""Intervals with equal probability for equal factors, not for equal differences."""

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
    """The intervals, each with a uniform distribution except for those in `LOGARITHMIC`."""

    speed: Interval = (0.1, 1.2)
    """[m/s] largest speed of the person's hand."""
    base_delay: Interval = (0.0, 0.4)
    """[s] delay from a velocity command to the base's drive."""
    encoder_noise: Interval = (0.0, 0.003)
    """[rad] standard deviation of the noise of each joint's measured position."""
    mass_error: Interval = (-0.2, 0.2)
    """[-] relative error of the arm's masses in the controller's model."""
    slip: Interval = (0.0, 0.3)
    """[-] share of the base's motion that is lost to slip."""
    v_max: Interval = (0.25, 1.0)
    """[m/s] largest speed that the admittance law may command."""
    hand_f_max: Interval = (30.0, 100.0)
    """[N] largest force of the person's spring and damper."""
    hand_stiffness: Interval = (300.0, 3000.0)
    """[N/m] stiffness of that spring."""
    hand_mass: Interval = (0.0, 2.0)
    """[kg] mass of the person's hand and forearm."""
    height: Interval = (0.12, 0.90)
    """[m] height of the end-effector above the floor at the start."""
    payload: Interval = (0.0, 1.0)
    """[kg] load at the end-effector that the controller includes."""
    sensor_delay: Interval = (0.0, 0.02)
    """[s] age of all readings."""
    sensor_period: Interval = (0.0, 0.033)
    """[s] interval between new readings."""
    dropped: Interval = (0.0, 0.5)
    """[-] share of the readings that are lost."""
    unknown_load: Interval = (0.0, 3.0)
    """[kg] load at the end-effector that the controller does not include."""
    stated_period: Interval = (0.0005, 0.005)
    """[s] control period that the controller assumes; the true one is 0.001."""
    faulty: float = 0.5
    """[-] share of the cases with one to three of these five; the others have none."""
    fault_at: Interval = (0.0, 0.5)
    """[-] share of the pull's time after which these begin; the period is wrong from the start."""
    duration: float = 8.0
    """[s] longest run of a case; a slow pull is shortened to fit."""
    released: float = 0.3
    """[-] share of the pulls that the person releases early."""
    regrasped: float = 0.5
    """[-] share of these in which the person takes hold again."""

    @model_validator(mode="after")
    def _within_bounds(self) -> Self:
        """Refuse impossible ranges, in the words of the options of `dbb study`.

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
    """Everything that determines the cases; the number of cases is no part of it."""

    seed: int = 0
    """Seed of the study; case k depends on it and k alone."""
    robot: str = "husky_panda"
    """Name of the robot; `dbb robots` lists them."""
    controller: str = "dbb"
    """dbb, hqp (the paper's controller as printed; slower), a compared method
    (repulsive, barrier), or none: the same controller without avoidance."""
    physics: str = Field(default_factory=default_plant)
    """planar, mujoco, mujoco-contact or kinematic."""
    ranges: StudyRange = StudyRange()
    inside: bool = False
    """Draw only cases inside of the envelope that the project states."""


@cache
def code_digest() -> str:
    """16 hexadecimal digits of all code that a case's figures depend on.

    Remote workers, and a study that continues, must have the same code.
    """
    here = Path(__file__).parent
    root = here.parent.parent
    files = [root / "config.py", *(here / f"{name}.py" for name in _MODULES)]
    files += [path for room in _ROOMS for path in sorted((root / room).rglob("*.py"))]
    digest = hashlib.blake2b(digest_size=8)
    for path in files:
        digest.update(str(path.relative_to(root)).encode() + b"\0" + path.read_bytes() + b"\0")
    return digest.hexdigest()
