"""Quantities as columns: names that end in their unit, and values as cells and back."""

from __future__ import annotations

import json
from collections import ChainMap
from collections.abc import Callable, Sequence
from functools import lru_cache
from itertools import product
from typing import Any, Literal, NamedTuple, get_type_hints

import numpy as np

from app.config import Config, make_config
from app.simulation.session import Session, Step
from app.simulation.trace.meta import TraceMeta

Array = np.ndarray
Kind = Literal["float", "int", "bool", "text"]
Cell = float | int | bool | str
Take = Callable[[Session, Step], Any]

NAN = float("nan")
_UNITS = {
    "rad": {"position": "rad", "speed": "radps", "effort": "nm"},
    "m": {"position": "m", "speed": "mps", "effort": "n"},
}
"""Of what belongs to a joint, by the unit of its position."""
_CASTS: dict[Kind, Callable[[Any], Any]] = {"float": float, "int": int, "bool": bool, "text": str}


def column_names(template: str, meta: TraceMeta) -> list[str]:
    """The columns of a quantity of a robot, which end in their unit.

    Args:
        template: Such as `p_ee_{xyz}_m`, a column each of x, y and z; `u_{joint}_{effort}`, one a
            joint in N m or N; `base_{velocity}`, one an axis of the base in m/s or rad/s;
            `d_{pair}_m`, one a link pair.
        meta: About the run.
    """
    joints = zip(meta.joints, meta.joint_units, strict=True)
    every: dict[str, list[dict[str, str]]] = {
        "pair": [{"pair": name} for name in meta.pairs],
        "mobile": [{"mobile": name} for name in meta.mobile_pairs],
        "joint": [{"joint": name, **_UNITS[unit]} for name, unit in joints],
        "velocity": [{"velocity": name} for name in meta.velocities],
        "acceleration": [{"acceleration": name} for name in meta.accelerations],
        "pose": [{"pose": name} for name in ("x_m", "y_m", "yaw_rad")],
        "wheel": [{"wheel": name} for name in meta.wheels],
        "wxyz": [{"wxyz": axis} for axis in "wxyz"],
        "xyz": [{"xyz": axis} for axis in "xyz"],
    }
    groups = [group for key, group in every.items() if f"{{{key}}}" in template]
    return [template.format(**dict(ChainMap(*each))) for each in product(*groups)]


class Column(NamedTuple):
    """One column.

    Attributes:
        name: Ends in its unit.
        kind: What its cells are.
        optional: Whether a cell may be empty, which is not-a-number in memory.
        often: Whether it has a number at each control step, not only where a snapshot is taken.
        since: Format of the files that have it first.
    """

    name: str
    kind: Kind = "float"
    optional: bool = False
    often: bool = False
    since: int = 1


class Quantity(NamedTuple):
    """One quantity of a run.

    Attributes:
        columns: Its columns in a run.
        cells: From a snapshot's value to their cells.
        value: Back.
        take: Its value at a control step, from the session after it and the step; None if only who
            publishes the snapshot knows it.
        row: Cells of the columns that have one at each control step.
        single: Whether it is one number, not several.
    """

    columns: Callable[[TraceMeta], Sequence[Column]]
    cells: Callable[[Any, TraceMeta], Sequence[Cell]]
    value: Callable[[Sequence[Any], TraceMeta], Any]
    take: Take | None = None
    row: Take | None = None
    single: bool = False


def number(name: str, kind: Kind, take: Take, *, since: int = 1) -> Quantity:
    """A number that is kept at each control step."""
    column = Column(name, kind, often=True, since=since)
    return _one(column, take, lambda session, step: (take(session, step),))


def numbers(template: str, take: Take, *, since: int = 1) -> Quantity:
    """An array (k,) that is kept at each control step; `template` as `column_names` takes it."""
    row = lambda session, step: take(session, step).tolist()  # noqa: E731
    return _several(template, take, row, optional=since > 1, since=since)


def drawn(name: str, kind: Kind, take: Take | None = None, *, optional: bool = False) -> Quantity:
    """A number or text that is kept where a snapshot is taken; an optional one may be None."""
    return _one(Column(name, kind, optional), take)


def drawn_numbers(template: str, take: Take, *, optional: bool = False) -> Quantity:
    """An array (k,) that is kept where a snapshot is taken; an optional one may be None."""
    return _several(template, take, None, optional=optional)


def _one(column: Column, take: Take | None, row: Take | None = None) -> Quantity:
    def value(cells: Sequence[Any], _: TraceMeta) -> Any:
        return None if column.optional and np.isnan(cells[0]) else _CASTS[column.kind](cells[0])

    def cells(value: Any, _: TraceMeta) -> Sequence[Cell]:
        return (NAN if value is None else value,)

    return Quantity(lambda _: (column,), cells, value, take, row, single=True)


def _several(
    template: str, take: Take, row: Take | None, *, optional: bool, since: int = 1
) -> Quantity:
    def columns(meta: TraceMeta) -> Sequence[Column]:
        often = row is not None
        return [
            Column(name, "float", optional, often, since) for name in column_names(template, meta)
        ]

    def cells(value: Array | None, meta: TraceMeta) -> Sequence[Cell]:
        return [NAN] * len(columns(meta)) if value is None else value.tolist()

    def value(cells: Sequence[float], _: TraceMeta) -> Array | None:
        return None if optional and np.isnan(cells).all() else frozen(cells)

    return Quantity(columns, cells, value, take, row)


def config_changes(take: Take) -> Quantity:
    """What a row's parameters have that those of the first row have not, as JSON."""
    return Quantity(
        lambda _: (Column("config_changes", "text"),),
        lambda config, meta: (_changes(meta.config, config),),
        lambda cells, meta: _changed(meta.config, cells[0]),
        take,
    )


def records(name: str, kind: type[Any], take: Take | None = None) -> Quantity:
    """A tuple of named tuples as JSON, empty if there are none; for what is seldom there."""
    hints = get_type_hints(kind)

    def inner(name: str, data: Any) -> Any:
        return frozen(data) if hints[name] is np.ndarray else data

    def cells(values: Sequence[Any], _: TraceMeta) -> Sequence[Cell]:
        rows = [
            {k: v.tolist() if isinstance(v, np.ndarray) else v for k, v in each._asdict().items()}
            for each in values
        ]
        return (json.dumps(rows) if rows else "",)

    def value(cells: Sequence[str], _: TraceMeta) -> tuple[Any, ...]:
        rows = json.loads(cells[0] or "[]")
        return tuple(kind(**{k: inner(k, v) for k, v in row.items()}) for row in rows)

    return Quantity(lambda _: (Column(name, "text"),), cells, value, take)


def frozen(values: Any) -> Array:
    """A copy as a float array that refuses to be changed."""
    array = np.array(values, dtype=float)
    array.flags.writeable = False
    return array


@lru_cache(maxsize=64)
def _changes(first: Config, config: Config) -> str:
    known, now = first.model_dump(mode="json"), config.model_dump(mode="json")
    changed = {
        f"{section}.{name}": value
        for section, values in now.items()
        for name, value in values.items()
        if value != known[section][name]
    }
    return json.dumps(changed) if changed else ""


@lru_cache(maxsize=64)
def _changed(first: Config, text: str) -> Config:
    data = first.model_dump()
    for path, value in json.loads(text or "{}").items():
        section, _, name = path.partition(".")
        data[section][name] = value
    return make_config(data) if text else first
