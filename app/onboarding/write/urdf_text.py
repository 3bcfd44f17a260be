"""The URDF of a description: rooted on the floor, meshes by package, an inertia for each link."""

from __future__ import annotations

from collections.abc import Mapping
from copy import deepcopy
from pathlib import Path
from xml.etree import ElementTree
from xml.etree.ElementTree import Element, SubElement

import numpy as np
import pinocchio as pin

from app.onboarding.read.arm import Arm
from app.onboarding.read.geometry import LinkGeometry
from app.onboarding.read.inertia import LinkInertia
from app.onboarding.read.source import mesh_path
from app.onboarding.read.tree import Tree

ROOT = "floor_point"
"""Link of the point on the floor below the middle between the wheels: the base's frame."""
_ENDLESS = "1e6"  # [rad] limit of a joint that turns without end


def rebased_urdf(
    tree: Tree,
    arm: Arm,
    T_base_floor: pin.SE3,
    geometry: Mapping[str, LinkGeometry],
    inertias: Mapping[str, LinkInertia],
    *,
    name: str,
    header: str,
    home: Path | None = None,
) -> str:
    """The text of the new URDF.

    The base and all below it, on a root on the floor, x forward. Meshes keep their files. A link
    that is only seen can be touched too. Endless joints become revolute with wide limits, joints
    that follow others stand still: pinocchio and pybullet then read the same robot.

    Args:
        tree: The robot.
        arm: Its arm.
        T_base_floor: The new root in the base's link.
        geometry: Of the links.
        inertias: Of the links.
        name: Of the robot.
        header: A comment at the top.
        home: Of the new URDF, for meshes that lie below it.
    """
    robot = Element("robot", name=name, version="1.2")
    robot.append(ElementTree.Comment(f" {header.replace('--', '- -')} "))
    for material in tree.robot.findall("material"):
        if material.find("color") is not None:
            robot.append(_colour_only(material))
    _add_inertial(SubElement(robot, "link", name=ROOT), pin.Inertia.Zero())
    joint = SubElement(robot, "joint", name=f"{ROOT}_joint", type="fixed")
    SubElement(joint, "parent", link=ROOT)
    SubElement(joint, "child", link=arm.base)
    _add_origin(joint, T_base_floor.inverse())
    for link in tree.below(arm.base):
        if (above := tree.joint_of.get(link)) is not None and link != arm.base:
            robot.append(_joint(_find(tree.robot, "joint", above.name)))
        robot.append(_link(tree.links[link], geometry[link], inertias[link], home))
    ElementTree.indent(robot)
    return '<?xml version="1.0"?>\n' + ElementTree.tostring(robot, encoding="unicode") + "\n"


def mesh_name(address: str, home: Path | None) -> str:
    """How the new URDF names a mesh: below its own folder, which will move, by the path in it.

    That comes first, also where Python takes a folder above for a package.

    Args:
        address: As `mesh_address` gives it.
        home: The new URDF's folder, or None if it has no meshes.
    """
    if home is not None:
        path, home = mesh_path(address).resolve(), home.resolve()
        if path.is_relative_to(home):
            return path.relative_to(home).as_posix()
    return address


def _find(robot: Element, tag: str, name: str) -> Element:
    return next(each for each in robot.findall(tag) if each.get("name") == name)


def _link(old: Element, geometry: LinkGeometry, inertia: LinkInertia, home: Path | None) -> Element:
    link = Element("link", name=str(old.get("name")))
    if inertia.assumed:
        link.append(ElementTree.Comment(f" inertia assumed: {inertia.assumed} "))
    _add_inertial(link, inertia.inertia)
    for tag in ("visual", "collision"):
        source = "visual" if tag == "collision" and geometry.seen_only else tag
        for each in old.findall(source):
            part = SubElement(link, tag)
            for child in ("origin", "geometry"):
                if (found := each.find(child)) is not None:
                    part.append(deepcopy(found))
            for mesh in part.iter("mesh"):
                mesh.set("filename", mesh_name(str(mesh.get("filename")), home))
            if tag == "visual" and (material := each.find("material")) is not None:
                part.append(_colour_only(material))
    return link


def _colour_only(material: Element) -> Element:
    """A material without its texture, which nobody draws."""
    kept = Element("material", name=material.get("name") or "unnamed")
    if (colour := material.find("color")) is not None:
        kept.append(deepcopy(colour))
    return kept


def _joint(old: Element) -> Element:
    joint = Element("joint", name=str(old.get("name")), type=str(old.get("type")))
    for tag in ("parent", "child", "origin", "axis"):
        if (found := old.find(tag)) is not None:
            joint.append(deepcopy(found))
    if joint.get("type") == "fixed":
        return joint
    limit = old.find("limit")
    kept = dict(limit.attrib) if limit is not None else {}
    if joint.get("type") == "continuous":
        joint.set("type", "revolute")
        kept |= {"lower": f"-{_ENDLESS}", "upper": _ENDLESS}
    SubElement(joint, "limit", {"effort": "0", "velocity": "0", "lower": "0", "upper": "0"} | kept)
    return joint


def _add_inertial(link: Element, inertia: pin.Inertia) -> None:
    element = SubElement(link, "inertial")
    SubElement(element, "origin", xyz=_words(inertia.lever), rpy="0 0 0")
    SubElement(element, "mass", value=f"{inertia.mass:.9g}")
    names = ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")
    values = inertia.inertia[np.triu_indices(3)]
    SubElement(element, "inertia", {n: f"{v:.9g}" for n, v in zip(names, values, strict=True)})


def _add_origin(element: Element, T: pin.SE3) -> None:
    SubElement(
        element, "origin", xyz=_words(T.translation), rpy=_words(pin.rpy.matrixToRpy(T.rotation))
    )


def _words(numbers: np.ndarray) -> str:
    return " ".join(f"{value + 0.0:.9g}" for value in np.where(np.abs(numbers) < 1e-12, 0, numbers))
