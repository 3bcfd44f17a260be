"""Links: a page's address that carries scenario, controller, robot, parameters, camera and time."""

from __future__ import annotations

import math
from typing import NamedTuple
from urllib.parse import parse_qsl, urlencode

import numpy as np

from app.config import Config, tunable
from app.control import CONTROLLERS
from app.dashboard.scene.camera import PRESETS
from app.errors import ConfigError, UnknownNameError
from app.parameters import Parameter
from app.robot.assets import robot_names
from app.simulation.scenarios import SCENARIOS
from app.strict import check_range

Array = np.ndarray

_FARTHEST = 100.0  # [m] of a camera


class Link(NamedTuple):
    """What a link asks for; what is empty it leaves as it is.

    Attributes:
        scenario: Name of the one that is played; all parameters that are not named are then at
            their defaults.
        controller, robot: Their names.
        parameters: By their paths.
        look: A key of `PRESETS`, or eye and target as six numbers [m].
        at: [s] of the scenario, where it stands still.
    """

    scenario: str = ""
    controller: str = ""
    robot: str = ""
    parameters: tuple[tuple[str, float | str], ...] = ()
    look: str = ""
    at: float | None = None

    @classmethod
    def read(cls, query: str) -> Link:
        """What the query of an address asks for, all of it checked.

        Raises:
            UnknownNameError: Something does not exist.
            ConfigError: A value is out of its range, or no number.
        """
        words = dict(parse_qsl(query, keep_blank_values=True))
        given = {name: words.pop(name) for name in cls._fields if name in words}
        for name, choices in (
            ("scenario", SCENARIOS),
            ("controller", CONTROLLERS),
            ("robot", robot_names()),
        ):
            if name in given and given[name] not in choices:
                raise UnknownNameError(name, given[name], choices)
        parameters = ((path, _value(path, text)) for path, text in words.items() if "." in path)
        scenario, controller, robot, look = (
            given.get(name, "") for name in ("scenario", "controller", "robot", "look")
        )
        found = cls(scenario, controller, robot, tuple(parameters), look)
        found.configured(Config())
        found.camera()
        if "at" in given:
            at = _number("at", given["at"])
            if not found.scenario:
                raise ConfigError("at: is the time of a scenario; name it")
            check_range("at", at, 0.0, SCENARIOS[found.scenario].duration, "s")
            found = found._replace(at=at)
        return found

    def configured(self, now: Config) -> Config:
        """The parameters with it, from those of now.

        Raises:
            ConfigError: One does not exist, or is out of its range.
        """
        config = Config() if self.scenario else now
        for path, value in self.parameters:
            config = config.replace(path, value)
        return config

    def camera(self) -> tuple[Array, Array] | None:
        """(3,) [m] the eye and the target, where it gives them.

        Raises:
            UnknownNameError: It is neither a preset nor six numbers.
            ConfigError: They are farther away than 100 m, or one place.
        """
        if not self.look or self.look in PRESETS:
            return None
        numbers = self.look.split(",")
        if len(numbers) != 6:
            raise UnknownNameError("look", self.look, PRESETS)
        place = np.array([_number("look", text) for text in numbers])
        for number in place:
            check_range("look", float(number), -_FARTHEST, _FARTHEST, "m")
        if np.linalg.norm(place[:2] - place[3:5]) < 1e-3:
            raise ConfigError("look: a camera looks to a place that is not above or below it")
        return place[:3], place[3:]

    def query(self) -> str:
        """The query of its address."""
        words: list[tuple[str, str | float]] = [
            (name, getattr(self, name))
            for name in ("scenario", "controller", "robot")
            if getattr(self, name)
        ]
        words += [(p, f"{v:.12g}" if isinstance(v, float) else v) for p, v in self.parameters]
        words += [("look", self.look)] if self.look else []
        words += [("at", f"{self.at:g}")] if self.at is not None else []
        return urlencode(words, safe=",")


def camera_text(eye: Array, target: Array) -> str:
    """A camera as a link gives it, to the centimetre."""
    return ",".join(f"{number:.2f}" for number in (*eye, *target))


def changed_parameters(config: Config) -> tuple[tuple[str, float | str], ...]:
    """Those that are not at their defaults, by their paths."""
    default = Config().model_dump()
    return tuple(
        (f"{section}.{name}", value)
        for section, values in config.model_dump().items()
        for name, value in values.items()
        if value != default[section][name]
    )


def _value(path: str, text: str) -> float | str:
    return _number(path, text) if isinstance(tunable(path), Parameter) else text


def _number(name: str, text: str) -> float:
    try:
        number = float(text)
    except ValueError:
        number = math.nan
    if not math.isfinite(number):
        raise ConfigError(f"{name}: {text[:40]!r} is no number")
    return number
