"""The file of a trace: CSV with a leading comment, or Parquet with schema metadata."""

import io
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.csv
import pyarrow.parquet as pq
from pydantic import Field, ValidationError
from typing_extensions import Self

from app.errors import DbbError, LogError, did_you_mean
from app.simulation.trace.columns import NAN, Column, TraceMeta
from app.simulation.trace.snapshot import QUANTITIES, Snapshot
from app.simulation.trace.trace import Layout, Trace, cells_of, columns_of
from app.strict import Strict, explain, text_of
from app.system import write_whole

SUFFIXES = ".csv", ".parquet"  # the ending of a file's name says which of the two it is

_KEY = b"dbb_log"
_COMMENT = "# "
_MOST_CELLS = 200_000_000  # [-] of a log; ten minutes have as many
_TYPES = {"float": pa.float64(), "int": pa.int64(), "bool": pa.bool_(), "text": pa.string()}


class LogHeader(Strict):
    """What the first line of a file says of the rest."""

    dbb_log: TraceMeta
    rows: int = Field(ge=1, strict=True)

    @classmethod
    def read(cls, text: str) -> Self:
        """A header from its JSON.

        Raises:
            LogError: It is no header, or one of another format.
        """
        try:
            return cls.model_validate_json(text)
        except ValidationError as error:
            problems = [(p["type"], p["loc"]) for p in error.errors()]
            if ("missing", ("dbb_log",)) in problems or any(not loc for _, loc in problems):
                told = "it has no meta data of a log: dbb run --log or --out writes logs"
                raise LogError(told) from None
            raise LogError(f"its meta data: {explain(error, cls)}") from None


def write_trace(path: Path, trace: Trace) -> None:
    """Write a trace as CSV or Parquet, by the ending of the file's name, whole or not at all.

    Raises:
        LogError: Its ending is neither.
        OutputError: It cannot be written there.
    """
    _check_suffix(path)
    rows, columns = len(trace), columns_of(trace.meta)
    cells: dict[Column, Any] = {column: [None] * rows for column in columns}
    cells |= zip(trace.columns, trace.table.T, strict=True)
    places = np.searchsorted(trace.t, [s.t for s in trace.snapshots])
    for k, snapshot in zip(places.tolist(), trace.snapshots, strict=True):
        for column, cell in zip(columns, cells_of(snapshot, trace.meta), strict=True):
            if not column.often:
                cells[column][k] = cell
    header = LogHeader(dbb_log=trace.meta, rows=rows).model_dump_json()
    table = pa.table({column.name: _array(column, values) for column, values in cells.items()})
    write_arrow(path, table, header)


def read_trace(path: Path) -> Trace:
    """Read the file of a trace; nothing in it is believed unseen.

    Raises:
        LogError: There is none, it is damaged, or its columns are not those of a trace.
    """
    _check_suffix(path)
    try:
        text, table = _read_csv(path) if path.suffix == ".csv" else _read_parquet(path)
    except FileNotFoundError:
        raise LogError(f"{path}: no such file") from None
    except (pa.ArrowException, OSError, ValueError) as error:
        reason = str(error).strip().splitlines()[0][:200] if str(error).strip() else "unreadable"
        raise LogError(f"{path}: not a log, or damaged: {reason}") from None
    try:
        return _trace(text, table)
    except (LogError, UnicodeDecodeError) as error:  # the latter of a column's name
        raise LogError(f"{path}: {error}") from None


def _trace(text: str, found: pa.Table) -> Trace:
    """The trace of a file's header and table.

    Raises:
        LogError: They do not belong together, or are no trace's.
    """
    header = LogHeader.read(text)
    meta, rows = header.dbb_log, header.rows
    known = columns_of(meta)
    _check_names(found.column_names, known)
    modes = _cells(Column("mode", "text"), found["mode"])
    drawn = [k for k, mode in enumerate(modes) if mode]
    if len(modes) != rows:
        raise LogError(f"it has {len(modes)} rows, and its meta data say {rows}")
    if not drawn:
        raise LogError("no row of it can be drawn: the column mode is empty")
    cells = {c: _cells(c, found[c.name], None if c.often else len(drawn)) for c in known}
    layout = Layout.of(meta)
    _check_times(cells[layout.columns[0]])
    table = np.column_stack([np.asarray(cells[c], dtype=float) for c in layout.columns])
    return Trace(layout, table, _snapshots(meta, cells, drawn))


