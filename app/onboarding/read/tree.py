"""The links and joints of a URDF as a checked tree, and the arm in it."""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple
from xml.etree.ElementTree import Element

import numpy as np
import pinocchio as pin

from app.errors import RobotFileError, did_you_mean
from app.robot.assets import floats
from app.robot.urdf import numbers, origin, unit_of, without_commas

Array = np.ndarray

MOVING = ("revolute", "continuous", "prismatic")
FREE = ("planar", "floating")
"""Kinds of joints for the motion of a whole base."""
ARM_ON_BASE = "arm_on_base"
"""The joint that fixes a separate arm to the base."""
_MAX_NAMES = 40  # [-] most names in a message
_LONGEST = 6.0  # [m] largest sum of an arm's joint offsets
_PARALLEL = 0.999  # [-] smallest cosine between parallel lines


class Joint(NamedTuple):
    """One joint of a URDF: its pose at zero; limits are None if the URDF states none."""

    name: str
    kind: str
    parent: str
    child: str
    T_parent_child: pin.SE3
    axis: Array
    """(3,) unit vector in the child's frame."""
    lower: float | None
    upper: float | None
    effort: float | None
    velocity: float | None
    mimic: tuple[str, float, float] | None
    """The joint that it follows, with multiplier and offset [rad or m]; None if independent."""

    @property
    def moves(self) -> bool:
        """Whether a motor moves it: it is movable and independent."""
        return self.kind in MOVING and self.mimic is None

    def motion(self, q: float) -> pin.SE3:
        """T_parent_child at a position [rad or m]."""
        if self.kind == "prismatic":
            return self.T_parent_child * pin.SE3(np.eye(3), q * self.axis)
        return self.T_parent_child * pin.SE3(pin.exp3(q * self.axis), np.zeros(3))


@dataclass(frozen=True)
class Tree:
    """A robot's XML, its links and joints by name, and the parent joint of each link."""

    robot: Element
    links: dict[str, Element]
    joints: dict[str, Joint]
    joint_of: dict[str, Joint]

    @property
    def root(self) -> str:
        """The link without a parent joint."""
        return next(link for link in self.links if link not in self.joint_of)

    def link(self, name: str, option: str) -> str:
        """The name, if that link exists.

        Raises:
            RobotFileError: It does not exist; names the option and the existing links.
        """
        if name not in self.links:
            raise RobotFileError(
                f"{option}: the URDF has no link {name!r}{did_you_mean(name, self.links)}; "
                f"links: {_some(self.links)}"
            )
        return name

    def children(self, link: str) -> list[Joint]:
        """The joints below a link."""
        return self._children.get(link, [])

    @cached_property
    def _children(self) -> dict[str, list[Joint]]:
        found: dict[str, list[Joint]] = {}
        for joint in self.joints.values():
            found.setdefault(joint.parent, []).append(joint)
        return found

    def chain(self, base: str, tip: str) -> list[Joint]:
        """The joints from one link out to another.

        Raises:
            RobotFileError: The tip is not a descendant of the base.
        """
        chain, link = [], tip
        while link != base:
            if link not in self.joint_of:
                raise RobotFileError(
                    f"--tip: {tip!r} does not hang on --base {base!r}; below that: "
                    f"{_some(self.below(base)[1:]) or '(nothing)'}"
                )
            chain.append(self.joint_of[link])
            link = chain[-1].parent
        return chain[::-1]

    def below(
        self, link: str, *, without: Collection[str] = (), moving: bool = True
    ) -> tuple[str, ...]:
        """A link and its descendants, or only those by fixed joints, without `without`."""
        found = [link]
        for name in found:
            found += [
                j.child
                for j in self.children(name)
                if j.name not in without and (moving or j.kind not in MOVING)
            ]
        return tuple(found)

    def pose(self, link: str, base: str) -> pin.SE3:
        """T_base_link with all joints at zero, for a link below the base."""
        T = pin.SE3.Identity()
        for joint in self.chain(base, link):
            T = T * joint.T_parent_child
        return T


def _some(names: Iterable[str]) -> str:
    """The first of many names in a row."""
    names = list(names)
    rest = len(names) - _MAX_NAMES
    return ", ".join(names[:_MAX_NAMES]) + (f" and {rest} more" if rest > 0 else "")


