"""Demonstration: what a page that nobody touches shows of itself, until somebody does."""

from __future__ import annotations

from collections.abc import Sequence
from time import monotonic
from typing import Protocol

from app.dashboard.drag import Grip
from app.errors import DbbError
from app.robot.description import RobotDescription
from app.simulation.loop.commands import Compare, Play, Reset
from app.simulation.loop.loop import LoopHandle
from app.simulation.scenarios import own_line

SHOWN = "guiding-lateral"
"""The scenario that shows what the base does: it is pulled at along its wheels' axis."""
PATIENCE = 20.0  # [s] for which nobody touches a page
REST = 3.0  # [s] between two times


class Visited(Protocol):
    """A viewer's page, as far as it matters here.

    Attributes:
        grip: What the viewer holds.
    """

    grip: Grip

    @property
    def untouched(self) -> bool:
        """Whether its browser has said that nobody has touched it."""
        ...


class Demonstration:
    """Plays a scenario beside a ghost without avoidance; called by the thread that draws."""

    def __init__(self) -> None:
        """Nothing is played."""
        self._due: float | None = None
        self._plays = False

    def update(self, pages: Sequence[Visited], loop: LoopHandle, robot: RobotDescription) -> None:
        """Begin, go on or end, by who is there."""
        newest = loop.latest()
        alone = len(pages) == 1 and pages[0].untouched and newest.controller == "dbb"
        if self._plays and not alone:
            self._plays, self._due = False, None
            loop.send(Compare())
            if not any(page.grip.holds_anything for page in pages):
                loop.send(Reset())
            return
        led = newest.scenario or newest.paused or newest.busy
        others = newest.ghosts and not self._plays
        if not alone or led or others:
            self._due = None
        elif self._due is None:
            self._due = monotonic() + (REST if self._plays else PATIENCE)
        elif monotonic() > self._due:
            self._due, self._plays = None, True
            try:
                loop.send(Compare(("none",)))
                loop.send(Play.named(SHOWN, own_line(robot, SHOWN)))
            except DbbError:  # a robot that cannot play it
                self._plays = False
                loop.send(Compare())
