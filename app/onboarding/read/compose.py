"""An arm's URDF put on a base's."""

from __future__ import annotations

from copy import deepcopy
from pathlib import Path
from xml.etree.ElementTree import Element, SubElement

from app.errors import RobotFileError
from app.onboarding.read.source import mesh_address

PREFIX = "arm_"
"""Before the names of an arm's links and joints that the base has too."""


def compose(
    base: Element,
    arm: Element,
    *,
    link: str,
    xyz: tuple[float, ...],
    rpy: tuple[float, ...],
    arm_folder: Path,
) -> Element:
    """One robot: the arm's root fixed to a link of the base.

    Names that both have get `arm_` before them on the arm, where the tip is looked for too.

    Args:
        base: The base's `<robot>`.
        arm: The arm's.
        link: Link of the base.
        xyz: [m] the arm's root in it.
        rpy: [rad] how it is turned.
        arm_folder: Of the arm's file, for meshes by a relative path.

    Raises:
        RobotFileError: The arm's links do not hang together.
    """
    robot, arm = deepcopy(base), deepcopy(arm)
    for mesh in arm.iter("mesh"):
        mesh.set("filename", mesh_address(str(mesh.get("filename")), arm_folder))
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
