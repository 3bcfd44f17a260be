"""The file of a trace: CSV with a leading comment, or Parquet with schema metadata."""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import MISSING, fields
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
from pydantic import Field, ValidationError
from typing_extensions import Self

from app.errors import DbbError, LogError, did_you_mean
from app.jobs.bounded import SMALL, Budget
from app.simulation.trace.arrow import read_arrow, write_arrow
from app.simulation.trace.columns import NAN, Column, TraceMeta
from app.simulation.trace.snapshot import QUANTITIES, Snapshot
from app.simulation.trace.trace import Trace, cells_of, columns_of
from app.strict import LARGEST_DATA, Strict, explain, problems_of

SUFFIXES = ".csv", ".parquet"  # the ending of a file's name selects the format

_NEWER = "; if a newer version of this program wrote the log, read it with that version"
_FORMAT = ("dbb_log", "format")  # place of the number of the format in the header
_NO_LOG = "missing", ("dbb_log",)  # problem of a header without a record `dbb_log`
_CELL = 100  # [bytes] memory for a cell of a snapshot
_NUMBER = 8  # [bytes] memory for a number of the table
_TYPES = {"float": pa.float64(), "int": pa.int64(), "bool": pa.bool_(), "text": pa.string()}


class LogHeader(Strict):
    dbb_log: TraceMeta
    rows: int = Field(ge=1, strict=True)

    @classmethod
    def read(cls, text: str) -> Self:
        """Read a header from JSON; a text that is no header of this format raises a LogError."""
        if len(text) > LARGEST_DATA:
            raise LogError("the metadata are too long for a log")
        try:
            return cls.model_validate_json(text)
        except ValidationError as error:
            problems = problems_of(error)
            stated = next((p["input"] for p in problems if p["loc"] == _FORMAT), None)
            if any(not p["loc"] or (p["type"], p["loc"]) == _NO_LOG for p in problems):
                fault = "the file has no metadata of a log: dbb run --log or --out writes logs"
            elif isinstance(stated, int):
                own = TraceMeta.model_fields["format"].default
                age = "an older" if stated < own else "a newer"
                helps = f"{age} version of this program wrote the log: read it with that version"
                fault = f"the format is {stated}, but this version reads {own}; {helps}"
            else:
                unknown = any(p["type"] in ("extra_forbidden", "literal_error") for p in problems)
                fault = f"the metadata: {explain(error, cls)}{_NEWER * unknown}"
            raise LogError(fault) from None


def write_trace(path: Path, trace: Trace) -> None:
    """Write a trace as CSV or Parquet, by the ending of the name, completely or not at all. Another
    ending raises a LogError, a failure to write an OutputError. `read_trace` refuses the file of a
    trace without snapshots.
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
    """Read a trace from an untrusted file; raises a LogError that names the fault."""
    _check_suffix(path)
    text, table = read_arrow(path)
    try:
        return _trace(text, table, Budget.of(path.stat().st_size))
    except (LogError, UnicodeDecodeError) as error:  # UnicodeDecodeError: the name of a column
        raise LogError(f"{path}: {error}") from None


def _trace(text: str, found: pa.Table, budget: Budget) -> Trace:
    """A trace from a file's header `text` and table `found`; a fault raises a LogError."""
    header = LogHeader.read(text)
    meta, rows = header.dbb_log, header.rows
    needed = {each.name for each in fields(Snapshot) if each.default is MISSING}
    names_of = {key: {c.name for c in each.columns(meta)} for key, each in QUANTITIES.items()}
    present = {key for key, names in names_of.items() if not names.isdisjoint(found.column_names)}
    names = [name for name in QUANTITIES if name in needed | present]
    known = [column for name in names for column in QUANTITIES[name].columns(meta)]
    _check_names(found.column_names, known)
    often = [column for column in known if column.often]
    if len(found) != rows:
        raise LogError(f"the file has {len(found)} rows, but its metadata state {rows}")
    if rows * len(often) * _NUMBER > budget.memory:
        raise LogError(f"{rows} rows are too many for a file of this size")
    modes = _cast(Column("mode", "text"), found["mode"], rows)
    drawn = found.filter(pc.not_equal(modes.fill_null(""), ""))
    if not len(drawn):
        raise LogError("the file has no snapshots: the column mode is empty")
    if len(drawn) * len(known) > budget.memory / _CELL:
        raise LogError(f"{len(drawn)} snapshots are too many for a file of this size")
    table = np.empty((rows, len(often)))
    for k, column in enumerate(often):
        table[:, k] = _cast(column, found[column.name], rows).to_numpy()
    gaps, times = np.diff(table[:, 0]), table[:, 0]
    if not np.isfinite(times).all():
        raise LogError("a time is not a finite number")
    if not (gaps > 0.0).all():
        k = int(np.argmin(gaps > 0.0))
        raise LogError(f"the times are not in order: {times[k + 1]:g} s follows {times[k]:g} s")
    cells = {c: _cells(c, found[c.name], drawn[c.name]) for c in known}
    return Trace(meta, table, _snapshots(meta, cells, names), names)


