"""The plan of a sweep: straight paths towards the base, with speeds, controllers and plant."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, field
from itertools import product
from typing import TYPE_CHECKING, Annotated, Literal, NamedTuple, get_type_hints

import numpy as np

from app.config import Config
from app.control import CONTROLLERS
from app.errors import ConfigError, check_name
from app.simulation.case import RunSpec
from app.simulation.plants import chosen_plant, default_plant
from app.simulation.scenarios.line import Point, StartedLine
from app.strict import Array, check_range

if TYPE_CHECKING:
    from app.robot.model import RobotModel

Mode = Literal["tracking", "guiding"]
Kind = Literal["side", "wheel_axis", "above"]
AXIS_OFFSETS = (0.0, 0.001, -0.001, 0.010, -0.010, 0.050, -0.050)
"""[m] x of p_b, the arm's point nearest to the base, at starts of paths along the wheel axis."""
ERROR_LIMIT = 0.001  # [m] largest final error of a successful path
CLEARANCE_LIMIT = 0.03  # [m] smallest distance between arm and base of a successful path
CLEAR = 0.02  # [m] difference between the distance at the start and d_b, by default
OPTIONS = {"controllers": "controller", "heights": "height", "speeds": "speed"}
"""Options of `dbb sweep` whose names differ from the field of `SweepPlan`."""


@dataclass(frozen=True)
class Approach:
    """A straight path of the end-effector towards the base, which is at the origin and faces +x."""

    kind: Kind
    """"side": horizontal, towards the middle of the base's box; "wheel_axis": parallel to the wheel
    axis; "above": vertical, downwards."""
    height: float = 0.0  # [m] height of the end-effector's origin, for horizontal paths
    direction_deg: float = 0.0
    """[deg] direction from the middle of the base's box to the start of a horizontal path,
    counter-clockwise from the front; 90 or 270 for `wheel_axis`."""
    offset: float = 0.0  # [m] x of p_b, the arm's closest point, at the start, for `wheel_axis`
    place: tuple[float, float] = (0.0, 0.0)  # [m] x and y of the end-effector, for `above`

    @property
    def inwards(self) -> Array:
        """(3,) unit vector of the end-effector's motion."""
        if self.kind == "above":
            return np.array([0.0, 0.0, -1.0])
        if self.kind == "wheel_axis":
            return np.array([0.0, -1.0 if self.direction_deg < 180.0 else 1.0, 0.0])
        angle = math.radians(self.direction_deg)
        return np.array([-math.cos(angle), -math.sin(angle), 0.0])

    @property
    def name(self) -> str:
        """The path as a text, such as `from 35°, height 0.3 m`."""
        if self.kind == "above":
            return "from above at ({:g}, {:g}) m".format(*self.place)
        at = f", p_b at x = {1000 * self.offset:g} mm" if self.kind == "wheel_axis" else ""
        return f"from {self.direction_deg:g}°, height {self.height:g} m{at}"

    def where(self) -> dict[str, object]:
        """The fields that distinguish this path from others of its kind; keys end in the unit."""
        if self.kind == "above":
            return {"place_x_m": self.place[0], "place_y_m": self.place[1]}
        found: dict[str, object] = {"height_m": self.height, "direction_deg": self.direction_deg}
        return found | ({"offset_m": self.offset} if self.kind == "wheel_axis" else {})


def point_of(p: Array) -> Point:
    """A vector (3,) as a tuple."""
    x, y, z = p.tolist()
    return x, y, z


def exit_distance(p: Array, direction: Array, lower: Array, upper: Array) -> float:
    """[m] distance from a point p [m] in a box to the surface of the box, along a unit vector. All
    arguments are (2,) or all are (3,); `lower` and `upper` [m] are corners of the box.
    """
    with np.errstate(divide="ignore", over="ignore"):
        distances = np.where(direction > 0.0, upper - p, lower - p) / direction
    return float(np.min(np.where(direction == 0.0, np.inf, distances)))


