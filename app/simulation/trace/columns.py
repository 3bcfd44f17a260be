"""Quantities as columns: their names, and the conversion of values to cells and back."""

import json
from collections import ChainMap
from collections.abc import Callable, Mapping, Sequence
from functools import lru_cache, partial
from itertools import product
from typing import Any, Literal, NamedTuple, get_type_hints

import numpy as np
from pydantic import Field, model_validator
from typing_extensions import Self

from app.config import Config
from app.robot.bases.kind import Axis
from app.robot.model import RobotModel
from app.simulation.session import Session, Step
from app.strict import Array, Positive, Strict, parsed

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
    """The run of a trace: constant data that also determine the names of the columns."""

    format: Literal[2] = 2
    """[-] version of the file format; other versions are refused."""
    robot: str
    """Name of the robot, as `dbb robots` lists it."""
    joints: tuple[str, ...]
    """The arm's joints, in the order of q_m."""
    joint_units: tuple[Literal["rad", "m"], ...]
    """Unit of the position of each of them."""
    joint_speeds: tuple[Positive, ...] = ()
    """(n_m,) [rad/s or m/s] largest joint speeds; empty if unknown."""
    velocities: tuple[str, ...] = ("v_mps", "w_radps")
    """Names of the base's velocities in the columns, in the order of its axes."""
    accelerations: tuple[str, ...] = ("a_mps2", "aw_radps2")
    """Names of their derivatives."""
    wheels: tuple[str, ...] = ("right", "left")
    """Names of the angles of the base's wheels."""
    pairs: tuple[str, ...]
    """All link pairs, in the order of the rows' distances."""
    mobile_pairs: tuple[str, ...]
    """Those of L_m among them."""
    scenario: str = ""
    """Name of the scenario; empty if a person guided the arm."""
    physics: str = ""
    """Name of the plant; empty if unknown."""
    seed: int = Field(default=0, ge=0)
    """[-] seed of all random numbers of the run."""
    config: Config
    """Parameters at the first row; later rows state differences."""
    stuck: dict[str, Any] | None = None
    """Place and reasons of a tracking end-effector that stopped short at the end (`Stuck`)."""
    left_way: dict[str, Any] | None = None
    """The same at its largest distance from the target, if that exceeded 1 mm."""
    faults: dict[str, float] = Field(default_factory=dict)
    """[s] when the controller first reported each fault of the readings, by its name."""

    @model_validator(mode="after")
    def _check_names(self) -> Self:
        if len(self.joint_units) != len(self.joints):
            raise ValueError("joint_units: not one for each of the joints")
        if self.joint_speeds and len(self.joint_speeds) != len(self.joints):
            raise ValueError("joint_speeds: not one for each of the joints")
        if not set(self.mobile_pairs) <= set(self.pairs):
            raise ValueError("mobile_pairs: not all of them are among the pairs")
        return self

    @classmethod
    def of(cls, model: RobotModel, pairs: Mapping[str, bool], config: Config, **about: Any) -> Self:
        """The meta data of a run, with all its link pairs; the values say which belong to L_m."""
        arm, base = model.description.arm, model.description.base
        velocities, accelerations = zip(*map(_rate_columns, base.axes), strict=True)
        kinds = (model.pin.joints[model.pin.getJointId(name)].shortname() for name in arm.joints)
        return cls(
            robot=model.description.name,
            joints=tuple(arm.joints),
            joint_units=tuple("m" if "JointModelP" in kind else "rad" for kind in kinds),
            joint_speeds=tuple(model.qd_max.tolist()),
            velocities=velocities,
            accelerations=accelerations,
            wheels=tuple(wheels.name for wheels in base.wheels),
            pairs=tuple(pairs),
            mobile_pairs=tuple(name for name, mobile in pairs.items() if mobile),
            config=config,
            **about,
        )


def axis_name(axis: Axis) -> str:
    """An axis of the base's velocity in plain letters: v, vx, vy or w."""
    return axis.symbol.replace("_", "").replace("ω", "w")


