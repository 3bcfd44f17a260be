"""The base's numbers: measured where the robot can be measured, assumed where it cannot."""

from __future__ import annotations

from typing import Any

import numpy as np
import pinocchio as pin

from app.onboarding.read.drives import Steering
from app.onboarding.read.wheels import Wheels
from app.robot.model import RobotModel

Array = np.ndarray

_SPEED = 1.0, 2.0  # [m/s], [rad/s] as the paper's robot
_ACCELERATION = 3.0, 6.0  # [m/s²], [rad/s²] as the paper's robot
_FRICTION = 0.5  # [-]
_YAW_FACTOR = 2.0  # [-] of the yaw inertia, as the paper's robot
_TIME_CONSTANT = 0.05  # [s]
_GRAVITY = 9.81  # [m/s²]


def base_numbers(
    model: RobotModel,
    wheels: Wheels,
    q_m: Array,
    half_track: float | None,
    steering: Steering | None = None,
) -> tuple[dict[str, Any], dict[str, str]]:
    """Fields of the description's base, and their sources.

    Args:
        model: The robot with its inertias.
        wheels: Its drive.
        q_m: (n_m,) the ready pose.
        half_track: [m] as given, or None for the measured one.
        steering: Of a car-like base.
    """
    data, kind = model.pin.createData(), model.description.base.kind
    M = pin.crba(model.pin, data, model.configuration((0.0, 0.0, 0.0), q_m))
    mass, yaw = float(M[0, 0]), float(M[2, 2])
    fastest = wheels.joint_velocity * wheels.r if wheels.joint_velocity else np.inf
    v = min(_SPEED[0], fastest)
    geometry, how = _geometry(kind, wheels, half_track, steering)
    values = geometry | {
        "mass_kg": round(mass, 2),
        "inertia_kgm2": round(yaw if steering else _YAW_FACTOR * yaw, 3),
        "max_linear_velocity_mps": round(v, 3),
        "max_linear_acceleration_mps2": _ACCELERATION[0],
        "traction_limit_n": round(_FRICTION * _GRAVITY * mass, 1),
        "drive_time_constant_s": _TIME_CONSTANT,
    }
    sources = how | {
        "mass_kg": "measured: sum of the URDF's masses",
        "inertia_kgm2": "measured: the yaw inertia of the whole robot in its ready pose, about the "
        "rear axle"
        if steering
        else f"measured: {_YAW_FACTOR:g} times the yaw inertia of the whole robot in its ready "
        "pose, as for the paper's robot",
        "max_linear_velocity_mps": "from the URDF: the wheels' velocity limit"
        if v == fastest
        else "assumed: as the paper's robot",
        "max_linear_acceleration_mps2": "assumed: as the paper's robot",
        "traction_limit_n": f"assumed: friction coefficient {_FRICTION:g} on the whole weight",
        "drive_time_constant_s": "assumed: half of a 10 Hz command period",
    }
    if kind != "car-like":  # there the steering limits the turning
        w = min(_SPEED[1], v / values["half_track_m"] if "half_track_m" in values else np.inf)
        values |= {
            "max_angular_velocity_radps": round(w, 3),
            "max_angular_acceleration_radps2": _ACCELERATION[1],
        }
        sources |= {
            "max_angular_velocity_radps": "assumed: as the paper's robot"
            if w == _SPEED[1]
            else "assumed: one wheel at rest at the largest speed of the other",
            "max_angular_acceleration_radps2": "assumed: as the paper's robot",
        }
    return values, sources


def _geometry(
    kind: str, wheels: Wheels, half_track: float | None, steering: Steering | None
) -> tuple[dict[str, Any], dict[str, str]]:
    """Radius, track and steering, as far as the kind has them, and their sources."""
    radius = wheels.how if wheels.how.startswith("given") else f"measured: {wheels.how}"
    if kind == "holonomic":
        return {}, {}
    if steering is not None:
        numbers = {
            "wheelbase_m": round(steering.wheelbase, 5),
            "steering_limit_rad": round(steering.limit, 5),
            "steering_rate_radps": round(steering.rate, 5),
            "wheel_radius_m": round(wheels.r, 5),
        }
        return numbers, steering.sources | {"wheel_radius_m": radius}
    skid = len(wheels.left) > 1
    track = (
        "given: --half-track"
        if half_track
        else "measured: half of the distance between the wheels' joints"
        + ("; on a base that skids the effective one is wider" if skid else "")
    )
    numbers = {
        "wheel_radius_m": round(wheels.r, 5),
        "half_track_m": round(half_track or wheels.b, 5),
    }
    return numbers, {"wheel_radius_m": radius, "half_track_m": track}
