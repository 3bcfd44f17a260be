"""The quantities of a sweep's maps: their scales, their limits, and the colours of good and bad."""

from __future__ import annotations

import math
from typing import Literal, NamedTuple

from matplotlib import colormaps

from app.studies.sweep.result import CLEARANCE_LIMIT, ERROR_LIMIT, Row

Colour = tuple[float, float, float, float]

_GOOD, _BAD = colormaps["Blues"], colormaps["YlOrRd"]
_PALE, _DEEP = 0.45, 0.95  # [-] of a colour map
UNREACHABLE = "#D5DAE0"
NEVER = "#B10026"


class Quantity(NamedTuple):
    """One row of the maps.

    Attributes:
        key: Of a path's figures.
        title: For people, with its unit.
        low: [m or s] where the scale begins.
        high: [m or s] where it ends.
        limit: [m or s] between good and bad, or None.
        marks: Values with their texts, where circles are drawn.
        scale: How the scale runs: by the value, its logarithm, or its root.
        more_is_better: Which side of the limit is good.
    """

    key: str
    title: str
    low: float
    high: float
    limit: float | None
    marks: tuple[tuple[float, str], ...]
    scale: Literal["linear", "logarithmic", "root"] = "linear"
    more_is_better: bool = False

    def share(self, value: float) -> float:
        """[-] where a value stands on the scale, within 0 and 1."""
        value = min(max(value, self.low), self.high)
        if self.scale == "logarithmic":
            return math.log(value / self.low) / math.log(self.high / self.low)
        share = (value - self.low) / (self.high - self.low)
        return math.sqrt(share) if self.scale == "root" else share

    def length(self, value: float) -> float:
        """[-] of a bar; where more is better, one that lacks it reaches to the limit in red."""
        lacks = self.limit is not None and self.more_is_better and value < self.limit
        return self.share(self.limit if lacks and self.limit is not None else value)

    def good(self, value: float) -> bool:
        """Whether a value is on the good side of the limit."""
        if self.limit is None:
            return True
        return value >= self.limit if self.more_is_better else value <= self.limit

    def colour(self, value: float) -> Colour:
        """Blue if good, yellow to red if bad; the deeper, the farther from the limit."""
        at, limit = self.share(value), self.share(self.limit or self.high)
        good = self.good(value)
        room = limit if good is not self.more_is_better else 1.0 - limit
        depth = abs(at - limit) / room if room > 0.0 else 0.0
        return (_GOOD if good else _BAD)(_PALE + (_DEEP - _PALE) * min(depth, 1.0))


def quantities(rows: list[Row]) -> tuple[Quantity, ...]:
    """Final error, least clearance and time, with scales that hold these paths."""
    times = [row["time_s"] for row in rows if row["time_s"] is not None]
    longest = 5.0 * math.ceil(max(times, default=5.0) / 5.0)
    widest = 0.05 * math.ceil(max((row["start_clearance_m"] for row in rows), default=0.2) / 0.05)
    return (
        Quantity(
            "ee_error_final_m",
            "final error of the hand",
            1e-6,
            0.3,
            ERROR_LIMIT,
            ((1e-5, "10 µm"), (ERROR_LIMIT, "1 mm"), (0.1, "100 mm")),
            scale="logarithmic",
        ),
        Quantity(
            "min_clearance_m",
            "least distance to the base",
            0.0,
            widest,
            CLEARANCE_LIMIT,
            (
                (CLEARANCE_LIMIT, f"{CLEARANCE_LIMIT:g} m"),
                (widest / 2, f"{widest / 2:.3g} m"),
                (widest, f"{widest:.3g} m"),
            ),
            scale="root",
            more_is_better=True,
        ),
        Quantity(
            "time_s",
            "time until within 1 mm",
            0.0,
            longest,
            None,
            ((longest / 2, f"{longest / 2:g} s"), (longest, f"{longest:g} s")),
        ),
    )
