"""The links and joints of a URDF as a checked tree, and the arm in it."""

import operator
from collections import Counter, defaultdict
from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property, reduce
from itertools import takewhile
from typing import NamedTuple
from xml.etree.ElementTree import Element, SubElement

import numpy as np
import pinocchio as pin

from app.errors import RobotFileError, did_you_mean
from app.robot.assets import floats
from app.robot.urdf import colour, numbers, only_rpy, origin, stated, unit_of, without_commas
from app.strict import Array

MOVING = ("revolute", "continuous", "prismatic")
FREE = ("planar", "floating")  # kinds of joints that move a whole base
_MAX_NAMES = 40  # [-] largest number of names in a message
_LONGEST = 6.0  # [m] largest sum of an arm's joint offsets
_X = np.array([1.0, 0.0, 0.0])
PARALLEL = 0.999  # [-] smallest cosine between parallel lines


class Joint(NamedTuple):
    """One joint of a URDF; its units are rad, rad/s and N m, or m, m/s and N if prismatic. A limit
    that is not stated is None, or 0 if only the other of `lower` and `upper` is stated.
    """

    name: str
    kind: str  # type in the URDF
    parent: str
    child: str
    T_parent_child: pin.SE3  # pose of the child at the position zero
    axis: Array = _X  # (3,) unit vector in the child's frame
    lower: float | None = None
    upper: float | None = None
    effort: float | None = None
    velocity: float | None = None
    mimic: tuple[str, float, float] | None = None  # leader, multiplier and offset
    unstated: str = ""  # which of `lower` and `upper` is 0 because only the other is stated

    @property
    def moves(self) -> bool:
        """Whether the joint is revolute, continuous or prismatic, and follows no other joint."""
        return self.kind in MOVING and self.mimic is None

    def motion(self, q: float) -> pin.SE3:
        """T_parent_child at the position q of a revolute, continuous or prismatic joint."""
        if self.kind == "prismatic":
            return self.T_parent_child * pin.SE3(np.eye(3), q * self.axis)
        return self.T_parent_child * pin.SE3(pin.exp3(q * self.axis), np.zeros(3))


@dataclass(frozen=True)
class Tree:
    """The links and joints of a robot by name."""

    links: dict[str, Element]
    joints: dict[str, Joint]

    @cached_property
    def joint_of(self) -> dict[str, Joint]:
        """The joint between each link and its parent, by the name of the link; not for the root."""
        return {joint.child: joint for joint in self.joints.values()}

    @property
    def root(self) -> str:
        """The link that is the child of no joint."""
        return next(link for link in self.links if link not in self.joint_of)

    def check_link(self, name: str, option: str) -> None:
        """Raise a RobotFileError, which names `option` and the links, if no link has this name."""
        if name not in self.links:
            why = f"{option}: the URDF has no link {name!r}{did_you_mean(name, self.links)}"
            raise RobotFileError(f"{why}; links: {_some(self.links)}")

    @cached_property
    def children(self) -> defaultdict[str, list[Joint]]:
        """The joints between each link and its children, by the name of the link."""
        found = defaultdict[str, list[Joint]](list)
        for joint in self.joints.values():
            found[joint.parent].append(joint)
        return found

    def chain(self, base: str, tip: str) -> list[Joint]:
        """The joints from `base` to `tip`; a RobotFileError if `tip` is no descendant of `base`."""
        chain, link = [], tip
        while link != base:
            if link not in self.joint_of:
                why = f"--tip: {tip!r} is not a descendant of --base {base!r}"
                some = _some(self.below(base)[1:]) or "(none)"
                raise RobotFileError(f"{why}; descendants of {base!r}: {some}")
            chain.append(self.joint_of[link])
            link = chain[-1].parent
        return chain[::-1]

    def below(
        self, link: str, *, without: Collection[str] = (), moving: bool = True
    ) -> tuple[str, ...]:
        """A link and its descendants outwards, except those beyond the joints named in `without`
        and, if `moving` is False, those beyond joints of the kinds `MOVING`.
        """
        found = [link]
        for name in found:
            joints = [j for j in self.children[name] if moving or j.kind not in MOVING]
            found += [joint.child for joint in joints if joint.name not in without]
        return tuple(found)

    def pose(self, link: str, base: str) -> pin.SE3:
        """T_base_link, with all joints at zero, of a `link` below `base`."""
        steps = (joint.T_parent_child for joint in self.chain(base, link))
        return reduce(operator.mul, steps, pin.SE3.Identity())


def _some(names: Iterable[str]) -> str:
    """A text with up to 40 names, and the number of the others."""
    first, rest = [*names][:_MAX_NAMES], [*names][_MAX_NAMES:]
    return ", ".join(first) + (f" and {len(rest)} more" if rest else "")


