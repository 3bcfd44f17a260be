"""Constant inputs of Algorithm 2: the robot's constants and the gains of a method, as structs."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from numba import types

from app.avoidance.closest_points import SmoothPoints
from app.border.cache import BorderData
from app.border.score import ScoreField
from app.config import AdmittanceConfig, Config
from app.robot.bases.kind import BaseKind
from app.robot.link_pairs import PairDistances
from app.robot.model import RobotModel
from app.strict import Array
from app.structs import StructType

_FLOAT, _FLAG = types.f8, types.b1
_VECTOR, _MATRIX = types.Array(types.f8, 1, "C"), types.Array(types.f8, 2, "C")
_INTS, _TABLE = types.Array(types.i8, 1, "C"), types.Array(types.i8, 2, "C")

_ROBOT: dict[str, Any] = {
    "n_b": types.i8,  # velocity axes of the base
    "n_mob": types.i8,  # pairs of L_m
    "J_m": _MATRIX,  # (n_b, n_b) from q̇_b to ν, (19)
    "J_m_inv": _MATRIX,  # (n_b, n_b)
    "T_J_m": _MATRIX,  # (3, n_b) from q̇_b to the base's twist (v_x, v_y, ω)
    "base_rows": _MATRIX,  # (n_b, n) [J_m O]
    "A_b": _MATRIX,  # (n_b, 3) from f_m to ẍ_m, (16) to (18)
    "a_max": _VECTOR,  # (n_b,) [m/s², rad/s²]
    "v_max": _VECTOR,  # (n_b,) [m/s, rad/s]
    "drive_time": _FLOAT,  # [s] time constant of the drive
    "inertia": _VECTOR,  # (n_b,) [kg, kg m²]
    "mass": _FLOAT,  # [kg] of the base
    "q_limits": _MATRIX,  # (2, n_m) [rad, m]
    "qd_limits": _MATRIX,  # (2, n_m) [rad/s, m/s]
    "qd_max": _VECTOR,  # (n_m,) [rad/s, m/s]
    "tau_max": _VECTOR,  # (n_m,) [N m, N]
    "ready_inertia": _VECTOR,  # (n_m,) [kg m², kg] of each joint at the ready posture
    "tau_limits": _MATRIX,  # (2, n_m) [N m, N] ∓tau_max
    "R_tip": _MATRIX,  # (3, 3) rotation of the end-effector in the frame of the last joint
    "p_tip": _VECTOR,  # (3,) [m] origin of the end-effector in the frame of the last joint
    "shapes": _MATRIX,  # (P, 16) of `Shapes`
    "triangles": types.Array(types.f8, 3, "C"),  # (T, 4, 3) of `Shapes`
    "nodes": _MATRIX,  # (K, 4) of `mean_nearest`
    "firsts": _TABLE,  # (bodies + 1, 2) of `mean_nearest`
    "sought": _TABLE,  # (n_r, 4) of `mean_nearest`
    "shape_order": _INTS,  # (pairs of shapes in all groups,) of `put_least`
    "shape_firsts": _INTS,  # (n_r + 1,) of `put_least`
    "body_joints": _INTS,  # (bodies,) pinocchio's joint of each body
    "pair_joints": _TABLE,  # (n_r, 2) joints that carry l_a and l_b
    "convex": _INTS,  # (n_c,) rows of the distances to a single convex part of l_a
    "n_convex_mob": types.i8,  # number of these rows of L_m, which are the first ones
    "score_coefficients": _MATRIX,  # (n_mob, 9) `ScoreField.coefficients`
}
_Robot: Any = NamedTuple("_Robot", [(each, Any) for each in _ROBOT])  # type: ignore[misc]
ROBOT = StructType("_Robot", _ROBOT)
"""The struct of the robot's constants, for signatures of compiled functions."""

_SECTIONS = "border", "force", "activation", "repulsion", "barrier", "task", "limit", "estimate"
_PARAMETERS = [
    name for each in _SECTIONS for name, value in getattr(Config(), each) if type(value) is float
]
_GAINS: dict[str, Any] = {
    "dt": _FLOAT,  # [s] control period
    "joint_damping": _VECTOR,  # (n_m,) [N m s/rad, N s/m]
    **dict.fromkeys(_PARAMETERS, _FLOAT),  # numbers of these sections of `Config`, in their units
    "barrier_rate": _FLOAT,  # [1/s] `barrier.rate`
    "ee_hold_min_speed": _FLOAT,  # [m/s] `ee_hold.min_speed`
    "ee_hold_weight": _FLOAT,  # [-] `ee_hold.weight`
    "payload_mass": _FLOAT,  # [kg] `payload.mass`
    "command_period": _FLOAT,  # [s] of the base's velocity command
    "virtual_mass": _VECTOR,  # (n_b,) [kg, kg m²] M_a
    "virtual_damping": _VECTOR,  # (n_b,) [N s/m, N m s] D_a
    "largest_command": _VECTOR,  # (n_b,) [m/s, rad/s]
    "moves_base": _FLAG,  # the method moves the base by (16)
    "link_rows": _FLAG,  # the method separates links of the arm by (20)
    "arm_rows": _FLAG,  # the method pushes the arm away from the base (T_rep)
    "barrier": _FLAG,  # distances have a barrier
    "base_in_barrier": _FLAG,  # the base takes part in these barriers
    "lookahead": _FLAG,  # the base makes room for the arm's distances
    "hierarchy": _FLAG,  # q̈ solves the paper's hierarchy, `app.control.hqp`
}
_Gains: Any = NamedTuple("_Gains", [(each, Any) for each in _GAINS])  # type: ignore[misc]
GAINS = StructType("_Gains", _GAINS)
"""The struct of the gains, for signatures of compiled functions."""

