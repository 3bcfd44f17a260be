"""Scenarios by name, a robot's own lines for them, and the start posture of free motion."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from app.errors import DescriptionError, UnreachableError, check_name
from app.simulation.scenarios.leading import Scenario
from app.simulation.scenarios.line import LineScenario, Point
from app.simulation.scenarios.refrigerator import RefrigeratorScenario
from app.simulation.scenarios.way_out import WayOutScenario
from app.strict import Array

if TYPE_CHECKING:
    from collections.abc import Sequence

    from app.border.cache import BorderData
    from app.config import Config
    from app.robot.description import RobotDescription
    from app.robot.model import RobotModel


def _guiding(name: str, direction: str, start: Point, move: Point) -> LineScenario:
    about = f"a person pulls the end-effector {direction}"
    return LineScenario(name, 8.0, about, "guiding", start, move, 0.6)


_LINES = (
    _guiding("guiding-lateral", "from the side towards the base", (0.3, 0.72, 0.3), (0, -0.25, 0)),
    _guiding("guiding-front", "from the front towards the base", (0.92, 0.1, 0.3), (-0.3, 0, 0)),
    _guiding("guiding-above", "down onto the base's top", (-0.2, 0.15, 0.75), (0, 0, -0.4)),
    _guiding("guiding-fold", "into the arm's own column", (0.75, 0.1, 0.75), (-0.4, -0.1, 0)),
    LineScenario(
        "tracking",
        30.0,
        "the end-effector tracks a line towards the base's side at constant orientation",
        "tracking",
        (0.30, 0.68, 0.30),
        (0.0, -0.2, 0.0),
        1.0,
    ),
)
LINES = {scenario.name: scenario for scenario in _LINES}  # scenarios with a straight path

SCENARIOS: dict[str, Scenario] = {
    scenario.name: scenario for scenario in (*_LINES, RefrigeratorScenario(), WayOutScenario())
}
_OWN = ("guiding-lateral", "guiding-front", "tracking")
"""Scenarios towards the side or front of the base: each needs the robot's own line or a start."""
_FREE = "guiding-front"  # scenario whose start is also the start of the free motion
_SAME_LINE = {"tracking": "guiding-lateral"}  # a scenario without a line uses that of another


def scenario_by_name(name: str) -> Scenario:
    """The scenario with a name; raises an UnknownNameError if it does not exist."""
    check_name("scenario", name, SCENARIOS)
    return SCENARIOS[name]


def scenario_of(description: RobotDescription, name: str, **changes: object) -> Scenario:
    """The scenario with a name, for a robot. A line of the robot's description (start and
    displacement of the end-effector) replaces the scenario's own line; `changes`, options as in
    `Scenario.changed`, override both. This raises the errors of `scenario_by_name` and
    `Scenario.changed`; an UnreachableError if the scenario needs a start, and neither description
    nor `changes` have one; a DescriptionError if the description has a line that is not in `LINES`.
    """
    scenario, own = scenario_by_name(name), _own_line(description, name)
    if name in _OWN and not own and changes.get("start") is None:
        there = ", ".join(each for each in _OWN if _own_line(description, each)) or "none"
        unknown = "no line is known on which the base moves away from the arm"
        why = description.without_line.get(name, unknown)
        why = f"{description.name} has no line for {name}: {why}; it has lines for: {there}"
        raise UnreachableError(f"{why}. --start X Y Z and --move X Y Z set a line")
    return scenario.changed(**own).changed(**changes)


def free_start(
    model: RobotModel, data: BorderData, config: Config, start: Sequence[float] | None, seed: int
) -> Array:
    """The arm's joint positions (n_m,) [rad or m] at the start of the free motion. `start` (3,) [m]
    is the end-effector's position for a base at the origin, by default the start of the robot's own
    line for `guiding-front`. Without `start` and such a line, the result is the ready posture. If
    the search finds no posture, this raises an UnreachableError.
    """
    # Imported here: scipy would delay the start of every command.
    from app.simulation.scenarios.start import find_start

    at = _own_line(model.description, _FREE).get("start") if start is None else start
    if at is None:
        return np.array(model.description.arm.ready_position)
    x, y, z = at
    return find_start(model, data.pairs, config.border.d_b, (x, y, z), seed=seed)


def _own_line(description: RobotDescription, name: str) -> dict[str, Point]:
    """Start and displacement of the robot's line for a scenario; {} if it has no such line."""
    lines = description.lines
    if unknown := sorted(lines.keys() - LINES.keys()):
        where = f"{description.name}: [lines.{unknown[0]}] in robot.toml"
        raise DescriptionError(f"{where} belongs to no scenario; lines are for: {', '.join(LINES)}")
    place = lines.get(name) or lines.get(_SAME_LINE.get(name, name))
    return {} if place is None else {"start": place.start_m, "move": place.move_m}
