"""The driven wheels of a base: which joints they are, their radius, and how far they are apart."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import pinocchio as pin

from app.errors import RobotFileError
from app.onboarding.read.arm import Arm, rigid_to_base
from app.onboarding.read.geometry import looks, read_shapes
from app.onboarding.read.tree import Joint, Tree

Array = np.ndarray

_LEVEL = np.cos(np.radians(2.0))  # an axle may lean by 2 degrees
_ROUND = 0.08  # [-] by how much the two widths of a wheel may differ
_ALIKE = 0.03  # [-] by how much the radii of the wheels may differ
_SAME_PLACE = 0.01  # [m] by which mirrored wheels may be off


class Wheels(NamedTuple):
    """The drive, seen from the base's link.

    Attributes:
        left, right: Joints of each side.
        r: [m] their radius.
        b: [m] half of the distance between the sides.
        T_base_floor: The point on the floor below the middle between the wheels, x forward.
        joint_velocity: [rad/s] limit of the wheels, or None where the URDF states none.
        how: Where the radius comes from.
    """

    left: tuple[str, ...]
    right: tuple[str, ...]
    r: float
    b: float
    T_base_floor: pin.SE3
    joint_velocity: float | None
    how: str


class _Wheel(NamedTuple):
    joint: Joint
    centre: Array  # (3,) [m] in the base's link
    axis: Array  # (3,) there
    r: float
    how: str


def find_wheels(tree: Tree, arm: Arm, given: tuple[str, str] | None = None) -> Wheels:
    """The wheels.

    Without `given`, they are the round links on level axles fixed to the base that stand on the
    floor in mirrored pairs.

    Args:
        tree: The robot.
        arm: Its arm.
        given: Joints or links of a left and a right wheel; those of the same shape on the same side
            and height go with them.

    Raises:
        RobotFileError: What was given is no wheel, or there are none or several to choose from.
    """
    found = _candidates(tree, arm)
    if given is not None:
        sides = [
            _named(tree, arm, name, side)
            for name, side in zip(given, ("left", "right"), strict=True)
        ]
        left, right = sides
    else:
        pairs = _mirrored([w for w in found if isinstance(w, _Wheel)])
        if not pairs:
            reasons = "; ".join(str(w) for w in found if isinstance(w, str)) or "no joint turns"
            raise RobotFileError(
                f"--wheels: no pair of wheels found under {arm.base!r} ({reasons}); "
                "give --wheels LEFT RIGHT, their joints; or --wheel-radius and --half-track if the "
                "URDF has no wheels"
            )
        lowest = min(left.centre[2] - left.r for left, _ in pairs)
        pairs = [p for p in pairs if p[0].centre[2] - p[0].r < lowest + _SAME_PLACE]
        if max(p[0].r for p in pairs) > (1 + _ALIKE) * min(p[0].r for p in pairs):
            names = "; ".join(f"{a.joint.name} {b.joint.name}" for a, b in pairs)
            raise RobotFileError(
                f"--wheels: pairs of different radius may be the driven ones: {names}; "
                "give --wheels LEFT RIGHT"
            )
        left, right = pairs[0]
    if abs(left.r - right.r) > _ALIKE * left.r:
        raise RobotFileError(
            f"--wheels: {left.joint.name} has a radius of {left.r:.4f} m and {right.joint.name} of "
            f"{right.r:.4f} m: two driven wheels are equal"
        )
    wheels = [w for w in found if isinstance(w, _Wheel)] + [left, right]
    forward = _forward(left, right)
    return _drive(tree, left, right, wheels, forward)


def stated_wheels(tree: Tree, arm: Arm, r: float, b: float) -> Wheels:
    """A base whose URDF has no wheels: the floor is below its shapes, ahead is its link's x.

    Args:
        tree: The robot.
        arm: Its arm.
        r: [m] radius of the wheels.
        b: [m] half track.

    Raises:
        RobotFileError: The base has no shapes.
    """
    floor = pin.SE3(np.eye(3), np.array([0.0, 0.0, floor_below(tree, arm)]))
    return Wheels((), (), r, b, floor, None, "given: --wheel-radius")


def floor_below(tree: Tree, arm: Arm) -> float:
    """[m] the height of the lowest point of the base's shapes in its link's frame.

    Raises:
        RobotFileError: The base has no shapes.
    """
    lows = [
        float((tree.pose(link, arm.base).act(corner))[2])
        for link in arm.base_links
        for shape in read_shapes(tree, link)
        for corner in np.asarray(shape.hull.bounding_box.vertices)
    ]
    if not lows:
        raise RobotFileError(f"--base: no link of {arm.base!r} has a shape")
    return min(lows)


def _drive(
    tree: Tree, left: _Wheel, right: _Wheel, wheels: Sequence[_Wheel], forward: Array
) -> Wheels:
    """The whole drive: both sides with what is like the two wheels."""
    floor = float(np.mean([left.centre[2] - left.r, right.centre[2] - right.r]))
    like = {
        w.joint.name: w
        for w in wheels
        if abs(w.r - left.r) <= _ALIKE * left.r and abs(w.centre[2] - w.r - floor) < _SAME_PLACE
    }
    sideways = np.cross([0.0, 0.0, 1.0], forward)
    y = {name: float(w.centre @ sideways) for name, w in like.items()}
    y_left, y_right = (float(w.centre @ sideways) for w in (left, right))
    sides = [[n for n in like if abs(y[n] - own) < _SAME_PLACE] for own in (y_left, y_right)]
    middle = np.mean([np.mean([like[n].centre for n in side], axis=0) for side in sides], axis=0)
    rotation = np.column_stack([forward, sideways, [0.0, 0.0, 1.0]])
    speeds = [w.joint.velocity for w in (left, right) if w.joint.velocity]
    return Wheels(
        left=tuple(sides[0]),
        right=tuple(sides[1]),
        r=left.r,
        b=abs(y_left - y_right) / 2,
        T_base_floor=pin.SE3(rotation, np.array([middle[0], middle[1], floor])),
        joint_velocity=min(speeds) if speeds else None,
        how=left.how,
    )


def _forward(left: _Wheel, right: _Wheel) -> Array:
    """(3,) x forward: at a right angle to the way from the right to the left wheel."""
    across = left.centre - right.centre
    across[2] = 0.0
    if np.linalg.norm(across) < 0.02:
        raise RobotFileError(
            f"--wheels: {left.joint.name} and {right.joint.name} stand at the same place"
        )
    if abs(left.axis @ across) < 0.99 * np.linalg.norm(across):
        raise RobotFileError(
            f"--wheels: {left.joint.name} and {right.joint.name} are not side by side: their axles "
            "do not point at each other"
        )
    across /= np.linalg.norm(across)
    return np.cross(across, [0.0, 0.0, 1.0])


def _candidates(tree: Tree, arm: Arm) -> list[_Wheel | str]:
    """What turns on the base: wheels, and why the others are none."""
    rigid = set(rigid_to_base(tree, arm))
    taken = {joint.name for joint in arm.joints}
    found: list[_Wheel | str] = []
    for joint in tree.joints.values():
        if joint.parent not in rigid or joint.name in taken or not _turns_round(joint):
            continue
        try:
            found.append(_wheel(tree, arm, joint))
        except RobotFileError as error:
            found.append(str(error))
    return found


def _named(tree: Tree, arm: Arm, name: str, side: str) -> _Wheel:
    joint = tree.joints.get(name) or tree.joint_of.get(name)
    if joint is None:
        turning = [j.name for j in tree.joints.values() if _turns_round(j)]
        raise RobotFileError(
            f"--wheels: there is no joint or link {name!r}; joints that turn without end: "
            f"{', '.join(turning) or '(none)'}"
        )
    if joint.child not in arm.base_links:
        raise RobotFileError(f"--wheels: {name!r} ({side}) is not on the base")
    if not _turns_round(joint):
        raise RobotFileError(f"--wheels: {joint.name} is no wheel: it is {joint.kind}")
    if joint.parent not in rigid_to_base(tree, arm):
        raise RobotFileError(f"--wheels: {joint.name} is a caster's wheel: its fork turns too")
    try:
        return _wheel(tree, arm, joint)
    except RobotFileError as error:
        raise RobotFileError(f"--wheels: {error}") from None


def _turns_round(joint: Joint) -> bool:
    if joint.kind == "continuous":
        return True
    span = (joint.upper or 0.0) - (joint.lower or 0.0)
    return joint.kind == "revolute" and span > 4 * np.pi


def _wheel(tree: Tree, arm: Arm, joint: Joint) -> _Wheel:
    T = tree.pose(joint.child, arm.base)
    axis = T.rotation @ joint.axis
    if np.linalg.norm(axis[:2]) < _LEVEL:
        raise RobotFileError(f"{joint.name} is no wheel: its axis is not level")
    links = tree.rigid(joint.child)
    touched = [s for link in links for s in read_shapes(tree, link)]
    if not touched:
        raise RobotFileError(f"{joint.name}: {joint.child} has no shape to read a radius from")
    try:
        r, how = _radius(touched, joint)
    except RobotFileError:  # a wheel may collide as a box: then what is seen counts
        r, how = _radius([s for link in links for s in looks(tree, link).shapes], joint)
    return _Wheel(joint, T.translation.copy(), axis, r, how)


def _radius(shapes: Sequence, joint: Joint) -> tuple[float, str]:
    """Radius about the joint's axis, and where it comes from."""
    stated = [s for s in shapes if s.radius is not None]
    if stated:
        return max(s.radius for s in stated), f"{stated[0].kind} of {joint.child}"
    points = np.vstack([np.asarray(s.hull.vertices) for s in shapes])
    one = np.cross(joint.axis, [1.0, 0.0, 0.0])
    if np.linalg.norm(one) < 0.5:
        one = np.cross(joint.axis, [0.0, 1.0, 0.0])
    one /= np.linalg.norm(one)
    two = np.cross(joint.axis, one)
    flat = points @ np.column_stack([one, two])
    widths = [float(np.ptp(flat @ [np.cos(a), np.sin(a)])) for a in np.linspace(0, np.pi, 12)]
    r = float(np.linalg.norm(flat, axis=1).max())
    if max(widths) > (1 + _ROUND) * min(widths) or abs(2 * r / max(widths) - 1) > _ROUND:
        raise RobotFileError(
            f"{joint.name} is no wheel: {joint.child} is not round about its axis "
            f"({min(widths):.3f} to {max(widths):.3f} m wide)"
        )
    return r, f"mesh of {joint.child}"


def _mirrored(wheels: Sequence[_Wheel]) -> list[tuple[_Wheel, _Wheel]]:
    """Left and right wheels across from each other; left is where y of the base's link is larger,
    or for axles along its x axis where x is smaller.
    """
    pairs = []
    for i, a in enumerate(wheels):
        for b in wheels[i + 1 :]:
            apart = a.centre - b.centre
            across = abs(apart @ a.axis)
            off = np.linalg.norm(apart - (apart @ a.axis) * a.axis)
            if across > 0.05 and off < _SAME_PLACE and abs(a.r - b.r) <= _ALIKE * a.r:
                along_y = abs(a.axis[1]) >= abs(a.axis[0])
                swap = apart[1] < 0 if along_y else apart[0] > 0
                pairs.append((b, a) if swap else (a, b))
    return pairs
