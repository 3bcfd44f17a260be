"""The two files that a log can be: CSV with a leading comment, and Parquet with schema metadata."""

from __future__ import annotations

import io
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.csv
import pyarrow.parquet as pq

from app.errors import LogError
from app.simulation.trace.columns import Column
from app.system import write_whole

SUFFIXES = ".csv", ".parquet"
"""The ending of a file's name says which of the two it is."""

Cells = Sequence[Any] | np.ndarray
_KEY = b"dbb_log"
_COMMENT = "# "
_TYPES = {"float": pa.float64(), "int": pa.int64(), "bool": pa.bool_(), "text": pa.string()}


def check_suffix(path: Path) -> None:
    """Refuse a name that says of neither format."""
    if path.suffix not in SUFFIXES:
        raise LogError(f"{path}: a log ends in {' or '.join(SUFFIXES)}")


def write_cells(path: Path, header: str, cells: Mapping[Column, Cells]) -> None:
    """Write a file whole or not at all.

    Args:
        path: Its ending chooses the format.
        header: One line about the whole.
        cells: Columns of equal length; not-a-number in an optional one becomes an empty cell.

    Raises:
        LogError: Its ending is none of the formats.
        OutputError: It cannot be written there.
    """
    check_suffix(path)
    table = pa.table({c.name: _array(c, values) for c, values in cells.items()})
    content = _csv(header, table) if path.suffix == ".csv" else _parquet(header, table)
    write_whole(path, content)


def read_table(path: Path) -> tuple[str, Mapping[str, Any]]:
    """The header, and the columns by their names, of a kind as the file has them.

    Raises:
        LogError: There is no such file, or it cannot be read as what its ending says.
    """
    check_suffix(path)
    try:
        header, table = _read_csv(path) if path.suffix == ".csv" else _read_parquet(path)
    except FileNotFoundError:
        raise LogError(f"{path}: no such file") from None
    except (pa.ArrowException, OSError, ValueError) as error:
        reason = str(error).strip().splitlines()[0][:200] if str(error).strip() else "unreadable"
        raise LogError(f"{path}: not a log, or damaged: {reason}") from None
    if twice := sorted({n for n in table.column_names if table.column_names.count(n) > 1}):
        raise LogError(f"{path}: column {twice[0]!r} is there twice")
    return header, {name: table.column(name) for name in table.column_names}


def column_of(column: Column, values: Any, filled: int | None = None) -> list[Any]:
    """The cells of a column that `read_table` gave, checked.

    Args:
        column: What it must be.
        values: As in the file.
        filled: How many cells have something in them; all if not given.

    Raises:
        LogError: They are of another kind, or one is empty that may not be.
    """
    empty = values.null_count - (0 if filled is None else len(values) - filled)
    if not column.optional and column.kind != "text" and empty:
        raise LogError(f"column {column.name}: {abs(empty)} cells are empty")
    try:
        cells = values.cast(_TYPES[column.kind]).to_pylist()
    except pa.ArrowException as error:
        raise LogError(f"column {column.name}: {str(error).splitlines()[0]}") from None
    nothing = "" if column.kind == "text" else float("nan")
    return [nothing if cell is None else cell for cell in cells]


def _array(column: Column, values: Cells) -> pa.Array:
    """Its cells as the file has them; empty where they are None or, if optional, not-a-number."""
    kind = _TYPES[column.kind]
    if not isinstance(values, np.ndarray):
        return pa.array(values, kind, from_pandas=column.optional)
    nothing = np.isnan(values) if column.optional else None
    if column.kind != "float":
        values = np.nan_to_num(values).astype(bool if column.kind == "bool" else np.int64)
    return pa.array(values, kind, mask=nothing)


def _csv(header: str, table: pa.Table) -> bytes:
    sink = io.BytesIO()
    sink.write(f"{_COMMENT}{header}\n".encode())
    pyarrow.csv.write_csv(table, sink)
    return sink.getvalue()


def _read_csv(path: Path) -> tuple[str, pa.Table]:
    content = path.read_bytes()
    first, _, rest = content.partition(b"\n")
    text = first.decode("utf-8")
    if not text.startswith(_COMMENT):
        raise ValueError("its first line is no comment with meta data")
    # Nothing is guessed but what is a number and what is not: the caller knows the kinds.
    options = pyarrow.csv.ConvertOptions(null_values=[""], strings_can_be_null=False)
    table = pyarrow.csv.read_csv(io.BytesIO(rest), convert_options=options)
    return text.removeprefix(_COMMENT).rstrip("\r"), table


def _parquet(header: str, table: pa.Table) -> bytes:
    sink = pa.BufferOutputStream()
    table = table.replace_schema_metadata({_KEY: header.encode()})
    pq.write_table(table, sink, compression="zstd", write_page_checksum=True)
    return sink.getvalue().to_pybytes()


def _read_parquet(path: Path) -> tuple[str, pa.Table]:
    with pq.ParquetFile(path, page_checksum_verification=True) as file:
        table = file.read()
    metadata = table.schema.metadata or {}
    return metadata.get(_KEY, b"").decode("utf-8"), table
