"""Quantities as columns: names, and the conversion of values to cells and back."""

import json
from collections import ChainMap
from collections.abc import Callable, Mapping, Sequence
from functools import lru_cache, partial
from itertools import product
from operator import attrgetter
from typing import Any, Literal, NamedTuple, get_type_hints

import numpy as np
from pydantic import Field, model_validator
from typing_extensions import Self

from app.config import Config
from app.robot.bases.kind import Axis
from app.robot.model import RobotModel
from app.simulation.session import Session, Step
from app.strict import Array, Positive, Strict, from_json

Kind = Literal["float", "int", "bool", "text"]
Cell = float | int | bool | str
Take = Callable[[Session, Step], Any]

NAN = float("nan")
_UNITS = {
    "rad": {"position": "rad", "speed": "radps", "effort": "nm"},
    "m": {"position": "m", "speed": "mps", "effort": "n"},
}
"""Units of a joint's quantities, by the unit of its position."""
_CASTS: dict[Kind, Callable[[Any], Any]] = {"float": float, "int": int, "bool": bool, "text": str}


class TraceMeta(Strict):
    """Constant data of a run; they also determine the names of the columns."""

    format: Literal[2] = 2  # [-] version of the file format; files of other versions cannot be read
    robot: str
    joints: tuple[str, ...]  # names of the arm's joints, in the order of q_m
    joint_units: tuple[Literal["rad", "m"], ...]
    joint_speeds: tuple[Positive, ...] = ()  # (n_m,) [rad/s or m/s] limits; empty if unknown
    joint_torques: tuple[Positive, ...] = ()  # (n_m,) [N m or N] limits; empty if unknown
    velocities: tuple[str, ...] = ("v_mps", "w_radps")  # names in columns, such as vx_mps, by axis
    accelerations: tuple[str, ...] = ("a_mps2", "aw_radps2")
    wheels: tuple[str, ...] = ("right", "left")  # names of the angles of the base's wheels
    pairs: tuple[str, ...]  # names of all link pairs, in the order of the distances
    mobile_pairs: tuple[str, ...]  # names of the pairs with the base (L_m)
    scenario: str = ""
    physics: str = ""  # name of the plant; empty if unknown
    seed: int | None = Field(default=None, ge=0)  # of all random numbers; None if unknown
    config: Config  # parameters at the first row; a column has the later changes
    stuck: dict[str, Any] | None = None  # result of `find_stuck` at the end
    left_way: dict[str, Any] | None = None
    """`Stuck` at the largest tracking error, if this exceeds 1 mm; otherwise None."""
    faults: dict[str, float] = Field(default_factory=dict)
    """[s] time of the controller's first report of each fault of the readings, by name."""

    @model_validator(mode="after")
    def _check_names(self) -> Self:
        if len(self.joint_units) != len(self.joints):
            raise ValueError("joint_units: there must be one for each joint")
        for name in ("joint_speeds", "joint_torques"):
            if len(getattr(self, name)) not in (0, len(self.joints)):
                raise ValueError(f"{name}: there must be one for each joint")
        if not set(self.mobile_pairs) <= set(self.pairs):
            raise ValueError("mobile_pairs: each must be one of the pairs")
        return self

    @classmethod
    def of(cls, model: RobotModel, pairs: Mapping[str, bool], config: Config, **about: Any) -> Self:
        """The data of a run; `pairs` states whether each link pair is one with the base (L_m)."""
        arm, base = model.description.arm, model.description.base
        names = [(axis_name(each), "radps" if each.angular else "mps") for each in base.axes]
        return cls(
            robot=model.description.name,
            joints=tuple(arm.joints),
            joint_units=model.joint_units,
            joint_speeds=tuple(model.qd_max.tolist()),
            joint_torques=tuple(model.tau_max.tolist()),
            velocities=tuple(f"{name}_{unit}" for name, unit in names),
            accelerations=tuple(f"a{name.removeprefix('v')}_{unit}2" for name, unit in names),
            wheels=tuple(wheels.name for wheels in base.wheels),
            pairs=tuple(pairs),
            mobile_pairs=tuple(name for name, mobile in pairs.items() if mobile),
            config=config,
            **about,
        )


def axis_name(axis: Axis) -> str:
    """The name of an axis of the base in plain letters: v, vx, vy or w."""
    return axis.symbol.replace("_", "").replace("ω", "w")


