"""Logs: one row a published snapshot, and enough in it to draw the whole simulation again."""

from __future__ import annotations

import math
from array import array
from collections.abc import Iterable, Mapping
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple

from app.errors import DbbError, LogError, did_you_mean
from app.simulation.trace.log_columns import Column, Part, parts
from app.simulation.trace.log_file import cells_of, read_table, write_cells
from app.simulation.trace.log_meta import LogMeta, header_text, read_header
from app.simulation.trace.snapshot import Snapshot

_CODES = {"float": "d", "int": "q", "bool": "b"}  # of Python's arrays, a fifth of a list's memory


class Log(NamedTuple):
    """A log that has been read.

    Attributes:
        meta: About the run as a whole.
        snapshots: In order of time, at least one.
    """

    meta: LogMeta
    snapshots: tuple[Snapshot, ...]


class LogTable:
    """Snapshots as rows, taken one by one."""

    def __init__(self, meta: LogMeta) -> None:
        """An empty table.

        Args:
            meta: About the run; its pairs are those of all snapshots.
        """
        self._meta, self._parts = meta, parts(meta)
        self._cells: dict[Column, Any] = {
            column: array(_CODES[column.kind]) if column.kind in _CODES else []
            for part in self._parts
            for column in part.columns
        }
        self._last = -math.inf

    def add(self, snapshot: Snapshot) -> None:
        """Append a snapshot.

        Raises:
            LogError: It is not later than the last one, or has other pairs than the log.
        """
        if not snapshot.t > self._last:
            raise LogError(f"a snapshot at {snapshot.t:g} s follows one at {self._last:g} s")
        if tuple(pair.name for pair in snapshot.pairs) != self._meta.pairs:
            raise LogError(f"at {snapshot.t:g} s the link pairs are not those of the log")
        self._last = snapshot.t
        for part in self._parts:
            cells = part.split(getattr(snapshot, part.field))
            for column, cell in zip(part.columns, cells, strict=True):
                self._cells[column].append(cell)

    def write(self, path: Path) -> None:
        """Write the log as CSV or Parquet, by the ending of its name, whole or not at all.

        Raises:
            LogError: Its ending is neither, or there are no rows.
            OutputError: It cannot be written there.
        """
        rows = len(next(iter(self._cells.values())))
        if not rows:
            raise LogError(f"{path}: a log of no snapshots")
        write_cells(path, header_text(self._meta, rows), self._cells)


def write_log(path: Path, snapshots: Iterable[Snapshot], meta: LogMeta) -> None:
    """Write a log as CSV or Parquet, by the ending of its name.

    Args:
        path: Ends in `.csv` or `.parquet`.
        snapshots: In order of time.
        meta: About the run; `LogMeta.of` makes it.

    Raises:
        LogError: Its ending is neither; the snapshots are none, not in order, or of other pairs.
        OutputError: It cannot be written there.
    """
    table = LogTable(meta)
    for snapshot in snapshots:
        table.add(snapshot)
    table.write(path)


def read_log(path: Path) -> Log:
    """Read a log; nothing in it is believed unseen.

    Raises:
        LogError: There is none, it is damaged, or its columns are not those of a log.
    """
    header, found = read_table(path)
    try:
        meta, rows = read_header(header)
        known = parts(meta)
        _check_names(found, known)
        cells = {c.name: cells_of(c, found[c.name]) for part in known for c in part.columns}
        _check_rows(cells["t_s"], rows)
        snapshots = _snapshots(known, cells)
    except LogError as error:
        raise LogError(f"{path}: {error}") from None
    return Log(meta, snapshots)


def _snapshots(known: tuple[Part, ...], cells: Mapping[str, list[Any]]) -> tuple[Snapshot, ...]:
    fields = {}
    for part in known:
        rows = zip(*(cells[column.name] for column in part.columns), strict=True)
        try:
            fields[part.field] = [part.join(row) for row in rows]
        except (DbbError, ValueError, TypeError, KeyError, AttributeError) as error:
            names = ", ".join(column.name for column in part.columns[:3])
            raise LogError(f"columns {names}: {error}") from None
    rows = zip(*fields.values(), strict=True)
    return tuple(Snapshot(**dict(zip(fields, row, strict=True))) for row in rows)


def _check_names(found: Iterable[str], known: tuple[Part, ...]) -> None:
    given = list(found)
    wanted = [column.name for part in known for column in part.columns]
    unknown = [name for name in given if name not in set(wanted)]
    if unknown:
        raise LogError(f"unknown column {unknown[0]!r}{did_you_mean(unknown[0], wanted)}")
    missing = [name for name in wanted if name not in set(given)]
    if missing:
        more = f" and {len(missing) - 1} more" if len(missing) > 1 else ""
        raise LogError(f"column {missing[0]!r} is missing{more}")


def _check_rows(times: list[float], rows: int) -> None:
    if len(times) != rows:
        raise LogError(f"it has {len(times)} rows, and its meta data say {rows}")
    for before, after in pairwise(times):
        if not after > before:
            raise LogError(f"its times are not in order: {after:g} s follows {before:g} s")