METHODS: Mapping[str, frozenset[str]] = {
    "dbb": frozenset({"moves_base", "link_rows", "reaction", "barrier", "lookahead"}),
    "hqp": frozenset({"moves_base", "link_rows", "hierarchy"}),
    "repulsive": frozenset({"link_rows", "arm_rows"}),
    "barrier": frozenset({"barrier", "base_in_barrier"}),
    "none": frozenset(),
}
"""The terms that each controller adds to the tasks or to the limits: flags of `_GAINS`, and the
"reaction" of the arm with the force `force.f_arm`."""
MOVES_BASE = frozenset(name for name, terms in METHODS.items() if "moves_base" in terms)
"""Names of the controllers that move the base by the avoidance force."""


def robot_struct(
    model: RobotModel, data: BorderData, smooth: SmoothPoints, distances: PairDistances
) -> Any:
    """The struct `ROBOT`: constants of a robot and of its link pairs' closest points and distances.

    If the arm's body of a pair in L_m has no reachability, this raises a DescriptionError.
    """
    base, tip = model.description.base, model.pin.frames[model.ee_frame].placement
    mobile = data.pairs.mobile
    rows = [parts or [whole] for whole, *parts in smooth.rows]
    scores = [ScoreField.of(model, pair.b).coefficients() for pair in mobile]
    own = {
        "n_mob": len(mobile),
        "T_J_m": model.S[:3, : model.n_b],
        "A_b": base.A_b,
        "a_max": model.base_acceleration_max,
        "v_max": np.array(base.max_velocity),
        "drive_time": base.drive_time_constant_s,
        "inertia": model.base_inertia,
        "mass": base.mass_kg,
        "R_tip": tip.rotation,
        "p_tip": tip.translation,
        "convex": np.array([k for each in rows for k in each], dtype=int),
        "n_convex_mob": sum(map(len, rows[: len(mobile)])),
        "score_coefficients": np.array(scores).reshape(-1, 9),
        "shape_order": distances.order,
        "shape_firsts": distances.firsts,
        **smooth.arrays,
    }
    values = _Robot(**{name: own.get(name, getattr(model, name, None)) for name in _ROBOT})
    return ROBOT.made_of(_contiguous(values, _ROBOT))


def gains_struct(config: Config, model: RobotModel, name: str, dt: float) -> Any:
    """`GAINS` of a configuration for a controller in `METHODS`; `dt` [s] is the control period."""
    c, terms, base = config, METHODS[name], model.description.base
    found = {name: value for each in _SECTIONS for name, value in getattr(c, each)}
    found |= {
        "dt": dt,
        "joint_damping": model.joint_damping,
        "f_arm": c.force.f_arm if "reaction" in terms else 0.0,
        "barrier_rate": c.barrier.rate,
        "ee_hold_min_speed": c.ee_hold.min_speed,
        "ee_hold_weight": c.ee_hold.weight,
        "payload_mass": c.payload.mass,
        "command_period": c.admittance.period,
        "virtual_mass": base.by_axis(c.admittance.mass, c.admittance.inertia),
        "virtual_damping": base.by_axis(c.admittance.damping, c.admittance.angular_damping),
        "largest_command": largest_command(base, c.admittance),
    }
    found |= {each: each in terms for each, kind in _GAINS.items() if kind is _FLAG}
    return GAINS.made_of(_contiguous(_Gains(**{each: found[each] for each in _GAINS}), _GAINS))


def largest_command(base: BaseKind, config: AdmittanceConfig) -> Array:
    """(n_b,) [m/s or rad/s] the largest velocity command of each axis."""
    return np.minimum(base.max_velocity, base.by_axis(config.v_max, config.omega_max))


def _contiguous(values: Any, fields: Mapping[str, Any]) -> Any:
    """Convert each field: arrays to contiguous arrays, numbers to the type in the struct."""
    numbers, found = {types.f8: float, types.i8: int, types.b1: bool}, list[Any]()
    for kind, value in zip(fields.values(), values, strict=True):
        entry = int if kind in (_INTS, _TABLE) else float
        made = numbers[kind](value) if kind in numbers else np.ascontiguousarray(value, dtype=entry)
        found.append(made)
    return values._make(found)
