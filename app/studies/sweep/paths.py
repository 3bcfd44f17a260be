"""Straight hand paths towards the base: from all around, along the wheel axis, and from above."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

Array = np.ndarray
Kind = Literal["side", "wheel_axis", "above"]

KINDS: tuple[Kind, ...] = ("side", "wheel_axis", "above")
AXIS_OFFSETS = (0.0, 0.001, -0.001, 0.010, -0.010, 0.050, -0.050)
"""[m] x of p_b on the paths along the wheel axis."""


@dataclass(frozen=True)
class Approach:
    """One straight path of the hand towards the base, which stands at the origin facing +x.

    Attributes:
        kind: Along a ray to the base's centre at one height, parallel to the wheel axis, or down.
        height: [m] of the hand's origin; for paths from above nothing.
        direction_deg: [deg] where the hand comes from, counter-clockwise from the front.
        offset: [m] x of the closest point p_b at the begin, on the paths along the wheel axis.
        place: [m] x and y of the hand's origin, on the paths from above.
    """

    kind: Kind
    height: float = 0.0
    direction_deg: float = 0.0
    offset: float = 0.0
    place: tuple[float, float] = (0.0, 0.0)

    @property
    def inwards(self) -> Array:
        """(3,) unit vector along which the hand is led."""
        if self.kind == "above":
            return np.array([0.0, 0.0, -1.0])
        if self.kind == "wheel_axis":
            return np.array([0.0, -1.0 if self.direction_deg < 180.0 else 1.0, 0.0])
        angle = math.radians(self.direction_deg)
        return np.array([-math.cos(angle), -math.sin(angle), 0.0])

    @property
    def name(self) -> str:
        """As in `from 35°, height 0.3 m`."""
        if self.kind == "above":
            return "from above at ({:g}, {:g}) m".format(*self.place)
        text = f"from {self.direction_deg:g}°, height {self.height:g} m"
        if self.kind == "wheel_axis":
            text += f", p_b at x = {1000 * self.offset:g} mm"
        return text

    def where(self) -> dict[str, object]:
        """What tells it from others of its kind; keys end in their unit."""
        if self.kind == "above":
            return {"place_x_m": self.place[0], "place_y_m": self.place[1]}
        found: dict[str, object] = {"height_m": self.height, "direction_deg": self.direction_deg}
        return found | ({"offset_m": self.offset} if self.kind == "wheel_axis" else {})


def ring(heights: Sequence[float], step: float) -> Iterator[Approach]:
    """Paths from all around, every `step` [deg], at each height [m]."""
    for height in heights:
        for k in range(round(360.0 / step)):
            yield Approach("side", height, k * step)


def wheel_axis(heights: Sequence[float]) -> Iterator[Approach]:
    """Paths along the wheel axis and beside it, from the left and from the right."""
    for height in heights:
        for direction in (90.0, 270.0):
            for offset in AXIS_OFFSETS:
                yield Approach("wheel_axis", height, direction, offset)


def from_above(lower: Array, upper: Array, spacing: float) -> Iterator[Approach]:
    """Paths down onto the base, over a grid on its footprint that includes its rim.

    Args:
        lower: (2,) [m] corner of the footprint.
        upper: (2,) [m] the opposite corner.
        spacing: [m] at most, between two places of the grid.
    """
    counts = np.maximum(np.ceil((upper - lower) / spacing - 1e-9).astype(int), 1) + 1
    xs, ys = (np.linspace(a, b, n) for a, b, n in zip(lower[:2], upper[:2], counts, strict=True))
    for x in xs:
        for y in ys:
            yield Approach("above", place=(round(float(x), 6), round(float(y), 6)))


def outline_distance(direction: Array, half: Array) -> float:
    """[m] from the centre of a rectangle of half sides (2,) [m] to its outline, along (2,)."""
    along = np.abs(np.asarray(direction, dtype=float)[:2])
    with np.errstate(divide="ignore", over="ignore"):
        return float(np.min(np.where(along > 1e-12, half / along, np.inf)))
