"""What a URDF says of a robot: tree, arm, shapes, wheels, inertias and limits, each checked."""

from __future__ import annotations

from copy import deepcopy
from dataclasses import dataclass
from xml.etree.ElementTree import Element, SubElement

from app.errors import RobotFileError
from app.onboarding.numbers import Limits, read_limits
from app.onboarding.read.links import LinkGeometry, LinkInertia, read_geometry, read_inertias
from app.onboarding.read.source import locate, read_robot
from app.onboarding.read.tree import Arm, Tree, find_arm, make_tree
from app.onboarding.read.wheels import Steering, Wheels, find_drive, with_rigid_suspensions
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
    tree = make_tree(_with_distinct_joints(robot))
    arm = find_arm(tree, request.base, tip, request.mount)
    limits = read_limits(arm)
    _check_ready(request, arm, limits)
    geometry = read_geometry(tree)
    if not any(geometry[name].shapes for part in arm.segments for name in part):
        raise RobotFileError(f"no link between {request.base!r} and {tip!r} has a shape")
    arm = with_rigid_suspensions(tree, arm, geometry)
    wheels, steering = find_drive(request, tree, arm, geometry)
    inertias = read_inertias(tree, arm, geometry, assume=request.assume_inertia)
    return Parsed(tree, arm, geometry, wheels, inertias, limits, steering)


def _check_ready(request: Request, arm: Arm, limits: Limits) -> None:
    """Refuse a ready pose that the description would not take."""
    if request.ready is None:
        return
    if len(request.ready) != len(arm.joints):
        names = ", ".join(joint.name for joint in arm.joints)
        raise RobotFileError(
            f"--ready: {len(request.ready)} numbers; the arm has {len(arm.joints)} joints: {names}"
        )
    for joint, q, low, high in zip(
        arm.joints, request.ready, limits.lower, limits.upper, strict=True
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
    names = [{link.get("name") for link in part.findall("link")} for part in (robot, arm)]
    return _composed(robot, arm, request), PREFIX + tip if tip in names[0] & names[1] else tip


def _with_distinct_joints(robot: Element) -> Element:
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


def _composed(base: Element, arm: Element, request: Request) -> Element:
    """One robot: the arm's root fixed to --base; its names that the base has get `arm_` in front.

    Neither of the two is changed.
    """
    robot, arm = deepcopy(base), deepcopy(arm)
    for tag, roles in (("link", ("parent", "child")), ("joint", ("mimic",))):
        taken = {each.get("name") for each in base.findall(tag)}
        for each in arm.findall(tag):
            if each.get("name") in taken:
                each.set("name", f"{PREFIX}{each.get('name')}")
        for role in roles:
            for end in arm.iterfind(f"joint/{role}"):
                if end.get(tag) in taken:
                    end.set(tag, f"{PREFIX}{end.get(tag)}")
    root = make_tree(arm).root
    known = {m.get("name") for m in base.findall("material")}
    robot.extend(m for m in arm.findall("material") if m.get("name") not in known)
    robot.extend([*arm.findall("link"), *arm.findall("joint")])
    joint = SubElement(robot, "joint", name="arm_on_base", type="fixed")
    SubElement(joint, "parent", link=request.base)
    SubElement(joint, "child", link=root)
    xyz, rpy = (" ".join(map(repr, each)) for each in (request.mount_xyz, request.mount_rpy))
    SubElement(joint, "origin", xyz=xyz, rpy=rpy)
    return robot