def column_names(template: str, meta: TraceMeta) -> list[str]:
    """The names of a quantity's columns, which end in the unit, if any.

    Templates are such as `p_ee_{xyz}_m` for x, y and z; `u_{joint}_{effort}` for the joints, in N m
    or N; `base_{velocity}` for the base's axes, in m/s or rad/s; `d_{pair}_m` for the link pairs.
    """
    joints = zip(meta.joints, meta.joint_units, strict=True)
    plain: dict[str, Sequence[str]] = {
        "pair": meta.pairs,
        "mobile": meta.mobile_pairs,
        "velocity": meta.velocities,
        "acceleration": meta.accelerations,
        "pose": ("x_m", "y_m", "yaw_rad"),
        "wheel": meta.wheels,
        "wxyz": "wxyz",
        "xyz": "xyz",
    }
    every = {key: [{key: name} for name in names] for key, names in plain.items()}
    every["joint"] = [{"joint": name, **_UNITS[unit]} for name, unit in joints]
    groups = [group for key, group in every.items() if f"{{{key}}}" in template]
    return [template.format(**dict(ChainMap(*each))) for each in product(*groups)]


class Column(NamedTuple):
    name: str  # name, which ends in the unit, if any
    kind: Kind = "float"
    optional: bool = False  # whether a cell can be empty; in memory, an empty cell is NaN
    often: bool = False  # whether the table of a trace has the column


class Quantity(NamedTuple):
    """A quantity of a run."""

    columns: Callable[[TraceMeta], Sequence[Column]]
    cells: Callable[[Any, TraceMeta], Sequence[Cell]]  # conversion of a snapshot's value to cells
    value: Callable[[Sequence[Any], TraceMeta], Any]  # conversion of cells to a snapshot's value
    take: Take | None = None  # computes the value; None if `make_snapshot` or its caller sets it
    single: bool = False  # whether the quantity is one number or text
    paths: tuple[str, ...] = ()
    """Attributes of `Step`, such as `truth.q_m`, that are recorded at each control step. Without
    any, a column that is `often` has the number of `take` at 50 Hz, and NaN in between."""


def number(
    template: str,
    source: str | Take | None = None,
    kind: Kind = "float",
    *,
    often: bool = True,
    optional: bool = False,
) -> Quantity:
    """A quantity of one number or text, or of an array (k,) if the `template` names k columns.

    `template` is as in `column_names`. `source` is the value's attribute of `Step`, as in
    `Quantity.paths`, or its computation at 50 Hz, as in `Quantity.take`. If not `often`, the value
    is recorded only at snapshots. If `optional`, the value can be None. A ValueError is raised if
    `often` is true, and `source` is neither an attribute nor the computation of one number.
    """
    single = "{" not in template
    if often and not isinstance(source, str) and (source is None or not single):
        must = f"{template}: `source` must be an attribute of `Step`, or compute one number"
        why = "the value is recorded at each control step; otherwise use `drawn`"
        raise ValueError(f"{must}, because {why}")

    def columns(meta: TraceMeta) -> Sequence[Column]:
        return [Column(name, kind, optional, often) for name in column_names(template, meta)]

    def cells(value: Any, meta: TraceMeta) -> Sequence[Cell]:
        if value is None:
            return [NAN] * len(columns(meta))
        return (value,) if single else value.tolist()

    def value(cells: Sequence[Any], _: TraceMeta) -> Any:
        if optional and np.isnan(cells).all():
            return None
        return _CASTS[kind](cells[0]) if single else frozen(cells)

    if not isinstance(source, str):
        return Quantity(columns, cells, value, source, single)
    read, convert = attrgetter(source), _CASTS[kind] if single else np.asarray
    return Quantity(columns, cells, value, lambda _, step: convert(read(step)), single, (source,))


drawn = partial(number, often=False)  # a quantity that is recorded at snapshots


def config_changes(take: Take) -> Quantity:
    """A quantity for the parameters that differ from the first row's parameters, as JSON."""
    return Quantity(
        lambda _: (Column("config_changes", "text"),),
        lambda config, meta: (_changes(meta.config, config),),
        lambda cells, meta: _changed(meta.config, cells[0]),
        take,
    )


def records(name: str, kind: type[Any], take: Take | None = None) -> Quantity:
    """A quantity for a tuple of named tuples of type `kind`, as JSON; "" for an empty tuple."""
    hints = get_type_hints(kind)

    def cells(values: Sequence[Any], _: TraceMeta) -> Sequence[Cell]:
        rows = [each._asdict() for each in values]
        return (json.dumps(rows, default=np.ndarray.tolist) if rows else "",)

    def field(name: str, data: Any) -> Any:
        return frozen(data) if hints[name] is np.ndarray else data

    def value(cells: Sequence[str], _: TraceMeta) -> tuple[Any, ...]:
        rows = from_json(cells[0] or "[]")
        return tuple(kind(**{k: field(k, v) for k, v in row.items()}) for row in rows)

    return Quantity(lambda _: (Column(name, "text"),), cells, value, take)


def frozen(values: Any) -> Array:
    """A read-only copy as a float array."""
    array = np.array(values, dtype=float)
    array.flags.writeable = False
    return array


@lru_cache(maxsize=64)
def _changes(first: Config, config: Config) -> str:
    changes = config.changes(first)
    return json.dumps(changes) if changes else ""


@lru_cache(maxsize=64)
def _changed(first: Config, text: str) -> Config:
    return first.changed(from_json(text)) if text else first
