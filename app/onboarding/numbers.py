"""The numbers of a description with their sources: limits, damping, base and reachability."""

from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from decimal import ROUND_DOWN, Context
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin

from app.border.reach import PEAK, ReachMap, fit_reachability, reach_bodies, sample_reach_map
from app.border.score import FLOOR, ReachFit
from app.errors import DescriptionError, RobotFileError
from app.jobs.pool import Workers
from app.onboarding.fit.units import placements
from app.onboarding.read.links import BASE_DENSITY, LinkInertia
from app.onboarding.read.tree import Arm, Joint, Tree
from app.onboarding.read.wheels import Wheels
from app.robot.link_pairs import candidate_pairs, sample_joints
from app.robot.model import STABLE_STEPS, RobotModel
from app.strict import Array

Inertias = dict[str, LinkInertia]  # by the names of the links
Sourced = Mapping[str, tuple[Any, str]]  # values with sources, by the field of the description

_TURN = np.pi  # [rad] assumed travel on a side without limit, from zero or from the other limit
_SPEED = {"revolute": 1.5, "continuous": 1.5, "prismatic": 0.3}  # [rad/s], [m/s] assumed limits
_SPEEDS = "1.5 rad/s or 0.3 m/s"  # these limits in words
_LARGEST = 1000.0  # [rad] or [m] position limit from which a joint has no limit on this side
_TWO_DIGITS = Context(prec=2, rounding=ROUND_DOWN)  # a bound also holds after rounding
_FASTEST = 20.0  # [rad/s] or [m/s] speed limit from which a joint counts as unlimited
_GRAVITY_SHARE = 2.5  # [-] ratio of the assumed effort to the largest gravity load
_MIN_EFFORT = {"revolute": 5.0, "continuous": 5.0, "prismatic": 50.0}  # [N m], [N] smallest assumed
_DAMPING = {"strong": 2.0, "weak": 1.0, "prismatic": 20.0}  # [N m s/rad], prismatic [N s/m]


def with_source(
    before: Mapping[str, Any], numbers: Sourced, after: Mapping[str, Any] = MappingProxyType({})
) -> dict[str, Any]:
    """A table of a description: `before`, `numbers`, `after`, then the sources of `numbers`."""
    values = {name: value for name, (value, _) in numbers.items()}
    sources = {name: why for name, (_, why) in numbers.items()}
    return {**before, **values, **after, "source": sources}


class Limits(NamedTuple):
    """Limits (n_m,) of the arm's joints [rad or m, rad/s or m/s, N m or N]."""

    lower: tuple[float, ...]
    upper: tuple[float, ...]
    velocity: tuple[float, ...]
    effort: tuple[float, ...]
    assumed: dict[str, dict[str, list[str]]]
    """Joints without a limit in the URDF, by the description's field, then by the assumed limit."""
    stops: dict[str, str]  # reasons of narrower position limits, by the name of the joint

    @property
    def numbers(self) -> Sourced:
        """The four limits with their sources, by the field of the description."""
        stops = [f"{name} is limited before {why}" for name, why in self.stops.items()]
        found = {}
        for (field, assumed), values in zip(self.assumed.items(), self[:4], strict=True):
            parts = [f"assumed for {', '.join(names)}: {what}" for what, names in assumed.items()]
            parts += stops if field.startswith("position") else []
            found[field] = values, "; ".join(["from the URDF", *parts])
        return found


def read_limits(tree: Tree, arm: Arm) -> Limits:
    """The arm's limits in the URDF, with assumed ones for missing limits of position and speed.

    A limit so large that it limits nothing counts as missing. A missing effort is 0 in the result.
    A RobotFileError is raised if position limits of a prismatic joint are missing, or if limits are
    an empty range or probably in another unit. Beside the arm, they may be missing or equal.
    """
    _check_ranges(tree, arm)
    sides = [{j.name: _position(j, side) for j in arm.joints} for side in ("lower", "upper")]
    lower, upper = (grouped({k: why for k, (_, why) in side.items()}) for side in sides)
    speeds = {joint.name: _within(joint.velocity, _FASTEST) for joint in arm.joints}
    slow = grouped({name: "" if v else _SPEEDS for name, v in speeds.items()})
    assumed = {"position_lower": lower, "position_upper": upper, "max_velocity": slow}
    low, high = (tuple(limit for limit, _ in side.values()) for side in sides)
    velocity = tuple(speeds[joint.name] or _SPEED[joint.kind] for joint in arm.joints)
    effort = tuple(_within(joint.effort, 1e5) for joint in arm.joints)
    return Limits(low, high, velocity, effort, {**assumed, "max_effort": {}}, stops={})


