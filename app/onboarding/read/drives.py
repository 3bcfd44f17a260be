"""What moves the base, for each kind of base that can be made from a URDF."""

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
