"""What a sweep is to do: which paths, how fast, with which controllers and parameters."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Literal, NamedTuple

from app.config import Config
from app.control.names import CONTROLLERS
from app.errors import ConfigError, UnknownNameError
from app.simulation.plants.choice import chosen_plant, default_plant
from app.simulation.scenarios.line import StartedLine
from app.strict import check_range

if TYPE_CHECKING:
    from app.robot.model import RobotModel
    from app.studies.sweep.paths import Approach
    from app.studies.sweep.paths_start import Start

Mode = Literal["tracking", "guiding"]

CLEAR = 0.02
"""[m] beyond the buffer at which the arm starts, if nothing else is asked."""
MORE_THAN_BUFFER = 0.005
"""[m] what a start needs beyond the buffer at least."""


_RANGES = {
    "heights": (0.02, 2.0, "m"),
    "speeds": (0.001, 1.0, "m/s"),
    "step": (0.5, 90.0, "deg"),
    "above_spacing": (0.02, 1.0, "m"),
    "length": (0.01, 0.5, "m"),
    "hold": (0.0, 60.0, "s"),
}
_FARTHEST = 0.5  # [m] a start from the base
OPTIONS = {"controllers": "controller", "heights": "height", "speeds": "speed"}
"""Options of `dbb sweep` that are called otherwise than the field that they set."""


@dataclass(frozen=True)
class SweepPlan:
    """The paths of a sweep and how they are led."""

    robot: str = "husky_panda"
    """Name of the robot; `dbb robots` lists them."""
    controllers: tuple[str, ...] = ("dbb",)
    """One or several of dbb, repulsive, barrier and none, with blanks or commas."""
    heights: tuple[float, ...] = (0.3,)
    """[m] of the hand on the paths from the side, one or several."""
    speeds: tuple[float, ...] = (0.025,)
    """[m/s] mean speed of the hand on its way, one or several."""
    step: float = 5.0
    """[deg] between two directions."""
    mode: Mode = "tracking"
    """tracking with the orientation held, or guiding, where a person pulls the hand."""
    wheel_axis: bool = True
    """Paths along the wheel axis too."""
    above: bool = False
    """Paths down onto the base too, over a grid of places."""
    above_spacing: float = 0.15
    """[m] at most, between two of these places."""
    length: float = 0.2
    """[m] of each path."""
    hold: float = 3.0
    """[s] how long the hand is held at the end."""
    start_distance: float | None = None
    """[m] between arm and base at the start; by default 0.02 beyond the buffer."""
    physics: str = field(default_factory=default_plant)
    """planar, mujoco, mujoco-contact or kinematic."""
    seed: int = 0
    """Seed of everything random."""
    config: Config = field(default_factory=Config)
    """Parameters."""

    def __post_init__(self) -> None:
        """Refuse what cannot be done, in the words of the options.

        Raises:
            ConfigError: A number out of its range.
            UnknownNameError: No such controller or plant.
        """
        for name in self.controllers:
            if name not in CONTROLLERS:
                raise UnknownNameError("controller", name, CONTROLLERS)
        chosen_plant(self.physics)
        for name, bounds in _RANGES.items():
            given = getattr(self, name)
            option = f"--{OPTIONS.get(name, name).replace('_', '-')}"
            for value in given if isinstance(given, tuple) else (given,):
                check_range(option, value, *bounds)
        for name in OPTIONS:
            if not getattr(self, name):
                raise ConfigError(f"--{OPTIONS[name]}: give one or several")
        if self.start_distance is not None:
            least = self.config.border.d_b + MORE_THAN_BUFFER
            check_range("--start-distance", self.start_distance, least, _FARTHEST, "m")
        if abs(360.0 / self.step - round(360.0 / self.step)) > 1e-9:
            raise ConfigError(f"--step: 360° is not a multiple of {self.step:g}°")

    @property
    def distance(self) -> float:
        """[m] between arm and base at the start."""
        return (
            self.config.border.d_b + CLEAR if self.start_distance is None else self.start_distance
        )

    def approaches(self, model: RobotModel) -> list[Approach]:
        """All paths, each once for all speeds and controllers."""
        # Imported here, so that a plan is checked at once.
        from app.border.mobile import MobileBody
        from app.studies.sweep.paths import from_above, ring, wheel_axis

        found = list(ring(self.heights, self.step))
        if self.wheel_axis:
            found += wheel_axis(self.heights)
        if self.above:
            body = MobileBody(model)
            found += from_above(body.lower[:2], body.upper[:2], self.above_spacing)
        return found

    def trials(self, starts: list[Start]) -> Iterator[Trial]:
        """All runs from these starts."""
        for controller in self.controllers:
            for speed in self.speeds:
                yield from (Trial(start, controller, speed) for start in starts if not start.reason)

    def scenario(self, trial: Trial) -> StartedLine:
        """The run of one trial."""
        moving = self.length / trial.speed
        duration = moving + self.hold
        move = self.length * trial.start.approach.inwards
        return StartedLine(
            trial.start.approach.name,
            duration,
            "the hand is led towards the base",
            self.mode,
            trial.start.p_ee,
            (float(move[0]), float(move[1]), float(move[2])),
            moving / duration,
            trial.start.q_m,
        )


class Trial(NamedTuple):
    """One run: a start, and with what it is done.

    Attributes:
        start: Where the path begins.
        controller: Name of the controller.
        speed: [m/s] mean speed of the hand on its way.
    """

    start: Start
    controller: str
    speed: float
