"""The drive of a base: driven wheels, which are found by their shape, and steered wheels."""

from collections.abc import Mapping, Sequence
from itertools import combinations
from typing import NamedTuple

import numpy as np
import pinocchio as pin
from scipy.linalg import null_space

from app.errors import RobotFileError
from app.onboarding.read.links import LinkGeometry, LinkShape, link_geometry
from app.onboarding.read.tree import Arm, Joint, Tree
from app.onboarding.request import Request
from app.strict import Array

_LEVEL = np.cos(np.radians(2.0))  # an axle may be tilted by 2 degrees
_ROUND = 0.08  # [-] largest relative difference of the widths of a wheel in different directions
_ALIKE = 0.03  # [-] largest relative difference of the wheels' radii
_SAME_PLACE = 0.01  # [m] largest asymmetry of mirrored wheels
_UPRIGHT = np.cos(np.radians(10.0))  # a steering axis may be tilted by 10 degrees
_STEERING_RATE = 1.5  # [rad/s] assumed steering rate
_IN_LINE = 0.02  # [m] largest offset of the steered wheels along x
_ON_FLOOR = 0.02  # [m] largest height above the base's lowest point
_TRAVEL = 0.5  # [-] largest travel of a rigid suspension, relative to the wheel's radius


class Steering(NamedTuple):
    """The steered front wheels of a car-like base."""

    wheelbase: float
    """[m] distance between rear and front axle."""
    limit: float
    """[rad] largest steering angle."""
    rate: float
    """[rad/s] largest steering rate."""
    rolling: tuple[str, ...]
    """Joints about which the steered wheels roll."""
    joints: tuple[str, ...]
    """Steering joints."""
    sources: tuple[str, str, str]
    """The sources of the first three fields."""


class Wheels(NamedTuple):
    """The driven wheels of a base."""

    left: tuple[str, ...]
    """Joints of the left wheels."""
    right: tuple[str, ...]
    """Joints of the right wheels."""
    r: float
    """[m] radius; 0 for a holonomic base."""
    b: float
    """[m] half track: half of the distance between the wheels; 0 for a holonomic base."""
    T_base_floor: pin.SE3
    """Pose of the frame `app.onboarding.ROOT` in the frame of the base's link; x points forward."""
    joint_velocity: float | None
    """[rad/s] speed limit of the wheels, or None if the URDF states none."""
    how: str
    """The source of the radius."""
    steering: Steering | None = None
    """The steered wheels of a car-like base."""


class _Wheel(NamedTuple):
    joint: Joint
    centre: Array  # (3,) [m] in the base's link
    axis: Array  # (3,) unit vector in the base's link
    r: float
    how: str


def with_rigid_suspensions(tree: Tree, arm: Arm, geometry: Mapping[str, LinkGeometry]) -> Arm:
    """The arm, with the links on wheel suspensions added to `rigid_links`.

    A suspension is a joint that carries wheels and moves little on a level floor: see `_suspends`.
    """
    rigid = list(arm.rigid_links)
    for link in rigid:
        for joint in tree.children(link):
            if joint.name in arm.names or joint.kind not in ("prismatic", "revolute"):
                continue
            below = [tree.joint_of[name] for name in tree.below(joint.child)]
            try:
                wheels = [_wheel(tree, arm, geometry, j) for j in below if _rolls(tree, arm, j)]
            except RobotFileError:
                continue
            if wheels and _suspends(tree, arm, joint, wheels):
                rigid += tree.below(joint.child, moving=False)
    return arm._replace(rigid_links=tuple(rigid))


def _suspends(tree: Tree, arm: Arm, joint: Joint, wheels: Sequence[_Wheel]) -> bool:
    """Whether a joint hardly moves the wheels that it carries while they stand on a level floor.

    A spring has a travel of less than `_TRAVEL` times the wheels' radius. A rocker turns about a
    horizontal axis between its wheels, so a level floor keeps it at zero.
    """
    if joint.kind == "prismatic":
        return _range(joint) < _TRAVEL * min(wheel.r for wheel in wheels)
    T = tree.pose(joint.child, arm.base)
    axis = T.rotation @ joint.axis
    rises = [float(np.cross(axis, wheel.centre - T.translation)[2]) for wheel in wheels]
    return bool(np.linalg.norm(axis[:2]) >= _LEVEL) and min(rises) < 0.0 < max(rises)


