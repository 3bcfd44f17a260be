"""What moves the base, for each kind of base that can be made from a URDF, and its numbers."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin

from app.errors import RobotFileError
from app.onboarding.read.arm import Arm, rigid_to_base
from app.onboarding.read.tree import Joint, Tree
from app.onboarding.read.wheels import Wheels, find_wheels, floor_below, stated_wheels
from app.onboarding.request import Request
from app.robot.model import RobotModel

_UPRIGHT = np.cos(np.radians(10.0))  # a steering axis may lean by 10 degrees
_STEERING_RATE = 1.5  # [rad/s]
_IN_LINE = 0.02  # [m] by which steered wheels may be ahead of each other


class Steering(NamedTuple):
    """The steered front wheels of a car-like base.

    Attributes:
        wheelbase: [m] from the rear axle to theirs.
        limit: [rad] how far they turn to either side.
        rate: [rad/s] how fast.
        rolling: Joints of the wheels on them.
        joints: Joints that turn with the steering.
        sources: Of the first three, by the name of the description's field.
    """

    wheelbase: float
    limit: float
    rate: float
    rolling: tuple[str, ...]
    joints: tuple[str, ...]
    sources: dict[str, str]


def find_drive(request: Request, tree: Tree, arm: Arm) -> tuple[Wheels, Steering | None]:
    """The wheels that the kind of base needs, and its steering.

    A holonomic base needs none: its frame is that of its link, put on the floor below its shapes.

    Raises:
        RobotFileError: The URDF has not what the kind needs; names the option that helps.
    """
    if request.kind == "holonomic":
        floor = pin.SE3(np.eye(3), np.array([0.0, 0.0, floor_below(tree, arm)]))
        return Wheels((), (), 0.0, 0.0, floor, None, ""), None
    if request.wheel_radius is not None and request.half_track is not None:
        return stated_wheels(tree, arm, request.wheel_radius, request.half_track), None
    wheels = find_wheels(tree, arm, request.wheels)
    if request.kind == "car-like":
        return wheels, find_steering(request, tree, arm, wheels.T_base_floor)
    return wheels, None


def find_steering(request: Request, tree: Tree, arm: Arm, T_base_floor: pin.SE3) -> Steering:
    """The steering: upright joints on the base, each with a wheel on it, or what is given.

    Args:
        request: What is asked; its numbers count before the URDF's.
        tree: The robot.
        arm: Its arm.
        T_base_floor: The floor below the middle of the rear axle, x ahead.

    Raises:
        RobotFileError: A number is neither given nor in the URDF.
    """
    rigid, taken = set(rigid_to_base(tree, arm)), {joint.name for joint in arm.joints}
    found: list[tuple[Joint, list[Joint], float]] = []
    for joint in tree.joints.values():
        if joint.parent not in rigid or joint.name in taken or not joint.moves:
            continue
        T = T_base_floor.inverse() * tree.pose(joint.child, arm.base)
        on_it = [j for j in tree.children(joint.child) if j.kind in ("continuous", "revolute")]
        if abs((T.rotation @ joint.axis)[2]) > _UPRIGHT and on_it:
            found.append((joint, on_it, float(T.translation[0])))
    sources: dict[str, str] = {}
    places = [x for _, _, x in found]
    if request.wheelbase is None and (not places or np.ptp(places) > _IN_LINE):
        raise RobotFileError(
            f"--wheelbase: {len(places)} steered wheels found on {arm.base!r}, none of them or not "
            "in line; give --wheelbase, from the rear axle to the front one"
        )
    wheelbase = request.wheelbase or float(np.mean(places))
    if wheelbase <= 0:
        raise RobotFileError("--wheels: the steered wheels are behind them; give LEFT and RIGHT")
    sources["wheelbase_m"] = (
        "given: --wheelbase" if request.wheelbase else "measured: from the wheels to the steered"
    )
    limit = request.steering_limit or _limit([joint for joint, _, _ in found])
    sources["steering_limit_rad"] = (
        "given: --steering-limit" if request.steering_limit else "from the URDF: the tightest joint"
    )
    speeds = [joint.velocity for joint, _, _ in found if joint.velocity]
    rate = request.steering_rate or (min(speeds) if speeds else _STEERING_RATE)
    sources["steering_rate_radps"] = (
        "given: --steering-rate"
        if request.steering_rate
        else "from the URDF: the slowest joint"
        if speeds
        else "assumed: as a small car's"
    )
    return Steering(
        wheelbase,
        limit,
        rate,
        tuple(j.name for _, rolling, _ in found for j in rolling),
        tuple(joint.name for joint, _, _ in found),
        sources,
    )


def _limit(joints: Sequence[Joint]) -> float:
    """[rad] the smallest way of any of them to either side."""
    ways = [min(-(j.lower or 0.0), j.upper or 0.0) for j in joints if j.kind == "revolute"]
    if not ways or not 0.0 < min(ways) < np.pi / 2:
        raise RobotFileError(
            "--steering-limit: the URDF limits no steered joint to both sides, to less than a "
            "right angle; give it"
        )
    return min(ways)


def drive_fields(kind: str, wheels: Wheels, steering: Steering | None) -> dict[str, Any]:
    """The fields of the description's base that name joints."""
    if kind == "differential":
        return {"left_wheel_joints": wheels.left, "right_wheel_joints": wheels.right}
    if steering is None:
        return {}
    rolling = (*wheels.left, *wheels.right, *steering.rolling)
    return {"wheel_joints": rolling, "steering_joints": steering.joints}


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
