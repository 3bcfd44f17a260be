"""Messages of ROS 2 as CDR, without an installation of ROS."""

from collections.abc import Sequence
from functools import cache
from math import nan
from typing import Any

import numpy as np
import pinocchio as pin
from rosbags.typesys import Stores, get_typestore

from app.simulation.trace.motion import JointReading, nanoseconds

TEXT, JOINTS = "std_msgs/msg/String", "sensor_msgs/msg/JointState"
FRAMES = "tf2_msgs/msg/TFMessage"


@cache
def _store() -> Any:
    return get_typestore(Stores.ROS2_JAZZY)


@cache
def definition(kind: str) -> bytes:
    """The definition of a type, with those of its parts."""
    return _store().generate_msgdef(kind, ros_version=2)[0].encode()


def text(content: str) -> bytes:
    """A message of a text."""
    return _encode(TEXT, data=content)


def joints(t: float, states: Sequence[JointReading]) -> bytes:
    """A message of joints at a time [s]; a velocity or an effort that no joint has is left out."""
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


def frames(t: float, places: Sequence[tuple[str, str, pin.SE3]]) -> bytes:
    """A message of T_parent_child at a time [s]."""
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
