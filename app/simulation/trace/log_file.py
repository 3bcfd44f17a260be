"""The two files that a log can be: CSV with a leading comment, and Parquet with schema metadata."""

from __future__ import annotations

import io
import os
from array import array
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.csv
import pyarrow.parquet as pq

from app.errors import LogError, OutputError
from app.simulation.trace.log_columns import Column

SUFFIXES = ".csv", ".parquet"
"""The ending of a file's name says which of the two it is."""

Cells = Sequence[Any] | np.ndarray | array
_KEY = b"dbb_log"
_COMMENT = "# "
_TYPES = {"float": pa.float64(), "int": pa.int64(), "bool": pa.bool_(), "text": pa.string()}


def check_suffix(path: Path) -> None:
    """Refuse a name that says of neither format.

    Raises:
        LogError: Lists the formats.
    """
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
    beside = path.with_name(path.name + ".new")
    try:
        try:
            beside.write_bytes(content)
            os.replace(beside, path)
        finally:
            beside.unlink(missing_ok=True)
    except OSError as error:
        raise OutputError(f"cannot write {path}: {error.strerror}") from None


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


def cells_of(column: Column, values: Any) -> list[Any]:
    """The cells of a column that `read_table` gave, checked.

    Raises:
        LogError: They are of another kind, or one is empty that may not be.
    """
    kind = _TYPES[column.kind]
    if not column.optional and column.kind != "text" and values.null_count:
        raise LogError(f"column {column.name}: {values.null_count} cells are empty")
    try:
        cells = values.cast(kind).to_pylist()
    except pa.ArrowException as error:
        raise LogError(f"column {column.name}: {str(error).splitlines()[0]}") from None
    empty = {"float": float("nan"), "text": ""}.get(column.kind)
    return [empty if cell is None else cell for cell in cells]


def _array(column: Column, values: Cells) -> pa.Array:
    if isinstance(values, array):
        values = np.array(values, bool if column.kind == "bool" else None)
    return pa.array(values, _TYPES[column.kind], from_pandas=column.optional)


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
