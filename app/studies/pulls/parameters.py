"""The parameters of a study: robot, controller, plant, and intervals of the random quantities."""

import hashlib
from functools import cache
from pathlib import Path

from pydantic import Field, model_validator
from typing_extensions import Self

from app.config import parameter
from app.errors import ConfigError
from app.simulation.plants import default_plant
from app.strict import Strict, check_range

Interval = tuple[float, float]  # smallest and largest value; equal ends fix the value

FAULTS = {
    "sensor_delay": "lag",
    "sensor_period": "repeated",
    "dropped": "repeated",
    "unknown_load": "load",
    "stated_period": "period",
}
"""Disturbances that the controller must report, and the fault (one of
`app.control.readings.FAULTS`) that it reports for each. A case has none of them, or one to
three."""

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
"""The configuration's parameter for each random quantity that is one, by its path."""

LOGARITHMIC = ("hand_stiffness",)
"""Names of the quantities whose logarithm is uniformly distributed."""

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
    """The intervals of the random quantities, with uniform distributions except `LOGARITHMIC`."""

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
    """[N/m] stiffness of the person's spring."""
    hand_mass: Interval = (0.0, 2.0)
    """[kg] mass of the person's hand and forearm."""
    height: Interval = (0.12, 0.90)
    """[m] height of the end-effector above the floor at the start."""
    payload: Interval = (0.0, 1.0)
    """[kg] load at the end-effector that the controller includes."""
    sensor_delay: Interval = (0.0, 0.02)
    """[s] age of all readings."""
    sensor_period: Interval = (0.0, 0.033)
    """[s] time between new readings."""
    dropped: Interval = (0.0, 0.5)
    """[-] share of the readings that are lost."""
    unknown_load: Interval = (0.0, 3.0)
    """[kg] load at the end-effector that the controller does not include."""
    stated_period: Interval = (0.0005, 0.005)
    """[s] control period that the controller assumes; the true period is 0.001 s."""
    faulty: float = 0.5
    """[-] share of the cases with one to three faults: sensor_delay, sensor_period, dropped,
    unknown_load, stated_period; the other cases have no fault."""
    fault_at: Interval = (0.0, 0.5)
    """[-] time at which the faults begin, as a share of the pull's time; a wrong stated_period acts
    from the start."""
    duration: float = 8.0
    """[s] longest run of a case; a slow pull is shortened."""
    released: float = 0.3
    """[-] share of the pulls in which the person releases the end-effector early."""
    regrasped: float = 0.5
    """[-] share of the released pulls in which the person grasps the end-effector again."""

    @model_validator(mode="after")
    def _within_bounds(self) -> Self:
        """Check all ranges.

        Raises:
            ConfigError: A range is invalid; the message names the option of `dbb study` and the
                valid range.
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
    """All parameters that determine the cases; the number of cases is not one of them."""

    seed: int = 0
    """Seed of the study, which together with the number k determines case k."""
    robot: str = "husky_panda"
    """Name of the robot; `dbb robots` lists all names."""
    controller: str = "dbb"
    """dbb; hqp (the paper's controller as printed, slower); repulsive or barrier (methods for
    comparison); or none (the same controller without avoidance)."""
    physics: str = Field(default_factory=default_plant)
    """planar, mujoco, mujoco-contact or kinematic."""
    ranges: StudyRange = StudyRange()
    """Intervals of the random quantities."""
    inside: bool = False
    """Whether to draw only cases inside the envelope that the project states."""


@cache
def code_digest() -> str:
    """A digest, 16 hexadecimal digits, of all code on which a case's figures depend.

    Remote workers must have the same code, and so must a study that is continued.
    """
    here = Path(__file__).parent
    root = here.parent.parent
    files = [root / "config.py", *(here / f"{name}.py" for name in _MODULES)]
    files += [path for room in _ROOMS for path in sorted((root / room).rglob("*.py"))]
    digest = hashlib.blake2b(digest_size=8)
    for path in files:
        digest.update(str(path.relative_to(root)).encode() + b"\0" + path.read_bytes() + b"\0")
    return digest.hexdigest()
