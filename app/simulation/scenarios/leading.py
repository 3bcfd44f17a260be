"""The interface of scenarios: the start of a run, and the input of each control step."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields, replace
from functools import cache
from typing import TYPE_CHECKING, Any, Literal, NamedTuple, get_args, get_origin, get_type_hints

from typing_extensions import Self

from app.errors import ConfigError
from app.strict import Array, check_range

if TYPE_CHECKING:  # for annotations, so that options are checked before slow imports
    from app.border.cache import BorderData
    from app.config import Config
    from app.control.tasks import Reference
    from app.robot.model import RobotModel
    from app.simulation.people import Hold
    from app.simulation.plants.door import DoorView, OpenDoor
    from app.simulation.session import Session

_DURATIONS = 0.01, 3600.0  # [s] shortest and longest scenario
_FARTHEST = 10.0  # [m] largest coordinate of a point; a larger one counts as a typo


class StepInput(NamedTuple):
    """The input of one control step: the first four arguments of `Session.step`."""

    reference: Reference | None = None  # reference of the end-effector, or None
    pull: Array | None = None  # (3,) [m] target of a person at the end-effector, in the world
    door: DoorView | None = None  # state of the door while the scenario opens it, otherwise None
    holds: tuple[Hold, ...] = ()  # other people who hold the robot at any point


Driver = Callable[["Session"], StepInput]  # computes the input of the next control step


class Setting(NamedTuple):
    model: RobotModel  # model of the controller
    data: BorderData  # link pairs and border clouds of the model
    base_pose: Array  # (3,) x, y [m] and heading [rad] of the base
    q_m: Array  # (n_m,) [rad or m] joint positions of the arm
    config: Config  # parameters of the run
    door: OpenDoor | None = None  # the door that the end-effector holds, or None


@dataclass(frozen=True)
class Scenario(ABC):
    """The start and the motion of a run."""

    name: str
    duration: float
    """[s] duration of the run."""
    about: str
    """Description in one line."""

    def __post_init__(self) -> None:
        check_range("--duration", self.duration, *_DURATIONS, "s")
        for name, choices in _choices(type(self)).items():
            if (value := getattr(self, name)) not in choices:
                raise ConfigError(f"--{name}: {value!r} is not one of {', '.join(choices)}")

    @property
    def options(self) -> tuple[str, ...]:
        """Names of the fields that the user can set."""
        return tuple(field.name for field in fields(self) if field.name not in ("name", "about"))

    @abstractmethod
    def setting(self, model: RobotModel, data: BorderData, config: Config, seed: int) -> Setting:
        """The start of the run; raises a DbbError if the robot cannot start the scenario."""

    def adapted(self, config: Config) -> Config:
        """`config` with the values that this scenario requires, at the start or during a run."""
        return config

    @abstractmethod
    def driver(self, session: Session) -> Driver:
        """Make the driver for a session at its start; only with a door can this raise an error."""

    def changed(self, **changes: Any) -> Self:
        """A copy with `changes`; None is no change. An invalid change raises a ConfigError."""
        given = {name: value for name, value in changes.items() if value is not None}
        known = {field.name for field in fields(self)} - {"name", "about"}
        if unknown := [name for name in given if name not in known]:
            raise self.unknown_option(unknown[0])
        try:
            return replace(self, **given)
        except (TypeError, ValueError) as error:  # for example a text, or a point of two numbers
            raise ConfigError(f"options of {self.name}: {error}") from None

    def unknown_option(self, name: str) -> ConfigError:
        """The error for an option that this scenario does not have."""
        options = ", ".join(sorted(option.replace("_", "-") for option in self.options))
        option = name.replace("_", "-")
        return ConfigError(
            f"--{option}: the scenario {self.name} has no such option; its options are: {options}"
        )


@cache
def _choices(kind: type[Scenario]) -> dict[str, tuple[str, ...]]:
    hints = get_type_hints(kind).items()
    return {name: get_args(hint) for name, hint in hints if get_origin(hint) is Literal}


def check_point(option: str, point: Sequence[float], size: int = 3) -> None:
    """Check that a point has `size` coordinates within ±10 m; otherwise raise a ConfigError."""
    if len(point) != size:
        raise ConfigError(f"{option}: {point!r} is not {size} numbers")
    for coordinate in point:
        check_range(option, coordinate, -_FARTHEST, _FARTHEST, "m")