def _snapshots(
    meta: TraceMeta, cells: Mapping[Column, Sequence[Any]], names: Sequence[str]
) -> list[Snapshot]:
    values: dict[str, list[Any]] = {}
    for name in names:
        columns = QUANTITIES[name].columns(meta)
        rows = zip(*(cells[column] for column in columns), strict=True)
        try:
            values[name] = [QUANTITIES[name].value(row, meta) for row in rows]
        except (DbbError, ValueError, TypeError, KeyError, AttributeError) as error:
            names = ", ".join(column.name for column in columns[:3])
            raise LogError(f"columns {names}: {error}") from None
    by_row = zip(*values.values(), strict=True)
    run = {"physics": meta.physics, "seed": meta.seed}
    return [Snapshot(**dict(zip(values, row, strict=True)), **run) for row in by_row]


def _cells(column: Column, values: pa.ChunkedArray, drawn: pa.ChunkedArray) -> list[Any]:
    """The cells of a column in the rows with snapshots; an empty cell becomes NaN or ""."""
    if not column.often:
        _cast(column, values, len(drawn))
    nothing = "" if column.kind == "text" else NAN
    cells = _cast(column, drawn, len(drawn)).to_pylist()
    if column.kind == "text" and max(len(cell or "") for cell in cells) > SMALL:
        raise LogError(f"column {column.name}: a text is too long for a log")
    return [nothing if cell is None else cell for cell in cells]


def _cast(column: Column, values: pa.ChunkedArray, filled: int) -> pa.ChunkedArray:
    """Convert a column to its type; unless optional or text, it must have `filled` values."""
    empty = filled - (len(values) - values.null_count)
    if not column.optional and column.kind != "text" and empty:
        count = f"{filled - empty} cells have a value, but {filled} must have one"
        raise LogError(f"column {column.name}: {count}")
    try:
        return values.cast(_TYPES[column.kind])
    except pa.ArrowException as error:
        raise LogError(f"column {column.name}: {str(error).splitlines()[0]}") from None


def _check_suffix(path: Path) -> None:
    if path.suffix.lower() not in SUFFIXES:
        raise LogError(f"{path}: a log ends in {' or '.join(SUFFIXES)}")


def _check_names(found: Sequence[str], known: Sequence[Column]) -> None:
    if twice := sorted(name for name, count in Counter(found).items() if count > 1):
        raise LogError(f"column {twice[0]!r} appears twice")
    names = [column.name for column in known]
    if len(set(names)) < len(names):
        raise LogError("the metadata name a pair, a joint or an axis twice")
    for name in found:
        if name not in names:
            raise LogError(f"unknown column {name!r}{did_you_mean(name, names)}{_NEWER}")
    if missing := [name for name in names if name not in found]:
        more = f" and {len(missing) - 1} more" if len(missing) > 1 else ""
        raise LogError(f"column {missing[0]!r} is missing{more}")


def _array(column: Column, values: Sequence[Any] | np.ndarray) -> pa.Array:
    """The cells of a column for a file; None, or NaN in an optional column, becomes empty."""
    kind = _TYPES[column.kind]
    if not isinstance(values, np.ndarray):
        return pa.array(values, kind, from_pandas=column.optional)
    nothing = np.isnan(values) if column.optional else None
    if column.kind != "float":
        values = np.nan_to_num(values).astype(bool if column.kind == "bool" else np.int64)
    return pa.array(values, kind, mask=nothing)
