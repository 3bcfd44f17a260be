"""The drive of a base: driven wheels, which are found by their shape, and steered wheels."""

from collections.abc import Mapping, Sequence
from contextlib import suppress
from itertools import combinations
from typing import NamedTuple

import numpy as np
import pinocchio as pin
from scipy.linalg import null_space

from app.errors import RobotFileError
from app.onboarding.read.links import Geometry, link_geometry
from app.onboarding.read.tree import Arm, Joint, Tree
from app.onboarding.request import Request, option
from app.strict import Array

_LEVEL = np.sin(np.radians(2.0))  # an axle may be tilted by 2 degrees
_ROUND = 0.08  # [-] largest relative difference of the widths of a wheel in different directions
_ALIKE = 0.03  # [-] largest relative difference of the wheels' radii
_SAME_PLACE = 0.01  # [m] largest difference of wheels' coordinates that count as equal
_UPRIGHT = np.cos(np.radians(10.0))  # a steering axis may be tilted by 10 degrees
_STEERING_RATE = 1.5  # [rad/s] assumed steering rate
_IN_LINE = 0.02  # [m] largest offset of the steered wheels along x
_ON_FLOOR = 0.02  # [m] largest height above the floor of a wheel or link that stands on it
_TRAVEL = 0.5  # [-] largest travel of a rigid suspension, relative to the wheel's radius


class Steering(NamedTuple):
    """The steered front wheels of a car-like base."""

    numbers: dict[str, tuple[float, str]]
    """Wheelbase [m], largest angle [rad] and rate [rad/s] with their sources, by field."""
    rolling: tuple[str, ...]  # joints about which the steered wheels roll
    joints: tuple[str, ...]  # steering joints


class Wheels(NamedTuple):
    """The driven wheels of a base."""

    left: tuple[str, ...]  # joints of the left wheels
    right: tuple[str, ...]
    r: float  # [m] radius; 0 for a holonomic base
    b: float  # [m] half track: half of the distance between the wheels; 0 for a holonomic base
    T_base_floor: pin.SE3  # pose of `app.onboarding.ROOT` in the base's link; x points forward
    joint_velocity: float | None  # [rad/s] limit of the wheels, if the URDF states it
    how: str  # the source of the radius
    steering: Steering | None = None  # only of a car-like base


class _Wheel(NamedTuple):
    joint: Joint
    centre: Array  # (3,) [m] in the base's link
    axis: Array  # (3,) unit vector in the base's link
    r: float  # [m]
    how: str
    bottom: float  # [m] z of the lowest point in the base's link


