"""What the links of one body fill when the joints between them turn."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import pinocchio as pin

from app.onboarding.fit.convex import hull_corners
from app.robot.model import RobotModel

Array = np.ndarray

_STEP = np.radians(10.0)  # [rad] between the turns looked at
_SAGITTA = 1.0 / np.cos(_STEP / 2)  # [-] by which a chord lies inside of its circle


def swept(model: RobotModel, points: Mapping[int, Array], frame: int) -> Array:
    """(N, 3) [m] corners of the hull of what points fill, seen from one joint's frame.

    Args:
        model: The robot.
        points: (N, 3) [m] of neighbouring joints, in each joint's own frame, by its number.
        frame: Number of the joint in whose frame the answer is.
    """
    first, last = min(points), max(points)
    outer = np.zeros((0, 3))
    for joint in range(last, frame, -1):
        outer = _through(model, np.vstack([points[joint], outer]), joint, outwards=True)
    inner = np.zeros((0, 3))
    for joint in range(first, frame):
        inner = _through(model, np.vstack([points[joint], inner]), joint + 1, outwards=False)
    return hull_corners(np.vstack([points[frame], outer, inner]))


def _through(model: RobotModel, points: Array, joint: int, *, outwards: bool) -> Array:
    """Points beyond a joint as all its positions show them on this side of it."""
    if not len(points):
        return points
    placement = model.pin.jointPlacements[joint]
    corners = hull_corners(points if outwards else _moved(points, placement.inverse()))
    axis, turns = _axis(model, joint)
    if turns:
        corners = _grown(corners, axis)
    clouds = []
    for position in _positions(model, joint, turns):
        motion = pin.SE3.Identity()
        if turns:
            motion.rotation = pin.exp3(axis * position)
        else:
            motion.translation = axis * position
        clouds.append(_moved(corners, placement * motion if outwards else motion.inverse()))
    return hull_corners(np.vstack(clouds))


def _grown(points: Array, axis: Array) -> Array:
    """Points moved out from an axis through the origin, so that chords become tangents."""
    along = np.outer(points @ axis, axis)
    return along + (points - along) * _SAGITTA


def _axis(model: RobotModel, joint: int) -> tuple[Array, bool]:
    """(3,) axis of a joint in its own frame, and whether it turns."""
    kind = model.pin.joints[joint]
    data = kind.createData()
    kind.calc(data, pin.neutral(model.pin))
    S = np.asarray(data.S).ravel()
    turns = bool(np.abs(S[3:]).max() > 0.5)
    return (S[3:] if turns else S[:3]), turns


def _positions(model: RobotModel, joint: int, turns: bool) -> Sequence[float]:
    low, high = model.q_lower[joint - 2], model.q_upper[joint - 2]
    if not turns:
        return [low, high]
    if high - low >= 2 * np.pi:
        return list(np.arange(0.0, 2 * np.pi, _STEP))
    return list(np.linspace(low, high, max(2, int(np.ceil((high - low) / _STEP)) + 1)))


def _moved(points: Array, T: pin.SE3) -> Array:
    return points @ T.rotation.T + T.translation
