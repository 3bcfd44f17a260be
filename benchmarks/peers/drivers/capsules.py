"""Capsules for libraries whose URDF parser, urdfdom before version 6, does not support them."""

from __future__ import annotations

from xml.etree import ElementTree


def without_capsules(urdf: str) -> str:
    """The URDF with cylinders instead of capsules; pinocchio converts these back to capsules."""
    robot = ElementTree.fromstring(urdf)
    robot.attrib.pop("version")
    for link in robot.iterfind("link"):
        marks = ElementTree.Element("collision_checking")
        for collision in link.iterfind("collision"):
            for capsule in collision.iterfind("geometry/capsule"):
                capsule.tag = "cylinder"
                ElementTree.SubElement(marks, "capsule", name=str(collision.get("name")))
        if len(marks):
            link.append(marks)
    return ElementTree.tostring(robot, encoding="unicode")