class _Base(NamedTuple):
    """A base, with all links and shapes of its robot, in the posture with all joints at zero."""

    tree: Tree
    arm: Arm
    geometry: Geometry

    def pose(self, link: str) -> pin.SE3:
        """T_base_link."""
        return self.tree.pose(link, self.arm.base)

    def axis(self, joint: Joint) -> Array:
        """(3,) axis of a joint in the frame of the base's link."""
        return self.pose(joint.child).rotation @ joint.axis

    def lowest(self, links: Sequence[str]) -> float | None:
        """[m] z of the lowest point of links in the base link's frame, or None without shapes."""
        places = [(self.pose(k), self.geometry[k].corners) for k in links]
        heights = [float((p @ T.rotation[2]).min() + T.translation[2]) for T, p in places if len(p)]
        return min(heights, default=None)

    def wheel(self, joint: Joint) -> _Wheel:
        """The wheel on a joint; a `RobotFileError` names the reason why there is none."""
        tree, axis, centre = self.tree, self.axis(joint), self.pose(joint.child).translation.copy()
        if abs(axis[2]) > _LEVEL:
            raise RobotFileError(f"{joint.name} is not a wheel: its axis is not horizontal")
        places = {k: tree.pose(k, joint.child) for k in tree.below(joint.child, moving=False)}
        try:
            r, how = _radius(joint, places, self.geometry)
        except RobotFileError:  # a wheel may collide as a box: then its visual shape counts
            looks = {k: link_geometry(tree.links[k], ("visual", "collision")) for k in places}
            r, how = _radius(joint, places, looks)
        return _Wheel(joint, centre, axis, r, how, float(centre[2] - r))

    def rigid_wheel(self, joint: Joint) -> _Wheel:
        """The `wheel` on a joint that `turns_round` on one of `Arm.rigid_links`; else an error."""
        if not turns_round(joint):
            raise RobotFileError(f"{joint.name} is not a wheel: it is {joint.kind}")
        if joint.parent in self.arm.rigid_links:
            return self.wheel(joint)
        chain = self.tree.chain(self.arm.base, joint.parent)
        above = next(each for each in reversed(chain) if each.kind != "fixed")
        why = "turns as the fork of a caster does"
        if above.kind == "prismatic":
            why = f"moves by {_range(above):g} m: too far for a spring"
        raise RobotFileError(f"{joint.name} hangs on {above.name}, which {why}")

    def named_wheel(self, name: str) -> _Wheel:
        """The `rigid_wheel` on a joint, or on the joint of a link; errors name --wheels."""
        joints = self.tree.joints
        joint = joints.get(name) or self.tree.joint_of.get(name)
        try:
            if joint is None:
                raise RobotFileError(f"there is no joint or link {name!r}")
            if joint.child not in self.arm.base_links[1:]:
                raise RobotFileError(f"{name!r} is not on the base")
            return self.rigid_wheel(joint)
        except RobotFileError as error:
            turning = ", ".join(each.name for each in joints.values() if turns_round(each))
            endless = f"joints without limits: {turning or '(none)'}"
            raise RobotFileError(f"--wheels: {error}; {endless}") from None

    def stands(self, joint: Joint, floor: float) -> bool:
        """Whether a joint carries a wheel that touches the floor, at the height `floor` [m]."""
        with suppress(RobotFileError):
            return abs(self.wheel(joint).bottom - floor) < _ON_FLOOR
        return False

    def suspends(self, joint: Joint, wheels: Sequence[_Wheel]) -> bool:
        """Whether a joint is a short spring, or a rocker with a level axis between its wheels."""
        if joint.kind == "prismatic":
            return _range(joint) < _TRAVEL * min(wheel.r for wheel in wheels)
        axis, at = self.axis(joint), self.pose(joint.child).translation
        rises = [float(np.cross(axis, wheel.centre - at)[2]) for wheel in wheels]
        return abs(axis[2]) <= _LEVEL and min(rises) < 0.0 < max(rises)


def with_rigid_suspensions(tree: Tree, arm: Arm, geometry: Geometry) -> Arm:
    """The arm, with the links on suspensions of wheels added to `rigid_links`."""
    base, rigid = _Base(tree, arm, geometry), list(arm.rigid_links)
    for link in rigid:
        for joint in tree.children[link]:
            if joint.name in arm.names or joint.kind not in ("prismatic", "revolute"):
                continue
            below = (tree.joint_of[name] for name in tree.below(joint.child))
            rolling = [j for j in below if turns_round(j) and abs(base.axis(j)[2]) <= _LEVEL]
            with suppress(RobotFileError):  # one of them is no wheel
                if rolling and base.suspends(joint, [base.wheel(j) for j in rolling]):
                    rigid += tree.below(joint.child, moving=False)
    return arm._replace(rigid_links=tuple(rigid))


def find_drive(request: Request, tree: Tree, arm: Arm, geometry: Geometry) -> Wheels:
    """Find the driven wheels of a base, and the steering of a car-like one. For a holonomic base,
    or with --wheel-radius and --half-track, the URDF's wheels are not used: the floor is at the
    lowest point of the base's shapes, and x of the base's link points forward. If wheels, steering
    or shapes are missing, a RobotFileError names an option that helps.
    """
    base = _Base(tree, arm, geometry)
    given = request.wheel_radius is not None and request.half_track is not None
    if request.kind == "holonomic" or given:
        if (low := base.lowest(arm.base_links)) is None:
            why = f"--base: no link of {arm.base!r} has a shape"
            raise RobotFileError(f"{why}; add a <collision> to one, or set a different --base")
        floor = pin.SE3(np.eye(3), np.array([0.0, 0.0, low]))
        r, b = request.wheel_radius or 0.0, request.half_track or 0.0
        return Wheels((), (), r, b, floor, None, "from --wheel-radius" if given else "")
    wheels = _find_wheels(base, request.wheels)
    if request.kind != "car-like":
        return wheels
    return wheels._replace(steering=_find_steering(request, base, wheels.T_base_floor))


