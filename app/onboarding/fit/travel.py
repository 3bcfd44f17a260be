"""The volume that links on joints outside of the arm's chain, such as fingers, can occupy."""

from collections.abc import Iterator, Mapping, Sequence

import numpy as np
import pinocchio as pin

from app.onboarding.read.links import Geometry, LinkGeometry, in_pieces, swept_shape
from app.onboarding.read.tree import MOVING, Joint, Tree, extends
from app.onboarding.read.wheels import turns_round

Positions = Mapping[str, float]  # [rad or m] by the names of the joints
_STEP = np.radians(10.0)  # [rad] step of the sampled angles in a range of up to 25 rad


def filled(tree: Tree, geometry: Geometry, chain: Sequence[Joint]) -> dict[str, LinkGeometry]:
    """The links' geometry in nearly convex pieces; the pieces of some links cover their motions.

    These links are those beyond the arm's last link (fingers), the other parts of telescopes, and
    those on joints that mimic a joint of the arm. `chain` has the joints of the arm.
    """
    found = {
        name: each._replace(shapes=tuple(p for shape in each.shapes for p in in_pieces(shape)))
        for name, each in geometry.items()
    }
    for sweep in _sweeps(tree, chain):
        found = with_travel(tree, found, *sweep)
    return found


def held_by(tree: Tree, chain: Sequence[Joint]) -> dict[str, str]:
    """By link: the first joint from the base or the arm to the link that has only one position in
    the model and in the shapes of `filled`. A joint that `turns_round`, as of a wheel, is left out.
    """
    moving, found = {k.name for k in tree.chain(tree.root, chain[-1].child)}, dict[str, str]()
    for carrier, without, leaders in _sweeps(tree, chain):
        joints = [tree.joint_of[link] for link in tree.below(carrier, without=without)[1:]]
        led = [each.name for each in leaders or joints if each.moves and len({*_range(each)}) > 1]
        moving.update(joint.name for joint in joints if _leader(tree, joint)[0].name in led)
    for link in tree.below(tree.root)[1:]:
        joint = tree.joint_of[link]
        held = joint.kind in MOVING and joint.name not in moving and not turns_round(joint)
        if name := found.get(joint.parent, joint.name if held else ""):
            found[link] = name
    return found


def _sweeps(tree: Tree, chain: Sequence[Joint]) -> Iterator[tuple[str, list[str], list[Joint]]]:
    """The arguments `carrier`, `without` and `leaders` of the calls of `with_travel`."""
    own = [joint.name for joint in chain]
    yield chain[-1].child, [], []
    for joint in followers(tree, own):
        beside = [each.name for each in tree.children[joint.parent] if each is not joint]
        yield joint.parent, [*own, *beside], [_leader(tree, joint)[0]]
    for slide in [joint for joint in chain[:-1] if joint.kind == "prismatic"]:
        below = tree.children[slide.child]
        other = [joint.name for joint in below if not (joint.moves and extends(tree, slide, joint))]
        yield slide.child, [*own, *other], []


def followers(tree: Tree, chain: Sequence[str]) -> list[Joint]:
    """Joints outside of the arm's chain that follow a joint of the chain (`<mimic>`)."""
    outside = [joint for joint in tree.joints.values() if joint.mimic and joint.name not in chain]
    return [joint for joint in outside if _leader(tree, joint)[0].name in chain]


def _leader(tree: Tree, joint: Joint) -> tuple[Joint, float, float]:
    """The independent joint that a joint follows, or the joint itself; multiplier and offset."""
    multiplier, offset = 1.0, 0.0
    for _ in tree.joints:  # a closed chain of mimic joints ends too
        if joint.mimic and joint.mimic[0] in tree.joints:
            name, factor, shift = joint.mimic
            offset += multiplier * shift
            joint, multiplier = tree.joints[name], multiplier * factor
    return joint, multiplier, offset


def with_travel(
    tree: Tree,
    geometry: Geometry,
    carrier: str,
    without: Sequence[str] = (),
    leaders: Sequence[Joint] = (),
) -> dict[str, LinkGeometry]:
    """Geometry in which each link below `carrier` has shapes that cover its sampled positions.

    `leaders` (if empty: all moving joints below `carrier`) move through their ranges: first one at
    a time with the others at rest (`held_at`), then all at the same share. Mimic joints follow. The
    shapes are in the frames of the links at rest. Links beyond the joints `without` do not change.
    """
    links = tree.below(carrier, without=without)[1:]
    joints = [tree.joint_of[link] for link in links]
    held = _placed(tree, links, carrier, {joint.name: held_at(joint) for joint in joints})
    leaders = leaders or [joint for joint in joints if joint.moves]
    tried = [_placed(tree, links, carrier, each) for each in _positions(joints, leaders)]
    found = dict(geometry)
    for link in links:
        motions = [held[link].actInv(places[link]) for places in tried]
        if any(not T.isIdentity(1e-6) for T in motions) and geometry[link].shapes:
            shapes = tuple(swept_shape(shape, motions) for shape in geometry[link].shapes)
            found[link] = geometry[link]._replace(shapes=shapes)
    return found


def held_at(joint: Joint) -> float:
    """[rad or m] position at rest of a joint: zero, or the limit nearest to zero."""
    low, high = joint.lower or 0.0, joint.upper or 0.0
    return 0.0 if low >= high else float(np.clip(0.0, low, high))


def _positions(joints: Sequence[Joint], leaders: Sequence[Joint]) -> Iterator[Positions]:
    ranges = {joint.name: _range(joint) for joint in leaders}
    rest = {joint.name: held_at(joint) for joint in [*joints, *leaders] if joint.moves}
    yield from ({**rest, name: q} for name, values in ranges.items() for q in values)
    most = max(map(len, ranges.values()), default=0)
    for share in np.linspace(0.0, 1.0, most):
        at = {name: each[0] + share * (each[-1] - each[0]) for name, each in ranges.items()}
        yield {**rest, **at}


def _range(joint: Joint) -> list[float]:
    """Both ends of a prismatic joint's range; for another joint, angles in equal steps over its
    range. Without a range, a prismatic joint stays at zero, and another joint makes a whole turn.
    """
    low, high, slides = joint.lower, joint.upper, joint.kind == "prismatic"
    if low is None or high is None or low >= high or high - low > 1e3:
        low, high = (0.0, 0.0) if slides else (-np.pi, np.pi)
    count = 1 if slides else min(int(np.ceil((high - low) / _STEP)), 144)
    return np.linspace(low, high, count + 1).tolist()


def _placed(tree: Tree, links: Sequence[str], carrier: str, at: Positions) -> dict[str, pin.SE3]:
    """T_carrier_link of `links` (parents first) below a carrier, at the joint positions `at`."""
    found = {carrier: pin.SE3.Identity()}
    for link in links:
        joint = tree.joint_of[link]
        leader, multiplier, offset = _leader(tree, joint)
        q = at.get(joint.name, multiplier * at.get(leader.name, 0.0) + offset)
        own = joint.motion(q) if joint.kind in MOVING else joint.T_parent_child
        found[link] = found[joint.parent] * own
    return found
