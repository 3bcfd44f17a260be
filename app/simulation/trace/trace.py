"""The trace of a run: every quantity over time, in memory, in a file, and as snapshots."""

from __future__ import annotations

import math
from array import array
from collections import deque
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from typing_extensions import Self

from app.control.buffer_watch import BufferReading
from app.errors import DbbError, LogError, did_you_mean
from app.robot.model import RobotModel
from app.simulation.scenarios.leading import Scenario
from app.simulation.session import DT, Session, Step
from app.simulation.trace.columns import NAN, Column, LogHeader, Take, TraceMeta
from app.simulation.trace.snapshot import EVERY, QUANTITIES, Snapshot, make_snapshot
from app.simulation.trace.stuck import find_stuck

Array = np.ndarray

SNAPSHOTS_KEPT = 3000
"""60 s at 50 Hz."""


class Layout(NamedTuple):
    """Where each quantity stands in a trace's table.

    Attributes:
        meta: About the run.
        columns: Of the table, in order: those that have a number at each control step.
        slices: By quantity; one number for those that have one column.
        index: By the columns' names.
    """

    meta: TraceMeta
    columns: tuple[Column, ...]
    slices: dict[str, slice | int]
    index: dict[str, int]

    @classmethod
    def of(cls, meta: TraceMeta, names: Iterable[str] = QUANTITIES) -> Self:
        """The layout for some quantities."""
        columns: list[Column] = []
        slices: dict[str, slice | int] = {}
        for name in names:
            begin = len(columns)
            whole = QUANTITIES[name].columns(meta)
            columns += (column for column in whole if column.often)
            slices[name] = begin if QUANTITIES[name].single else slice(begin, len(columns))
        index = {column.name: i for i, column in enumerate(columns)}
        return cls(meta, tuple(columns), slices, index)


class Trace:
    """A run over time.

    Attributes:
        meta: About the run as a whole.
        table: (N, C) what is kept at each row, in order of time.
        snapshots: What was drawn: of some rows or of all.
    """

    def __init__(self, layout: Layout, table: Array, snapshots: Sequence[Snapshot] = ()) -> None:
        """Put together what a `Recorder` has taken, or what was read."""
        self.meta, self.table, self.snapshots = layout.meta, table, tuple(snapshots)
        self._layout = layout

    @classmethod
    def of_snapshots(cls, model: RobotModel, snapshots: Sequence[Snapshot], **about: Any) -> Self:
        """A trace with the rows of these snapshots.

        Raises:
            LogError: There is none, one is not later than the one before, or has other pairs.
        """
        if not snapshots:
            raise LogError("a log of no snapshots")
        first = snapshots[0]
        pairs = {pair.name: pair.mobile for pair in first.pairs}
        layout = Layout.of(TraceMeta.of(model, pairs, first.config, **about))
        columns = _columns(layout.meta)
        rows, last = [], -math.inf
        for s in snapshots:
            if not s.t > last:
                raise LogError(f"a snapshot at {s.t:g} s follows one at {last:g} s")
            if tuple(pair.name for pair in s.pairs) != layout.meta.pairs:
                raise LogError(f"at {s.t:g} s the link pairs are not those of the log")
            last = s.t
            cells = zip(columns, _cells_of(s, layout.meta), strict=True)
            rows.append([float(cell) for column, cell in cells if column.often])
        return cls(layout, np.array(rows), snapshots)

    def __len__(self) -> int:
        """How many rows it has."""
        return len(self.table)

    def __getitem__(self, column: str) -> Array:
        """(N,) a column of the table by its name, such as `d_lm-lEE_m`."""
        return self.table[:, self._layout.index[column]]

    def of(self, quantity: str) -> Array:
        """(N,) or (N, k) a quantity of the table by its name, a field of `Snapshot`."""
        return self.table[:, self._layout.slices[quantity]]

    def names(self, quantity: str) -> list[str]:
        """Names of the columns of a quantity of the table that has several."""
        place = self._layout.slices[quantity]
        assert isinstance(place, slice)
        return [column.name for column in self._layout.columns[place]]

    @property
    def columns(self) -> tuple[Column, ...]:
        """Of the table, in order."""
        return self._layout.columns

    @property
    def t(self) -> Array:
        """(N,) [s] times of the rows."""
        return self.of("t")

    @property
    def distances(self) -> Array:
        """(N, P) [m] signed distances of the pairs."""
        return self.of("pairs")[:, : len(self.meta.pairs)]

    @property
    def betas(self) -> Array:
        """(N, P) [-] activations of the pairs."""
        return self.of("pairs")[:, len(self.meta.pairs) :]

    @property
    def buffer(self) -> BufferReading:
        """Whether d_b was enough, at the last row."""
        return BufferReading(*self.of("buffer")[-1].tolist())

    @property
    def angular(self) -> Array:
        """(n_b,) which axes of the base turn it."""
        return np.array([name.endswith("_radps") for name in self.meta.velocities])

    @property
    def finite(self) -> bool:
        """Whether all torques and poses of the base are numbers."""
        return bool(np.isfinite(self.of("u_a")).all() and np.isfinite(self.of("base_pose")).all())

    @property
    def each_step(self) -> bool:
        """Whether it has a row for each control step."""
        return bool((np.diff(self.t) < 1.5 * DT).all())

    def row_at(self, t: float) -> int:
        """Number of the row nearest to a time [s]."""
        return int(np.abs(self.t - t).argmin())

    def at(self, t: float) -> Snapshot:
        """What is drawn at a time [s]: the snapshot nearest to it."""
        return min(self.snapshots, key=lambda snapshot: abs(snapshot.t - t))

    def rows(self, which: slice | Array) -> Trace:
        """Some rows of the table, without snapshots."""
        return Trace(self._layout, self.table[which])

    def write(self, path: Path) -> None:
        """Write it as CSV or Parquet, by the ending of its name, whole or not at all.

        Raises:
            LogError: Its ending is neither.
            OutputError: It cannot be written there.
        """
        from app.simulation.trace.log_file import write_cells  # pyarrow takes long to import

        rows, columns = len(self.table), _columns(self.meta)
        cells: dict[Column, Any] = {column: [None] * rows for column in columns}
        cells |= zip(self._layout.columns, self.table.T, strict=True)
        places = np.searchsorted(self.t, [s.t for s in self.snapshots])
        for k, snapshot in zip(places.tolist(), self.snapshots, strict=True):
            for column, cell in zip(columns, _cells_of(snapshot, self.meta), strict=True):
                if not column.often:
                    cells[column][k] = cell
        write_cells(path, LogHeader(dbb_log=self.meta, rows=rows).model_dump_json(), cells)


