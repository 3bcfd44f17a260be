"""Warnings that a user should read before using a new robot."""

from collections.abc import Iterator, Sequence
from operator import itemgetter
from typing import NamedTuple

import numpy as np
from scipy.optimize import lsq_linear

from app.border.mobile import MobileBody
from app.config import parameter
from app.control.inputs import largest_command
from app.control.limits import force_bound
from app.onboarding.fit.grouping import BY_BODIES
from app.onboarding.fit.meetings import ALWAYS
from app.onboarding.fit.travel import followers, with_travel
from app.onboarding.fit.units import moved, placements
from app.onboarding.numbers import grouped, read_limits
from app.onboarding.read.tree import FREE
from app.onboarding.read.wheels import turns_round
from app.onboarding.record import NewRobot, Parsed
from app.onboarding.whole import ARM_ON_BASE
from app.robot.bases.kind import Axis
from app.robot.link_pairs import Pair, PairDistances, candidate_pairs, sample_joints
from app.robot.model import RobotModel
from app.robot.shapes import shape_mesh
from app.robot.state import RobotState, at_rest
from app.strict import Array

_POSTURES, _SAMPLES = 100, 2000  # [-] postures near the base (upper bound), random postures
_LIMIT = "limit the joints between them by position_lower and position_upper of robot.toml"
OFTEN = 0.25  # [-] share of postures above which there is a warning


def warnings_of(robot: NewRobot) -> list[str]:
    """All warnings except that of `push_row`, one sentence each, the most serious ones first."""
    return [
        *_scale(robot),
        *_places(robot),
        *_postures(robot),
        *filter(None, [robot.held]),
        *_bodies(robot),
        *_reaches(robot),
        *_joints(robot),
        *_inertias(robot),
        *held_still(robot.parsed),
        *_moving_beside(robot),
        *robot.parsed.changes,
        *_base(robot),
    ]


def _places(robot: NewRobot) -> Iterator[str]:
    """Warnings of links of the arm below the floor or completely in l_m, in the ready posture."""
    base, placed = MobileBody(robot.model), placements(robot.model, robot.ready.q_m)
    own = robot.request.arm_urdf is None
    look = f"check {'' if own else '--mount-xyz, --mount-rpy and '}--ready"
    for unit in robot.meetings.units:
        if unit.index in robot.bodies[0].units or not unit.parts:
            continue
        corners = np.vstack([moved(part.corners, placed[unit.joint]) for part in unit.parts])
        names = ", ".join(dict.fromkeys(part.link for part in unit.parts))
        fixed = unit.index == 1  # no posture moves it
        if (deep := -float(corners[:, 2].min())) > 0.005:
            yield f"links {deep:.3g} m below the floor in the ready posture: {names}; {look}"
        elif (base.distance(corners) <= 0.0).all():
            where = "the base's body" + ", so no link can meet them" * fixed
            advice = "" if fixed and own else f", in the ready posture; {look}"
            yield f"links completely inside of {where}: {names}{advice}"


def _postures(robot: NewRobot) -> Iterator[str]:
    d_b, ready, near = robot.request.buffer, robot.ready, robot.verdict.near
    if ready.beyond_buffer < 0:
        most = np.floor(100 * (d_b + ready.beyond_buffer)) / 100
        inside = f"{-ready.beyond_buffer:.3f} m inside its buffer in the ready posture"
        helps = "set another posture by --ready"
        if most >= parameter("border.d_b").low:
            helps += f" or a --buffer-distance of at most {most:g}"
        yield f"the pair {ready.nearest} is {inside}; {helps}"
    for name in robot.verdict.always:
        share = f"{near[name]:.0%} of the free random postures (limit {ALWAYS:.0%})"
        helps = "try a smaller --buffer-distance, or another number of --bodies"
        active = f"its task is active in most postures; {helps}"
        yield f"the pair {name} is inside its buffer of {d_b:g} m in {share}: {active}"
    whys = robot.lacking
    if always := ", ".join(robot.verdict.always):
        whys = dict.fromkeys(whys, f"inside the buffer in most postures: {always}")
    for why, names in grouped(whys).items():
        yield f"{', '.join(names)}: no line for guiding: {why}"


