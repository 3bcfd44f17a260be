"""What all that runs shares: rows of rounded figures, and their files."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from app.system import write_whole

if TYPE_CHECKING:
    from app.simulation.run import RunResult

Row = dict[str, Any]  # numbers, texts, truths and None, by columns that end in their unit; no NaN

DIGITS = 9  # [-] after the point, of metres, radians, newtons and seconds
_LOG_EVERY = 10  # control steps between two rows of a trace that is thinned


def thinned(result: RunResult) -> RunResult:
    """A run with a row a hundredth of a second, as other processes and the figures take it."""
    return result._replace(trace=result.trace.rows(slice(None, None, _LOG_EVERY)))


def flattened(figures: Mapping[str, Any]) -> Row:
    """Figures by pair, axis or joint as figures of their own, each with its unit at its end.

    `min_distance_m` of `lm-lEE` becomes `min_distance_lm-lEE_m`.
    """
    row: Row = {}
    for key, value in figures.items():
        if isinstance(value, Mapping):
            stem, unit = (key[:-2], key[-2:]) if key.endswith(("_m", "_s")) else (key, "")
            row |= {f"{stem}_{inner}{unit}": each for inner, each in value.items()}
        else:
            row[key] = value
    return row


def rounded(value: object) -> object:
    """A number rounded to `DIGITS`, anything else as it is.

    The QP solver's answers differ in their last digit with where its memory lies, and a result is
    to be the same on any number of processes.
    """
    return round(value, DIGITS) if isinstance(value, float) else value


def write_table(path: Path, columns: Mapping[str, Any]) -> None:
    """Write columns of equal length whole or not at all, by the ending; None and NaN are empty."""
    # Imported here: it is not needed before all runs are done.
    import pyarrow as pa

    from app.simulation.trace.arrow import write_arrow

    arrays = {name: pa.array(column, from_pandas=True) for name, column in columns.items()}
    empty = {name: a.cast(pa.float64()) for name, a in arrays.items() if a.type == pa.null()}
    write_arrow(path, pa.table(arrays | empty))


def write_rows(path: Path, rows: Sequence[Row], first: Iterable[str] = ()) -> None:
    """The same for rows: a column for each name in them, and before those the first ones."""
    names = dict.fromkeys([*first, *(name for row in rows for name in row)])
    write_table(path, {name: [row.get(name) for row in rows] for name in names})


def write_json(path: Path, content: object) -> None:
    """Write a file whole or not at all."""
    text = json.dumps(content, indent=2, allow_nan=False) + "\n"
    write_whole(path, text)
