"""The result of a measurement, as a table or as one JSON object."""

from __future__ import annotations

import math
import sys
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from typing import Any, NamedTuple

from app.cli.common import print_json
from benchmarks.law.options import Options


class Report(NamedTuple):
    """The result of a measurement.

    Attributes:
        name: Name of the measurement.
        rows: One mapping from column name to value for each row.
        summary: Values for all rows together.
    """

    name: str
    rows: Sequence[Mapping[str, Any]]
    summary: Mapping[str, Any]


def show(report: Report, options: Options) -> None:
    """Print the result on standard output in the chosen format."""
    if options.json:
        print_json(
            {
                "measurement": report.name,
                **asdict(options),
                "summary": dict(report.summary),
                "rows": [dict(row) for row in report.rows],
            }
        )
        return
    sys.stdout.write(markdown(report.rows) + "\n")
    for key, value in report.summary.items():
        sys.stdout.write(f"{key}: {_text(value)}\n")


def markdown(rows: Sequence[Mapping[str, Any]]) -> str:
    """The rows as a Markdown table."""
    if not rows:
        return ""
    lines = [list(rows[0]), ["---"] * len(rows[0])]
    lines += [[_text(value) for value in row.values()] for row in rows]
    return "".join(f"| {' | '.join(line)} |\n" for line in lines)


def largest(rows: Sequence[Mapping[str, Any]], column: str) -> float | None:
    """The largest value of a column, or None if no row has a value."""
    return max((row[column] for row in rows if row[column] is not None), default=None)


def least(rows: Sequence[Mapping[str, Any]], column: str) -> float | None:
    """The smallest value of a column, or None if no row has a value."""
    return min((row[column] for row in rows if row[column] is not None), default=None)


def _text(value: Any) -> str:
    if isinstance(value, float):
        return f"{value:.4g}" if math.isfinite(value) else str(value)
    if isinstance(value, (list, tuple)):
        return ", ".join(map(_text, value))
    return "" if value is None else str(value)