def make_tree(robot: Element) -> Tree:
    """Check and read a URDF's structure.

    Raises:
        RobotFileError: A name is not unique, a joint refers to a missing link, the
            links form a closed chain or are not connected, or the lengths are not in metres.
    """
    _once(robot, "link")
    _once(robot, "joint")
    links = {str(link.get("name")): link for link in robot.findall("link")}
    if not links:
        near = did_you_mean("link", {str(each.tag) for each in robot})
        raise RobotFileError(f"the URDF has no <link>{near}")
    joints = {str(j.get("name")): _joint(j, links) for j in robot.findall("joint")}
    joint_of: dict[str, Joint] = {}
    for joint in joints.values():
        if joint.child in joint_of:
            raise RobotFileError(
                f"closed chain: the link {joint.child!r} hangs on two joints, "
                f"{joint_of[joint.child].name!r} and {joint.name!r}; a URDF is a tree: cut the "
                "chain at one of them"
            )
        joint_of[joint.child] = joint
    tree = Tree(robot, links, joints, joint_of)
    _hang_together(tree)
    return tree


def _once(robot: Element, tag: str) -> None:
    for name, count in Counter(each.get("name") for each in robot.findall(tag)).items():
        if not name:
            raise RobotFileError(f"a {tag} has no name")
        if count > 1:
            raise RobotFileError(f"the {tag} {name!r} stands {count} times; names must be unique")


def _hang_together(tree: Tree) -> None:
    roots = [name for name in tree.links if name not in tree.joint_of]
    if len(roots) > 1:
        raise RobotFileError(
            f"the links do not hang together: {_some(roots)} hang on no joint; "
            "a robot has one such link"
        )
    if lost := tree.links.keys() - {link for root in roots for link in tree.below(root)}:
        link = min(lost)
        for _ in lost:  # up into the chain, if it hangs below it
            link = tree.joint_of[link].parent
        raise RobotFileError(f"closed chain: the link {link!r} hangs on itself")


def _joint(element: Element, links: dict[str, Element]) -> Joint:
    name, kind = str(element.get("name")), str(element.get("type"))
    if kind not in (*MOVING, *FREE, "fixed"):
        known = ", ".join((*MOVING, *FREE))
        near = did_you_mean(kind, ("fixed", *MOVING, *FREE))
        raise RobotFileError(
            f"joint {name!r}: its type is {kind!r}{near}; fixed, {known} are possible"
        )
    ends = []
    for role in ("parent", "child"):
        end = element.find(role)
        link = "" if end is None else str(end.get("link"))
        if link not in links:
            near = did_you_mean(link, links)
            raise RobotFileError(f"joint {name!r}: its {role} is {link!r}, which is no link{near}")
        ends.append(link)
    T = origin(element, f"joint {name!r}")
    axis = numbers(element.find("axis"), "xyz", (1.0, 0.0, 0.0), f"joint {name!r}")
    length = float(np.linalg.norm(axis))
    if kind in MOVING and length < 1e-6:
        raise RobotFileError(f"joint {name!r}: its axis is zero")
    limit = element.find("limit")

    def stated(key: str) -> float | None:
        word = None if limit is None else limit.get(key)
        value = None if word is None else floats(word, 1)
        if word is not None and value is None:
            raise RobotFileError(
                f"joint {name!r}: {key}={word!r} should be a finite number; leave it out if "
                f"there is no limit{without_commas(word)}"
            )
        if value is not None and value[0] < 0.0 and key in ("effort", "velocity"):
            raise RobotFileError(f"joint {name!r}: {key}={word!r}: a size is not below zero")
        return None if value is None else value[0]

    bounded = kind in ("revolute", "prismatic")
    return Joint(
        name,
        kind,
        ends[0],
        ends[1],
        T,
        axis / max(length, 1e-12),
        stated("lower") if bounded else None,
        stated("upper") if bounded else None,
        stated("effort"),
        stated("velocity"),
        _mimic(element, name),
    )


def _mimic(element: Element, name: str) -> tuple[str, float, float] | None:
    if (found := element.find("mimic")) is None:
        return None
    where = f"joint {name!r}"
    multiplier, offset = (
        float(numbers(found, key, (default,), where)[0])
        for key, default in (("multiplier", 1.0), ("offset", 0.0))
    )
    return str(found.get("joint")), multiplier, offset


class Arm(NamedTuple):
    """The arm's chain: `tip` carries the end-effector."""

    base: str
    tip: str
    mount: str
    """Link whose origin is the arm's mount."""
    joints: tuple[Joint, ...]
    """The joints that move it, from the base outwards."""
    base_links: tuple[str, ...]
    """All links that are fixed to the base or descend from it, except the arm; includes wheels."""
    rigid_links: tuple[str, ...]
    """Those of them that do not move relative to the base."""
    segments: tuple[tuple[str, ...], ...]
    """(n_m + 1) segments of links that move as one: first the links below the first joint, then
    those of each joint, with joints beside the chain (fingers) fixed at zero."""
    beside: tuple[tuple[str, ...], ...]
    """For each segment except the last, its links on other joints than the arm's: a head."""


