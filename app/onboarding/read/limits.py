"""Limits and damping of an arm's joints: the URDF's, and assumed ones where it states none."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
import pinocchio as pin

from app.errors import RobotFileError
from app.onboarding.read.arm import Arm
from app.onboarding.read.tree import Joint
from app.robot.link_pairs import sample_joints
from app.robot.model import RobotModel

Array = np.ndarray

_TURN = np.pi  # [rad] either way, of a joint without limits
_SPEED = {"revolute": 1.5, "prismatic": 0.3}  # [rad/s], [m/s] where none is stated
_LARGEST = 100.0  # [rad] or [m] of a limit that means none
_GRAVITY_SHARE = 2.5  # [-] of the largest gravity load, the assumed effort
_LEAST_EFFORT = {"revolute": 5.0, "prismatic": 50.0}  # [N m], [N]
_DAMPING = (2.0, 1.0, 20.0)  # [N m s/rad] of strong and weak joints, [N s/m] of slides
_STRONG = 30.0  # [N m] effort of a strong joint
_STABLE = 0.3e-3  # [s] damping over inertia may be a third of the inverse of a step of 1 ms
_SAMPLES = 400


class Limits(NamedTuple):
    """Of all joints, in order; `source` says where each list comes from."""

    lower: tuple[float, ...]
    upper: tuple[float, ...]
    velocity: tuple[float, ...]
    effort: tuple[float, ...]
    source: dict[str, str]


def read_limits(arm: Arm) -> Limits:
    """What the URDF states; 0 stands for an effort that it does not.

    Raises:
        RobotFileError: The limits of a joint leave no room.
    """
    lower, upper, velocity, effort = [], [], [], []
    assumed: dict[str, list[str]] = {"position": [], "velocity": []}
    for joint in arm.joints:
        low, high = _range(joint)
        if low is None or high is None:
            assumed["position"].append(joint.name)
            low, high = -_TURN, _TURN
        lower.append(low)
        upper.append(high)
        if not (joint.velocity and 0 < joint.velocity < _LARGEST):
            assumed["velocity"].append(joint.name)
        kind = "prismatic" if joint.kind == "prismatic" else "revolute"
        velocity.append(
            joint.velocity if joint.velocity and 0 < joint.velocity < _LARGEST else _SPEED[kind]
        )
        effort.append(joint.effort if joint.effort and 0 < joint.effort < 1e5 else 0.0)
    position = _origin(assumed["position"], "half a turn either way")
    source = {
        "position_lower": position,
        "position_upper": position,
        "max_velocity": _origin(assumed["velocity"], "1.5 rad/s or 0.3 m/s"),
        "max_effort": "from the URDF",
    }
    return Limits(tuple(lower), tuple(upper), tuple(velocity), tuple(effort), source)


def completed(limits: Limits, arm: Arm, model: RobotModel) -> Limits:
    """The same with an assumed effort where there is none: a share more than gravity needs.

    Args:
        limits: What the URDF states.
        arm: The arm.
        model: The robot with its inertias; its own efforts are not used.
    """
    missing = [j.name for j, e in zip(arm.joints, limits.effort, strict=True) if not e]
    if not missing:
        return limits
    load = _largest(
        model, lambda q: np.abs(pin.computeGeneralizedGravity(model.pin, _data(model), q)[3:])
    )
    effort = [
        e or float(max(_GRAVITY_SHARE * g, _LEAST_EFFORT[_kind(j)]))
        for j, e, g in zip(arm.joints, limits.effort, load, strict=True)
    ]
    text = _origin(missing, "2.5 times the largest gravity load in random poses")
    return limits._replace(
        effort=tuple(round(e, 2) for e in effort), source=limits.source | {"max_effort": text}
    )


def damping(limits: Limits, arm: Arm, model: RobotModel) -> tuple[float, ...]:
    """[N m s/rad or N s/m] D of guiding by hand: as the paper's robot has, if the step allows it.

    A third of the joint's least inertia over a step is the most that pybullet damps stably.
    """

    def inertia(q: Array) -> Array:
        M = pin.crba(model.pin, _data(model), q)
        M = np.triu(M) + np.triu(M, 1).T
        return -1.0 / np.diag(np.linalg.inv(M))[3:]  # what the joint alone has to move

    least = -_largest(model, inertia)
    wanted = [
        _DAMPING[2] if _kind(j) == "prismatic" else _DAMPING[0 if e >= _STRONG else 1]
        for j, e in zip(arm.joints, limits.effort, strict=True)
    ]
    return tuple(
        float(f"{min(d, m / _STABLE * 0.1):.2g}") for d, m in zip(wanted, least, strict=True)
    )


def _range(joint: Joint) -> tuple[float | None, float | None]:
    low, high = joint.lower, joint.upper
    if joint.kind == "continuous":
        return None, None
    if low is None or high is None or max(abs(low), abs(high)) > _LARGEST:
        if joint.kind == "prismatic":
            raise RobotFileError(f"joint {joint.name!r} slides without limits; give it a <limit>")
        return None, None
    if not low < high:
        raise RobotFileError(
            f"joint {joint.name!r}: its lower limit {low:g} is not below its upper {high:g}"
        )
    return low, high


def _kind(joint: Joint) -> str:
    return "prismatic" if joint.kind == "prismatic" else "revolute"


def _origin(assumed: list[str], what: str) -> str:
    if not assumed:
        return "from the URDF"
    return f"from the URDF; assumed for {', '.join(assumed)}: {what}"


def _largest(model: RobotModel, values: Callable[[Array], Array]) -> Array:
    """(n_m,) largest values over random poses."""
    rng = np.random.default_rng(0)
    poses = sample_joints(model, _SAMPLES, rng)
    return np.max([values(model.configuration((0.0, 0.0, 0.0), pose)) for pose in poses], axis=0)


def _data(model: RobotModel) -> pin.Data:
    return model.pin.createData()