def read_trace(path: Path) -> Trace:
    """Read the file of a trace; nothing in it is believed unseen.

    Raises:
        LogError: There is none, it is damaged, or its columns are not those of a trace.
    """
    from app.simulation.trace.log_file import column_of, read_table  # pyarrow takes long to import

    text, found = read_table(path)
    try:
        header = LogHeader.read(text)
        meta, rows = header.dbb_log, header.rows
        known = _columns(meta)
        _check_names(found, known, meta.format)
        modes = column_of(Column("mode", "text"), found["mode"])
        drawn = [k for k, mode in enumerate(modes) if mode]
        if len(modes) != rows:
            raise LogError(f"it has {len(modes)} rows, and its meta data say {rows}")
        if not drawn:
            raise LogError("no row of it can be drawn: the column mode is empty")
        cells = {
            c: column_of(c, found[c.name], None if c.often else len(drawn))
            if c.name in found
            else [NAN if c.kind == "float" else 0] * rows
            for c in known
        }
        layout = Layout.of(meta)
        _check_times(cells[layout.columns[0]])
        table = np.column_stack([np.asarray(cells[c], dtype=float) for c in layout.columns])
        return Trace(layout, table, _snapshots(meta, cells, drawn))
    except LogError as error:
        raise LogError(f"{path}: {error}") from None