def find_arm(tree: Tree, base: str, tip: str, mount: str | None = None) -> Arm:
    """The arm between two links, with its mount at `mount` or at the parent of its first joint.

    Raises:
        RobotFileError: A link does not exist, or no joint moves between them; names the option.
    """
    tree.link(base, "--base")
    tree.link(tip, "--tip")
    chain = tree.chain(base, tip)
    _nothing_above(tree, base)
    joints = [joint for joint in chain if joint.moves]
    if far := next((each for each in chain if each.kind in FREE), None):
        raise RobotFileError(
            f"--base: the {far.kind} joint {far.name!r} between it and the arm is the base's own "
            f"motion; give --base {far.child}"
        )
    length = sum(float(np.linalg.norm(each.T_parent_child.translation)) for each in chain)
    if length > _LONGEST:
        raise RobotFileError(
            f"--tip: the joints to {tip!r} are {length:.3g} m apart one after the other: lengths "
            f"of a URDF are in metres, these look like {unit_of(length)}"
        )
    if follower := next((each.name for each in chain if each.kind in MOVING and each.mimic), None):
        raise RobotFileError(
            f"--tip: the joint {follower!r} of the arm follows another one (<mimic>): each joint "
            "needs a motor of its own; take the <mimic> away, or give a --tip before it"
        )
    if not joints:
        raise RobotFileError(
            f"--tip: no joint moves {tip!r} against --base {base!r}; give one farther out, or a "
            "--base before the arm"
        )
    first = joints[0]
    on_chain = [joint.parent for joint in chain]
    fixed_part = on_chain[: on_chain.index(first.parent) + 1]
    if mount is None:
        mount = first.parent if first.parent != base else first.child
    elif tree.link(mount, "--mount") not in (*fixed_part, first.child):
        raise RobotFileError(
            f"--mount: {mount!r} is not between --base and the first joint {first.name!r}; "
            f"choose from: {', '.join(fixed_part[1:]) or first.child}"
        )
    segments = [tree.below(mount, without=[first.name]) if mount in fixed_part[1:] else ()]
    for joint, following in zip(joints, [*joints[1:], None], strict=True):
        without = [] if following is None else [following.name]
        segments.append(tree.below(joint.child, without=without))
    beside = [_beside(tree, part, joints) for part in segments[:-1]]
    cut = [first.name, *([tree.joint_of[mount].name] if segments[0] else [])]
    base_links = tree.below(base, without=cut)
    rigid = tuple(link for link in tree.below(base, moving=False) if link in base_links)
    return Arm(base, tip, mount, tuple(joints), base_links, rigid, tuple(segments), (*beside, ()))


def _beside(tree: Tree, segment: Sequence[str], chain: Sequence[Joint]) -> tuple[str, ...]:
    """Links of a segment below movable joints outside of the chain and of telescopes."""
    slides = [joint for joint in chain if joint.kind == "prismatic" and joint.child in segment]
    hanging = [tree.joint_of[link] for link in segment if tree.joint_of[link].moves]
    roots = [
        joint.child
        for joint in hanging
        if joint not in chain and not any(parallel(slide, joint) for slide in slides)
    ]
    return tuple(dict.fromkeys(link for root in roots for link in tree.below(root)))


def parallel(a: Joint, b: Joint) -> bool:
    """Whether a slide b whose parent moves on a slide a has the same line."""
    line = b.T_parent_child.rotation @ b.axis
    return a.kind == b.kind == "prismatic" and abs(float(a.axis @ line)) > _PARALLEL


def _nothing_above(tree: Tree, base: str) -> None:
    """Check that each link between the root and the base has no shapes and no other children.

    Links above a joint that moves the whole base belong to the world, and are left out.
    """
    link = base
    while link in tree.joint_of and tree.joint_of[link].kind not in FREE:
        parent = tree.joint_of[link].parent
        beside = [j.child for j in tree.children(parent) if j.child != link]
        solid = any(tree.links[parent].findall(tag) for tag in ("collision", "visual"))
        if beside or solid:
            what = f"{', '.join(beside)} hang on" if beside else "there are shapes on"
            raise RobotFileError(
                f"--base: {what} {parent!r}, above {base!r}: they would be lost; "
                f"give --base {parent}"
            )
        link = parent