def find_drive(
    request: Request, tree: Tree, arm: Arm, geometry: Mapping[str, LinkGeometry]
) -> Wheels:
    """Find the driven wheels of a base, and the steering of a car-like one.

    For a holonomic base, or with --wheel-radius, the URDF's wheels are not used: the floor is at
    the lowest point of the base's shapes, and the base faces the x axis of its link.

    Raises:
        RobotFileError: The URDF lacks wheels or steering; the message names an option that helps.
    """
    given = request.wheel_radius is not None and request.half_track is not None
    if request.kind == "holonomic" or given:
        if (low := _lowest(tree, arm, geometry, arm.base_links)) is None:
            raise RobotFileError(
                f"--base: no link of {arm.base!r} has a shape; add a <collision> to one, or set a "
                "different --base"
            )
        floor = pin.SE3(np.eye(3), np.array([0.0, 0.0, low]))
        r, b = request.wheel_radius or 0.0, request.half_track or 0.0
        return Wheels((), (), r, b, floor, None, "from --wheel-radius" if given else "")
    wheels = _find_wheels(tree, arm, geometry, request.wheels)
    if request.kind != "car-like":
        return wheels
    steering = _find_steering(request, tree, arm, geometry, wheels.T_base_floor)
    return wheels._replace(steering=steering)


def _lowest(
    tree: Tree, arm: Arm, geometry: Mapping[str, LinkGeometry], links: Sequence[str]
) -> float | None:
    """[m] height of the lowest point of links in the base's frame, or None without shapes."""
    places = [
        (tree.pose(link, arm.base), geometry[link].corners)
        for link in links
        if geometry[link].shapes
    ]
    heights = [float((corners @ T.rotation[2]).min() + T.translation[2]) for T, corners in places]
    return min(heights, default=None)


def stands_on_floor(tree: Tree, arm: Arm, geometry: Mapping[str, LinkGeometry]) -> bool:
    """Whether the links before the arm's first joint reach as low as the links of the base.

    Then these links belong to the base. An example is a robot whose --base is a frame on the floor,
    and whose link with wheels and arm is a child of this frame.
    """
    low = _lowest(tree, arm, geometry, arm.segments[0])
    floor = _lowest(tree, arm, geometry, arm.base_links)
    return low is not None and (floor is None or low < floor + _ON_FLOOR)


def _find_wheels(
    tree: Tree, arm: Arm, geometry: Mapping[str, LinkGeometry], named: tuple[str, str] | None
) -> Wheels:
    """The driven wheels: the wheels whose joints or links are `named`, or the lowest pair.

    Other wheels of the same radius on the floor, with the same lateral position as one of these
    two, are included. A wheel is a link of circular cross-section that `_rolls`; its parent is
    rigidly fixed to the base.
    """
    found: dict[str, _Wheel] = {}
    reasons: dict[str, str] = {}
    for joint in tree.joints.values():
        if joint.parent in arm.rigid_links and joint.name not in arm.names and turns_round(joint):
            try:
                found[joint.name] = _wheel(tree, arm, geometry, joint)
            except RobotFileError as error:
                reasons[joint.name] = str(error)
    if named is not None:
        left, right = (_named(tree, arm, found, reasons, name) for name in named)
        if not _mirrored([left, right]):
            raise RobotFileError(
                f"--wheels: {left.joint.name} of {left.r:.4f} m radius and {right.joint.name} of "
                f"{right.r:.4f} m are not two equal wheels on one axle: name one wheel on each side"
            )
    else:
        turn = ", ".join(found)
        turning = [each for each in tree.joints.values() if turns_round(each)]
        hung = [_hung(tree, each) for each in turning if each.child in arm.base_links]
        why = f"{turn}: no two are on one axle" if found else "; ".join(filter(None, hung))
        why = why or "no joint turns without limits"
        why = "; ".join([*reasons.values(), why] if found else [*reasons.values()] or [why])
        helps = "set --wheels LEFT RIGHT, their joints; " if found or reasons else ""
        left, right = _driven(_mirrored(list(found.values())), f"{arm.base!r} ({why}); {helps}")
    return _drive(left, right, list(found.values()))