def stands_on_floor(tree: Tree, arm: Arm, geometry: Geometry) -> bool:
    """Whether the links before the arm's first joint reach as low as the base. Then they belong to
    the base: --base may be a frame on the floor, the parent of the real base.
    """
    base = _Base(tree, arm, geometry)
    low, floor = base.lowest(arm.segments[0]), base.lowest(arm.base_links)
    return low is not None and (floor is None or low < floor + _ON_FLOOR)


def _find_wheels(base: _Base, named: tuple[str, str] | None) -> Wheels:
    """Result of `_drive` for the wheels on the joints or links `named`, or the lowest pair."""
    found = [j for j in base.tree.joints.values() if j.child in base.arm.base_links[1:]]
    turning, wheels, why = [*filter(turns_round, found)], list[_Wheel](), list[str]()
    for joint in turning:
        try:
            wheels.append(base.rigid_wheel(joint))
        except RobotFileError as error:
            why.append(str(error))
    if named is not None:
        left, right = map(base.named_wheel, named)
        if not _mirrored([left, right]):
            one, other = (f"{each.joint.name} of {each.r:.4f} m" for each in (left, right))
            unlike = "are not two equal wheels on one axle: name one wheel on each side"
            raise RobotFileError(f"--wheels: {one} radius and {other} {unlike}")
    elif pairs := _mirrored(wheels):
        lowest = min(left.bottom for left, _ in pairs)
        pairs = [pair for pair in pairs if pair[0].bottom < lowest + _SAME_PLACE]
        radii = [left.r for left, _ in pairs]
        if max(radii) > (1 + _ALIKE) * min(radii):
            names = "; ".join(f"{a.joint.name} {b.joint.name}" for a, b in pairs)
            problem = f"pairs of different radius may be the driven ones: {names}"
            raise RobotFileError(f"--wheels: {problem}; set --wheels LEFT RIGHT")
        left, right = pairs[0]
    else:
        if wheels:
            why.append(f"{', '.join(each.joint.name for each in wheels)}: no two are on one axle")
        fixed = any(joint.parent in base.arm.rigid_links for joint in turning)
        helps = "set --wheels LEFT RIGHT, their joints; " if fixed else ""
        helps += "set --wheel-radius and --half-track if the URDF has no such wheels"
        helps += "; or --kind holonomic if the base drives sideways too"
        lacking = f"no pair of wheels found under {base.arm.base!r}"
        reasons = "; ".join(why) or "no joint turns without limits"
        raise RobotFileError(f"--wheels: {lacking} ({reasons}); {helps}")
    return _drive(left, right, wheels)


def _drive(left: _Wheel, right: _Wheel, wheels: Sequence[_Wheel]) -> Wheels:
    """The drive of two wheels, and of all `wheels` of equal radius and height ahead or behind."""
    across = (left.centre - right.centre) * [1.0, 1.0, 0.0]
    sideways = across / np.linalg.norm(across)
    forward = np.cross(sideways, [0.0, 0.0, 1.0])
    floor = float(np.mean([left.bottom, right.bottom]))
    alike = [w for w in wheels if abs(w.r - left.r) <= _ALIKE * left.r]
    like = [w for w in alike if abs(w.bottom - floor) < _SAME_PLACE]
    y = [float(wheel.centre @ sideways) for wheel in (left, right)]
    sides = [[w for w in like if abs(w.centre @ sideways - own) < _SAME_PLACE] for own in y]
    middle = np.mean([np.mean([w.centre for w in side], axis=0) for side in sides], axis=0)
    rotation = np.column_stack([forward, sideways, [0.0, 0.0, 1.0]])
    T = pin.SE3(rotation, np.array([middle[0], middle[1], floor]))
    speed = min((w.joint.velocity for w in (left, right) if w.joint.velocity), default=None)
    lefts, rights = (tuple(w.joint.name for w in side) for side in sides)
    return Wheels(lefts, rights, left.r, abs(y[0] - y[1]) / 2, T, speed, left.how)


def turns_round(joint: Joint) -> bool:
    """Whether a joint is continuous, or revolute with a range of more than two turns."""
    return joint.kind == "continuous" or (joint.kind == "revolute" and _range(joint) > 4 * np.pi)


def _range(joint: Joint) -> float:
    """[rad or m] distance between the position limits of a joint; 0 without limits."""
    return (joint.upper or 0.0) - (joint.lower or 0.0)


