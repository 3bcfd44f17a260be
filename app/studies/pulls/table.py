"""All cases of a study as one table, sorted by case: `results.parquet`."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq

from app.studies.pulls.journal import write_whole
from app.studies.pulls.play import Row


def write_table(path: Path, rows: Sequence[Row]) -> None:
    """Write the rows, one a case; the same rows give the same bytes, whatever their order."""
    sink = pa.BufferOutputStream()
    pq.write_table(table_of(rows), sink, compression="zstd")
    write_whole(path, sink.getvalue().to_pybytes())


def table_of(rows: Sequence[Row]) -> pa.Table:
    """The rows sorted by case; what a row does not have is null."""
    ordered = sorted(rows, key=lambda row: row["case"])
    names = dict.fromkeys(name for row in ordered for name in row)
    columns = {name: [row.get(name) for row in ordered] for name in names}
    return pa.table({name: pa.array(v, _kind(v)) for name, v in columns.items()})


def _kind(values: Sequence[Any]) -> pa.DataType:
    kinds = {type(value) for value in values if value is not None}
    if kinds <= {bool} and kinds:
        return pa.bool_()
    if kinds <= {int} and kinds:
        return pa.int64()
    if kinds <= {str} and kinds:
        return pa.string()
    return pa.float64()