def _bodies(robot: NewRobot) -> Iterator[str]:
    verdict, meetings, found = robot.verdict, robot.meetings, robot.detection
    if found.undetected:
        postures = f"{found.share:.1%} of the colliding random postures"
        why = "bodies that are neighbours or close by design are no pair"
        helps = f"try a smaller --buffer-distance or another number of --bodies, or {_LIMIT}"
        most = f"most are of {found.worst}"
        yield f"no pair detects the collision in {postures}; {most}; {why}: {helps}"
    if found.left_out:
        postures = f"{found.left_out} of {found.looked_at:,} random postures"
        why = "they are neighbours or close by design"
        meet = f"in {postures} links meet that no pair can monitor, because {why}"
        yield f"{meet}: {found.rule}; {_LIMIT}"
    for name, why in verdict.unwatched.items():
        if why == BY_BODIES:
            close = "its bodies are within d_b of each other in most postures"
            yield f"{name} is not monitored: {close}, although its links are not"
    for pair in sorted(meetings.nested):
        a, b = (meetings.units[unit].name for unit in pair)
        touching = f"the hulls of {a} and {b} touch in most postures"
        yield f"{touching}: they count as nested, and no pair monitors them"
    for name in verdict.spurious:
        yield f"the bodies of the pair {name} can meet, but their links never do"
    for name in verdict.near:
        if (overlap := verdict.overlap[name]) > 0.1:
            free = f"{overlap:.0%} of the free random postures"
            avoided = "the controller avoids these, although no links collide there"
            yield f"the bodies of the pair {name} overlap in {free}: {avoided}"
    for body in robot.bodies:
        links = sum(fit.volume / fit.over_cover for fit in body.fits)  # 0 for flat parts
        if (volume := sum(fit.volume for fit in body.fits)) > 2.0 * links:
            ratio = volume / links if links else np.inf
            yield f"{body.name} has {ratio:.1f} times the volume of its links"


def _reaches(robot: NewRobot) -> Iterator[str]:
    for name, reach in robot.reach.items():
        if reach.fit is not None and reach.fit.r_squared < 0.6:  # the paper's arm has 0.9
            badly = f"badly, with an R² of {reach.fit.r_squared:.2f}"
            so = "the scores of the border are only approximate"
            yield f"(9) fits the counted reachability of {name} {badly}: {so}"
    bare = [
        link
        for body in robot.bodies
        for link in body.links
        if not robot.parsed.geometry[link].shapes and robot.parsed.inertias[link].inertia.mass > 0
    ]
    if bare:
        yield f"these links have no shape, so no body encloses them: {', '.join(bare)}"


def _scale(robot: NewRobot) -> Iterator[str]:
    """Warn if links are far longer than the distances of joints, as with meshes in millimetres."""
    total, shapes = 0.0, robot.parsed.geometry
    for links in robot.parsed.arm.segments[1:]:
        sizes = [float(s.hull.extents.max()) for link in links for s in shapes[link].shapes]
        total += max(sizes, default=0.0)
    joints = robot.model.pin.jointPlacements[3:]
    apart = sum(float(np.linalg.norm(T.translation)) for T in joints)
    if total > 5.0 * apart:  # a telescope has a ratio of 3
        long = f"the arm's links have a total length of {total:.2g} m"
        helps = 'if meshes are too large in the report, set their scale="..." in the URDF'
        yield f"{long}, but its joints are only {apart:.2g} m apart in total: {helps}"


def _joints(robot: NewRobot) -> Iterator[str]:
    limits, stated = robot.parsed.limits, read_limits(robot.parsed.tree, robot.parsed.arm)
    ranges = zip(limits.lower, limits.upper, stated.lower, stated.upper, strict=True)
    for name, (low, high, lower, upper) in zip(robot.parsed.arm.names, ranges, strict=True):
        if (low, high) != (lower, upper):
            narrower = f"{low:g} … {high:g} instead of {lower:g} … {upper:g}"
            yield f"{name} is limited to {narrower}, before {limits.stops[name]}"
    fields: dict[str, str] = {}  # the first field: both position limits can be assumed alike
    for field, assumed in limits.assumed.items():
        for what, names in assumed.items():
            fields.setdefault(f"{', '.join(names)}: {what}", field.replace("_", " "))
    for part, field in fields.items():
        yield f"{field} of {part} (assumed)"