def _driven(pairs: list[tuple[_Wheel, _Wheel]], where: str) -> tuple[_Wheel, _Wheel]:
    """The lowest pair of wheels; pairs of the same height must have equal radii."""
    if not pairs:
        raise RobotFileError(
            f"--wheels: no pair of wheels found under {where}"
            "set --wheel-radius and --half-track if the URDF has no such wheels; or --kind "
            "holonomic if the base drives sideways too"
        )
    lowest = min(left.centre[2] - left.r for left, _ in pairs)
    pairs = [p for p in pairs if p[0].centre[2] - p[0].r < lowest + _SAME_PLACE]
    if max(p[0].r for p in pairs) > (1 + _ALIKE) * min(p[0].r for p in pairs):
        names = "; ".join(f"{a.joint.name} {b.joint.name}" for a, b in pairs)
        raise RobotFileError(
            f"--wheels: pairs of different radius may be the driven ones: {names}; "
            "set --wheels LEFT RIGHT"
        )
    return pairs[0]


def _drive(left: _Wheel, right: _Wheel, wheels: Sequence[_Wheel]) -> Wheels:
    """The drive of a left and a right wheel, with all similar wheels in line with one of them."""
    across = (left.centre - right.centre) * [1.0, 1.0, 0.0]
    sideways = across / np.linalg.norm(across)
    forward = np.cross(sideways, [0.0, 0.0, 1.0])
    floor = float(np.mean([left.centre[2] - left.r, right.centre[2] - right.r]))
    like = {
        w.joint.name: w
        for w in wheels
        if abs(w.r - left.r) <= _ALIKE * left.r and abs(w.centre[2] - w.r - floor) < _SAME_PLACE
    }
    y = {name: float(w.centre @ sideways) for name, w in like.items()}
    y_left, y_right = (float(w.centre @ sideways) for w in (left, right))
    sides = [[n for n in like if abs(y[n] - own) < _SAME_PLACE] for own in (y_left, y_right)]
    middle = np.mean([np.mean([like[n].centre for n in side], axis=0) for side in sides], axis=0)
    rotation = np.column_stack([forward, sideways, [0.0, 0.0, 1.0]])
    T = pin.SE3(rotation, np.array([middle[0], middle[1], floor]))
    speed = min((w.joint.velocity for w in (left, right) if w.joint.velocity), default=None)
    lefts, rights = map(tuple, sides)
    return Wheels(lefts, rights, left.r, abs(y_left - y_right) / 2, T, speed, left.how)


def _named(
    tree: Tree, arm: Arm, found: Mapping[str, _Wheel], reasons: Mapping[str, str], name: str
) -> _Wheel:
    """The wheel of `found` on a named joint or link; an error states why it is no wheel."""
    joint = tree.joints.get(name) or tree.joint_of.get(name)
    if joint is not None and joint.name in found:
        return found[joint.name]
    if joint is None:
        why = f"there is no joint or link {name!r}"
    elif joint.child not in arm.base_links:
        why = f"{name!r} is not on the base"
    elif not turns_round(joint):
        why = f"{joint.name} is not a wheel: it is {joint.kind}"
    else:
        why = reasons.get(joint.name) or _hung(tree, joint) or f"{joint.name} does not roll"
    turning = ", ".join(j.name for j in tree.joints.values() if turns_round(j))
    raise RobotFileError(f"--wheels: {why}; joints without limits: {turning or '(none)'}")