def _rate_columns(axis: Axis) -> tuple[str, str]:
    """Columns of an axis's velocity and acceleration, such as vx_mps and ax_mps2."""
    name, unit = axis_name(axis), "radps" if axis.angular else "mps"
    return f"{name}_{unit}", f"a{name.removeprefix('v')}_{unit}2"


def column_names(template: str, meta: TraceMeta) -> list[str]:
    """The columns of a quantity of a robot, which end in their unit.

    Args:
        template: Such as `p_ee_{xyz}_m`, one column for each of x, y and z;
            `u_{joint}_{effort}`, one per joint in N m or N; `base_{velocity}`, one per axis of
            the base in m/s or rad/s; `d_{pair}_m`, one per link pair.
        meta: The run.
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
    """One column."""

    name: str
    """Name, which ends in the unit."""
    kind: Kind = "float"
    """Type of its cells."""
    optional: bool = False
    """Whether a cell may be empty, which is not-a-number in memory."""
    often: bool = False
    """Whether it has a number at each control step, not only at snapshots."""


class Quantity(NamedTuple):
    """One quantity of a run."""

    columns: Callable[[TraceMeta], Sequence[Column]]
    """Its columns in a run."""
    cells: Callable[[Any, TraceMeta], Sequence[Cell]]
    """Conversion of a snapshot's value to cells."""
    value: Callable[[Sequence[Any], TraceMeta], Any]
    """Back."""
    take: Take | None = None
    """Its value at a control step, from the session after it and the step; None if only the
    publisher of the snapshot knows it."""
    single: bool = False
    """Whether it is a single number."""
    row: Take | None = None
    """Its numbers at a control step, of the columns that have one at each; None if it is only
    drawn."""


def number(
    name: str,
    kind: Kind,
    take: Take | None = None,
    *,
    often: bool = True,
    optional: bool = False,
) -> Quantity:
    """A number that is recorded at each control step; otherwise it may be a text or None."""
    column = Column(name, kind, optional, often)

    def value(cells: Sequence[Any], _: TraceMeta) -> Any:
        return None if optional and np.isnan(cells[0]) else _CASTS[kind](cells[0])

    def cells(value: Any, _: TraceMeta) -> Sequence[Cell]:
        return (NAN if value is None else value,)

    row = None if take is None or not often else lambda s, o: (take(s, o),)
    return Quantity(lambda _: (column,), cells, value, take, single=True, row=row)


def numbers(template: str, take: Take, *, often: bool = True, optional: bool = False) -> Quantity:
    """An array (k,) that is recorded at each control step; `template` as in `column_names`."""

    def columns(meta: TraceMeta) -> Sequence[Column]:
        return [Column(n, "float", optional, often) for n in column_names(template, meta)]

    def cells(value: Array | None, meta: TraceMeta) -> Sequence[Cell]:
        return [NAN] * len(columns(meta)) if value is None else value.tolist()

    def value(cells: Sequence[float], _: TraceMeta) -> Array | None:
        return None if optional and np.isnan(cells).all() else frozen(cells)

    row = (lambda s, o: take(s, o).tolist()) if often else None
    return Quantity(columns, cells, value, take, row=row)


drawn = partial(number, often=False)  # a number or text that is recorded at snapshots
drawn_numbers = partial(numbers, often=False)
"""An array (k,) that is recorded at snapshots."""


def config_changes(take: Take) -> Quantity:
    """The parameters of a row that differ from those of the first row, as JSON."""
    return Quantity(
        lambda _: (Column("config_changes", "text"),),
        lambda config, meta: (_changes(meta.config, config),),
        lambda cells, meta: _changed(meta.config, cells[0]),
        take,
    )


def records(name: str, kind: type[Any], take: Take | None = None) -> Quantity:
    """A tuple of named tuples as JSON, or empty; for rare events."""
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
        rows = parsed(json.loads, cells[0] or "[]")
        return tuple(kind(**{k: inner(k, v) for k, v in row.items()}) for row in rows)

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
    return first.changed(parsed(json.loads, text)) if text else first
