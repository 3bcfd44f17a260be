"""Scenarios: the start of a run, and the input of each step."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields, replace
from typing import TYPE_CHECKING, Any, NamedTuple

from typing_extensions import Self

from app.errors import ConfigError
from app.strict import Array, check_range

if TYPE_CHECKING:  # for annotations, so that options are checked before slow imports
    from app.border.cache import BorderData
    from app.config import Config
    from app.control.tasks import Reference
    from app.robot.model import RobotModel
    from app.simulation.people import Hold
    from app.simulation.plants.door import DoorReading, OpenDoor
    from app.simulation.session import Session

SHORTEST = 0.01  # [s] shortest scenario
_DURATIONS = SHORTEST, 3600.0  # [s]
_FARTHEST = 10.0  # [m] from the origin; a longer path is a typing error


class StepInput(NamedTuple):
    """The input of one control step; the arguments of `Session.step`."""

    reference: Reference | None = None
    """The end-effector's reference, or None while a person guides the arm."""
    pull: Array | None = None
    """(3,) [m] target of the person's hand, or None."""
    door: DoorReading | None = None
    """State of the opening door, or None without one."""
    holds: tuple[Hold, ...] = ()
    """Other people who hold the robot, at the end-effector or elsewhere."""


Driver = Callable[["Session"], StepInput]
"""Computes the input of each control step; may read the session's sensors."""


class Setting(NamedTuple):
    """The start of a run."""

    model: RobotModel
    """The robot model of the controller."""
    data: BorderData
    """Its pairs and clouds."""
    base_pose: Array
    """(3,) x, y [m] and heading [rad] of the base."""
    q_m: Array
    """(n_m,) [rad or m] joint positions of the arm."""
    config: Config
    door: OpenDoor | None = None


@dataclass(frozen=True)
class Scenario(ABC):
    """The start and the motion of a run."""

    name: str
    duration: float
    """[s] duration of the run; a motion along a line scales with it, unless the person releases."""
    about: str
    """Description in one line."""

    def __post_init__(self) -> None:
        check_range("--duration", self.duration, *_DURATIONS, "s")

    @property
    def options(self) -> tuple[str, ...]:
        """Names of the fields that the user may set."""
        return tuple(field.name for field in fields(self) if field.name not in ("name", "about"))

    @property
    def open(self) -> bool:
        """Whether it continues, and is recorded, while people hold the end-effector."""
        return False

    @abstractmethod
    def setting(self, model: RobotModel, data: BorderData, config: Config, seed: int) -> Setting:
        """The start of the run.

        Raises:
            DbbError: The robot cannot start there.
        """

    def adapted(self, config: Config) -> Config:
        """The parameters for this scenario, also for a configuration that changes during it."""
        return config

    @abstractmethod
    def driver(self, session: Session) -> Driver:
        """The driver of a session that is at the start."""

    def changed(self, **changes: Any) -> Self:
        """A copy with some fields changed; None means no change.

        Raises:
            ConfigError: This scenario has no such field, or the value is invalid.
        """
        given = {name: value for name, value in changes.items() if value is not None}
        known = {field.name for field in fields(self)} - {"name", "about"}
        for name in given:
            if name not in known:
                raise self.without(name)
        try:
            return replace(self, **given)
        except (TypeError, ValueError) as error:  # a text, a point of two numbers
            raise ConfigError(f"options of {self.name}: {error}") from None

    def without(self, name: str) -> ConfigError:
        """The error for an option that this scenario does not have."""
        options = ", ".join(sorted(option.replace("_", "-") for option in self.options))
        option = name.replace("_", "-")
        return ConfigError(f"--{option}: the scenario {self.name} has none; it has: {options}")


def check_point(option: str, point: Sequence[float], size: int = 3) -> None:
    """Refuse a point with a wrong number of coordinates, or beyond 10 m.

    Raises:
        ConfigError: Names the option and the valid form.
    """
    if len(point) != size:
        raise ConfigError(f"{option}: {point!r} is not {size} numbers")
    for coordinate in point:
        check_range(option, coordinate, -_FARTHEST, _FARTHEST, "m")