class Recorder:
    """Takes every control step of a run."""

    def __init__(
        self,
        scenario: Scenario | None = None,
        *,
        quantities: Iterable[str] = QUANTITIES,
        drawn: bool = False,
        also: Iterable[int] = (),
    ) -> None:
        """Nothing is recorded.

        Args:
            scenario: Which leads the hand from the first step to the last.
            quantities: What is recorded, by the fields of `Snapshot`.
            drawn: Whether a snapshot of each twentieth step is kept too, the first among them.
            also: Numbers of further control steps of which a snapshot is wanted.
        """
        self._scenario, self._drawn, self._also = scenario, drawn, frozenset(also)
        self._names = list(quantities)
        self._rows: list[Take] = []
        self._layout: Layout | None = None
        self._cells = array("d")  # a fifth of a list's memory, and nothing for the collector
        self._last: tuple[Session, Step] | None = None
        self.snapshots: list[Snapshot] = []

    def add(self, session: Session, step: Step) -> None:
        """Take one control step, and the session after it."""
        if self._layout is None:
            self._begin(session, step)
        self._last = session, step
        cells: list[float] = []
        for row in self._rows:
            cells += row(session, step)
        self._cells.extend(cells)
        if self._drawn:
            self._draw(session, step)

    def trace(self) -> Trace:
        """What has been recorded; its table is the recorder's own memory, so nothing is added."""
        assert self._layout is not None, "no step was recorded"
        assert self._last is not None
        session, step = self._last
        stuck = find_stuck(session.model, step)
        meta = self._layout.meta.model_copy(update={"stuck": stuck and stuck._asdict()})
        table = np.frombuffer(self._cells).reshape(-1, len(self._layout.columns))
        return Trace(self._layout._replace(meta=meta), table, self.snapshots)

    def taken(self) -> Trace:
        """What has been recorded since the last call, and the row before it."""
        assert self._layout is not None, "no step was recorded"
        wide = len(self._layout.columns)
        table = np.array(self._cells).reshape(-1, wide)
        del self._cells[:-wide]
        return Trace(self._layout, table)

    def __len__(self) -> int:
        """How many rows there are."""
        return len(self._cells) // len(self._layout.columns) if self._layout else 0

    def _begin(self, session: Session, step: Step) -> None:
        base = session.model.body_names[0]
        closest = [state.closest.pair for state in step.output.avoidance.pairs]
        pairs = {pair.name: pair.a == base for pair in closest}
        meta = TraceMeta.of(
            session.model,
            pairs,
            session.config,
            scenario=self._scenario.name if self._scenario else "",
            physics=session.kind,
            seed=session.seed,
        )
        self._layout = Layout.of(meta, self._names)
        self._rows = [QUANTITIES[name].row_of(meta) for name in self._names]

    def _draw(self, session: Session, step: Step) -> None:
        k = round(step.t / DT)
        if k % EVERY and k not in self._also:
            return
        course: dict[str, Any] = {"explained": not self._rows}  # pictures alone say why
        if self._scenario is not None:
            course |= {"scenario": self._scenario.name, "scenario_ends": self._scenario.duration}
        self.snapshots.append(make_snapshot(session, step, None, paused=False, **course))


class History:
    """A bounded record in order of time; when time goes back, it begins anew."""

    def __init__(self, kept: int = SNAPSHOTS_KEPT) -> None:
        """Empty; the newest snapshots stay, so many of them."""
        self._kept: deque[Snapshot] = deque(maxlen=kept)
        self._latest: Snapshot | None = None

    @property
    def latest(self) -> Snapshot:
        """The newest snapshot; there must be one."""
        assert self._latest is not None, "start the loop first"
        return self._latest

    def add(self, snapshot: Snapshot) -> None:
        """Append a snapshot; one of the same time as the newest takes its place."""
        newest = self._latest
        if newest is not None and snapshot.t < newest.t:
            self._kept.clear()
        elif newest is not None and snapshot.t == newest.t:
            self._kept.pop()
        self._kept.append(snapshot)
        self._latest = snapshot

    def after(self, t: float) -> list[Snapshot]:
        """Snapshots later than `t` [s], oldest first."""
        found = []
        for snapshot in reversed(tuple(self._kept)):
            if snapshot.t <= t:
                break
            found.append(snapshot)
        return found[::-1]


def _columns(meta: TraceMeta) -> list[Column]:
    """All columns of a file, in order."""
    return [column for quantity in QUANTITIES.values() for column in quantity.columns(meta)]


def _cells_of(snapshot: Snapshot, meta: TraceMeta) -> list[Any]:
    """All cells of a snapshot, in the columns' order."""
    return [x for name, q in QUANTITIES.items() for x in q.cells(getattr(snapshot, name), meta)]


def _snapshots(
    meta: TraceMeta, cells: Mapping[Column, Sequence[Any]], drawn: Sequence[int]
) -> list[Snapshot]:
    """The snapshots in these rows of a file."""
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


def _check_names(found: Iterable[str], known: Sequence[Column], since: int) -> None:
    given, wanted = set(found), [column.name for column in known]
    if len(set(wanted)) < len(wanted):
        raise LogError("its meta data name a pair, a joint or an axis twice")
    for name in found:
        if name not in wanted:
            raise LogError(f"unknown column {name!r}{did_you_mean(name, wanted)}")
    missing = [c.name for c in known if c.name not in given and c.since <= since]
    if missing:
        more = f" and {len(missing) - 1} more" if len(missing) > 1 else ""
        raise LogError(f"column {missing[0]!r} is missing{more}")


def _check_times(times: Sequence[float]) -> None:
    gaps = np.diff(times)
    if not (gaps > 0.0).all():
        k = int(np.argmin(gaps > 0.0))
        raise LogError(f"its times are not in order: {times[k + 1]:g} s follows {times[k]:g} s")
