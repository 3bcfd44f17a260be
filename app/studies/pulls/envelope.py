"""The envelope of safety: the largest safe force of a person, for intervals of other quantities."""

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import tomlkit
from pydantic import ValidationError, create_model
from typing_extensions import Self

from app.errors import StudyError
from app.simulation.trace.metrics import NEAR
from app.strict import NonNegative, Strict, explain, from_toml
from app.studies.pulls.case import COLUMNS, entered_buffer, failed
from app.studies.pulls.parameters import PARAMETERS, Interval, StudyRange
from app.studies.runs import Row

STATED = Path(__file__).with_name("envelope.toml")  # the envelope that the project states
MARGIN = 0.9  # [-] largest ratio of the envelope's force to the smallest force of a bad case
FORCE = "hand_force_clear_max_n"  # largest force until any two bodies were nearer than `NEAR`
_drawn: dict[str, Any] = {name: (Interval, ...) for name in PARAMETERS if name != "hand_f_max"}


class Envelope(create_model("Drawn", __base__=Strict, **_drawn)):
    """A set of cases: their force (`exerted`) is at most F*, and some quantities are in intervals.

    An interval has the name of its quantity in `StudyRange`; other quantities are not limited.
    """

    force: NonNegative  # [N] largest force F* of a case inside; with 0, no case is inside
    speed: Interval  # [m/s] largest speed of the person's hand

    @classmethod
    def stated(cls) -> Self:
        """The envelope that the project states; a `StudyError` if its file is damaged."""
        try:
            return cls.model_validate(from_toml(STATED.read_text(encoding="utf-8"))["envelope"])
        except ValidationError as error:
            raise StudyError(f"{STATED}: {explain(error, cls)}") from None
        except (OSError, ValueError, KeyError) as error:
            raise StudyError(f"{STATED}: the envelope cannot be read ({error})") from None

    def narrowed(self, ranges: StudyRange) -> StudyRange:
        """Ranges within the envelope, `hand_f_max` up to F*; StudyError if one is all outside."""
        found = {}
        for name, (lower, upper) in (self._intervals() | {"hand_f_max": (0.0, self.force)}).items():
            low, high = getattr(ranges, name)
            found[name] = max(low, lower), min(high, upper)
            if low > upper or high < lower:
                why = f"--{name.replace('_', '-')}: {low:g} to {high:g} is outside of the envelope"
                helps = "--inside needs a range that overlaps the envelope"
                raise StudyError(f"{why}, {lower:g} to {upper:g}; {helps}")
        return ranges.model_copy(update=found)

    def holds(self, row: Row) -> bool:
        """Whether a case is inside the envelope."""
        intervals = self._intervals().items()
        within = all(low <= row[COLUMNS[name]] <= high for name, (low, high) in intervals)
        return within and exerted(row) <= self.force and self.force > 0.0

    def _intervals(self) -> dict[str, Interval]:
        return {name: interval for name, interval in self if name != "force"}


def exerted(row: Row) -> float:
    """[N] the force `FORCE` of a case; if it is missing, as after an error, `hand_f_max_n`."""
    force = row.get(FORCE)
    return row["hand_f_max_n"] if force is None else force


def fit_envelope(rows: Sequence[Row], ranges: StudyRange) -> Envelope:
    """Fit an envelope to cases, with the intervals of the study's ranges.

    A case is bad if it failed, or if the arm came nearer to the base than 10 mm. F* is the smaller
    of two forces: 0.9 times the smallest force of a bad case, and the largest force of the other
    cases; F* is rounded down to 1 N. Without other cases, F* is 0.
    """
    good: list[float] = []
    bad: list[float] = []
    for row in rows:
        (bad if failed(row) or entered_buffer(row, NEAR) else good).append(exerted(row))
    safe = min(MARGIN * min(bad, default=math.inf), max(good, default=0.0))
    intervals = {name: getattr(ranges, name) for name in Envelope.model_fields if name != "force"}
    return Envelope(force=math.floor(safe + 1e-9), **intervals)


def tally(rows: Sequence[Row]) -> dict[str, Any]:
    """Number of cases, number of failed cases, and the upper 95 % bound of the share that fails."""
    failures = sum(map(failed, rows))
    bound = rate_bound(failures, len(rows))
    return {"cases": len(rows), "failed": failures, "rate_bound_95": bound}


def tally_by_halves(rows: Sequence[Row], ranges: StudyRange) -> dict[str, Any]:
    """One tally: even cases inside an envelope fitted to odd cases, and odd cases vice versa."""
    halves = [[row for row in rows if row["case"] % 2 == k] for k in (0, 1)]
    inside: list[Row] = []
    for fitted, others in (halves, halves[::-1]):
        inside += filter(fit_envelope(fitted, ranges).holds, others)
    return tally(inside)


def rate_bound(failures: int, cases: int) -> float:
    """[-] upper 95 % bound of a failure rate (Clopper and Pearson); 1 if no case succeeded."""
    from scipy.stats import beta

    if failures >= cases:
        return 1.0
    return float(beta.ppf(0.95, failures + 1, cases - failures))


def as_toml(envelope: Envelope, source: Mapping[str, Any]) -> str:
    """The text of `envelope.toml`, with the table `source` and the table `envelope`."""
    return tomlkit.dumps({"source": source, "envelope": envelope.model_dump(mode="json")})