def grouped(whys: Mapping[str, str]) -> dict[str, list[str]]:
    """The lists of names with equal reasons in `whys`, by reason; without the empty reason."""
    found = defaultdict[str, list[str]](list)
    for name, why in whys.items():
        if why:
            found[why].append(name)
    return dict(found)


def completed(limits: Limits, arm: Arm, model: RobotModel) -> Limits:
    """The limits; a missing effort becomes 2.5 times the `gravity_load`, at least 5 N m or 50 N."""
    missing = [j.name for j, e in zip(arm.joints, limits.effort, strict=True) if not e]
    if not missing:
        return limits
    effort = tuple(
        e or round(float(max(_GRAVITY_SHARE * g, _MIN_EFFORT[j.kind])), 2)
        for j, e, g in zip(arm.joints, limits.effort, gravity_load(model), strict=True)
    )
    least = f"{_MIN_EFFORT['revolute']:g} N m or {_MIN_EFFORT['prismatic']:g} N"
    why = f"{_GRAVITY_SHARE:g} times the largest gravity load in random postures, at least {least}"
    return limits._replace(effort=effort, assumed=limits.assumed | {"max_effort": {why: missing}})


def damping(limits: Limits, arm: Arm, model: RobotModel) -> tuple[float, ...]:
    """(n_m,) [N m s/rad or N s/m] damping D of the joints while a person guides the arm.

    It is 2 N m s/rad for a joint with an effort of at least 30 N m and 1 N m s/rad for a weaker
    one, as for the paper's robot, and 20 N s/m for a prismatic joint. It is at most m/(3 ms), which
    is stable in pybullet; m is the smallest `RobotModel.joint_inertia` in random postures.
    """
    least = 1.0 / largest_of_postures(model, lambda q: 1.0 / model.joint_inertia(q))
    found = []
    for joint, effort, m in zip(arm.joints, limits.effort, least, strict=True):
        strength = "strong" if effort >= 30.0 else "weak"
        wanted = _DAMPING["prismatic" if joint.kind == "prismatic" else strength]
        found.append(float(_TWO_DIGITS.create_decimal(min(wanted, m / (STABLE_STEPS * 1e-3)))))
    return tuple(found)


def gravity_load(model: RobotModel) -> Array:
    """(n_m,) [N m or N] largest magnitudes of the gravity torques in random postures."""
    data = model.pin.createData()
    return largest_of_postures(
        model, lambda q: np.abs(pin.computeGeneralizedGravity(model.pin, data, q)[3:])
    )


def largest_of_postures(model: RobotModel, values: Callable[[Array], Array]) -> Array:
    """(n_m,) maximum over random postures of `values`, a function of pinocchio's configuration."""
    postures = sample_joints(model, 400, np.random.default_rng(0))
    q = (model.configuration((0.0, 0.0, 0.0), posture) for posture in postures)
    return np.max([values(each) for each in q], axis=0)


def _range(joint: Joint) -> list[float | None]:
    """The lower and the upper limit of a joint; None if missing or outside of ±`_LARGEST`."""
    return [None if q is None or abs(q) >= _LARGEST else q for q in (joint.lower, joint.upper)]


def _position(joint: Joint, side: str) -> tuple[float, str]:
    """A joint's limit on a `side` (`lower`, `upper`), and words for an assumed limit, or empty."""
    low, high = _range(joint)
    own, other = (low, high) if side == "lower" else (high, low)
    if own is not None:
        return own, "0, as the URDF states only the other" if joint.unstated == side else ""
    both = " in both directions" if other is None else ""
    at = min(0.0, other or 0.0) - _TURN if side == "lower" else max(0.0, other or 0.0) + _TURN
    return at, f"half a turn{both}"


def _check_ranges(tree: Tree, arm: Arm) -> None:
    """Refuse implausible position limits; one message names all joints and their corrections."""
    wrong = defaultdict[str, list[str]](list)
    screws = {j.mimic[0] for j in tree.joints.values() if j.mimic and j.kind == "prismatic"}
    for joint in (tree.joint_of[link] for link in tree.below(arm.base)[1:]):
        limits = [q for q in _range(joint) if q is not None]
        farthest = max(map(abs, limits), default=0.0)
        if joint.name not in arm.names and (joint.mimic or not limits or len({*_range(joint)}) < 2):
            continue
        turns = joint.name in screws or (joint.child in arm.base_links and not sum(limits))  # wheel
        if joint.kind == "prismatic" and len(limits) < 2:
            why = "are prismatic without a limit on each side; write both limits in the <limit>"
        elif limits == [0.0, 0.0]:
            why = "have limits of 0, as some exporters write; write those of the real joints, as "
            why += '<limit lower="-3.14" upper="3.14" effort="50" velocity="1"/>'
        elif len(limits) == 2 and not limits[0] < limits[1]:
            why = "have a lower limit that is not below the upper limit; correct the <limit>"
        elif joint.kind == "prismatic" and farthest > 5.0:
            why = "have limits of many metres, which are probably millimetres; write metres"
        elif joint.kind == "revolute" and farthest > 4 * np.pi and not turns:
            why = 'have limits of over two turns, as in degrees; write radians or type="continuous"'
        else:
            continue
        stated = f" ({joint.lower:g} to {joint.upper:g})" if limits else ""
        wrong[why].append(joint.name + stated)
    if wrong:
        raise RobotFileError("; ".join(f"joints {', '.join(n)} {why}" for why, n in wrong.items()))