def _inertias(robot: NewRobot) -> Iterator[str]:
    arm, inertias = robot.parsed.arm, robot.parsed.inertias
    for why, links in grouped({link: each.assumed for link, each in inertias.items()}).items():
        mass = sum(inertias[link].inertia.mass for link in links)
        yield f"inertia assumed of {', '.join(links)}: {why}, {mass:.3g} kg in total"
    for joint, links in zip(arm.joints, arm.segments[1:], strict=True):
        if sum(inertias[link].inertia.mass for link in links) <= 0:
            yield f"the links directly on {joint.name} have no mass: their inertia is zero"


def held_still(parsed: Parsed) -> Iterator[str]:
    """Warnings of joints that the model fixes, except joints of the base that `turns_round`."""
    tree, arm = parsed.tree, parsed.arm
    above = [tree.joint_of[link] for link in arm.rigid_links if link != arm.base]
    if rigid := [joint for joint in above if joint.kind != "fixed"]:
        names = ", ".join(joint.name for joint in rigid)
        yield f"suspensions of wheels count as rigid on a level floor: {names}"
    own = {joint.name for joint in (*arm.joints, *rigid)}
    own.update(parsed.wheels.steering.joints if parsed.wheels.steering else ())
    carried = {link for links in arm.segments for link in links}
    held = [
        joint.name
        for link in tree.below(arm.base)
        for joint in tree.children[link]
        if joint.moves and joint.name not in own and (link in carried or not turns_round(joint))
    ]
    if held:
        why = "these joints are not between the base and --tip"
        where = "at zero or at the limit nearest to zero"
        yield f"{why}, so they are fixed {where}: {', '.join(held)}"
    if led := ", ".join(joint.name for joint in followers(tree, arm.names)):
        fixed = f"these joints follow a joint of the arm (<mimic>), but are fixed here: {led}"
        yield f"{fixed}; the bodies cover their whole travel"
    free = [joint for joint in tree.joints.values() if joint.kind in FREE]
    if names := ", ".join(j.name for j in free if j.child in tree.below(arm.base)[1:]):
        yield f"planar and floating joints are fixed: {names}"


def _moving_beside(robot: NewRobot) -> Iterator[str]:
    """Warn of links beside the arm that can move more than 5 mm out of their body; only of the link
    that moves farthest, for each body and each link of the arm's chain that carries such links.
    """
    tree, arm, model = robot.parsed.tree, robot.parsed.arm, robot.model
    for carrier in (arm.base, *(joint.child for joint in arm.joints[:-1])):
        filled = with_travel(tree, robot.parsed.geometry, carrier, arm.names)
        for body in robot.bodies:
            loose = [link for link in body.links if link not in arm.rigid_links]
            outs = [(0.0, "")]
            for link in (k for k in loose if filled[k] is not robot.parsed.geometry[k]):
                frame, own = model.pin.frames[model.pin.getFrameId(link)], tree.joint_of[link]
                if frame.parentJoint == model.body_joints[body.name] and not turns_round(own):
                    corners = moved(filled[link].corners, frame.placement)
                    outs.append((float(outside(model, body.name, corners).max()), link))
            out, link = max(outs, key=itemgetter(0))
            if out > 0.005:
                yield f"{link} can move {out:.2f} m out of its body {body.name}"


def outside(model: RobotModel, body: str, points: Array) -> Array:
    """(N,) [m] lower bounds of signed distances from a body to points (N, 3) in its joint frame."""
    found = np.full(len(points), np.inf)
    for k, shape in zip(model.shape_ids[body], model.description.body(body).shapes, strict=True):
        own = moved(points, model.geometry.geometryObjects[k].placement.inverse())
        mesh = shape_mesh(shape)
        offsets = np.einsum("ij,ij->i", mesh.face_normals, mesh.triangles[:, 0])
        found = np.minimum(found, (own @ mesh.face_normals.T - offsets).max(axis=1))
    return found


