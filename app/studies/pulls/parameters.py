"""The parameters of a study: robot, controller, plant, and intervals of the random quantities."""

import hashlib
import math
from functools import cache
from pathlib import Path
from typing import Annotated

import numpy as np
from pydantic import Field, model_validator
from typing_extensions import Self

from app.config import parameter
from app.errors import ConfigError
from app.simulation.plants import default_plant
from app.strict import Strict, check_range

Interval = tuple[float, float]  # smallest and largest value, which may be equal
FAULTS = {
    "sensor_delay": "lag",
    "sensor_period": "repeated",
    "dropped": "repeated",
    "unknown_load": "load",
    "stated_period": "period",
}
"""The faults of a case, each with the name of the controller's report in `readings.FAULTS`."""
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
"""Paths of the parameters in the configuration that have random values, by the quantity's name."""
LOGARITHMIC = ("hand_stiffness",)  # quantities whose logarithm is uniformly distributed
Probability = Annotated[float, (0.0, 1.0, "")]


class StudyRange(Strict):
    """The distributions of the random quantities.

    The distribution in an interval is uniform, for `LOGARITHMIC` on a logarithmic scale. `height`
    only bounds the random starts. A single number is a probability or, for `duration`, a limit.
    The annotation of a quantity that is not in `PARAMETERS` has its valid range and its unit.
    """

    speed: Annotated[Interval, (0.01, 1.5, "m/s")] = (0.1, 1.2)
    """[m/s] largest speed of the person's hand."""
    base_delay: Interval = (0.0, 0.4)
    """[s] delay from a velocity command to the base's drive."""
    encoder_noise: Interval = (0.0, 0.003)
    """[rad] standard deviation of the noise of each joint's measured position; m for a prismatic
    joint."""
    mass_error: Interval = (-0.2, 0.2)
    """[-] relative error of the arm's masses and inertias in the controller's model."""
    slip: Interval = (0.0, 0.3)
    """[-] share of the base's commanded motion that is lost to slip."""
    v_max: Interval = (0.25, 1.0)
    """[m/s] largest speed that the admittance law may command."""
    hand_f_max: Interval = (30.0, 100.0)
    """[N] largest force of the person's spring and damper."""
    hand_stiffness: Interval = (300.0, 3000.0)
    """[N/m] stiffness of the person's spring."""
    hand_mass: Interval = (0.0, 2.0)
    """[kg] mass of the person's hand and forearm."""
    height: Annotated[Interval, (0.05, 2.0, "m")] = (0.12, 0.90)
    """[m] height of the end-effector above the floor at the start."""
    payload: Interval = (0.0, 1.0)
    """[kg] mass of the load at the end-effector that the controller's model includes."""
    sensor_delay: Interval = (0.0, 0.02)
    """[s] age of all readings, from fault_at on, in a case with this fault."""
    sensor_period: Interval = (0.0, 0.033)
    """[s] time between new readings in a case with this fault."""
    dropped: Interval = (0.0, 0.5)
    """[-] share of the readings that are lost in a case with this fault."""
    unknown_load: Interval = (0.0, 3.0)
    """[kg] mass of an additional load, which the controller's model does not include, in a case
    with this fault."""
    stated_period: Interval = (0.0005, 0.005)
    """[s] control period that the controller assumes in a case with this fault; the true period is
    0.001 s."""
    faulty: Probability = 0.5
    """[-] probability that a case has one to three of the faults sensor_delay, sensor_period,
    dropped, unknown_load, stated_period; the other cases have no fault."""
    fault_at: Annotated[Interval, (0.0, 1.0, "")] = (0.0, 0.5)
    """[-] time at which the faults begin, as a share of the pull's duration; a wrong stated_period
    acts from the start."""
    duration: Annotated[float, (0.05, 60.0, "s")] = 8.0
    """[s] largest duration of a run: pull and rest; it limits the distance of a slow pull."""
    released: Probability = 0.3
    """[-] probability that the person releases the end-effector before the end of the pull."""
    regrasped: Probability = 0.5
    """[-] probability that a person who has released the end-effector grasps it again."""

    @model_validator(mode="after")
    def _within_bounds(self) -> Self:
        """Raise a `ConfigError`, which names the option of `dbb study`, for an invalid value."""
        for name, value in self:
            option = f"--{name.replace('_', '-')}"
            if name in PARAMETERS:
                known = parameter(PARAMETERS[name])
                low, high, unit = known.low, known.high, known.unit.removeprefix("-")
            else:
                ((low, high, unit),) = type(self).model_fields[name].metadata
            ends = value if isinstance(value, tuple) else (value,)
            for end in ends:
                check_range(option, end, low, high, unit)
            if ends[0] > ends[-1]:
                raise ConfigError(f"{option}: LOW {ends[0]:g} is above HIGH {ends[-1]:g}")
        return self

    def draw(self, name: str, rng: np.random.Generator) -> float:
        """Draw a value in the interval `name`."""
        low, high = getattr(self, name)
        if name not in LOGARITHMIC:
            return float(rng.uniform(low, high))
        return float(np.clip(math.exp(rng.uniform(math.log(low), math.log(high))), low, high))


class StudyParameters(Strict):
    """All parameters of a study except the number of cases; they determine each case."""

    seed: int = 0  # the random quantities of case k depend only on seed, k, robot and ranges
    robot: str = "husky_panda"
    controller: str = "dbb"
    physics: str = Field(default_factory=default_plant)
    ranges: StudyRange = StudyRange()
    inside: bool = False  # whether to narrow the ranges to the envelope that the project states
    time_stamps: bool = False  # whether readings and control steps have the time of a clock


@cache
def code_digest() -> str:
    """A digest of the program's Python files; all workers of a study must have the same digest."""
    root, digest = Path(__file__).parents[2], hashlib.blake2b(digest_size=8)
    for path in sorted(root.rglob("*.py")):
        digest.update(str(path.relative_to(root)).encode() + b"\0" + path.read_bytes() + b"\0")
    return digest.hexdigest()
