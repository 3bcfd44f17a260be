"""Scenarios: where the hand starts, where it is led, by a person's pull or by a reference."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
import pinocchio as pin

from app.control.tasks import Reference
from app.errors import UnknownNameError

Array = np.ndarray
Point = tuple[float, float, float]


@dataclass(frozen=True)
class Scenario:
    """The hand is led on a straight line in the world, along a cubic in time, and then held.

    The base starts at the origin facing +x.
    """

    name: str
    mode: Literal["guiding", "tracking"]
    """Whether a person pulls the hand or the arm tracks the line."""
    start: Point
    """[m] where the hand starts, in the world."""
    move: Point
    """[m] how far it is led, in the world."""
    duration: float
    """[s] of the whole run."""
    moving: float
    """[-] share of the duration in which the hand is led; then it is held."""
    about: str
    """One line for people."""

    def position(self, t: float) -> tuple[Array, Array, Array]:
        """Position [m], velocity [m/s], acceleration [m/s²] of the leading point at time t [s]."""
        T = self.duration * self.moving
        s = min(max(t / T, 0.0), 1.0)
        inside = 0.0 <= t <= T
        move = np.array(self.move)
        return (
            np.array(self.start) + s * s * (3 - 2 * s) * move,
            (6 * s * (1 - s) / T if inside else 0.0) * move,
            (6 * (1 - 2 * s) / T**2 if inside else 0.0) * move,
        )

    def reference(self, t: float, orientation: Array) -> Reference:
        """The end-effector's reference with a constant orientation, (3, 3)."""
        p, v, a = self.position(t)
        zero = np.zeros(3)
        return Reference(
            pin.SE3(orientation, p), np.concatenate([v, zero]), np.concatenate([a, zero])
        )

    def changed(
        self,
        *,
        start: Point | None = None,
        move: Point | None = None,
        duration: float | None = None,
    ) -> Scenario:
        """A copy with another hand path or duration; None keeps what is."""
        given = {"start": start, "move": move, "duration": duration}
        return replace(self, **{k: v for k, v in given.items() if v is not None})


SCENARIOS = {
    scenario.name: scenario
    for scenario in (
        Scenario(
            "guiding-lateral", "guiding", (0.30, 0.72, 0.30), (0.0, -0.25, 0.0), 8.0, 0.6,
            "a person pulls the hand from the side towards the base",
        ),
        Scenario(
            "guiding-front", "guiding", (0.92, 0.10, 0.30), (-0.30, 0.0, 0.0), 8.0, 0.6,
            "a person pulls the hand from the front towards the base",
        ),
        Scenario(
            "guiding-above", "guiding", (-0.20, 0.15, 0.75), (0.0, 0.0, -0.40), 8.0, 0.6,
            "a person pulls the hand down onto the base's top",
        ),
        Scenario(
            "guiding-fold", "guiding", (0.75, 0.10, 0.75), (-0.40, -0.10, 0.0), 8.0, 0.6,
            "a person pulls the hand into the arm's own column",
        ),
        Scenario(
            "tracking", "tracking", (0.30, 0.68, 0.30), (0.0, -0.2, 0.0), 30.0, 1.0,
            "the hand tracks a line of 0.2 m towards the base's side, its orientation held",
        ),
    )
}  # fmt: skip


def scenario_by_name(name: str) -> Scenario:
    """The scenario of that name.

    Raises:
        UnknownNameError: Lists those that exist.
    """
    if name not in SCENARIOS:
        raise UnknownNameError("scenario", name, SCENARIOS)
    return SCENARIOS[name]
