"""The base's numbers: measured where the robot can be measured, assumed where it cannot."""

from __future__ import annotations

from typing import Any

import numpy as np
import pinocchio as pin

from app.onboarding.wheels import Wheels
from app.robot.model import RobotModel

Array = np.ndarray

_SPEED = 1.0, 2.0  # [m/s], [rad/s] as the paper's robot
_ACCELERATION = 3.0, 6.0  # [m/s²], [rad/s²] as the paper's robot
_FRICTION = 0.5  # [-]
_YAW_FACTOR = 2.0  # [-] of the yaw inertia, as the paper's robot
_TIME_CONSTANT = 0.05  # [s]
_GRAVITY = 9.81  # [m/s²]


def base_numbers(
    model: RobotModel, wheels: Wheels, q_m: Array, half_track: float | None
) -> tuple[dict[str, Any], dict[str, str]]:
    """Fields of the description's base, and their sources.

    Args:
        model: The robot with its inertias.
        wheels: Its drive.
        q_m: (n_m,) the ready pose.
        half_track: [m] as given, or None for the measured one.
    """
    data = model.pin.createData()
    M = pin.crba(model.pin, data, model.configuration((0.0, 0.0, 0.0), q_m))
    mass, yaw = float(M[0, 0]), float(M[2, 2])
    fastest = wheels.joint_velocity * wheels.r if wheels.joint_velocity else np.inf
    v = min(_SPEED[0], fastest)
    b = half_track or wheels.b
    w = min(_SPEED[1], v / b)
    values = {
        "wheel_radius_m": round(wheels.r, 5),
        "half_track_m": round(b, 5),
        "mass_kg": round(mass, 2),
        "inertia_kgm2": round(_YAW_FACTOR * yaw, 3),
        "max_linear_velocity_mps": round(v, 3),
        "max_angular_velocity_radps": round(w, 3),
        "max_linear_acceleration_mps2": _ACCELERATION[0],
        "max_angular_acceleration_radps2": _ACCELERATION[1],
        "traction_limit_n": round(_FRICTION * _GRAVITY * mass, 1),
        "drive_time_constant_s": _TIME_CONSTANT,
    }
    skid = len(wheels.left) > 1
    sources = {
        "wheel_radius_m": wheels.how
        if wheels.how.startswith("given")
        else f"measured: {wheels.how}",
        "half_track_m": "given: --half-track"
        if half_track
        else "measured: half of the distance between the wheels' joints"
        + ("; on a base that skids the effective one is wider" if skid else ""),
        "mass_kg": "measured: sum of the URDF's masses",
        "inertia_kgm2": f"measured: {_YAW_FACTOR:g} times the yaw inertia of the whole robot in "
        "its ready pose, as for the paper's robot",
        "max_linear_velocity_mps": "from the URDF: the wheels' velocity limit"
        if v == fastest
        else "assumed: as the paper's robot",
        "max_angular_velocity_radps": "assumed: as the paper's robot"
        if w == _SPEED[1]
        else "assumed: one wheel at rest at the largest speed of the other",
        "max_linear_acceleration_mps2": "assumed: as the paper's robot",
        "max_angular_acceleration_radps2": "assumed: as the paper's robot",
        "traction_limit_n": f"assumed: friction coefficient {_FRICTION:g} on the whole weight",
        "drive_time_constant_s": "assumed: half of a 10 Hz command period",
    }
    return values, sources
