"""The scenarios by their names."""

from __future__ import annotations

from app.errors import UnknownNameError
from app.robot.description import RobotDescription
from app.simulation.scenarios.leading import Scenario
from app.simulation.scenarios.line import LineScenario
from app.simulation.scenarios.refrigerator import RefrigeratorScenario
from app.simulation.scenarios.way_out import WayOutScenario

LINES = {
    scenario.name: scenario
    for scenario in (
        LineScenario(
            "guiding-lateral",
            8.0,
            "a person pulls the hand from the side towards the base",
            "guiding",
            (0.30, 0.72, 0.30),
            (0.0, -0.25, 0.0),
            0.6,
        ),
        LineScenario(
            "guiding-front",
            8.0,
            "a person pulls the hand from the front towards the base",
            "guiding",
            (0.92, 0.10, 0.30),
            (-0.30, 0.0, 0.0),
            0.6,
        ),
        LineScenario(
            "guiding-above",
            8.0,
            "a person pulls the hand down onto the base's top",
            "guiding",
            (-0.20, 0.15, 0.75),
            (0.0, 0.0, -0.40),
            0.6,
        ),
        LineScenario(
            "guiding-fold",
            8.0,
            "a person pulls the hand into the arm's own column",
            "guiding",
            (0.75, 0.10, 0.75),
            (-0.40, -0.10, 0.0),
            0.6,
        ),
        LineScenario(
            "tracking",
            30.0,
            "the hand tracks a line of 0.2 m towards the base's side, its orientation held",
            "tracking",
            (0.30, 0.68, 0.30),
            (0.0, -0.2, 0.0),
            1.0,
        ),
    )
}
"""Scenarios in which the hand is led on a straight line."""

SCENARIOS: dict[str, Scenario] = {
    **LINES,
    **{s.name: s for s in (RefrigeratorScenario(), WayOutScenario())},
}


_SAME_LINE = {"tracking": "guiding-lateral"}
"""Scenarios that take another one's line of a robot that has none for them."""


def scenario_by_name(name: str) -> Scenario:
    """The scenario of that name.

    Raises:
        UnknownNameError: Lists those that exist.
    """
    if name not in SCENARIOS:
        raise UnknownNameError("scenario", name, SCENARIOS)
    return SCENARIOS[name]


def scenario_of(description: RobotDescription, name: str) -> Scenario:
    """The scenario of that name, on the line that suits the robot if its description has one.

    Raises:
        UnknownNameError: Lists those that exist.
    """
    return scenario_by_name(name).changed(**own_line(description, name))


def own_line(description: RobotDescription, name: str) -> dict[str, object]:
    """Start and move of a robot's own line for a scenario, as `Scenario.changed` takes them.

    The hand is tracked, as it is guided, from the base's side.
    """
    lines = description.lines
    place = lines.get(name) or lines.get(_SAME_LINE.get(name, name))
    return {} if place is None else {"start": place.start_m, "move": place.move_m}
