"""The common model: a plain URDF that every library reads in the same way."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple
from xml.etree import ElementTree
from xml.etree.ElementTree import Element, SubElement

import numpy as np
import pinocchio as pin

from app.errors import DescriptionError
from app.robot.assets import root_link, urdf_path
from app.robot.description import RobotDescription
from app.robot.link_pairs import Pair
from app.robot.model import RobotModel
from app.robot.shapes import Box, Capsule, Cylinder, Shape, Sphere

EE = "peers_ee"
"""Link of the end-effector's frame."""
PLANAR = ("peers_x", "peers_y", "peers_yaw")
"""Joints of the base on the floor."""
UNICYCLE = ("peers_yaw", "peers_forward")
"""Joints of a base that is modelled as a rotation, then a forward motion."""
_FARTHEST = 100.0  # [m] or [rad] limit of the base's joints: never met


class CommonModel(NamedTuple):
    """The model of a robot for all libraries.

    Each shape is a box, a sphere, a cylinder or a capsule; there are no visual shapes. The position
    and speed limits are those of our own controller. Names of links and joints are distinct. Each
    link has 1 kg, because masses have no effect at velocity level.

    Attributes:
        planar: The URDF with base joints x, y and yaw, for libraries with equality rows.
        unicycle: The URDF with base joints yaw and x, for the other libraries. If both joints are
            at zero, its Jacobian equals the Jacobian of a base that cannot move sideways.
        joints: Joints of the arm, from the base outwards.
        pairs: The two links of each pair, those of arm and base first.
        body_pairs: The same pairs by the names of the bodies.
    """

    planar: str
    unicycle: str
    joints: tuple[str, ...]
    pairs: tuple[tuple[str, str], ...]
    body_pairs: tuple[str, ...]


def common_model(
    model: RobotModel, pairs: Sequence[Pair], base_velocity: tuple[float, float]
) -> CommonModel:
    """The common model of a robot.

    Args:
        model: The robot.
        pairs: Pairs that must not collide.
        base_velocity: Largest v [m/s] and ω [rad/s].

    Raises:
        DescriptionError: A link has several shapes, or a shape that some library does not support.
    """
    description = model.description
    v, w = base_velocity
    turn = ("revolute", "0 0 1", w)
    ahead, aside = ("prismatic", "1 0 0", v), ("prismatic", "0 1 0", v)
    return CommonModel(
        _urdf(model, dict(zip(PLANAR, (ahead, aside, turn), strict=True))),
        _urdf(model, dict(zip(UNICYCLE, (turn, ahead), strict=True))),
        description.arm.joints,
        tuple((description.body(p.a).frame, description.body(p.b).frame) for p in pairs),
        tuple(pair.name for pair in pairs),
    )


def _urdf(model: RobotModel, base: dict[str, tuple[str, str, float]]) -> str:
    """The URDF with these root joints, by their names: kind, axis and largest velocity."""
    description = model.description
    text = urdf_path(description).read_text(encoding="utf-8")
    source = ElementTree.fromstring(text)
    # Without the version urdfdom silently ignores capsules.
    robot = Element("robot", name=description.name, version="1.2")
    for link in source.iterfind("link"):
        _link(robot, str(link.get("name")), description)
    for joint in source.iterfind("joint"):
        _joint(robot, joint, model)
    _end_effector(robot, description)
    parent = "peers_floor"
    _link(robot, parent)
    for k, (name, (kind, axis, velocity)) in enumerate(base.items()):
        child = root_link(text) if k == len(base) - 1 else f"{name}_link"
        if k < len(base) - 1:
            _link(robot, child)
        joint = SubElement(robot, "joint", name=name, type=kind)
        _between(joint, parent, child)
        SubElement(joint, "axis", xyz=axis)
        _limit(joint, -_FARTHEST, _FARTHEST, velocity)
        parent = child
    ElementTree.indent(robot)
    return ElementTree.tostring(robot, encoding="unicode") + "\n"


def _link(robot: Element, name: str, description: RobotDescription | None = None) -> None:
    link = SubElement(robot, "link", name=name)
    inertial = SubElement(link, "inertial")
    SubElement(inertial, "mass", value="1")
    SubElement(inertial, "inertia", ixx="0.01", ixy="0", ixz="0", iyy="0.01", iyz="0", izz="0.01")
    bodies = [] if description is None else [b for b in description.bodies if b.frame == name]
    shapes = [(body.name, shape) for body in bodies for shape in body.shapes]
    if len(shapes) > 1:
        raise DescriptionError(f"{name}: has {len(shapes)} shapes; some libraries support only one")
    for body, shape in shapes:
        collision = SubElement(link, "collision", name=body)
        at = shape.placement()
        _origin(collision, at.translation, pin.rpy.matrixToRpy(at.rotation))
        _geometry(SubElement(collision, "geometry"), body, shape)


def _geometry(geometry: Element, body: str, shape: Shape) -> None:
    if isinstance(shape, Box):
        SubElement(geometry, "box", size=_numbers(shape.size_m))
    elif isinstance(shape, Sphere):
        SubElement(geometry, "sphere", radius=repr(shape.radius_m))
    elif isinstance(shape, Cylinder | Capsule):
        size = {"radius": repr(shape.radius_m), "length": repr(shape.length_m)}
        SubElement(geometry, shape.type, size)
    else:
        raise DescriptionError(
            f"{body}: some libraries do not support a {shape.type}; all support box, sphere, "
            "cylinder and capsule"
        )


def _joint(robot: Element, source: Element, model: RobotModel) -> None:
    """A joint of the arm with its position and speed limits; other joints are fixed."""
    name, joints = str(source.get("name")), model.description.arm.joints
    moves = name in joints
    joint = SubElement(
        robot, "joint", name=name, type=str(source.get("type")) if moves else "fixed"
    )
    for tag in ("parent", "child", "origin", "axis"):
        if (found := source.find(tag)) is not None and (moves or tag != "axis"):
            SubElement(joint, tag, found.attrib)
    if moves:
        k = joints.index(name)
        _limit(joint, model.q_lower[k], model.q_upper[k], model.qd_max[k])


def _end_effector(robot: Element, description: RobotDescription) -> None:
    arm = description.arm
    _link(robot, EE)
    joint = SubElement(robot, "joint", name=f"{EE}_joint", type="fixed")
    _between(joint, arm.end_effector_link, EE)
    _origin(joint, arm.end_effector_xyz_m, arm.end_effector_rpy_rad)


def _between(joint: Element, parent: str, child: str) -> None:
    SubElement(joint, "parent", link=parent)
    SubElement(joint, "child", link=child)


def _origin(element: Element, xyz: Sequence[float], rpy: Sequence[float]) -> None:
    SubElement(element, "origin", xyz=_numbers(xyz), rpy=_numbers(rpy))


def _limit(joint: Element, lower: float, upper: float, velocity: float) -> None:
    limit = {"lower": lower, "upper": upper, "velocity": velocity, "effort": 1000.0}
    SubElement(joint, "limit", {key: repr(float(value)) for key, value in limit.items()})


def _numbers(values: Sequence[float]) -> str:
    return " ".join(repr(value) for value in np.asarray(values, dtype=float).tolist())