def _hung(tree: Tree, joint: Joint) -> str:
    """The reason why a joint under a moving joint is no wheel; empty if no joint above it moves."""
    above = tree.joint_of.get(joint.parent)
    while above is not None and above.kind == "fixed":
        above = tree.joint_of.get(above.parent)
    if above is None:
        return ""
    if above.kind != "prismatic":
        return f"{joint.name} hangs on {above.name}, which turns as the fork of a caster does"
    way = _range(above)
    return f"{joint.name} hangs on {above.name}, which moves by {way:g} m: too far for a spring"


def turns_round(joint: Joint) -> bool:
    """Whether the range of a joint has no limits, or is more than two turns."""
    return joint.kind == "continuous" or (joint.kind == "revolute" and _range(joint) > 4 * np.pi)


def _range(joint: Joint) -> float:
    """[rad or m] distance between the position limits of a joint; 0 without limits."""
    return (joint.upper or 0.0) - (joint.lower or 0.0)


def _rolls(tree: Tree, arm: Arm, joint: Joint) -> bool:
    """Whether a joint `turns_round` about a horizontal axis."""
    level = np.linalg.norm((tree.pose(joint.child, arm.base).rotation @ joint.axis)[:2]) >= _LEVEL
    return turns_round(joint) and bool(level)


def _wheel(tree: Tree, arm: Arm, geometry: Mapping[str, LinkGeometry], joint: Joint) -> _Wheel:
    T = tree.pose(joint.child, arm.base)
    axis = T.rotation @ joint.axis
    if np.linalg.norm(axis[:2]) < _LEVEL:
        raise RobotFileError(f"{joint.name} is not a wheel: its axis is not horizontal")
    links = tree.below(joint.child, moving=False)
    places = {link: tree.pose(link, joint.child) for link in links}
    touched = [(s, T) for link, T in places.items() for s in geometry[link].shapes]
    if not touched:
        raise RobotFileError(f"{joint.name}: {joint.child} has no shape to read a radius from")
    try:
        r, how = _radius(touched, joint)
    except RobotFileError:  # a wheel may collide as a box: then its visual shape counts
        looks = {link: link_geometry(tree.links[link], ("visual", "collision")) for link in links}
        r, how = _radius([(s, places[k]) for k, each in looks.items() for s in each.shapes], joint)
    return _Wheel(joint, T.translation.copy(), axis, r, how)


def _radius(shapes: Sequence[tuple[LinkShape, pin.SE3]], joint: Joint) -> tuple[float, str]:
    """[m] radius of all shapes together about a joint's axis, and the name of the largest shape.

    Each shape has the pose of its link in the frame of the joint's child.
    """
    across = null_space(joint.axis[None])
    outlines = [(s.hull.vertices @ T.rotation.T + T.translation) @ across for s, T in shapes]
    radii = [float(np.linalg.norm(each, axis=1).max()) for each in outlines]
    r, flat, largest = max(radii), np.vstack(outlines), shapes[int(np.argmax(radii))][0]
    widths = [float(np.ptp(flat @ [np.cos(a), np.sin(a)])) for a in np.linspace(0, np.pi, 12)]
    if max(widths) > (1 + _ROUND) * min(widths) or abs(2 * r / max(widths) - 1) > _ROUND:
        round_off_axis = max(widths) <= (1 + _ROUND) * min(widths)
        why = "its shapes are not centred on its axis" if round_off_axis else "it is not round"
        raise RobotFileError(
            f"{joint.name} is not a wheel: {joint.child} is not round about its axis: {why} "
            f"({min(widths):.3f} to {max(widths):.3f} m wide)"
        )
    if largest.radius is not None and abs(largest.radius / r - 1) < _ROUND:
        r = largest.radius
    return r, f"{largest.kind} of {joint.child}"