@dataclass(frozen=True)
class SweepPlan:
    """The paths and runs of a sweep; an `Annotated` field has its valid range and its unit."""

    robot: str = "husky_panda"
    """Name of the robot; `dbb robots` lists all names."""
    controllers: tuple[str, ...] = ("dbb",)
    """One or several of dbb, hqp, repulsive, barrier and none, separated by blanks or commas."""
    heights: Annotated[tuple[float, ...], (0.02, 2.0, "m")] = (0.3,)
    """[m] heights of the end-effector on horizontal paths, one or several."""
    speeds: Annotated[tuple[float, ...], (0.001, 1.0, "m/s")] = (0.025,)
    """[m/s] mean speeds of the end-effector on a path, one or several."""
    step: Annotated[float, (0.5, 90.0, "deg")] = 5.0
    """[deg] angle between two neighbouring directions; 360 must be a multiple of this angle."""
    mode: Mode = "tracking"
    """tracking with constant orientation, or guiding by a person who pulls the end-effector."""
    wheel_axis: bool = True
    """Include paths parallel to the wheel axis, from the left and from the right."""
    above: bool = False
    """Include vertical paths down onto the base, one at each point of a grid over the base."""
    above_spacing: Annotated[float, (0.02, 1.0, "m")] = 0.15
    """[m] largest spacing of the vertical paths of --above."""
    length: Annotated[float, (0.01, 0.5, "m")] = 0.2
    """[m] length of each path."""
    hold: Annotated[float, (0.0, 60.0, "s")] = 3.0
    """[s] duration of the rest at the end of each path."""
    start_distance: float | None = None
    """[m] distance between arm and base at the start; default: d_b + 0.02."""
    physics: str = field(default_factory=default_plant)
    """Name of the plant; `dbb run guiding-front --help` lists all names."""
    seed: int = 0
    """Seed of all random numbers."""
    config: Config = field(default_factory=Config)

    def __post_init__(self) -> None:
        """Check controllers, plant and ranges; raises a `ConfigError` or `UnknownNameError`."""
        for name in self.controllers:
            check_name("controller", name, CONTROLLERS)
        chosen_plant(self.physics)
        for name, kind in get_type_hints(type(self), include_extras=True).items():
            values = getattr(self, name)
            option = f"--{OPTIONS.get(name, name).replace('_', '-')}"
            for bounds in getattr(kind, "__metadata__", ()):
                for value in values if isinstance(values, tuple) else (values,):
                    check_range(option, value, *bounds)
        for name, option in OPTIONS.items():
            if not getattr(self, name):
                raise ConfigError(f"--{option}: needs one or several values")
        if self.start_distance is not None:
            smallest = self.config.border.d_b + 0.005
            check_range("--start-distance", self.start_distance, smallest, 0.5, "m")
        if abs(360.0 / self.step - round(360.0 / self.step)) > 1e-9:
            raise ConfigError(f"--step: 360° is not a multiple of {self.step:g}°")

    @property
    def distance(self) -> float:
        """[m] desired distance between arm and base at the start."""
        usual = self.config.border.d_b + CLEAR
        return usual if self.start_distance is None else self.start_distance

    def approaches(self, model: RobotModel) -> list[Approach]:
        """All paths, without speeds and controllers."""
        from app.border.mobile import MobileBody

        directions, body = range(round(360.0 / self.step)), MobileBody(model)
        found = [Approach("side", h, k * self.step) for h, k in product(self.heights, directions)]
        if self.wheel_axis:
            for height, direction, x in product(self.heights, (90.0, 270.0), AXIS_OFFSETS):
                found.append(Approach("wheel_axis", height, direction, offset=x))
        if self.above:
            lower, upper = body.lower[:2], body.upper[:2]
            parts = np.ceil((upper - lower) / self.above_spacing - 1e-9).astype(int)
            xs, ys = (
                [round(x, 6) for x in np.linspace(low, high, max(count, 1) + 1).tolist()]
                for low, high, count in zip(lower, upper, parts, strict=True)
            )
            found += [Approach("above", place=place) for place in product(xs, ys)]
        return found

    def trials(self, starts: list[Start]) -> Iterator[tuple[Start, str, float]]:
        """The arguments of `spec` for each controller, each speed, and each found start."""
        for controller, speed, start in product(self.controllers, self.speeds, starts):
            if not start.reason:
                yield start, controller, speed

    def spec(self, start: Start, controller: str, speed: float) -> RunSpec:
        """The run from a start with a controller at a mean speed [m/s] of the end-effector."""
        moving, path = self.length / speed, start.approach
        total, move = moving + self.hold, point_of(self.length * path.inwards)
        about = "the end-effector moves towards the base"
        line = StartedLine(
            path.name, total, about, self.mode, start.p_ee, move, moving / total, start.q_m
        )
        return RunSpec(self.robot, line, self.config, controller, self.physics, self.seed)


class Start(NamedTuple):
    """The start of a path. If the path has none, only `approach` and `reason` have a meaning."""

    approach: Approach
    q_m: tuple[float, ...] = ()  # (n_m,) [rad or m] joint positions of the arm
    p_ee: Point = (0.0, 0.0, 0.0)  # (3,) [m] the end-effector's origin; the base is at the origin
    p_b: Point = (0.0, 0.0, 0.0)  # (3,) [m] the arm's closest point to the base
    clearance: float = 0.0  # [m] distance of p_b from the base
    reason: str = ""  # the reason why there is no start; empty if there is one
