"""What a sweep is to do: which paths, how fast, with which controllers and parameters."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Literal, NamedTuple

import numpy as np

from app.border.cache import BorderData
from app.border.mobile import MobileBody
from app.config import Config
from app.robot.model import RobotModel
from app.simulation.person import checked_target
from app.simulation.plants.choice import default_plant
from app.simulation.scenarios.leading import Setting
from app.simulation.scenarios.line import LineScenario
from app.studies.sweep.paths import Approach, from_above, ring, wheel_axis
from app.studies.sweep.paths_start import Start

Array = np.ndarray
Mode = Literal["tracking", "guiding"]

CLEAR = 0.02
"""[m] beyond the buffer at which the arm starts, if nothing else is asked."""
MORE_THAN_BUFFER = 0.005
"""[m] what a start needs beyond the buffer at least."""


@dataclass(frozen=True)
class SweepPlan:
    """The paths of a sweep and how they are led.

    Attributes:
        robot: Name of the robot.
        controllers: Names of the controllers, one after the other.
        heights: [m] of the hand's origin on the paths from the side.
        speeds: [m/s] mean speed of the hand on its way.
        step: [deg] between two directions.
        mode: Whether the arm tracks the path, its orientation held, or a person pulls it there.
        wheel_axis: Whether paths along the wheel axis are among them.
        above: Whether paths from above are among them.
        above_spacing: [m] at most, between two places of their grid.
        length: [m] of each path.
        hold: [s] how long the hand is held at the end.
        start_distance: [m] between arm and base at the start; None is a little more than d_b.
        physics: Kind of plant.
        seed: Of everything random.
        config: Parameters.
    """

    robot: str = "husky_panda"
    controllers: tuple[str, ...] = ("dbb",)
    heights: tuple[float, ...] = (0.3,)
    speeds: tuple[float, ...] = (0.025,)
    step: float = 5.0
    mode: Mode = "tracking"
    wheel_axis: bool = True
    above: bool = False
    above_spacing: float = 0.15
    length: float = 0.2
    hold: float = 3.0
    start_distance: float | None = None
    physics: str = field(default_factory=default_plant)
    seed: int = 0
    config: Config = field(default_factory=Config)

    @property
    def distance(self) -> float:
        """[m] between arm and base at the start."""
        return (
            self.config.border.d_b + CLEAR if self.start_distance is None else self.start_distance
        )

    def approaches(self, model: RobotModel) -> list[Approach]:
        """All paths, each once for all speeds and controllers."""
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


@dataclass(frozen=True)
class StartedLine(LineScenario):
    """A line whose starting posture is known."""

    q_m: tuple[float, ...]
    """[rad or m] the arm's joints at the begin."""

    def setting(self, model: RobotModel, data: BorderData, config: Config, seed: int) -> Setting:
        """See `Scenario.setting`.

        Raises:
            TargetError: The hand would be led below the floor.
        """
        checked_target(np.add(self.start, self.move))
        return Setting(model, data, np.zeros(3), np.array(self.q_m), config)
