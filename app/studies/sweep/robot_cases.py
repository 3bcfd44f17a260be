"""What every robot is compared in: pulls and paths towards its base, without numbers of its own."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from app.border.mobile import MobileBody
from app.studies.sweep.paths import Approach
from app.studies.sweep.plan import Mode

_HEIGHTS = (0.8, 0.65, 0.5, 0.9, 1.0)  # [-] of l_m's top, best first
_LEFT_RIGHT = (90.0, 270.0)  # [deg]
_SIDES = (60.0, 300.0, 75.0, 285.0, 45.0, 315.0, 90.0, 270.0, 105.0, 255.0, 120.0, 240.0)  # [deg]
_FRONTS = (10.0, 350.0, 0.0, 20.0, 340.0, 30.0, 330.0)  # [deg]


@dataclass(frozen=True)
class Case:
    """One row of the comparison.

    Attributes:
        name: As it is told.
        mode: Whether the arm tracks the path, its orientation held, or a person pulls it there.
        directions: [deg] from which the hand may come, counter-clockwise from the front, best
            first.
        on_axis: Whether p_b begins on the wheel axis, x = 0, and moves along it.
        length: [m] of the path, which begins 0.02 m outside of the buffer.
        speed: [m/s] mean speed of the hand.
    """

    name: str
    mode: Mode
    directions: tuple[float, ...]
    on_axis: bool = False
    length: float = 0.2
    speed: float = 0.025

    def approaches(self, body: MobileBody) -> Iterator[Approach]:
        """Paths that would do, best first: heights beside l_m from each direction."""
        for direction in self.directions:
            for share in _HEIGHTS:
                height = round(share * float(body.upper[2]), 3)
                yield Approach("wheel_axis" if self.on_axis else "side", height, direction)


CASES = (
    Case("guiding-lateral", "guiding", _SIDES, length=0.3, speed=0.05),
    Case("guiding-front", "guiding", _FRONTS, length=0.3, speed=0.05),
    Case("tracking", "tracking", _SIDES),
    Case("wheel-axis", "tracking", _LEFT_RIGHT, on_axis=True),
)
"""The rows of each robot."""