def make_tree(robot: Element) -> Tree:
    """Read links and joints of a URDF; in `robot`, a colour replaces each visual's material. A
    RobotFileError is raised if there is no link, a name is empty or not unique, a joint has an
    unknown type or a missing link, the links are not a tree, or a number or an axis is invalid.
    """
    for tag in ("link", "joint"):
        for name, count in Counter(each.get("name") for each in robot.findall(tag)).items():
            if not name:
                raise RobotFileError(f"a {tag} has no name")
            if count > 1:
                raise RobotFileError(f"{count} {tag}s have the name {name!r}; names must be unique")
    only_rpy(robot)
    links = {str(link.get("name")): link for link in robot.findall("link")}
    if not links:
        near = did_you_mean("link", {str(each.tag) for each in robot})
        macros = "; if it is a xacro that only defines macros, give the file that calls them"
        raise RobotFileError(f"the URDF has no <link>{near or macros}")
    joints = {str(j.get("name")): _joint(j, links) for j in robot.findall("joint")}
    tree = Tree(links, joints)
    for joint in joints.values():
        if (other := tree.joint_of[joint.child]) is not joint:
            why = f"closed chain: the link {joint.child!r} is the child of two joints"
            raise RobotFileError(f"{why}, {joint.name!r} and {other.name!r}; remove one of them")
    roots = [name for name in links if name not in tree.joint_of]
    if len(roots) > 1:
        why = f"the links are not connected: {_some(roots)} are children of no joint"
        raise RobotFileError(f"{why}; only one link, the root, may be the child of no joint")
    if lost := links.keys() - {link for root in roots for link in tree.below(root)}:
        link = min(lost)
        for _ in lost:  # from a descendant of the closed chain up into it
            link = tree.joint_of[link].parent
        raise RobotFileError(f"closed chain: the link {link!r} is its own descendant")
    materials = {each.get("name"): each for each in robot.findall("material")}
    for visual in robot.iterfind("link/visual"):  # two robots can use one name for two materials
        rgba = colour(visual, materials)
        for material in visual.findall("material"):
            visual.remove(material)
        if rgba is not None:
            words = " ".join(f"{value:.6g}" for value in rgba)
            SubElement(SubElement(visual, "material", name=f"rgba {words}"), "color", rgba=words)
    return tree


def _joint(element: Element, links: dict[str, Element]) -> Joint:
    name, kind = str(element.get("name")), str(element.get("type"))
    where, kinds = f"joint {name!r}", ("fixed", *MOVING, *FREE)
    if kind not in kinds:
        near, known = did_you_mean(kind, kinds), ", ".join(kinds)
        raise RobotFileError(f"{where}: its type is {kind!r}{near}; {known} are possible")
    ends = []
    for role in ("parent", "child"):
        end = element.find(role)
        link = "" if end is None else str(end.get("link"))
        if link not in links:
            near = did_you_mean(link, links)
            raise RobotFileError(f"{where}: its {role} is {link!r}, which is not a link{near}")
        ends.append(link)
    axis = numbers(element.find("axis"), "xyz", (1.0, 0.0, 0.0), where)
    length = float(np.linalg.norm(axis))
    if kind in MOVING and length < 1e-6:
        raise RobotFileError(f"{where}: its axis is zero")
    leader, usual = element.find("mimic"), (("multiplier", 1.0), ("offset", 0.0))
    factor, offset = (float(numbers(leader, key, (x,), where)[0]) for key, x in usual)
    mimic = None if leader is None else (str(leader.get("joint")), factor, offset)
    keys = ("lower", "upper") if kind in ("revolute", "prismatic") else ()
    limits = {key: _limit(element, key, where) for key in (*keys, "effort", "velocity")}
    lacking = [key for key in keys if limits[key] is None]
    unstated = lacking[0] if len(lacking) == 1 else ""
    if unstated:
        limits[unstated] = 0.0
    T, axis = origin(element, where), axis / max(length, 1e-12)
    return Joint(name, kind, ends[0], ends[1], T, axis, mimic=mimic, unstated=unstated, **limits)


def _limit(element: Element, key: str, where: str) -> float | None:
    """The attribute `key` of the `<limit>` of the joint `where`, or None if it is not stated."""
    if (word := stated(element.find("limit"), key, where)) is None:
        return None
    if (value := floats(word, 1)) is None:
        why = f"{where}: {key}={word!r} should be a finite number"
        raise RobotFileError(f"{why}; leave it out if there is no limit{without_commas(word)}")
    if value[0] < 0.0 and key in ("effort", "velocity"):
        raise RobotFileError(f"{where}: {key}={word!r}: it must not be negative")
    return value[0]


class Arm(NamedTuple):
    """An arm: the joints between the base and the end-effector, and the links of base and arm."""

    base: str
    tip: str  # the link that carries the end-effector
    mount: str  # the link whose origin is the arm's mount
    joints: tuple[Joint, ...]  # the n_m joints of the arm, from the base outwards
    base_links: tuple[str, ...]  # `base` and its descendants outside of the arm
    rigid_links: tuple[str, ...]  # those of `base_links` fixed to `base`, also by suspensions
    segments: tuple[tuple[str, ...], ...]
    """(n_m + 1) groups of links: the arm's links before its first joint, then the links that each
    joint moves and the next joint does not. Links on other joints, such as fingers, are included.
    """
    beside: tuple[tuple[str, ...], ...]
    """Links of each segment that a joint outside of the arm moves, such as a head. Parts of a
    telescope and links of the last segment, such as fingers, do not count."""

    @property
    def names(self) -> tuple[str, ...]:
        """(n_m,) names of `joints`."""
        return tuple(joint.name for joint in self.joints)


