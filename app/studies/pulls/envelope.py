"""The envelope of safety: the largest force of a person, for intervals of all other quantities."""

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

RESERVE = NEAR  # [m] distance below which a case counts as failed for the envelope
MARGIN = 0.9  # [-] ratio of the envelope's force to the force of the weakest failure
FORCE = "hand_force_clear_max_n"
"""Column of a row with the force that the person exerted before two bodies were near."""
_CONFIDENCE = 0.95  # [-] confidence of the bound of a failure rate

_drawn: dict[str, Any] = {name: (Interval, ...) for name in PARAMETERS if name != "hand_f_max"}


class Envelope(create_model("Drawn", __base__=Strict, **_drawn)):
    """A case is inside if its force is at most `force` and each other quantity in its interval.

    The intervals have the names of the quantities in `StudyRange`. The force of a case is the
    largest force on the end-effector until two bodies come nearer than `RESERVE`; it is smaller
    than the limit of the person's spring.
    """

    force: NonNegative
    """[N] largest force F* of a case; 0 means that no case is inside."""
    speed: Interval
    """[m/s] largest speed of the person's hand."""

    @classmethod
    def stated(cls) -> Self:
        """The envelope that the project states.

        Raises:
            StudyError: The file is damaged.
        """
        try:
            content = from_toml(STATED.read_text(encoding="utf-8"))
            return cls.model_validate(content["envelope"])
        except ValidationError as error:
            raise StudyError(f"{STATED}: {explain(error, cls)}") from None
        except (OSError, ValueError, KeyError) as error:
            raise StudyError(f"{STATED}: the envelope cannot be read ({error})") from None

    def narrowed(self, ranges: StudyRange) -> StudyRange:
        """The parts of a study's ranges that are inside the envelope.

        Raises:
            StudyError: A range has no part inside the envelope.
        """
        found = {}
        stated = {name: getattr(self, name) for name in _INTERVALS}
        for name, (lower, upper) in {**stated, "hand_f_max": (0.0, self.force)}.items():
            low, high = getattr(ranges, name)
            found[name] = max(low, lower), min(high, upper)
            if low > upper or high < lower:
                raise StudyError(
                    f"--{name.replace('_', '-')}: {low:g} to {high:g} is outside of the envelope, "
                    f"{lower:g} to {upper:g}; --inside needs a range that overlaps the envelope"
                )
        return ranges.model_copy(update=found)

    def holds(self, row: Row) -> bool:
        """Whether a case is inside the envelope."""
        intervals = ((row[COLUMNS[name]], *getattr(self, name)) for name in _INTERVALS)
        within = all(low <= value <= high for value, low, high in intervals)
        return within and exerted(row) <= self.force and self.force > 0.0


_INTERVALS = tuple(name for name in Envelope.model_fields if name != "force")


def exerted(row: Row) -> float:
    """[N] the person's largest force in a case before two bodies were near.

    For a run that stopped with an error, it is the spring's limit.
    """
    force = row.get(FORCE)
    return row["hand_f_max_n"] if force is None else force


def fit_envelope(rows: Sequence[Row], ranges: StudyRange) -> Envelope:
    """Fit an envelope to cases.

    Cases that failed, or came nearer than 10 mm, count as failures. F* is 0.9 times the force of
    the weakest failure, or the force of the strongest successful case if this is lower; it is
    rounded down to 1 N. F* is 0 without a successful case.
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
    """Number of cases, number of failures, and the 95 % bound of the failure rate."""
    failures = sum(map(failed, rows))
    bound = rate_bound(failures, len(rows))
    return {"cases": len(rows), "failed": failures, "rate_bound_95": bound}


def tally_by_halves(rows: Sequence[Row], ranges: StudyRange) -> dict[str, Any]:
    """Results of the cases inside an envelope that was fitted to other cases.

    The even cases are compared with the envelope of the odd cases, and vice versa. A bound from
    the same cases as the fit would be meaningless.
    """
    halves = [[row for row in rows if row["case"] % 2 == k] for k in (0, 1)]
    inside: list[Row] = []
    for fitted, held in (halves, halves[::-1]):
        envelope = fit_envelope(fitted, ranges)
        inside += filter(envelope.holds, held)
    return tally(inside)


def rate_bound(failures: int, cases: int) -> float:
    """[-] upper 95 % bound of a failure rate (Clopper and Pearson).

    Without a failure it is about 3 divided by the number of cases.
    """
    from scipy.stats import beta

    if failures >= cases:
        return 1.0
    return float(beta.ppf(_CONFIDENCE, failures + 1, cases - failures))


def as_toml(envelope: Envelope, source: Mapping[str, Any]) -> str:
    """The text of a file in the format of `envelope.toml`."""
    return tomlkit.dumps({"source": source, "envelope": envelope.model_dump(mode="json")})
