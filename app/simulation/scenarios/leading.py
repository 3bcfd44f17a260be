"""What a scenario is: where a run begins, and what leads the hand from step to step."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from typing_extensions import Self

from app.border.cache import BorderData
from app.config import Config
from app.control.tasks import Reference
from app.errors import ConfigError
from app.robot.model import RobotModel
from app.simulation.plants.door import OpenDoor

if TYPE_CHECKING:
    from app.simulation.session import Session

Array = np.ndarray

LONGEST = 3600.0
"""[s] duration of the longest scenario."""


class DoorReading(NamedTuple):
    """How the opening of a door goes.

    Attributes:
        angle: [rad] how far the door is open.
        force: (3,) [N] that the hand exerts on it, in the world.
        radial_force: [N] the part of it towards the hinge's true place.
        radial_error: [rad] of the estimated radial direction, positive counter-clockwise.
    """

    angle: float
    force: Array
    radial_force: float
    radial_error: float


class Lead(NamedTuple):
    """What leads the hand in one control step; the arguments of `Session.step`.

    Attributes:
        reference: What the arm tracks, or None while it is guided.
        pull: (3,) [m] where a person pulls, or None.
        door: How the opening of a door goes, or None if there is none.
    """

    reference: Reference | None = None
    pull: Array | None = None
    door: DoorReading | None = None


Leader = Callable[["Session"], Lead]
"""Says before each control step what leads the hand in it; may read the session's sensors."""


class Setting(NamedTuple):
    """Where a run begins.

    Attributes:
        model: The robot as its controller knows it.
        data: Its pairs and clouds.
        base_pose: (3,) x, y [m] and heading [rad] of the base.
        q_m: (n_m,) [rad or m] the arm's joints.
        config: Parameters for this scenario.
        door: The door that the hand holds, or None.
    """

    model: RobotModel
    data: BorderData
    base_pose: Array
    q_m: Array
    config: Config
    door: OpenDoor | None = None


@dataclass(frozen=True)
class Scenario(ABC):
    """A run's beginning and course."""

    name: str
    duration: float
    """[s] of the whole run."""
    about: str
    """One line for people."""

    def __post_init__(self) -> None:
        if not 0.0 < self.duration <= LONGEST:
            raise ConfigError(f"--duration: {self.duration:g} s is not within 0 to {LONGEST:g} s")

    @abstractmethod
    def setting(self, model: RobotModel, data: BorderData, config: Config, seed: int) -> Setting:
        """Where the run begins.

        Raises:
            DbbError: It cannot begin there.
        """

    def adapted(self, config: Config) -> Config:
        """The parameters for this scenario; a configuration that changes in it passes here too."""
        return config

    @abstractmethod
    def leader(self, session: Session) -> Leader:
        """What leads the hand of a session that stands at the beginning."""

    def changed(self, **changes: Any) -> Self:
        """A copy with some fields changed; None keeps what is.

        Raises:
            ConfigError: This scenario has no such field.
        """
        given = {name: value for name, value in changes.items() if value is not None}
        known = {field.name for field in fields(self)} - {"name", "about"}
        for name in given:
            if name not in known:
                option = name.replace("_", "-")
                raise ConfigError(
                    f"--{option}: the scenario {self.name} has none; "
                    f"it has: {', '.join(sorted(n.replace('_', '-') for n in known))}"
                )
        return replace(self, **given)
