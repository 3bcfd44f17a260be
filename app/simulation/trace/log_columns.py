"""The columns of a log: how each field of a snapshot is split into them and joined again.

A new field of `Snapshot` gets a line in `parts`, or a place in `NOT_LOGGED` if no drawing of the
scene needs it.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import asdict
from functools import lru_cache
from typing import Any, Literal, NamedTuple, get_type_hints

import numpy as np
from pydantic import TypeAdapter

from app.config import Config, make_config
from app.control.buffer_watch import BufferReading
from app.simulation.people import PullReading
from app.simulation.plants.door import Door
from app.simulation.trace.comparison import GhostReading, Score
from app.simulation.trace.log_meta import LogMeta
from app.simulation.trace.snapshot import ActingReading, DoorView, PairReading

Array = np.ndarray
Kind = Literal["float", "int", "bool", "text"]
Cell = float | int | bool | str

NOT_LOGGED = frozenset({"busy", "refusal", "explanation"})
"""Fields of a snapshot that are about the moment; what is read from a log has their defaults."""

_XYZ = "xyz"
_DOOR = TypeAdapter(Door)
_EFFORT = {"rad": "nm", "m": "n"}  # unit of what moves a joint, by that of its position


class Column(NamedTuple):
    """One column.

    Attributes:
        name: Ends in its unit.
        kind: What its cells are.
        optional: Whether a cell may be empty, which is not-a-number in memory.
    """

    name: str
    kind: Kind = "float"
    optional: bool = False


class Part(NamedTuple):
    """The columns of one field of a snapshot.

    Attributes:
        field: Of `Snapshot`.
        columns: In the order of the cells.
        split: From the field's value to its cells.
        join: Back.
    """

    field: str
    columns: tuple[Column, ...]
    split: Callable[[Any], Sequence[Cell]]
    join: Callable[[Sequence[Any]], Any]


def parts(meta: LogMeta) -> tuple[Part, ...]:
    """All columns of the logs of a run."""
    joints = list(zip(meta.joints, meta.joint_units, strict=True))
    return (
        _one("t", "t_s"),
        _vector("base_pose", "base_x_m", "base_y_m", "base_yaw_rad"),
        _vector("base_velocity", *(f"base_{name}" for name in meta.velocities)),
        _vector("base_velocity_command", *(f"command_{name}" for name in meta.velocities)),
        _vector("base_acceleration", *(f"base_{name}" for name in meta.accelerations)),
        _vector("avoidance_acceleration", *(f"avoidance_{name}" for name in meta.accelerations)),
        _vector("wheel_angles", *(f"wheel_{name}_rad" for name in meta.wheels)),
        _vector("q_m", *(f"q_{name}_{unit}" for name, unit in joints)),
        _vector("u_a", *(f"u_{name}_{_EFFORT[unit]}" for name, unit in joints)),
        _vector("p_ee", *_point("p_ee", "m")),
        _vector("wxyz_ee", *(f"q_ee_{axis}" for axis in "wxyz")),
        _pairs(meta),
        _acting(meta),
        _one("beta_m", "beta_m"),
        _vector("hand_target", *_point("hand_target", "m"), optional=True),
        _vector("hand_force", *_point("hand_force", "n")),
        _one("ee_error", "ee_error_m"),
        _one("in_contact", "contact", "bool"),
        _one("arm_in_contact", "arm_contact", "bool"),
        _one("solver_failures", "solver_failures", "int"),
        _one("step_time_us", "step_time_us"),
        _one("realtime_factor", "realtime_factor"),
        _one("overruns", "overruns", "int"),
        _one("paused", "paused", "bool"),
        _one("mode", "mode", "text"),
        _one("controller", "controller", "text"),
        _config(meta.config),
        _buffer(),
        _one("scenario", "scenario", "text"),
        _maybe("scenario_ends", "scenario_ends_s"),
        _door(),
        _one("speed", "speed"),
        _records("pulls", PullReading),
        _records("ghosts", GhostReading),
        _records("scores", Score),
        _one("same", "ghosts_have_the_same", "text"),
    )


def frozen(values: Any) -> Array:
    """A float array that refuses to be changed."""
    array = np.array(values, dtype=float)
    array.flags.writeable = False
    return array


def _one(field: str, name: str, kind: Kind = "float") -> Part:
    return Part(field, (Column(name, kind),), lambda value: (value,), lambda cells: cells[0])


def _maybe(field: str, name: str) -> Part:
    """A number that may be None, and its cell is then empty."""
    return Part(
        field,
        (Column(name, "float", optional=True),),
        lambda value: (np.nan if value is None else value,),
        lambda cells: None if np.isnan(cells[0]) else cells[0],
    )


def _vector(field: str, *names: str, optional: bool = False) -> Part:
    """An array; an optional one may be None, and its cells are then empty."""
    nothing = (np.nan,) * len(names)

    def split(value: Array | None) -> Sequence[Cell]:
        return nothing if value is None else value.tolist()

    def join(cells: Sequence[float]) -> Array | None:
        return None if optional and np.isnan(cells).all() else frozen(cells)

    return Part(field, tuple(Column(name, "float", optional) for name in names), split, join)


def _point(name: str, unit: str) -> tuple[str, ...]:
    return tuple(f"{name}_{axis}_{unit}" for axis in _XYZ)


def _pairs(meta: LogMeta) -> Part:
    """d, β, p_a and p_b of each pair."""
    columns = [
        Column(name)
        for pair in meta.pairs
        for name in (
            f"d_{pair}_m",
            f"beta_{pair}",
            *_point(f"p_a_{pair}", "m"),
            *_point(f"p_b_{pair}", "m"),
        )
    ]

    def split(pairs: Sequence[PairReading]) -> Sequence[Cell]:
        return [x for pair in pairs for x in (pair.d, pair.beta, *pair.p_a, *pair.p_b)]

    def join(cells: Sequence[float]) -> tuple[PairReading, ...]:
        groups = zip(meta.pairs, np.reshape(cells, (-1, 8)), strict=True)
        return tuple(
            PairReading(
                name,
                name in meta.mobile_pairs,
                float(row[0]),
                float(row[1]),
                frozen(row[2:5]),
                frozen(row[5:8]),
            )
            for name, row in groups
        )

    return Part("pairs", tuple(columns), split, join)


def _acting(meta: LogMeta) -> Part:
    """p_n, p_t, p_act and f of each pair of L_m; empty while the pair has none."""
    columns = [
        Column(name, "float", optional=True)
        for pair in meta.mobile_pairs
        for point, unit in (("p_n", "m"), ("p_t", "m"), ("p_act", "m"), ("f", "n"))
        for name in _point(f"{point}_{pair}", unit)
    ]
    nothing = np.full(12, np.nan)

    def split(acting: Sequence[ActingReading]) -> Sequence[Cell]:
        rows = {r.name: np.concatenate([r.p_n, r.p_t, r.p_act, r.f]) for r in acting}
        return [x for pair in meta.mobile_pairs for x in rows.get(pair, nothing).tolist()]

    def join(cells: Sequence[float]) -> tuple[ActingReading, ...]:
        groups = zip(meta.mobile_pairs, np.reshape(cells, (-1, 4, 3)), strict=True)
        return tuple(
            ActingReading(name, *(frozen(point) for point in points))
            for name, points in groups
            if not np.isnan(points).all()
        )

    return Part("acting", tuple(columns), split, join)


def _config(first: Config) -> Part:
    """What a row's parameters have that those of the first row have not, as JSON."""

    @lru_cache(maxsize=64)
    def changes(config: Config) -> str:
        known, now = first.model_dump(mode="json"), config.model_dump(mode="json")
        changed = {
            f"{section}.{name}": value
            for section, values in now.items()
            for name, value in values.items()
            if value != known[section][name]
        }
        return json.dumps(changed) if changed else ""

    @lru_cache(maxsize=64)
    def changed(text: str) -> Config:
        data = first.model_dump()
        for path, value in json.loads(text or "{}").items():
            section, _, name = path.partition(".")
            data[section][name] = value
        return make_config(data) if text else first

    column = Column("config_changes", "text")
    return Part("config", (column,), lambda c: (changes(c),), lambda cells: changed(cells[0]))


