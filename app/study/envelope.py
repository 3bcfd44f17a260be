"""Where safety ends: how fast the hand may be pulled, by the base's delay and its largest speed."""

from __future__ import annotations

import math
import sys
from collections.abc import Mapping, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple

from pydantic import Field, ValidationError, model_validator
from typing_extensions import Self

from app.errors import StudyError
from app.strict import NonNegative, Strict, explain
from app.study.play import Row, failed
from app.study.study_range import Interval, StudyRange

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

STATED = Path(__file__).with_name("envelope.toml")
"""The envelope that the project states, with its source."""

DELAY_STEP = 0.05  # [s] width of a band of delays
BASE_STEP = 0.25  # [m/s] width of a band of the base's largest speed
RESERVE = 0.01  # [m] a case that comes nearer bounds the envelope as if it had failed
MARGIN = 0.9  # [-] of the slowest such case's speed that is still inside
_GRAIN = 0.01  # [m/s] to which speeds are rounded, downwards
_CONFIDENCE = 0.95  # [-] of the bound of a rate
_OTHERS = ("noise", "mass_error", "slip", "strength")
_COLUMNS = {
    "speed": "speed_mps", "delay": "delay_s", "base_speed": "base_speed_mps",
    "noise": "noise_rad", "mass_error": "mass_error", "slip": "slip", "strength": "strength_n",
}  # fmt: skip


class Envelope(Strict):
    """Speeds of the person's hand up to v*(delay, v_max) are inside.

    v* falls with the delay and rises with v_max; it is constant in each band. Outside of the
    intervals nothing is stated, and so nothing is inside.
    """

    delay: tuple[NonNegative, ...] = Field(min_length=2)
    """(D + 1,) [s] edges of the bands of the delay, rising."""
    base_speed: tuple[NonNegative, ...] = Field(min_length=2)
    """(B + 1,) [m/s] edges of the bands of v_max, rising."""
    speed: tuple[tuple[NonNegative, ...], ...]
    """(D, B) [m/s] v* in each band."""
    noise: Interval
    """[rad] of the joints' measured positions."""
    mass_error: Interval
    """[-] of the arm."""
    slip: Interval
    """[-] of the base."""
    strength: Interval
    """[N] of the person."""

    @model_validator(mode="after")
    def _fits(self) -> Self:
        for edges in (self.delay, self.base_speed):
            if any(a >= b for a, b in pairwise(edges)):
                raise ValueError("the edges of bands must rise")
        shape = [len(row) for row in self.speed]
        if shape != [len(self.base_speed) - 1] * (len(self.delay) - 1):
            raise ValueError("`speed` needs one row a band of delay, one column a band of v_max")
        return self

    @classmethod
    def stated(cls) -> Self:
        """The one that the project states.

        Raises:
            StudyError: Its file is damaged.
        """
        try:
            content = tomllib.loads(STATED.read_text(encoding="utf-8"))
            return cls.model_validate(content["envelope"])
        except ValidationError as error:
            raise StudyError(f"{STATED}: {explain(error, cls)}") from None
        except (OSError, ValueError, KeyError) as error:
            raise StudyError(f"{STATED}: no envelope can be read ({error})") from None

    def limit(self, delay: float, base_speed: float) -> float | None:
        """[m/s] v*(delay, v_max); None where nothing is stated.

        Args:
            delay: [s] of the base's command.
            base_speed: [m/s] v_max.
        """
        i, j = _band(delay, self.delay), _band(base_speed, self.base_speed)
        return None if i is None or j is None else self.speed[i][j]

    def holds(self, values: Mapping[str, float]) -> bool:
        """Whether a case is inside.

        Args:
            values: Speed and disturbances by their names in `Case`.
        """
        for name in _OTHERS:
            low, high = getattr(self, name)
            if not low <= values[name] <= high:
                return False
        limit = self.limit(values["delay"], values["base_speed"])
        return limit is not None and values["speed"] <= limit

    def holds_row(self, row: Row) -> bool:
        """The same of a row of the study's table."""
        return self.holds({name: row[column] for name, column in _COLUMNS.items()})


class Tally(NamedTuple):
    """How cases fared.

    Attributes:
        cases: How many.
        failures: How many of them failed.
        rate_bound: [-] that the true rate of failures does not exceed, with 95 % confidence.
    """

    cases: int
    failures: int
    rate_bound: float


