"""The paper's arm, bodies and border on bases of other kinds."""

from __future__ import annotations

from functools import cache
from typing import Any

from app.robot.bases.car_like import CarLikeBase
from app.robot.bases.holonomic import HolonomicBase
from app.robot.bases.kind import BaseKind
from app.robot.model import RobotModel
from tests.robots import husky_panda

_COMMON: dict[str, Any] = {
    "mass_kg": 60.0,
    "inertia_kgm2": 16.0,
    "max_linear_velocity_mps": 1.0,
    "max_linear_acceleration_mps2": 3.0,
    "traction_limit_n": 300.0,
    "drive_time_constant_s": 0.05,
}
_OWN: dict[str, dict[str, Any]] = {
    "holonomic": {"max_angular_velocity_radps": 2.0, "max_angular_acceleration_radps2": 6.0},
    "car-like": {
        "wheelbase_m": 0.8,
        "steering_limit_rad": 0.55,
        "steering_rate_radps": 2.0,
        "wheel_radius_m": 0.165,
        "wheel_joints": (),
        "steering_joints": (),
    },
}
_RECORDS: dict[str, type[BaseKind]] = {"holonomic": HolonomicBase, "car-like": CarLikeBase}
KINDS = ("differential", *_RECORDS)


@cache
def base_of(kind: str, **changes: float) -> BaseKind:
    """A base of a kind with the paper's mass; "differential" is the paper's and ignores changes."""
    if kind == "differential":
        return husky_panda().description.base
    fields = _COMMON | _OWN[kind] | changes
    source = {name: "test" for name, value in fields.items() if isinstance(value, float)}
    return _RECORDS[kind].model_validate({"kind": kind, **fields, "source": source})


@cache
def robot_on(kind: str) -> RobotModel:
    """The paper's arm on a base of this kind."""
    description = husky_panda().description.model_copy(update={"base": base_of(kind)})
    return RobotModel(description)
