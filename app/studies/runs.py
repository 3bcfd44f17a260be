"""The results of runs as rows of a table, and files of such tables."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pydantic_core import to_jsonable_python

from app.system import write_whole

if TYPE_CHECKING:
    from app.simulation.run import RunResult

Row = dict[str, Any]  # the cells of a row of a table by column, or other results by key


def thinned(result: RunResult) -> RunResult:
    """A run with each tenth row (0.01 s) and no snapshots, but with the results of all rows."""
    return result._replace(trace=result.trace.rows(slice(None, None, 10)))


def flattened(results: Mapping[str, Any]) -> Row:
    """The results, with a key for each entry of a mapping: `a` of `jump` has the key `jump_a`.

    An ending `_m` or `_s` stays at the end: `a` of `distance_m` has the key `distance_a_m`.
    """
    row: Row = {}
    for key, value in results.items():
        if isinstance(value, Mapping):
            stem, unit = (key[:-2], key[-2:]) if key.endswith(("_m", "_s")) else (key, "")
            row |= {f"{stem}_{inner}{unit}": each for inner, each in value.items()}
        else:
            row[key] = value
    return row


def rounded(value: object) -> object:
    """A float rounded to nine decimals; other values do not change."""
    # The last digits can depend on memory addresses, as those of sums by BLAS do, and therefore on
    # the number of processes.
    return round(value, 9) if isinstance(value, float) else value


def write_table(path: Path, columns: Mapping[str, Any]) -> None:
    """Write columns as CSV or Parquet, completely or not at all; None and NaN are empty cells."""
    import pyarrow as pa

    from app.simulation.trace.arrow import write_arrow

    arrays = {name: pa.array(column, from_pandas=True) for name, column in columns.items()}
    empty = {name: a.cast(pa.float64()) for name, a in arrays.items() if a.type == pa.null()}
    write_arrow(path, pa.table(arrays | empty))


def write_rows(path: Path, rows: Sequence[Row], first: Iterable[str] = ()) -> None:
    """Write rows as `write_table` does, with a column for each key; the keys `first` come first."""
    names = dict.fromkeys([*first, *(name for row in rows for name in row)])
    write_table(path, {name: [row.get(name) for row in rows] for name in names})


def plain(content: object) -> Any:
    """Content for JSON: lists replace arrays and tuples, None replaces NaN and infinite numbers."""
    return to_jsonable_python(content, inf_nan_mode="null", fallback=lambda x: x.tolist())


def json_text(content: object) -> str:
    """Indented JSON of `plain` content."""
    return json.dumps(plain(content), indent=2, allow_nan=False)


def write_json(path: Path, content: object) -> None:
    """Write the `json_text` of content by `write_whole`."""
    write_whole(path, json_text(content) + "\n")