def _radius(joint: Joint, places: Mapping[str, pin.SE3], geometry: Geometry) -> tuple[float, str]:
    """[m] radius of all shapes about a joint's axis, and its source. A RobotFileError is raised if
    shapes are missing or not round. `places` has T_child_link of links fixed to the joint's child.
    """
    shapes = [(s, T) for link, T in places.items() for s in geometry[link].shapes]
    if not shapes:
        raise RobotFileError(f"{joint.name}: {joint.child} has no shape to read a radius from")
    across = null_space(joint.axis[None])
    outlines = [(s.hull.vertices @ T.rotation.T + T.translation) @ across for s, T in shapes]
    radii = [float(np.linalg.norm(each, axis=1).max()) for each in outlines]
    r, flat, largest = max(radii), np.vstack(outlines), shapes[int(np.argmax(radii))][0]
    widths = [float(np.ptp(flat @ [np.cos(a), np.sin(a)])) for a in np.linspace(0, np.pi, 12)]
    is_round = max(widths) <= (1 + _ROUND) * min(widths)
    if not is_round or abs(2 * r / max(widths) - 1) > _ROUND:
        why = "its shapes are not centred on its axis" if is_round else "it is not round"
        shown = f"{joint.child} is not round about its axis: {why}"
        wide = f"{min(widths):.3f} to {max(widths):.3f} m wide"
        raise RobotFileError(f"{joint.name} is not a wheel: {shown} ({wide})")
    if largest.radius is not None and abs(largest.radius / r - 1) < _ROUND:
        r = largest.radius
    return r, f"{largest.kind} of {joint.child}"


def _mirrored(wheels: Sequence[_Wheel]) -> list[tuple[_Wheel, _Wheel]]:
    """Pairs of equal wheels on one axle: larger y first or, on an axle along x, smaller x first."""
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


def _find_steering(request: Request, base: _Base, T_base_floor: pin.SE3) -> Steering:
    """The steering by the upright joints of the base that carry wheels on the floor or, without
    such joints, other turning links. Options override the measured numbers.
    """
    tree, arm, floor = base.tree, base.arm, float(T_base_floor.translation[2])
    found: dict[str, list[Joint]] = {}
    for joint in tree.joints.values():
        on_it = [j for j in tree.children[joint.child] if j.kind in ("continuous", "revolute")]
        own = joint.parent in arm.rigid_links and joint.name not in arm.names and joint.moves
        if own and on_it and abs(T_base_floor.rotation[:, 2] @ base.axis(joint)) > _UPRIGHT:
            found[joint.name] = on_it
    wheeled = {k: each for k, each in found.items() if any(base.stands(j, floor) for j in each)}
    found = wheeled or found
    joints = [tree.joints[name] for name in found]
    places = [(T_base_floor.inverse() * base.pose(j.child)).translation[0] for j in joints]
    if request.wheelbase is None and (not places or np.ptp(places) > _IN_LINE):
        why = f"{len(places)} steered wheels found on {arm.base!r}"
        helps = "set --wheelbase, the distance from the rear to the front axle"
        raise RobotFileError(f"--wheelbase: {why}, but one steered axle is required; {helps}")
    if not request.wheelbase and np.mean(places) <= 0:
        why = "--wheels: the steered wheels are behind the driven ones"
        raise RobotFileError(f"{why}; set --wheels LEFT RIGHT")
    ways = [min(-(j.lower or 0.0), j.upper or 0.0) for j in joints if j.kind == "revolute"]
    tightest = min(ways, default=0.0)
    if not request.steering_limit and not 0.0 < tightest < np.pi / 2:
        why = "the URDF has no steered joint with limits below 90° to both sides"
        raise RobotFileError(f"--steering-limit: {why}; set this option")
    speeds = [joint.velocity for joint in joints if joint.velocity]
    slowest = "from the URDF: the slowest joint" if speeds else "assumed: as a small car's"
    numbers = {
        "wheelbase_m": (float(np.mean(places or 0.0)), "measured: from the rear to the front axle"),
        "steering_limit_rad": (tightest, "from the URDF: the tightest joint"),
        "steering_rate_radps": (min(speeds, default=_STEERING_RATE), slowest),
    }
    for name in numbers:
        field = name.rpartition("_")[0]
        if own := getattr(request, field):
            numbers[name] = own, f"from {option(field)}"
    rolling = tuple(joint.name for on_it in found.values() for joint in on_it)
    return Steering(numbers, rolling, tuple(found))
