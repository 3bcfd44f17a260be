"""Results that all studies of runs share: rows of rounded figures, and their files."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from app.system import write_whole

if TYPE_CHECKING:
    from app.simulation.run import RunResult

Row = dict[str, Any]  # numbers, texts, booleans and None, by columns that end in their unit; no NaN

DIGITS = 9  # [-] decimals of metres, radians, newtons and seconds
_LOG_EVERY = 10  # control steps between two rows of a thinned trace


def thinned(result: RunResult) -> RunResult:
    """A run with a row every hundredth of a second, for other processes and for figures."""
    return result._replace(trace=result.trace.rows(slice(None, None, _LOG_EVERY)))


def flattened(figures: Mapping[str, Any]) -> Row:
    """Figures by pair, axis or joint as separate figures, each with its unit at the end of its key.

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
    """A number rounded to `DIGITS`; other values do not change.

    The last digit of the QP solver's solutions depends on the addresses of its memory, and a result
    must be the same on any number of processes.
    """
    return round(value, DIGITS) if isinstance(value, float) else value


def write_table(path: Path, columns: Mapping[str, Any]) -> None:
    """Write columns of equal length completely or not at all; None and NaN are empty cells."""
    # Imported here, because it is needed only when all runs are done.
    import pyarrow as pa

    from app.simulation.trace.arrow import write_arrow

    arrays = {name: pa.array(column, from_pandas=True) for name, column in columns.items()}
    empty = {name: a.cast(pa.float64()) for name, a in arrays.items() if a.type == pa.null()}
    write_arrow(path, pa.table(arrays | empty))


def write_rows(path: Path, rows: Sequence[Row], first: Iterable[str] = ()) -> None:
    """Write rows as `write_table` does, with a column for each name; `first` names come first."""
    names = dict.fromkeys([*first, *(name for row in rows for name in row)])
    write_table(path, {name: [row.get(name) for row in rows] for name in names})


def write_json(path: Path, content: object) -> None:
    """Write a file completely or not at all."""
    text = json.dumps(content, indent=2, allow_nan=False) + "\n"
    write_whole(path, text)