def wheels_carried(parsed: Parsed) -> list[str]:
    """Names of continuous joints on links fixed to the root of --arm-urdf, except the arm's."""
    tree, mount = parsed.tree, parsed.tree.joints.get(ARM_ON_BASE)
    fixed = () if mount is None else tree.below(mount.child, moving=False)
    turning = [j for link in fixed for j in tree.children[link] if j.kind == "continuous"]
    return [joint.name for joint in turning if joint.name not in parsed.arm.names]


def _base(robot: NewRobot) -> Iterator[str]:
    wheels, tree = robot.parsed.wheels, robot.parsed.tree
    if carried := wheels_carried(robot.parsed):
        so = "its base is now mounted on --base, with its mass and shapes"
        wheeled = f"--arm-urdf has its own wheels: {', '.join(carried)}"
        yield f"{wheeled}; if it is a complete robot, {so}"
    skids = robot.request.kind == "differential" and len(wheels.left) > 1
    if skids and robot.request.half_track is None:
        skidding = f"{2 * len(wheels.left)} driven wheels skid when the base turns"
        larger = f"its effective half track is larger than the measured {wheels.b:.3f} m"
        yield f"{skidding}: {larger}; set it by --half-track"
    if robot.request.kind == "holonomic":
        yield "the base's speed, acceleration and traction are assumed"
    elif wheels.joint_velocity is None:
        yield "the wheels have no speed limit: the base's speed is assumed"
    joints = [tree.joints[name] for name in (*wheels.left, *wheels.right)]
    if any(not joint.effort for joint in joints):
        yield "the wheels have no torque limit: the base's traction is assumed"
    ahead = wheels.T_base_floor.rotation[:, 0]
    axis = int(np.abs(ahead).argmax())
    if ahead[axis] < 0 or axis != 0:
        way = f"{'-' if ahead[axis] < 0 else ''}{'xyz'[axis]}"
        along = f"the base drives along the {way} axis of {robot.parsed.arm.base}"
        yield f"{along}: --mount-xyz is in the frame of that link"
    inertias, geometry = robot.parsed.inertias, robot.parsed.geometry
    seen = [link for link, each in geometry.items() if link in inertias and each.seen_only]
    for link in list(seen):
        spheres = all(shape.kind == "sphere" for shape in geometry[link].shapes)
        if spheres and inertias[link].assumed:
            seen.remove(link)
            counts = f"it counts as a part with {inertias[link].inertia.mass:.2g} kg"
            helps = "if it is a marker, remove its <visual>"
            yield f"{link} is a sphere with only a <visual> and no mass: {counts}; {helps}"
    if seen:
        yield f"links without a collision shape, whose visual shape is used: {', '.join(seen)}"
    if mesh_paths := robot.urdf.count('filename="/'):
        why = f"{mesh_paths} meshes are not in an installed package"
        so = "the URDF has their absolute paths: this description works only on this machine"
        yield f"{why}, so {so}"
    if not np.isfinite(robot.ready.beyond_buffer):
        yield "no monitored pair of bodies can meet, so the arm avoids nothing"


class Carried(NamedTuple):
    """Shares of postures in which the arm cannot hold the end-effector while the base moves."""

    axis: Axis  # axis of the base's motion
    speed: float  # [m/s or rad/s]
    place: float  # [-] share of the postures in which the arm cannot hold the position
    pose: float  # [-] share in which the arm cannot hold position and orientation at the same time


def carried_ee(model: RobotModel) -> tuple[Carried, ...]:
    """For each axis of the base, shares of random postures near the base in which the arm cannot
    hold the end-effector while the base moves along it at its largest commanded speed (`lost_ee`).
    """
    base, state, n_b = model.description.base, RobotState(model), model.n_b
    speeds = largest_command(base, model.description.config.admittance)
    postures = _near_postures(model)
    lost = np.zeros((len(postures), n_b, 2))
    for k, q_m in enumerate(postures):
        state.update_kinematics(at_rest(model, q_m))
        for i in range(n_b):
            moved = state.J_ee[:, :n_b] @ model.J_m_inv[:, i] * speeds[i]
            lost[k, i] = lost_ee(state.J_ee[:, n_b:], moved, model.qd_max)
    rows = zip(base.axes, speeds.tolist(), lost.mean(axis=0).tolist(), strict=True)
    return tuple(Carried(axis, speed, *shares) for axis, speed, shares in rows)


