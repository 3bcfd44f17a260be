"""The URDF text for pybullet, made from the one description: only the arm's joints move."""

from __future__ import annotations

from xml.etree import ElementTree

from app.robot.description import RobotDescription
from app.robot.urdf import PLANAR_JOINTS, planar_urdf


def planar_plant_urdf(description: RobotDescription) -> str:
    """The robot on two prismatic joints and a revolute one; wheels fixed, nothing to draw."""
    tree = ElementTree.fromstring(planar_urdf(description))
    for link in tree.iterfind("link"):
        for visual in link.findall("visual"):  # pybullet would load its mesh
            link.remove(visual)
    for joint in tree.iterfind("joint"):
        if joint.get("name") not in (*PLANAR_JOINTS, *description.arm.joints):
            joint.set("type", "fixed")
    return ElementTree.tostring(tree, encoding="unicode")