def _snapshots(
    meta: TraceMeta, cells: Mapping[Column, Sequence[Any]], drawn: Sequence[int]
) -> list[Snapshot]:
    fields: dict[str, list[Any]] = {}
    for name, quantity in QUANTITIES.items():
        columns = quantity.columns(meta)
        rows = zip(*([cells[column][k] for k in drawn] for column in columns), strict=True)
        try:
            fields[name] = [quantity.value(row, meta) for row in rows]
        except (DbbError, ValueError, TypeError, KeyError, AttributeError) as error:
            names = ", ".join(column.name for column in columns[:3])
            raise LogError(f"columns {names}: {error}") from None
    by_row = zip(*fields.values(), strict=True)
    return [Snapshot(**dict(zip(fields, row, strict=True))) for row in by_row]


def _cells(column: Column, values: Any, filled: int | None = None) -> list[Any]:
    """The cells of a column of a file, checked; `filled` of them have something in them, or all.

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
    nothing = "" if column.kind == "text" else NAN
    return [nothing if cell is None else cell for cell in cells]


def _check_suffix(path: Path) -> None:
    if path.suffix not in SUFFIXES:
        raise LogError(f"{path}: a log ends in {' or '.join(SUFFIXES)}")


def _check_names(found: Sequence[str], known: Sequence[Column]) -> None:
    if twice := sorted({name for name in found if found.count(name) > 1}):
        raise LogError(f"column {twice[0]!r} is there twice")
    wanted = [column.name for column in known]
    if len(set(wanted)) < len(wanted):
        raise LogError("its meta data name a pair, a joint or an axis twice")
    for name in found:
        if name not in wanted:
            raise LogError(f"unknown column {name!r}{did_you_mean(name, wanted)}")
    missing = [c.name for c in known if c.name not in found]
    if missing:
        more = f" and {len(missing) - 1} more" if len(missing) > 1 else ""
        raise LogError(f"column {missing[0]!r} is missing{more}")


def _check_times(times: Sequence[float]) -> None:
    gaps = np.diff(times)
    if not (gaps > 0.0).all():
        k = int(np.argmin(gaps > 0.0))
        raise LogError(f"its times are not in order: {times[k + 1]:g} s follows {times[k]:g} s")


def _array(column: Column, values: Sequence[Any] | np.ndarray) -> pa.Array:
    """Its cells as the file has them; empty where they are None or, if optional, not-a-number."""
    kind = _TYPES[column.kind]
    if not isinstance(values, np.ndarray):
        return pa.array(values, kind, from_pandas=column.optional)
    nothing = np.isnan(values) if column.optional else None
    if column.kind != "float":
        values = np.nan_to_num(values).astype(bool if column.kind == "bool" else np.int64)
    return pa.array(values, kind, mask=nothing)


def write_arrow(path: Path, table: pa.Table, header: str = "") -> None:
    """Write columns whole or not at all, as CSV or Parquet by the file's ending.

    The header is a comment on the first line, or metadata. The same columns give the same bytes.
    """
    sink = io.BytesIO()
    if path.suffix == ".csv":
        sink.write(f"{_COMMENT}{header}\n".encode() if header else b"")
        pyarrow.csv.write_csv(table, sink)
    else:
        table = table.replace_schema_metadata({_KEY: header.encode()} if header else None)
        pq.write_table(table, sink, compression="zstd", write_page_checksum=True)
    write_whole(path, sink.getvalue())


def _read_csv(path: Path) -> tuple[str, pa.Table]:
    first, _, rest = text_of(path.read_bytes()).partition("\n")
    if not first.startswith(_COMMENT):
        changed = ", as spreadsheets leave it: keep the file that was written, or use .parquet"
        raise ValueError(f"its first line is no comment with meta data{changed * ('# ' in first)}")
    names, _, rows = rest.partition("\n")
    comma = ";" in names  # as spreadsheets of many countries write it, with decimal commas
    point = "," if comma and re.search(r"\d,\d", rows[:10_000]) else "."
    # Nothing is guessed but what is a number and what is not: the caller knows the kinds.
    options = pyarrow.csv.ConvertOptions(
        null_values=[""], strings_can_be_null=False, decimal_point=point
    )
    cells = pyarrow.csv.ParseOptions(delimiter=";" if comma else ",")
    content = io.BytesIO(rest.encode())
    table = pyarrow.csv.read_csv(content, convert_options=options, parse_options=cells)
    return first.removeprefix(_COMMENT).rstrip(",;"), table


def _read_parquet(path: Path) -> tuple[str, pa.Table]:
    with pq.ParquetFile(path, page_checksum_verification=True) as file:
        rows, columns = file.metadata.num_rows, file.metadata.num_columns
        if rows * columns > _MOST_CELLS:  # a small file may say so of one number
            raise ValueError(f"{rows:,} rows of {columns:,} columns, more than any log has")
        table = file.read()
    metadata = table.schema.metadata or {}
    return metadata.get(_KEY, b"").decode("utf-8"), table