def lost_ee(J_arm: Array, moved: Array, qd_max: Array) -> tuple[bool, bool]:
    """Whether the arm cannot hold the end-effector's position, and its pose, while the base moves.

    The arm compensates with the q̇ within its speed limits that minimises ‖J_arm q̇ + `moved`‖. The
    position is lost if this residual, of the linear rows alone, exceeds a tenth of the linear
    motion. For the pose all six rows count, and a lever of 0.3 m converts angular parts to metres.
    The pose is lost if the linear or the angular part of the residual exceeds a tenth of the larger
    part of the motion, or if the position is lost.

    Args:
        J_arm: (6, n_m) Jacobian of the end-effector, linear above angular.
        moved: (6,) [m/s, rad/s] velocity of the end-effector if only the base moves.
        qd_max: (n_m,) [rad/s or m/s] speed limits of the joints.
    """
    scale = np.repeat([1.0, 0.3], 3)
    J, motion = scale[:, None] * J_arm, scale * moved

    def is_lost(rows: int) -> bool:
        found = lsq_linear(J[:rows], -motion[:rows], (-qd_max, qd_max), method="bvls")
        left = J[:rows] @ found.x + motion[:rows]
        return _larger_part(left) > 0.10 * _larger_part(motion[:rows]) + 1e-6

    place = is_lost(3)
    return place, place or is_lost(6)


def _larger_part(v: Array) -> float:
    """The larger norm of the linear and, if `v` has six entries, of the angular part."""
    return max(float(np.linalg.norm(part)) for part in np.split(v, len(v) // 3))


def holding_warning(carried: tuple[Carried, ...]) -> str:
    """A warning of base motions that the arm often (over 25 %) cannot compensate, or empty."""
    if not (often := [each for each in carried if each.place > OFTEN]):
        return ""
    motions = ", or while it ".join(
        (f"turns at {speed:g} rad/s" if axis.angular else f"moves {axis.way} at {speed:g} m/s")
        + f" (in {place:.0%} of the postures near the base; in {pose:.0%} if the orientation "
        "counts too)"
        for axis, speed, place, pose in often
    )
    why = f"the arm cannot hold its end-effector in place while the base {motions}"
    return f"{why}; during avoidance the base moves less in these directions"


def borne_push(model: RobotModel, pairs: Sequence[Pair]) -> Array:
    """(N,) [N] largest pushes on the arm towards the base that the joint torques can resist, in
    random postures at rest near the base. `pairs` are the pairs with l_m; each push is the
    `force_bound` of the pair that is nearest in its posture. Without pairs, N is 0.
    """
    distances, state, found = PairDistances(model, pairs), RobotState(model), []
    for q_m in _near_postures(model) if pairs else ():
        state.update(at_rest(model, q_m))
        distances.update_from(state.data)
        d = distances.distances()
        nearest = distances.closest(int(np.argmin(d)))
        joints = np.array([[model.body_joints[body] for body in nearest.pair]])
        J, _, d_dot = state.distance_motions(joints, nearest.core[None], nearest.n[None])
        found.append(force_bound(nearest.d, J[0], d_dot[0], state.M, state.g, model.tau_max))
    return np.array(found)


def _near_postures(model: RobotModel) -> Array:
    """(N, n_m) up to 100 random postures without contact, with the arm within 0.3 m of the base. If
    fewer than 25 of 2,000 random postures qualify, the distance does not matter. If all have
    contact, the only posture is that of the lower limits.
    """
    pairs, q_m = candidate_pairs(model), sample_joints(model, _SAMPLES, np.random.default_rng(0))
    distances = PairDistances(model, pairs).sampled(q_m)
    clear = (distances > 0.0).all(axis=1)
    to_base = distances[:, [pair.a == model.body_names[0] for pair in pairs]]
    near = clear & (to_base < 0.30).any(axis=1)
    chosen = near if near.sum() >= _POSTURES // 4 else clear
    return q_m[chosen][:_POSTURES] if chosen.any() else model.q_lower[None]