def _buffer() -> Part:
    columns = (
        Column("approach_speed_mps"),
        Column("buffer_needed_m"),
        Column("approach_speed_max_mps"),
        Column("buffer_needed_max_m"),
        Column("buffer_too_small", "bool"),
        Column("buffer_too_small_ever", "bool"),
    )
    return Part("buffer", columns, tuple, lambda cells: BufferReading(*cells))


def _door() -> Part:
    """The door's geometry as JSON, empty without one, its angle and the force on it."""
    nothing = ("", np.nan, np.nan, np.nan, np.nan)
    columns = (
        Column("door", "text"),
        Column("door_angle_rad", "float", optional=True),
        *(Column(name, "float", optional=True) for name in _point("door_force", "n")),
    )

    @lru_cache(maxsize=64)
    def text(door: Door) -> str:
        return json.dumps(asdict(door))

    @lru_cache(maxsize=64)
    def door(text: str) -> Door:
        return _DOOR.validate_json(text)

    def split(view: DoorView | None) -> Sequence[Cell]:
        return nothing if view is None else (text(view.door), view.angle, *view.force.tolist())

    def join(cells: Sequence[Any]) -> DoorView | None:
        return DoorView(door(cells[0]), cells[1], frozen(cells[2:])) if cells[0] else None

    return Part("door", columns, split, join)


def _records(field: str, kind: type[Any]) -> Part:
    """A tuple of named tuples as JSON, empty if there are none; for what is seldom there."""
    hints = get_type_hints(kind)

    def value(name: str, data: Any) -> Any:
        return frozen(data) if hints[name] is np.ndarray else data

    def split(records: Sequence[Any]) -> Sequence[Cell]:
        rows = [
            {k: v.tolist() if isinstance(v, np.ndarray) else v for k, v in r._asdict().items()}
            for r in records
        ]
        return (json.dumps(rows) if rows else "",)

    def join(cells: Sequence[str]) -> tuple[Any, ...]:
        rows = json.loads(cells[0] or "[]")
        return tuple(kind(**{k: value(k, v) for k, v in row.items()}) for row in rows)

    return Part(field, (Column(f"{field}_json", "text"),), split, join)
