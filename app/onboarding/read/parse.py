"""What a URDF says of a robot: tree, arm, shapes, wheels, inertias and limits, each checked."""

from __future__ import annotations

from copy import deepcopy
from dataclasses import dataclass
from xml.etree.ElementTree import Element, SubElement

from app.errors import RobotFileError
from app.onboarding.read.arm import Arm, find_arm
from app.onboarding.read.drives import Steering, find_drive
from app.onboarding.read.geometry import LinkGeometry, read_geometry
from app.onboarding.read.inertia import LinkInertia, read_inertias
from app.onboarding.read.limits import Limits, read_limits
from app.onboarding.read.source import locate, read_robot
from app.onboarding.read.tree import Tree, make_tree
from app.onboarding.read.wheels import Wheels
from app.onboarding.request import Request, package_folders

PREFIX = "arm_"
"""Before the names of an arm's links and joints that the base has too."""


@dataclass(frozen=True)
class Parsed:
    """What the URDF itself says."""

    tree: Tree
    arm: Arm
    geometry: dict[str, LinkGeometry]
    wheels: Wheels
    inertias: dict[str, LinkInertia]
    limits: Limits
    steering: Steering | None = None


def parse(request: Request) -> Parsed:
    """Read and check the URDF; everything that can be wrong with it is reported here.

    Raises:
        RobotFileError: It cannot become a robot; says why, and which option helps.
        AssetError: A package is not installed.
    """
    robot, tip = _whole_robot(request)
    tree = make_tree(with_distinct_joints(robot))
    arm = find_arm(tree, request.base, tip, request.mount)
    if request.ready is not None and len(request.ready) != len(arm.joints):
        names = ", ".join(joint.name for joint in arm.joints)
        raise RobotFileError(
            f"--ready: {len(request.ready)} numbers; the arm has {len(arm.joints)} joints: {names}"
        )
    limits = read_limits(arm)
    _check_ready(request, arm, limits)
    geometry = read_geometry(tree)
    if not any(geometry[name].shapes for part in arm.segments for name in part):
        raise RobotFileError(f"no link between {request.base!r} and {tip!r} has a shape")
    wheels, steering = find_drive(request, tree, arm)
    inertias = read_inertias(tree, arm, geometry, assume=request.assume_inertia)
    return Parsed(tree, arm, geometry, wheels, inertias, limits, steering)


def _check_ready(request: Request, arm: Arm, limits: Limits) -> None:
    """Refuse a ready pose outside of the joints' limits, which the description would not take."""
    for joint, q, low, high in zip(
        arm.joints, request.ready or (), limits.lower, limits.upper, strict=False
    ):
        if not low <= q <= high:
            raise RobotFileError(
                f"--ready: {joint.name} at {q:g} is outside of its limits, {low:g} to {high:g}"
            )


def _whole_robot(request: Request) -> tuple[Element, str]:
    """The robot with its arm on it, and the tip's name there."""
    packages = package_folders(request.package)
    robot, tip = read_robot(locate(request.urdf), packages), request.tip
    if request.arm_urdf is None:
        return robot, tip
    arm = read_robot(locate(request.arm_urdf), packages)
    for part in (robot, arm):  # what is wrong with either is reported as its own
        make_tree(part)
    taken = {link.get("name") for link in robot.findall("link")}
    in_arm = {link.get("name") for link in arm.findall("link")}
    tip = PREFIX + tip if tip in taken and tip in in_arm else tip
    xyz, rpy = request.mount_xyz, request.mount_rpy
    return compose(robot, arm, link=request.base, xyz=xyz, rpy=rpy), tip


def with_distinct_joints(robot: Element) -> Element:
    """The robot with `_joint` after the name of each joint that is a link's name too.

    A URDF may name them so, but pinocchio then cannot tell their frames apart.
    """
    links = {link.get("name") for link in robot.findall("link")}
    taken = links | {joint.get("name") for joint in robot.findall("joint")}
    robot = deepcopy(robot)
    renamed: dict[str, str] = {}
    for joint in robot.findall("joint"):
        if (name := joint.get("name")) in links and name:
            new = f"{name}_joint"
            while new in taken:
                new += "_"
            taken.add(new)
            renamed[name] = new
            joint.set("name", new)
    for mimic in robot.iterfind("joint/mimic"):
        mimic.set("joint", renamed.get(str(mimic.get("joint")), str(mimic.get("joint"))))
    return robot


def compose(
    base: Element,
    arm: Element,
    *,
    link: str,
    xyz: tuple[float, ...],
    rpy: tuple[float, ...],
) -> Element:
    """One robot: the arm's root fixed to a link of the base.

    Names that both have get `arm_` before them on the arm, where the tip is looked for too.

    Args:
        base: The base's `<robot>`.
        arm: The arm's.
        link: Link of the base.
        xyz: [m] the arm's root in it.
        rpy: [rad] how it is turned.

    Raises:
        RobotFileError: The arm's links do not hang together.
    """
    robot, arm = deepcopy(base), deepcopy(arm)
    for tag in ("link", "joint"):
        taken = {each.get("name") for each in base.findall(tag)}
        for each in arm.findall(tag):
            if each.get("name") in taken:
                _rename(arm, tag, str(each.get("name")))
    children = {str(c.get("link")) for c in arm.iterfind("joint/child")}
    roots = [str(x.get("name")) for x in arm.findall("link") if x.get("name") not in children]
    if len(roots) != 1:
        raise RobotFileError(f"--arm-urdf: it has {len(roots)} roots; an arm has one")
    known = {m.get("name") for m in base.findall("material")}
    robot.extend(m for m in arm.findall("material") if m.get("name") not in known)
    robot.extend([*arm.findall("link"), *arm.findall("joint")])
    joint = SubElement(robot, "joint", name="arm_on_base", type="fixed")
    SubElement(joint, "parent", link=link)
    SubElement(joint, "child", link=roots[0])
    SubElement(joint, "origin", xyz=" ".join(map(repr, xyz)), rpy=" ".join(map(repr, rpy)))
    return robot


def _rename(arm: Element, tag: str, name: str) -> None:
    for each in arm.findall(tag):
        if each.get("name") == name:
            each.set("name", PREFIX + name)
    if tag == "link":
        for role in ("parent", "child"):
            for end in arm.iterfind(f"joint/{role}"):
                if end.get("link") == name:
                    end.set("link", PREFIX + name)
