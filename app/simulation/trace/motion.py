"""Frames of links and states of joints at a snapshot, with the names that ROS tools use.

They can be encoded as ROS 2 messages in CDR without an installation of ROS.
"""

from collections.abc import Sequence
from functools import cache
from math import nan
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin
from rosbags.typesys import Stores, get_typestore

from app.robot.model import RobotModel, whole_model
from app.simulation.trace.snapshot import Snapshot

WORLD = "world"  # name of the world's frame
TEXT, JOINTS = "std_msgs/msg/String", "sensor_msgs/msg/JointState"
FRAMES = "tf2_msgs/msg/TFMessage"


class JointReading(NamedTuple):
    """The state of a joint at one instant; None means unknown."""

    name: str
    position: float
    """[rad or m] position about or along the joint's axis in the URDF."""
    velocity: float | None = None
    """[rad/s or m/s] velocity."""
    effort: float | None = None
    """[N m or N] torque or force."""


class Frames:
    """Poses of the links relative to their parents, including turning wheels."""

    def __init__(self, model: RobotModel) -> None:
        self._model, self._whole = model, whole_model(model.description)
        self._data = self._whole.createData()
        frames = self._whole.frames
        self._links = [i for i, f in enumerate(frames) if f.type == pin.FrameType.BODY]
        hand = model.pin.frames[model.ee_frame]
        link = model.pin.frames[hand.parentFrame]
        self._hand = link.name, hand.name, link.placement.actInv(hand.placement)

    def at(self, s: Snapshot) -> list[tuple[str, str, pin.SE3]]:
        """Name of the parent, name of the link and T_parent_link, for each link at a snapshot.

        The end-effector's frame is the last one.
        """
        whole, turned = self._whole, np.zeros(self._whole.nv)
        for joint in joints_of(s, self._model):
            turned[whole.joints[whole.getJointId(joint.name)].idx_v] = joint.position
        q = pin.integrate(whole, pin.neutral(whole), turned)
        q[:4] = self._model.configuration(s.base_pose, s.q_m)[:4]
        pin.framesForwardKinematics(whole, self._data, q)
        return [*map(self._place, self._links), self._hand]

    def _place(self, link: int) -> tuple[str, str, pin.SE3]:
        frames, oMf = self._whole.frames, self._data.oMf
        parent = frames[link].parentFrame
        while parent and frames[parent].type != pin.FrameType.BODY:
            parent = frames[parent].parentFrame
        name = frames[parent].name if parent else WORLD  # frame 0 is the world
        return name, frames[link].name, oMf[parent].actInv(oMf[link])


def joints_of(s: Snapshot, model: RobotModel) -> list[JointReading]:
    """The states of the joints of arm and wheels at a snapshot."""
    arm = model.description.arm.joints
    speeds = [None] * len(arm) if s.qd_m is None else s.qd_m.tolist()
    moving = zip(arm, s.q_m.tolist(), speeds, s.u_a.tolist(), strict=True)
    wheels = model.wheel_positions(s.wheel_angles)
    return [*map(JointReading._make, moving), *(JointReading(*each) for each in wheels.items())]


def nanoseconds(t: float) -> int:
    """A time [s] in nanoseconds, the unit of MCAP logs."""
    return round(1e9 * t)


@cache
def _store() -> Any:
    return get_typestore(Stores.ROS2_JAZZY)


@cache
def ros_definition(kind: str) -> bytes:
    """The definition of a message type, including the definitions of its parts."""
    return _store().generate_msgdef(kind, ros_version=2)[0].encode()


def ros_text(content: str) -> bytes:
    """A ROS message with a text."""
    return _encode(TEXT, data=content)


def ros_joints(t: float, states: Sequence[JointReading]) -> bytes:
    """A ROS message with the states of joints at time t [s].

    Velocities or efforts are omitted if no joint has them.
    """
    names, position, *others = zip(*states, strict=True)
    velocity, effort = (
        np.array([nan if x is None else x for x in column if {*column} != {None}], dtype=float)
        for column in others
    )
    return _encode(
        JOINTS,
        header=_header(t, ""),
        name=list(names),
        position=np.array(position, dtype=float),
        velocity=velocity,
        effort=effort,
    )


def ros_frames(t: float, places: Sequence[tuple[str, str, pin.SE3]]) -> bytes:
    """A ROS message with transforms T_parent_child at time t [s]."""
    return _encode(FRAMES, transforms=[_frame(t, *each) for each in places])


def _frame(t: float, parent: str, child: str, T: pin.SE3) -> Any:
    x, y, z, *turn = pin.SE3ToXYZQUAT(T).tolist()
    place = _geometry("Vector3", x=x, y=y, z=z)
    rotation = _geometry("Quaternion", **dict(zip("xyzw", turn, strict=True)))
    motion = _geometry("Transform", translation=place, rotation=rotation)
    header = _header(t, parent)
    return _geometry("TransformStamped", header=header, child_frame_id=child, transform=motion)


def _header(t: float, frame: str) -> Any:
    seconds, rest = divmod(nanoseconds(t), 10**9)
    stamp = _store().types["builtin_interfaces/msg/Time"](seconds, rest)
    return _store().types["std_msgs/msg/Header"](stamp, frame)


def _geometry(kind: str, **fields: Any) -> Any:
    return _store().types[f"geometry_msgs/msg/{kind}"](**fields)


def _encode(kind: str, **fields: Any) -> bytes:
    return bytes(_store().serialize_cdr(_store().types[kind](**fields), kind))
