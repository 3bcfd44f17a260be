"""Where safety ends: how strongly the hand may be pulled, within which intervals of all else."""

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
from app.studies.pulls.case import COLUMNS, failed
from app.studies.pulls.parameters import PARAMETERS, Interval, StudyRange
from app.studies.runs import Row

STATED = Path(__file__).with_name("envelope.toml")
"""The envelope that the project states, with its source."""

RESERVE = NEAR  # [m] a case that comes nearer bounds the envelope as if it had failed
MARGIN = 0.9  # [-] of the weakest such case's force that is still inside
FORCE = "hand_force_clear_max_n"
"""Column of a row with the force that was exerted before two bodies were near."""
_CONFIDENCE = 0.95  # [-] of the bound of a rate

_drawn: dict[str, Any] = {name: (Interval, ...) for name in PARAMETERS if name != "hand_f_max"}


class Envelope(create_model("Drawn", __base__=Strict, **_drawn)):
    """Forces that a person exerts up to F* are inside, if all else is within its interval.

    The intervals are of what a `StudyRange` has by the same names. A force is the largest that
    acted on the hand before two bodies were near, whatever the person's spring would have allowed.
    """

    force: NonNegative
    """[N] F*; at 0 nothing is inside."""
    speed: Interval
    """[m/s] largest speed of the person's hand."""

    @classmethod
    def stated(cls) -> Self:
        """The one that the project states.

        Raises:
            StudyError: Its file is damaged.
        """
        try:
            content = from_toml(STATED.read_text(encoding="utf-8"))
            return cls.model_validate(content["envelope"])
        except ValidationError as error:
            raise StudyError(f"{STATED}: {explain(error, cls)}") from None
        except (OSError, ValueError, KeyError) as error:
            raise StudyError(f"{STATED}: no envelope can be read ({error})") from None

    def narrowed(self, ranges: StudyRange) -> StudyRange:
        """Those parts of what a study draws from that lie inside.

        Raises:
            StudyError: Of one quantity there is none.
        """
        found = {}
        stated = {name: getattr(self, name) for name in _INTERVALS}
        for name, (least, most) in {**stated, "hand_f_max": (0.0, self.force)}.items():
            low, high = getattr(ranges, name)
            found[name] = max(low, least), min(high, most)
            if low > most or high < least:
                raise StudyError(
                    f"--{name.replace('_', '-')}: nothing is stated from {low:g} to {high:g}, "
                    f"only from {least:g} to {most:g}; --inside needs some of that"
                )
        return ranges.model_copy(update=found)

    def holds(self, row: Row) -> bool:
        """Whether a case is inside, by its row and the force that was exerted in it."""
        intervals = ((row[COLUMNS[name]], *getattr(self, name)) for name in _INTERVALS)
        within = all(low <= value <= high for value, low, high in intervals)
        return within and exerted(row) <= self.force and self.force > 0.0


_INTERVALS = tuple(name for name in Envelope.model_fields if name != "force")


def exerted(row: Row) -> float:
    """[N] the person's largest force in a case before two bodies were near.

    Of a run that broke off it is what the spring allows.
    """
    force = row.get(FORCE)
    return row["hand_f_max_n"] if force is None else force


def fit_envelope(rows: Sequence[Row], ranges: StudyRange) -> Envelope:
    """The largest force below which no case failed or came nearer than 10 mm, less a margin.

    F* is 0.9 of the force of the weakest such case, but not above the strongest case that went
    well, rounded down to 1 N; 0 without a case that went well.
    """
    good: list[float] = []
    bad: list[float] = []
    for row in rows:
        distance = row.get("min_clearance_m")
        near = distance is not None and distance < RESERVE
        (bad if near or failed(row) else good).append(exerted(row))
    safe = min(MARGIN * min(bad, default=math.inf), max(good, default=0.0))
    intervals = {name: getattr(ranges, name) for name in _INTERVALS}
    return Envelope(force=math.floor(safe + 1e-9), **intervals)


def tally(rows: Sequence[Row]) -> dict[str, Any]:
    """How many cases there are, how many failed, and the 95 % bound of the rate of failures."""
    failures = sum(map(failed, rows))
    bound = rate_bound(failures, len(rows))
    return {"cases": len(rows), "failed": failures, "rate_bound_95": bound}


def tally_by_halves(rows: Sequence[Row], ranges: StudyRange) -> dict[str, Any]:
    """How cases fared inside of an envelope that was fitted without them.

    The even cases are held against the envelope of the odd ones, and the other way round: the
    bound of a rate from the same cases that the envelope was fitted to would be worth nothing.
    """
    halves = [[row for row in rows if row["case"] % 2 == k] for k in (0, 1)]
    inside: list[Row] = []
    for fitted, held in (halves, halves[::-1]):
        envelope = fit_envelope(fitted, ranges)
        inside += filter(envelope.holds, held)
    return tally(inside)


def rate_bound(failures: int, cases: int) -> float:
    """[-] upper 95 % bound of a rate (Clopper and Pearson); about 3 / cases without a failure."""
    from scipy.stats import beta

    if failures >= cases:
        return 1.0
    return float(beta.ppf(_CONFIDENCE, failures + 1, cases - failures))


def as_toml(envelope: Envelope, source: Mapping[str, Any]) -> str:
    """The text of a file as `envelope.toml` is one."""
    return tomlkit.dumps({"source": source, "envelope": envelope.model_dump(mode="json")})