def _mirrored(wheels: Sequence[_Wheel]) -> list[tuple[_Wheel, _Wheel]]:
    """Pairs of equal wheels on the same axle, the left one first.

    The left wheel has the larger y in the base's link or, on an axle along x, the smaller x.
    """
    pairs = []
    for a, b in combinations(wheels, 2):
        apart = a.centre - b.centre
        across = abs(apart @ a.axis)
        off = np.linalg.norm(apart - (apart @ a.axis) * a.axis)
        if across > 0.05 and off < _SAME_PLACE and abs(a.r - b.r) <= _ALIKE * a.r:
            along_y = abs(a.axis[1]) >= abs(a.axis[0])
            swap = apart[1] < 0 if along_y else apart[0] > 0
            pairs.append((b, a) if swap else (a, b))
    return pairs


def _find_steering(
    request: Request,
    tree: Tree,
    arm: Arm,
    geometry: Mapping[str, LinkGeometry],
    T_base_floor: pin.SE3,
) -> Steering:
    """The upright joints of the base that carry turning links; options override these.

    If some of these links are wheels on the floor, only their joints count.
    """
    upright: list[tuple[Joint, list[Joint], float]] = []
    floor = float(T_base_floor.translation[2])
    for joint in tree.joints.values():
        if joint.parent not in arm.rigid_links or joint.name in arm.names or not joint.moves:
            continue
        T = T_base_floor.inverse() * tree.pose(joint.child, arm.base)
        on_it = [j for j in tree.children(joint.child) if j.kind in ("continuous", "revolute")]
        if abs((T.rotation @ joint.axis)[2]) > _UPRIGHT and on_it:
            upright.append((joint, on_it, float(T.translation[0])))
    stand = [e for e in upright if any(_stands(tree, arm, geometry, j, floor) for j in e[1])]
    found = [joint for joint, *_ in stand or upright]
    rolling = [j.name for _, on_it, _ in stand or upright for j in on_it]
    places = [x for *_, x in stand or upright]
    if request.wheelbase is None and (not places or np.ptp(places) > _IN_LINE):
        raise RobotFileError(
            f"--wheelbase: {len(places)} steered wheels found on {arm.base!r}, but two on one axle "
            "are required; set --wheelbase, the distance from the rear to the front axle"
        )
    wheelbase = request.wheelbase or float(np.mean(places))
    if wheelbase <= 0:
        raise RobotFileError(
            "--wheels: the steered wheels are behind the driven ones; set --wheels LEFT RIGHT"
        )
    limit = request.steering_limit or _tightest(found)
    speeds = [joint.velocity for joint in found if joint.velocity]
    rate = request.steering_rate or min(speeds, default=_STEERING_RATE)
    measured = "measured: from the wheels to the steered"
    tightest = "from the URDF: the tightest joint"
    slowest = "from the URDF: the slowest joint" if speeds else "assumed: as a small car's"
    sources = (
        "from --wheelbase" if request.wheelbase else measured,
        "from --steering-limit" if request.steering_limit else tightest,
        "from --steering-rate" if request.steering_rate else slowest,
    )
    joints = tuple(joint.name for joint in found)
    return Steering(wheelbase, limit, rate, tuple(rolling), joints, sources)


def _stands(
    tree: Tree, arm: Arm, geometry: Mapping[str, LinkGeometry], joint: Joint, floor: float
) -> bool:
    """Whether a joint carries a wheel that touches the floor, at the height `floor` [m]."""
    try:
        wheel = _wheel(tree, arm, geometry, joint)
    except RobotFileError:
        return False
    return abs(float(wheel.centre[2]) - wheel.r - floor) < _ON_FLOOR


def _tightest(joints: Sequence[Joint]) -> float:
    """[rad] the smallest limit of joints to either side."""
    ways = [min(-(j.lower or 0.0), j.upper or 0.0) for j in joints if j.kind == "revolute"]
    if not ways or not 0.0 < min(ways) < np.pi / 2:
        raise RobotFileError(
            "--steering-limit: the URDF has no steered joint with limits below 90° to both sides; "
            "set this option"
        )
    return min(ways)
