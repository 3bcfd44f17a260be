"""URDF texts for pybullet, made from the one description: only the arm's joints move."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import product
from xml.etree import ElementTree
from xml.etree.ElementTree import Element, SubElement

import numpy as np
import pinocchio as pin

from app.robot.description import RobotDescription, differential
from app.robot.meshes import shape_mesh
from app.robot.model import RobotModel
from app.robot.urdf import PLANAR_JOINTS, planar_urdf, resolved_urdf, root_link

Array = np.ndarray

DRIVE_SPHERES = ("drive_right", "drive_left")
"""Joints and links of the contact base's driven spheres."""
CASTERS = ("caster_0", "caster_1", "caster_2", "caster_3")
"""Links of the contact base's frictionless spheres."""

_CASTER_LIFT = 0.0001  # [m] how much higher than the driven spheres, so that these carry the base
_SPHERE_SHARE = 0.005  # [-] mass of a driven sphere, in masses of the base; taken from the base


def planar_plant_urdf(description: RobotDescription) -> str:
    """The robot on two prismatic joints and a revolute one, wheels fixed."""
    return _lock_joints(planar_urdf(description), (*PLANAR_JOINTS, *description.arm.joints))


def contact_plant_urdf(model: RobotModel) -> str:
    """The robot free to move, on two driven spheres and four frictionless ones.

    The spheres' masses are taken from the base, so that the whole has the description's inertia.
    pybullet takes a root without mass for a fixed one: the root carries the inertia of all links
    that are fixed to it.
    """
    description = model.description
    text = _lock_joints(resolved_urdf(description), description.arm.joints)
    root = root_link(text)
    tree = ElementTree.fromstring(text)
    inertia = model.pin.inertias[1]  # of the root joint: the base and all that is fixed to it
    base = differential(description)
    r, b = base.wheel_radius_m, base.half_track_m
    mass = _SPHERE_SHARE * inertia.mass
    sphere = pin.Inertia.FromSphere(mass, r)
    for name, y in zip(DRIVE_SPHERES, (-b, b), strict=True):
        centre = np.array([0.0, y, r])
        inertia = inertia - pin.SE3(np.eye(3), centre).act(sphere)
        _add_sphere(tree, root, name, centre, r, sphere, "continuous")
    for name, (x, y) in zip(CASTERS, caster_places(model), strict=True):
        centre = np.array([x, y, r + _CASTER_LIFT])
        _add_sphere(tree, root, name, centre, r, pin.Inertia.Zero(), "fixed")
    _lump(tree, root, inertia)
    return ElementTree.tostring(tree, encoding="unicode")


def caster_places(model: RobotModel) -> Array:
    """(4, 2) [m] x and y of the casters: under the wheels, or under the corners of l_m.

    A skid-steer base stands on its four wheels. Where the wheels do not span the length (a base
    with two wheels and casters of its own), the corners of l_m's footprint are taken, a wheel's
    radius inwards.
    """
    base = differential(model.description)
    full = pin.buildModelFromXML(resolved_urdf(model.description))
    data = full.createData()
    pin.forwardKinematics(full, data, pin.neutral(full))
    wheels = [*base.left_wheel_joints, *base.right_wheel_joints]
    places = np.array([data.oMi[full.getJointId(name)].translation[:2] for name in wheels])
    if len(places) and np.ptp(places[:, 0]) > base.wheel_radius_m:
        low, high = places.min(axis=0), places.max(axis=0)
    else:
        low, high = _footprint(model)
        low, high = low + base.wheel_radius_m, high - base.wheel_radius_m
    return np.array(list(product((low[0], high[0]), (low[1], high[1]))))


def _footprint(model: RobotModel) -> tuple[Array, Array]:
    body = model.description.mobile_body
    shapes = [model.geometry.geometryObjects[i] for i in model.shape_ids[body.name]]
    corners = np.vstack(
        [
            shape_mesh(shape).apply_transform(placed.placement.homogeneous).bounds
            for shape, placed in zip(body.shapes, shapes, strict=True)
        ]
    )
    return corners.min(axis=0)[:2], corners.max(axis=0)[:2]


def _lock_joints(urdf: str, moving: Sequence[str]) -> str:
    """The URDF with every joint fixed at zero that is not among `moving`, and nothing to draw."""
    tree = ElementTree.fromstring(urdf)
    for link in tree.iterfind("link"):
        for visual in link.findall("visual"):  # pybullet would load its mesh
            link.remove(visual)
    for joint in tree.iterfind("joint"):
        if joint.get("name") not in moving:
            joint.set("type", "fixed")
    return ElementTree.tostring(tree, encoding="unicode")


def _lump(tree: Element, root: str, inertia: pin.Inertia) -> None:
    """Give the root link this inertia, and none to the links that are fixed to it."""
    fixed, todo = set(), [root]
    while todo:
        fixed.add(link := todo.pop())
        todo += [
            _end(j, "child")
            for j in tree.iterfind("joint[@type='fixed']")
            if _end(j, "parent") == link
        ]
    for link in tree.iterfind("link"):
        if link.get("name") in fixed:
            for old in link.findall("inertial"):
                link.remove(old)
            _add_inertial(link, inertia if link.get("name") == root else pin.Inertia.Zero())


def _end(joint: Element, role: str) -> str:
    element = joint.find(role)
    return "" if element is None else str(element.get("link"))


def _add_sphere(
    tree: Element, root: str, name: str, centre: Array, r: float, inertia: pin.Inertia, kind: str
) -> None:
    """A sphere of radius `r` on a joint at `centre` of the root, its axis to the left."""
    joint = SubElement(tree, "joint", name=name, type=kind)
    SubElement(joint, "parent", link=root)
    SubElement(joint, "child", link=name)
    SubElement(joint, "origin", xyz=_words(centre), rpy="0 0 0")
    SubElement(joint, "axis", xyz="0 1 0")
    link = SubElement(tree, "link", name=name)
    _add_inertial(link, inertia)
    shape = SubElement(SubElement(link, "collision"), "geometry")
    SubElement(shape, "sphere", radius=repr(float(r)))


def _add_inertial(link: Element, inertia: pin.Inertia) -> None:
    element = SubElement(link, "inertial")
    SubElement(element, "origin", xyz=_words(inertia.lever), rpy="0 0 0")
    SubElement(element, "mass", value=repr(float(inertia.mass)))
    I = inertia.inertia  # about the centre of mass
    names = {
        "ixx": (0, 0),
        "ixy": (0, 1),
        "ixz": (0, 2),
        "iyy": (1, 1),
        "iyz": (1, 2),
        "izz": (2, 2),
    }
    SubElement(element, "inertia", {name: repr(float(I[at])) for name, at in names.items()})


def _words(numbers: Array) -> str:
    return " ".join(repr(float(number)) for number in numbers)