def find_arm(tree: Tree, base: str, tip: str, mount: str | None = None) -> Arm:
    """Find the arm between the links `base` and `tip`.

    With `mount` None, the mount is the parent link of the arm's first joint, or this joint's child
    if the parent is the base. A RobotFileError names the wrong option if a link does not exist, if
    the joints between both are no arm, or if an ancestor of `base` has shapes or other children.
    """
    tree.check_link(base, "--base")
    tree.check_link(tip, "--tip")
    chain = tree.chain(base, tip)
    _nothing_above(tree, base)
    joints = [joint for joint in chain if joint.moves]
    if far := next((each for each in chain if each.kind in FREE), None):
        why = f"the {far.kind} joint {far.name!r} between --base and --tip moves the whole base"
        raise RobotFileError(f"--base: {why}; set --base {far.child}")
    length = sum(float(np.linalg.norm(each.T_parent_child.translation)) for each in chain)
    if length > _LONGEST:
        why = f"the distances between the joints up to {tip!r} sum up to {length:.3g} m"
        units = f"lengths of a URDF are in metres, these look like {unit_of(length)}"
        raise RobotFileError(f"--tip: {why}: {units}")
    if follower := next((each.name for each in chain if each.kind in MOVING and each.mimic), None):
        why = f"--tip: the joint {follower!r} of the arm follows another joint (<mimic>)"
        helps = "remove the <mimic>, or set a --tip before it"
        raise RobotFileError(f"{why}, but each joint of the arm needs its own motor; {helps}")
    if not joints:
        why = f"--tip: no joint moves {tip!r} relative to --base {base!r}"
        raise RobotFileError(f"{why}; set a --tip beyond the arm's joints, or a --base before them")
    first = joints[0]
    fixed_part = [joint.parent for joint in chain[: chain.index(first) + 1]]
    if mount is None:
        mount = first.parent if first.parent != base else first.child
    tree.check_link(mount, "--mount")
    if mount not in (*fixed_part, first.child):
        why = f"--mount: {mount!r} is not between --base and the first joint {first.name!r}"
        raise RobotFileError(f"{why}; choose from: {', '.join(fixed_part[1:]) or first.child}")
    names = [joint.name for joint in joints]
    segments = [tree.below(mount, without=names) if mount in fixed_part[1:] else ()]
    segments += [tree.below(joint.child, without=names) for joint in joints]
    beside = (*(_beside(tree, part, joints) for part in segments[:-1]), ())
    of_arm = set().union(*segments)
    of_base = [tree.below(base, moving=moving) for moving in (True, False)]
    own, rigid = (tuple(link for link in links if link not in of_arm) for links in of_base)
    return Arm(base, tip, mount, tuple(joints), own, rigid, tuple(segments), beside)


def _beside(tree: Tree, segment: Sequence[str], chain: Sequence[Joint]) -> tuple[str, ...]:
    """Links of a segment that an independent joint outside of chain and telescopes moves."""
    slides = [joint for joint in chain if joint.kind == "prismatic" and joint.child in segment]
    found: dict[str, None] = {}
    for joint in (tree.joint_of[link] for link in segment):
        if joint.moves and joint not in chain and not any(extends(tree, k, joint) for k in slides):
            found |= dict.fromkeys(tree.below(joint.child))
    return tuple(found)


def extends(tree: Tree, slide: Joint, joint: Joint) -> bool:
    """Whether a moving joint extends a slide, as in a telescope: all joints from `slide` to `joint`
    that are not fixed are prismatic and parallel, with or without `<mimic>`.
    """
    turn = np.eye(3)
    for each in (*tree.chain(slide.child, joint.parent), joint):
        turn = turn @ each.T_parent_child.rotation
        along = abs(float(slide.axis @ turn @ each.axis)) > PARALLEL
        if each.kind != "fixed" and not (each.kind == "prismatic" and along):
            return False
    return True


def _nothing_above(tree: Tree, base: str) -> None:
    """Refuse a base whose ancestors, up to a joint of `FREE`, have shapes or other children."""
    above = reversed(tree.chain(tree.root, base))
    for joint in takewhile(lambda each: each.kind not in FREE, above):
        parent = joint.parent
        beside = ", ".join(each.child for each in tree.children[parent] if each is not joint)
        solid = any(tree.links[parent].findall(tag) for tag in ("collision", "visual"))
        if beside or solid:
            what = f"child links {beside}" if beside else "shapes"
            why = f"--base: {parent!r}, an ancestor of {base!r}, has {what}"
            raise RobotFileError(f"{why}, which the robot would lose; set --base {parent}")
