"""Where safety ends: how strongly the hand may be pulled, by its speed and the base's delay."""

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
from app.simulation.trace.recording import NEAR
from app.strict import NonNegative, Strict, explain
from app.studies.pulls.draw_range import Interval, StudyRange
from app.studies.pulls.play import Row, failed

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

STATED = Path(__file__).with_name("envelope.toml")
"""The envelope that the project states, with its source."""

SPEED_STEP = 0.3  # [m/s] width of a band of speeds of the person's hand
DELAY_STEP = 0.2  # [s] width of a band of delays of the base
RESERVE = NEAR
"""[m] a case that comes nearer bounds the envelope as if it had failed."""
MARGIN = 0.9  # [-] of the weakest such case's force that is still inside
_GRAIN = 1.0  # [N] to which forces are rounded, downwards
_CONFIDENCE = 0.95  # [-] of the bound of a rate
_OTHERS = ("v_max", "encoder_noise", "mass_error", "slip", "hand_stiffness", "hand_mass")
_COLUMNS = {
    "speed": "speed_mps",
    "base_delay": "base_delay_s",
    "v_max": "v_max_mps",
    "encoder_noise": "encoder_noise_rad",
    "mass_error": "mass_error",
    "slip": "slip",
    "hand_stiffness": "hand_stiffness_npm",
    "hand_mass": "hand_mass_kg",
}
FORCE = "hand_force_clear_max_n"
"""Column of a row with the force that was exerted before two bodies were near."""


class Envelope(Strict):
    """Forces that a person exerts up to F*(speed, delay) are inside.

    F* falls with the speed of the person's hand and with the base's delay; it is constant in each
    band. A force is the largest that acted on the hand before two bodies were near, whatever the
    person's spring would have allowed. Outside of the intervals nothing is stated, and so nothing
    is inside.
    """

    speed: tuple[NonNegative, ...] = Field(min_length=2)
    """(S + 1,) [m/s] edges of the bands of the hand's largest speed, rising."""
    base_delay: tuple[NonNegative, ...] = Field(min_length=2)
    """(D + 1,) [s] edges of the bands of the base's delay, rising."""
    force: tuple[tuple[NonNegative, ...], ...]
    """(S, D) [N] F* in each band."""
    v_max: Interval
    """[m/s] largest commanded speed of the base."""
    encoder_noise: Interval
    """[rad] of the joints' measured positions."""
    mass_error: Interval
    """[-] of the arm."""
    slip: Interval
    """[-] of the base."""
    hand_stiffness: Interval
    """[N/m] of the person's spring."""
    hand_mass: Interval
    """[kg] of the person's hand and forearm."""

    @model_validator(mode="after")
    def _fits(self) -> Self:
        for edges in (self.speed, self.base_delay):
            if any(a >= b for a, b in pairwise(edges)):
                raise ValueError("the edges of bands must rise")
        shape = [len(row) for row in self.force]
        if shape != [len(self.base_delay) - 1] * (len(self.speed) - 1):
            raise ValueError("`force` needs one row a band of speed, one column a band of delay")
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

    def limit(self, speed: float, base_delay: float) -> float | None:
        """[N] F*(speed, delay); None where nothing is stated.

        Args:
            speed: [m/s] largest one of the person's hand.
            base_delay: [s] of the base's command.
        """
        i, j = _band(speed, self.speed), _band(base_delay, self.base_delay)
        return None if i is None or j is None else self.force[i][j]

    def within(self, name: str, interval: Interval) -> Interval:
        """The part of an interval of what a case draws in which something is stated.

        Args:
            name: As in `Case`.
            interval: Least and largest value.

        Raises:
            StudyError: There is none.
        """
        if name not in _COLUMNS:
            return interval
        stated = getattr(self, name)
        low, high = max(interval[0], stated[0]), min(interval[1], stated[-1])
        if low > high:
            raise StudyError(
                f"--{name.replace('_', '-')}: nothing is stated from {interval[0]:g} to "
                f"{interval[1]:g}, only from {stated[0]:g} to {stated[-1]:g}; --inside needs some "
                "of that"
            )
        return low, high

    def holds(self, values: Mapping[str, float], *, force: float) -> bool:
        """Whether a case is inside.

        Args:
            values: Speed, person and disturbances by their names in `Case`.
            force: [N] the largest that is exerted.
        """
        for name in _OTHERS:
            low, high = getattr(self, name)
            if not low <= values[name] <= high:
                return False
        limit = self.limit(values["speed"], values["base_delay"])  # 0 where no force is safe
        return limit is not None and force <= limit and limit > 0.0

    def holds_row(self, row: Row) -> bool:
        """The same of a row of the study's table, by the force that was exerted."""
        values = {name: row[column] for name, column in _COLUMNS.items()}
        return self.holds(values, force=exerted(row))


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


def exerted(row: Row) -> float:
    """[N] the person's largest force in a case before two bodies were near.

    Of a run that broke off it is what the spring allows.
    """
    force = row.get(FORCE)
    return row["hand_f_max_n"] if force is None else force


def fit_envelope(rows: Sequence[Row], ranges: StudyRange) -> Envelope:
    """The largest forces below which no case failed or came nearer than 10 mm, less a margin.

    In each band of speed and delay, F* is 0.9 of the force of the weakest such case that is neither
    faster nor later than the band: what fails when it is slower or with less delay fails there too.
    It is never above the strongest case that went well and is as hard as the band's easiest or
    harder, and 0 without one. Both are rounded down to 1 N.
    """
    speed, delay = _edges(ranges.speed, SPEED_STEP), _edges(ranges.base_delay, DELAY_STEP)
    bad = [row for row in rows if failed(row) or _near(row)]
    good = [row for row in rows if not (failed(row) or _near(row))]

    def limit(i: int, j: int) -> float:
        easier = (
            exerted(row)
            for row in bad
            if row["speed_mps"] <= speed[i + 1] and row["base_delay_s"] <= delay[j + 1]
        )
        as_hard = (
            exerted(row)
            for row in good
            if row["speed_mps"] >= speed[i] and row["base_delay_s"] >= delay[j]
        )
        safe = min(MARGIN * min(easier, default=math.inf), max(as_hard, default=0.0))
        return math.floor(safe / _GRAIN + 1e-9) * _GRAIN

    return Envelope(
        speed=speed,
        base_delay=delay,
        force=tuple(
            tuple(limit(i, j) for j in range(len(delay) - 1)) for i in range(len(speed) - 1)
        ),
        **{name: getattr(ranges, name) for name in _OTHERS},
    )


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
