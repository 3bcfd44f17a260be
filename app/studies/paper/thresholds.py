"""What counts as reached, clear or smooth: each number once, with where it comes from."""

from __future__ import annotations

from typing import NamedTuple


class Threshold(NamedTuple):
    """A number against which a measured one is held.

    Attributes:
        value: In the unit.
        unit: As printed.
        source: Where it comes from.
    """

    value: float
    unit: str
    source: str

    def __str__(self) -> str:
        return f"{self.value:g} {self.unit}".strip()


REACHED = Threshold(0.001, "m", "Figure 12(b) shows no error; 1 mm is what its axis resolves")
CLEAR = Threshold(0.05, "m", "Figure 10: from there inwards the avoidance task is in full force")
AVOIDED = Threshold(0.03, "m", "chosen: a gap that can be seen")
MISSED = Threshold(0.02, "m", "chosen: a tenth of the way that the hand is led")
NEARER = Threshold(0.05, "m", "chosen: a third of the buffer distance")
MOVED = Threshold(0.05, "m", "chosen: a motion of the base that can be seen in Figure 11")
TURNED = Threshold(
    0.02,
    "rad",
    "chosen with the first runs known: past 1 degree it is a turn; the paper gives no number",
)
BETA_STEP = Threshold(
    0.05, "in 10 ms", "chosen: four times what the hand's speed gives by the slope of Figure 10"
)
LINEAR_JUMP = Threshold(
    0.3, "m/s²", "chosen with the first runs known: a tenth of what the base can do"
)
ANGULAR_JUMP = Threshold(
    0.6, "rad/s²", "chosen with the first runs known: a tenth of what the base can do"
)
SIGN_CHANGES = Threshold(
    3, "", "chosen with the first runs known: into the buffer, out of it, once to settle"
)
TORQUE_SIGN_CHANGES = Threshold(
    2, "", "chosen: a torque rises, falls and settles while the hand is led in once and held"
)
MET_FROM = Threshold(25.0, "s", "§4.2.3: at 30 s, give or take 5 s")
MET_TO = Threshold(35.0, "s", "§4.2.3: at 30 s, give or take 5 s")
OPENED_BY = Threshold(40.0, "s", "§4.2.3: open at 40 s")
BACKS_FROM = Threshold(15.0, "s", "§4.2.3: from 20 s on, give or take 5 s")
BACKS_TO = Threshold(25.0, "s", "§4.2.3: from 20 s on, give or take 5 s")
HAND_FORCE = Threshold(50.0, "N", "chosen: a person opens such a door with less")
RADIAL_ERROR = Threshold(0.0873, "rad", "chosen: 5 degrees, from a first guess 30 degrees wrong")
CONTROL_STEP = Threshold(1000.0, "µs", "§4.1: the arm is controlled at 1 kHz")
