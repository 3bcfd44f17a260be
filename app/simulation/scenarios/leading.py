"""What a scenario is: where a run begins, and what leads the hand from step to step."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields, replace
from typing import TYPE_CHECKING, Any, NamedTuple

from typing_extensions import Self

from app.errors import ConfigError
from app.strict import Array, check_range

if TYPE_CHECKING:  # only names here, so that what is asked of a scenario is checked at once
    from app.border.cache import BorderData
    from app.config import Config
    from app.control.tasks import Reference
    from app.robot.model import RobotModel
    from app.simulation.people import Hold
    from app.simulation.plants.door import DoorReading, OpenDoor
    from app.simulation.session import Session

SHORTEST = 0.01  # [s] of a scenario
_DURATIONS = SHORTEST, 3600.0  # [s]
_FARTHEST = 10.0  # [m] from the origin; a longer way is a slip of the keys


class Lead(NamedTuple):
    """What leads the hand in one control step; the arguments of `Session.step`."""

    reference: Reference | None = None
    """What the arm tracks, or None while it is guided."""
    pull: Array | None = None
    """(3,) [m] where a person pulls, or None."""
    door: DoorReading | None = None
    """How the opening of a door goes, or None if there is none."""
    holds: tuple[Hold, ...] = ()
    """Others who hold the robot, here or elsewhere."""


Leader = Callable[["Session"], Lead]
"""Says before each control step what leads the hand in it; may read the session's sensors."""


class Setting(NamedTuple):
    """Where a run begins."""

    model: RobotModel
    """The robot as its controller knows it."""
    data: BorderData
    """Its pairs and clouds."""
    base_pose: Array
    """(3,) x, y [m] and heading [rad] of the base."""
    q_m: Array
    """(n_m,) [rad or m] the arm's joints."""
    config: Config
    door: OpenDoor | None = None


@dataclass(frozen=True)
class Scenario(ABC):
    """A run's beginning and course."""

    name: str
    duration: float
    """[s] of the whole run; a motion along a line scales with it, unless the person lets go."""
    about: str
    """One line for people."""

    def __post_init__(self) -> None:
        check_range("--duration", self.duration, *_DURATIONS, "s")

    @property
    def options(self) -> tuple[str, ...]:
        """Names of the fields that one who runs it may choose."""
        return tuple(field.name for field in fields(self) if field.name not in ("name", "about"))

    @property
    def open(self) -> bool:
        """Whether it goes on, and is recorded, while people take the end-effector."""
        return False

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
            ConfigError: This scenario has no such field, or it cannot have that value.
        """
        given = {name: value for name, value in changes.items() if value is not None}
        known = {field.name for field in fields(self)} - {"name", "about"}
        for name in given:
            if name not in known:
                raise self.without(name)
        try:
            return replace(self, **given)
        except (TypeError, ValueError) as error:  # a text for a number, a point of two numbers
            raise ConfigError(f"options of {self.name}: {error}") from None

    def without(self, name: str) -> ConfigError:
        """The refusal of an option that this scenario does not have."""
        options = ", ".join(sorted(option.replace("_", "-") for option in self.options))
        option = name.replace("_", "-")
        return ConfigError(f"--{option}: the scenario {self.name} has none; it has: {options}")


def check_point(option: str, point: Sequence[float], size: int = 3) -> None:
    """Refuse a point that has not so many coordinates, or one beyond 10 m.

    Raises:
        ConfigError: Names the option and what is right.
    """
    if len(point) != size:
        raise ConfigError(f"{option}: {point!r} is not {size} numbers")
    for coordinate in point:
        check_range(option, coordinate, -_FARTHEST, _FARTHEST, "m")
