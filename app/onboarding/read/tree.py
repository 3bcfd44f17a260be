"""The links and joints of a URDF as a tree that was checked, with poses at zero."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass
from typing import NamedTuple
from xml.etree.ElementTree import Element

import numpy as np
import pinocchio as pin

from app.errors import RobotFileError, did_you_mean
from app.robot.urdf import floats

Array = np.ndarray

MOVING = ("revolute", "continuous", "prismatic")
_MOST_NAMES = 40  # [-] that a message lists
_FARTHEST = 20.0  # [m] between neighbouring links; a robot in millimetres has hundreds


class Joint(NamedTuple):
    """One joint of a URDF.

    Attributes:
        T_parent_child: At zero.
        axis: (3,) unit vector in the child's frame.
        lower, upper, effort, velocity: Of its limit, or None where the URDF states none.
        mimic: Whether it follows another joint.
    """

    name: str
    kind: str
    parent: str
    child: str
    T_parent_child: pin.SE3
    axis: Array
    lower: float | None
    upper: float | None
    effort: float | None
    velocity: float | None
    mimic: bool

    @property
    def moves(self) -> bool:
        """Whether it is a motor's: it moves, by itself."""
        return self.kind in MOVING and not self.mimic


@dataclass(frozen=True)
class Tree:
    """A robot's links and joints.

    Attributes:
        robot: The XML.
        links: By name.
        joints: By name, in the order of the file.
        joint_of: The joint above a link, by the link's name.
    """

    robot: Element
    links: dict[str, Element]
    joints: dict[str, Joint]
    joint_of: dict[str, Joint]

    def link(self, name: str, option: str) -> str:
        """The name, if there is such a link.

        Raises:
            RobotFileError: There is none; names the option and what there is.
        """
        if name not in self.links:
            raise RobotFileError(
                f"{option}: the URDF has no link {name!r}{did_you_mean(name, self.links)}; "
                f"links: {_some(self.links)}"
            )
        return name

    def children(self, link: str) -> list[Joint]:
        """The joints below a link."""
        return [joint for joint in self.joints.values() if joint.parent == link]

    def chain(self, base: str, tip: str) -> list[Joint]:
        """The joints from one link out to another.

        Raises:
            RobotFileError: The tip does not hang on the base.
        """
        chain, link = [], tip
        while link != base:
            if link not in self.joint_of:
                raise RobotFileError(f"--tip: {tip!r} does not hang on --base {base!r}")
            chain.append(self.joint_of[link])
            link = chain[-1].parent
        return chain[::-1]

    def below(self, link: str, *, without: Iterable[str] = ()) -> list[str]:
        """A link and all that hangs on it, but not what hangs on the joints `without`."""
        found, cut = [link], set(without)
        for name in found:
            found += [j.child for j in self.children(name) if j.name not in cut]
        return found

    def rigid(self, link: str) -> list[str]:
        """A link and what is fixed to it."""
        found = [link]
        for name in found:
            found += [j.child for j in self.children(name) if j.kind not in MOVING]
        return found

    def pose(self, link: str, base: str) -> pin.SE3:
        """T_base_link with all joints at zero, for a link below the base."""
        T = pin.SE3.Identity()
        for joint in self.chain(base, link):
            T = T * joint.T_parent_child
        return T


def _some(names: Iterable[str]) -> str:
    """Names in a row, the first ones of many."""
    names = list(names)
    rest = len(names) - _MOST_NAMES
    return ", ".join(names[:_MOST_NAMES]) + (f" and {rest} more" if rest > 0 else "")


def make_tree(robot: Element) -> Tree:
    """Check and read a URDF's structure.

    Raises:
        RobotFileError: A link or joint stands twice, a joint names a link that there is not, the
            links form a closed chain or do not hang together, or the lengths are not in metres.
    """
    _once(robot, "link")
    _once(robot, "joint")
    links = {str(link.get("name")): link for link in robot.findall("link")}
    if not links:
        raise RobotFileError("the URDF has no links")
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
    _hang_together(links, joint_of)
    return Tree(robot, links, joints, joint_of)


def _once(robot: Element, tag: str) -> None:
    for name, count in Counter(each.get("name") for each in robot.findall(tag)).items():
        if not name:
            raise RobotFileError(f"a {tag} has no name")
        if count > 1:
            raise RobotFileError(f"the {tag} {name!r} stands {count} times; names must be unique")


def _hang_together(links: dict[str, Element], joint_of: dict[str, Joint]) -> None:
    roots = [name for name in links if name not in joint_of]
    if len(roots) > 1:
        raise RobotFileError(
            f"the links do not hang together: {_some(roots)} hang on no joint; "
            "a robot has one such link"
        )
    checked: set[str] = set()  # no link is passed twice, however long the chain is
    for name in links:
        seen, link = set(), name
        while link in joint_of and link not in checked:
            if link in seen:
                raise RobotFileError(f"closed chain: the link {link!r} hangs on itself")
            seen.add(link)
            link = joint_of[link].parent
        checked |= seen


def _joint(element: Element, links: dict[str, Element]) -> Joint:
    name, kind = str(element.get("name")), str(element.get("type"))
    if kind not in (*MOVING, "fixed"):
        raise RobotFileError(
            f"joint {name!r}: its type is {kind!r}; fixed, {', '.join(MOVING)} are possible"
        )
    ends = []
    for role in ("parent", "child"):
        end = element.find(role)
        link = "" if end is None else str(end.get("link"))
        if link not in links:
            raise RobotFileError(f"joint {name!r}: its {role} is {link!r}, which is no link")
        ends.append(link)
    T = origin(element, f"joint {name!r}")
    if np.abs(T.translation).max() > _FARTHEST:
        raise RobotFileError(
            f"joint {name!r} stands {np.abs(T.translation).max():g} m from its parent: lengths of "
            "a URDF are in metres, these look like millimetres"
        )
    axis = numbers(element.find("axis"), "xyz", (1.0, 0.0, 0.0), f"joint {name!r}")
    length = float(np.linalg.norm(axis))
    if kind in MOVING and length < 1e-6:
        raise RobotFileError(f"joint {name!r}: its axis is zero")
    limit = element.find("limit")

    def stated(key: str) -> float | None:
        word = None if limit is None else limit.get(key)
        try:
            return None if word is None else float(word)
        except ValueError:
            raise RobotFileError(f"joint {name!r}: {key}={word!r} should be a number") from None

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
        element.find("mimic") is not None,
    )


def origin(element: Element, where: str) -> pin.SE3:
    """The `<origin>` of an element; the identity where there is none.

    Raises:
        RobotFileError: It is not six numbers.
    """
    at = element.find("origin")
    rpy = numbers(at, "rpy", (0.0, 0.0, 0.0), where)
    return pin.SE3(pin.rpy.rpyToMatrix(*rpy), numbers(at, "xyz", (0.0, 0.0, 0.0), where))


def numbers(element: Element | None, key: str, default: tuple[float, ...], where: str) -> Array:
    """The numbers of an attribute, as many as the default has.

    Raises:
        RobotFileError: They are fewer, more or no numbers.
    """
    words = None if element is None else element.get(key)
    if words is None:
        return np.array(default)
    values = floats(words, len(default))
    if values is None:
        raise RobotFileError(f"{where}: {key}={words!r} should be {len(default)} numbers")
    return np.array(values)