def _within(value: float | None, most: float) -> float:
    return value if value and 0 < value < most else 0.0


def with_plausible_base(inertias: Inertias, base_links: Sequence[str]) -> Inertias:
    """The inertias of all links; a large assumed total mass of the base's links is reduced. Large
    bases are hollow: above `_COMPACT`, the mass grows with the power 2/3 of the volume.
    """
    if (total := assumed_mass(inertias, base_links)) <= _COMPACT:
        return inertias
    factor = float(np.cbrt(_COMPACT / total))
    why = f"{factor * BASE_DENSITY:.0f} {_DENSITY} in its hull"
    heavy = ((k, inertias[k].inertia) for k in base_links if _DENSITY in inertias[k].assumed)
    lighter = {k: pin.Inertia(factor * I.mass, I.lever, factor * I.inertia) for k, I in heavy}
    return {**inertias, **{k: LinkInertia(inertia, why) for k, inertia in lighter.items()}}


def assumed_mass(inertias: Inertias, links: Iterable[str]) -> float:
    """[kg] total mass of those links whose mass is assumed from their volume."""
    return sum(inertias[k].inertia.mass for k in links if _DENSITY in inertias[k].assumed)


_DENSITY = "kg/m³"  # in the reason of an assumed inertia: the mass is assumed, not stated
_COMPACT = 225.0  # [kg] mass of a base of 0.5 m³ with `BASE_DENSITY`
_BASE_SPEED = 1.0, 2.0  # [m/s], [rad/s] as for the paper's robot
_ACCELERATION = 3.0, 6.0  # [m/s²], [rad/s²] as for the paper's robot
_FRICTION = 0.5  # [-] coefficient of friction between wheels and floor
_AS_PAPERS = "assumed: as for the paper's robot"


def wheel_fields(kind: str, wheels: Wheels) -> dict[str, Any]:
    """The fields of the wheels' joints for a base of the kind `kind`; empty for a holonomic one."""
    if kind == "differential":
        return {"left_wheel_joints": wheels.left, "right_wheel_joints": wheels.right}
    if wheels.steering is None:
        return {}
    rolling = (*wheels.left, *wheels.right, *wheels.steering.rolling)
    return {"wheel_joints": rolling, "steering_joints": wheels.steering.joints}


def base_numbers(
    model: RobotModel, wheels: Wheels, inertias: Inertias, q_m: Array, half_track: float | None
) -> Sourced:
    """Numbers of the base with their sources; q_m (n_m,) is the ready posture. `half_track` [m] is
    that of --half-track; None means half of the distance between the wheels.
    """
    kind = model.description.base.kind
    M = pin.crba(model.pin, model.pin.createData(), model.configuration((0.0, 0.0, 0.0), q_m))
    mass, yaw = float(M[0, 0]), float(M[2, 2])
    fastest = wheels.joint_velocity * wheels.r if wheels.joint_velocity else np.inf
    v = min(_BASE_SPEED[0], fastest)
    limit = "from the URDF: the wheels' speed limit" if v == fastest else _AS_PAPERS
    weighed = "measured: sum of the URDF's masses"
    if assumed := assumed_mass(inertias, inertias):
        weighed = f"assumed: {assumed:.3g} kg from volumes; the rest is from the URDF"
    factor, about = 2.0, "the yaw inertia of the whole robot in its ready posture"
    inertia = f"measured: {factor:g} times {about}, as for the paper's robot"
    if wheels.steering:
        factor, inertia = 1.0, f"measured: {about}, about the rear axle"
    grip = f"assumed: friction coefficient {_FRICTION:g}, with the whole weight on driven wheels"
    found = _geometry(kind, wheels, half_track) | {
        "mass_kg": (round(mass, 2), weighed),
        "inertia_kgm2": (round(factor * yaw, 3), inertia),
        "max_linear_velocity_mps": (round(v, 3), limit),
        "max_linear_acceleration_mps2": (_ACCELERATION[0], _AS_PAPERS),
        "traction_limit_n": (round(_FRICTION * 9.81 * mass, 1), grip),
        "drive_time_constant_s": (0.05, "assumed: half of a 10 Hz command period"),
    }
    if kind != "car-like":  # the steering limits its angular velocity
        b = found["half_track_m"][0] if "half_track_m" in found else 0.0
        w = min(_BASE_SPEED[1], v / b if b else np.inf)
        one_wheel = "assumed: the wheels move at the largest linear velocity in opposite directions"
        turning = _AS_PAPERS if w == _BASE_SPEED[1] else one_wheel
        found["max_angular_velocity_radps"] = round(w, 3), turning
        found["max_angular_acceleration_radps2"] = _ACCELERATION[1], _AS_PAPERS
    return found