def fit_envelope(rows: Sequence[Row], ranges: StudyRange) -> Envelope:
    """The largest speeds below which no case failed or came nearer than 10 mm, less a margin.

    In each band of delay and v_max, v* is 0.9 of the speed of the slowest such case whose delay is
    not above the band and whose v_max is not below it: what fails with less delay or a faster base
    fails there too. It is never above the fastest case that went well and is as hard as the band's
    easiest or harder, and 0 without one. Both are rounded down to 0.01 m/s.
    """
    delay, base_speed = _edges(ranges.delay, DELAY_STEP), _edges(ranges.base_speed, BASE_STEP)
    bad = [row for row in rows if failed(row) or _near(row)]
    good = [row for row in rows if not (failed(row) or _near(row))]

    def limit(i: int, j: int) -> float:
        easier = (
            row["speed_mps"] for row in bad
            if row["delay_s"] <= delay[i + 1] and row["base_speed_mps"] >= base_speed[j]
        )  # fmt: skip
        as_hard = (
            row["speed_mps"] for row in good
            if row["delay_s"] >= delay[i] and row["base_speed_mps"] <= base_speed[j + 1]
        )  # fmt: skip
        safe = min(MARGIN * min(easier, default=math.inf), max(as_hard, default=0.0))
        return math.floor(safe / _GRAIN + 1e-9) * _GRAIN

    speed = tuple(
        tuple(round(limit(i, j), 6) for j in range(len(base_speed) - 1))
        for i in range(len(delay) - 1)
    )
    return Envelope(
        delay=delay, base_speed=base_speed, speed=speed,
        **{name: getattr(ranges, name) for name in _OTHERS},
    )  # fmt: skip


def tally(rows: Sequence[Row]) -> Tally:
    """How these cases fared."""
    failures = sum(map(failed, rows))
    return Tally(len(rows), failures, rate_bound(failures, len(rows)))


def tally_by_halves(rows: Sequence[Row], ranges: StudyRange) -> Tally:
    """How cases fared inside of an envelope that was fitted without them.

    The even cases are held against the envelope of the odd ones, and the other way round: the
    bound of a rate from the same cases that the envelope was fitted to would be worth nothing.
    """
    halves = [[row for row in rows if row["case"] % 2 == k] for k in (0, 1)]
    inside: list[Row] = []
    for fitted, held in (halves, halves[::-1]):
        envelope = fit_envelope(fitted, ranges)
        inside += [row for row in held if envelope.holds_row(row)]
    return tally(inside)


def rate_bound(failures: int, cases: int) -> float:
    """[-] upper 95 % bound of a rate (Clopper and Pearson); about 3 / cases without a failure."""
    from scipy.stats import beta

    if failures >= cases:
        return 1.0
    return float(beta.ppf(_CONFIDENCE, failures + 1, cases - failures))


def as_toml(envelope: Envelope, source: Mapping[str, Any]) -> str:
    """The text of a file as `envelope.toml` is one."""
    lines = ["[source]"]
    lines += [f"{key} = {_toml(value)}" for key, value in source.items()]
    lines += ["", "[envelope]"]
    lines += [f"{key} = {_toml(value)}" for key, value in envelope.model_dump().items()]
    return "\n".join(lines) + "\n"


def _near(row: Row) -> bool:
    distance = row.get("min_clearance_m")
    return distance is not None and distance < RESERVE


def _toml(value: Any) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, str):
        return '"' + value.replace("\\", "\\\\").replace('"', '\\"') + '"'
    if isinstance(value, (list, tuple)):
        return "[" + ", ".join(map(_toml, value)) + "]"
    return repr(value)


def _band(value: float, edges: Sequence[float]) -> int | None:
    """Number of the band that holds a value; of the harder of two whose edge it is."""
    if not edges[0] <= value <= edges[-1]:
        return None
    return next(i for i, upper in enumerate(edges[1:]) if value <= upper)


def _edges(interval: Interval, step: float) -> tuple[float, ...]:
    """Edges of bands of about that width that fill an interval; one band if it is a point."""
    low, high = interval
    count = max(1, round((high - low) / step))
    edges = [round(low + (high - low) * k / count, 6) for k in range(count)] + [high]
    return tuple(edges) if high > low else (low, math.nextafter(low, math.inf))