def _geometry(kind: str, wheels: Wheels, half_track: float | None) -> dict[str, tuple[Any, str]]:
    """Wheel radius, and half track or steering, with sources; empty for a holonomic base."""
    how = wheels.how if wheels.how.startswith("from --") else f"measured: {wheels.how}"
    radius = {"wheel_radius_m": (round(wheels.r, 5), how)}
    if kind == "holonomic":
        return {}
    if wheels.steering is not None:
        numbers = wheels.steering.numbers
        return {name: (round(value, 5), how) for name, (value, how) in numbers.items()} | radius
    track = "measured: half of the distance between the wheels' joints"
    if len(wheels.left) > 1:
        track += "; the effective half track of a base that skids is larger"
    if half_track:
        track = "from --half-track"
    return radius | {"half_track_m": (round(half_track or wheels.b, 5), track)}


SHARES = 0.5, 0.2, FLOOR
"""[-] shares of the peak above which (9) is fitted, best first; the tails are not parabolic."""
COUNTED_POSTURES = 20_000  # [-] random joint positions for counting a reachability


class Reach(NamedTuple):
    """The coefficients A [1/m²], B [m] and C [-] of (9) for one body."""

    A: float
    B: float
    C: float
    source: str
    counted: ReachMap | None  # the counted map, or None for assumed coefficients
    fit: ReachFit | None  # the fit of the counted map, or None

    def content(self) -> dict[str, Any]:
        """The coefficients with their source, in the form of a description."""
        values = {"A_per_m2": round(self.A, 1), "B_m": round(self.B, 4), "C": round(self.C, 1)}
        return with_source({}, {name: (value, self.source) for name, value in values.items()})


def find_reach(model: RobotModel, workers: Workers) -> Iterator[tuple[str, Reach]]:
    """The names of all bodies that can form a pair with l_m, with their coefficients of (9).

    `workers` start at once, before the results are read. Coefficients are those of `best_fit`, or
    assumed if fewer than three joints move the body, or if its map or `best_fit` fails.
    """
    bodies = [pair.b for pair in candidate_pairs(model) if pair.a == model.body_names[0]]
    return zip(bodies, workers.map(_reach_of, [(model, body) for body in bodies]), strict=True)


def _reach_of(_: object, job: tuple[RobotModel, str]) -> Reach:
    model, body = job
    if body not in reach_bodies(model):
        return _assumed(model, body, "fewer than three joints move it")
    try:
        counted = sample_reach_map(model, body, samples=COUNTED_POSTURES)
        fit, share = best_fit(counted)
    except DescriptionError as error:
        return _assumed(model, body, str(error))
    how = f"counted: by |det J| at {counted.samples:,} random joint positions"
    source = f"{how}; fitted above {share:g} of the peak, R² {fit.r_squared:.2f}"
    return Reach(fit.A_per_m2, fit.B_m, fit.C, source, counted, fit)


def best_fit(counted: ReachMap) -> tuple[ReachFit, float]:
    """The fit of (9) above the first of `SHARES` with a positive R², and this share [-].

    In a small workspace, the reachabilities above the first share can be almost equal. With R² ≤ 0,
    a constant fits better than (9). If no share has a positive R², this raises a DescriptionError.
    """
    why = f"{counted.body}: a constant fits the reachability map better than (9)"
    for share in SHARES:
        try:
            fit = fit_reachability(counted, share)
        except DescriptionError as error:
            why = str(error)
        else:
            if fit.r_squared > 0.0:
                return fit, share
    raise DescriptionError(why)


def _assumed(model: RobotModel, body: str, why: str) -> Reach:
    """A parabola about the mean distance of a body's first shape to the mount; `why`: reason."""
    shape, mount = model.geometry.geometryObjects[model.shape_ids[body][0]], model.p_base()
    rho = []
    for q in sample_joints(model, 2000, np.random.default_rng(0)):
        at = placements(model, q)[shape.parentJoint].act(shape.placement.translation)
        rho.append(float(np.linalg.norm(at - mount)))
    B, width = float(np.mean(rho)), max(3.0 * float(np.std(rho)), 0.1)
    source = f"assumed: a parabola about the body's mean distance in random postures; {why}"
    return Reach(PEAK / width**2, B, PEAK, source, None, None)
