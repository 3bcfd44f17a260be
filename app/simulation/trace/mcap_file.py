"""A trace as an MCAP file: ROS 2 messages in CDR, and Protobuf messages.

| topic | schema | how often |
|---|---|---|
| `/robot_description` | `std_msgs/msg/String`, the URDF with local paths of meshes | once |
| `/joint_states` | `sensor_msgs/msg/JointState`, the joints of arm and wheels | each snapshot |
| `/tf` | `tf2_msgs/msg/TFMessage`, the links in the world | each snapshot |
| `/curves/…` | `sensor_msgs/msg/JointState`, the columns of a quantity by name | each snapshot |
| `/robot` | `foxglove.SceneUpdate`, the visuals of the URDF, with their meshes | once |
| `/bodies` | `foxglove.SceneUpdate`, the convex bodies, fixed to their links | once |
| `/markers` | `foxglove.SceneUpdate`, closest points, acting points, forces | each snapshot |
| `/step` | `dbb.Step`, the columns with a number at each step; signs become `_` | each row |
| `/parameters` | `dbb.Config`, the parameters as SECTION_NAME | start, each change |

The schemas `foxglove.…` and `dbb.…` are Protobuf, the others are ROS 2 messages, because Rerun
reads robots and named curves only from these. A file of `--ros` has only the first three topics.
"""

import io
import json
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import cache
from math import nan
from pathlib import Path
from typing import Any, BinaryIO, NamedTuple
from urllib.parse import unquote, urlsplit
from xml.etree import ElementTree
from xml.etree.ElementTree import Element

import foxglove
import numpy as np
import pinocchio as pin
import trimesh
from foxglove import messages as fg
from foxglove.mcap import MCAPWriteOptions
from google.protobuf import descriptor_pb2, message_factory
from rosbags.typesys import Stores, get_typestore

from app.robot.assets import shown_urdf
from app.robot.model import RobotModel, whole_model
from app.robot.shapes import shape_mesh
from app.robot.urdf import colour, numbers, origin, primitive
from app.simulation.trace.snapshot import Snapshot
from app.simulation.trace.trace import Trace
from app.strict import Array
from app.system import write_whole

WORLD = "world"  # name of the world's frame
Materials = Mapping[str | None, Element]  # materials of the robot by name

_METRES_PER_NEWTON = 1 / 400  # [m/N] scale of drawn forces: 0.1 m represents 40 N
_BODY = fg.Color(r=0.25, g=0.6, b=0.9, a=0.4)
_GREY = fg.Color(r=0.6, g=0.6, b=0.6, a=1)
_INSIDE = fg.Color(r=1, g=0.7, b=0.1, a=1)  # of the buffer
_CONTACT = fg.Color(r=1, g=0.1, b=0.1, a=1)
_GLB, _STL = "model/gltf-binary", "model/stl"
_MEDIA = {".glb": _GLB, ".stl": _STL, ".obj": "model/obj", ".dae": "model/vnd.collada+xml"}
_LARGEST_MESH = 20_000_000  # [bytes] largest mesh file that a log includes


def write_mcap(path: Path, trace: Trace, model: RobotModel, *, ros: bool = False) -> None:
    """Write a trace with snapshots completely or not at all.

    With `ros`, the file has only the topics `/robot_description`, `/joint_states` and `/tf`. If the
    file cannot be written, this raises an OutputError; if the robot's URDF is missing or invalid,
    an AssetError, a DescriptionError or a RobotFileError.
    """
    file = io.BytesIO()  # in memory, so that a writing error occurs only at the end
    log = _Log(file, profile="ros2" if ros else None)
    with log.writer:
        about = trace.meta.model_dump(mode="json", exclude={"config"})
        log.writer.write_metadata("dbb", {name: json.dumps(x) for name, x in about.items()})
        _put_motion(log, trace, model)
        if not ros:
            _put_scene(log, trace, model)
            _put_numbers(log, trace)
    write_whole(path, file.getvalue())


class _Joints(NamedTuple):
    """The states of joints; without values, velocities or efforts are omitted."""

    names: Sequence[str]
    position: Array
    """[rad or m] positions about or along the joints' axes in the URDF."""
    velocity: Array = np.empty(0)
    effort: Array = np.empty(0)


class _Log:
    """An MCAP log; the first message of a topic opens the topic's channel."""

    def __init__(self, file: BinaryIO, profile: str | None) -> None:
        self._context = foxglove.Context()
        options = MCAPWriteOptions(profile=profile)
        self.writer = foxglove.open_mcap(file, context=self._context, writer_options=options)
        self._channels: dict[str, foxglove.Channel] = {}
        self._kinds: dict[str, tuple[Any, foxglove.Schema]] = {}

    def put(self, topic: str, t: float, message: Any) -> None:
        """Append a Foxglove message at time t [s]."""
        self._put(topic, t, message.encode(), message.get_schema)

    def put_ros(self, topic: str, t: float, kind: str, **fields: Any) -> None:
        """Append a ROS message of the type `kind` with these fields at time t [s]."""

        def schema() -> foxglove.Schema:
            definition, _ = _store().generate_msgdef(kind, ros_version=2)
            return foxglove.Schema(name=kind, encoding="ros2msg", data=definition.encode())

        self._put(topic, t, bytes(_store().serialize_cdr(_ros(kind, **fields), kind)), schema)

    def put_joints(self, topic: str, t: float, joints: _Joints) -> None:
        """Append the states of joints at time t [s]."""
        names, *values = joints
        states = dict(zip(("position", "velocity", "effort"), values, strict=True))
        kind, header = "sensor_msgs/msg/JointState", _header(t, "")
        self.put_ros(topic, t, kind, header=header, name=list(names), **states)

    def put_record(self, topic: str, t: float, name: str, values: Mapping[str, Any]) -> None:
        """Append numbers and texts at time t [s]; the first record determines their names."""
        if topic not in self._kinds:
            self._kinds[topic] = _record_kind(name, values)
        kind, schema = self._kinds[topic]
        self._put(topic, t, kind(**values).SerializeToString(), lambda: schema)

    def _put(
        self, topic: str, t: float, content: bytes, schema: Callable[[], foxglove.Schema]
    ) -> None:
        if topic not in self._channels:
            made = schema()
            encoding = "cdr" if made.encoding == "ros2msg" else made.encoding
            self._channels[topic] = foxglove.Channel(
                topic, schema=made, message_encoding=encoding, context=self._context
            )
        self._channels[topic].log(content, log_time=_nanoseconds(t))


def _record_kind(name: str, example: Mapping[str, Any]) -> tuple[Any, foxglove.Schema]:
    """The Protobuf type, and its schema, for records with the fields of an example."""
    file = descriptor_pb2.FileDescriptorProto(name=f"{name}.proto", package="dbb", syntax="proto3")
    kind = file.message_type.add(name=name)
    for number, (field, value) in enumerate(example.items(), 1):
        kind.field.add(name=field, number=number, label=1, type=9 if isinstance(value, str) else 1)
    data, name = descriptor_pb2.FileDescriptorSet(file=[file]).SerializeToString(), f"dbb.{name}"
    schema = foxglove.Schema(name=name, encoding="protobuf", data=data)
    return message_factory.GetMessages([file])[name], schema


class _Frames:
    """Poses of the links relative to their parents, including turning wheels."""

    def __init__(self, model: RobotModel) -> None:
        self._model, self._whole = model, whole_model(model.description)
        self._data = self._whole.createData()
        frames = self._whole.frames
        self._links = [i for i, f in enumerate(frames) if f.type == pin.FrameType.BODY]
        frame = model.pin.frames[model.ee_frame]
        link = model.pin.frames[frame.parentFrame]
        self._ee = link.name, frame.name, link.placement.actInv(frame.placement)

    def at(self, s: Snapshot) -> list[tuple[str, str, pin.SE3]]:
        """Name of the parent, name of the link and T_parent_link, for each link at a snapshot.

        The end-effector's frame is the last one.
        """
        whole, turned = self._whole, np.zeros(self._whole.nv)
        names, positions, *_ = _joints_of(s, self._model)
        turned[[whole.joints[whole.getJointId(name)].idx_v for name in names]] = positions
        q = pin.integrate(whole, pin.neutral(whole), turned)
        q[:4] = self._model.configuration(s.base_pose, s.q_m)[:4]
        pin.framesForwardKinematics(whole, self._data, q)
        return [*map(self._place, self._links), self._ee]

    def _place(self, link: int) -> tuple[str, str, pin.SE3]:
        frames, oMf = self._whole.frames, self._data.oMf
        parent = frames[link].parentFrame
        while parent and frames[parent].type != pin.FrameType.BODY:
            parent = frames[parent].parentFrame
        name = frames[parent].name if parent else WORLD  # frame 0 is the world
        return name, frames[link].name, oMf[parent].actInv(oMf[link])


def _joints_of(s: Snapshot, model: RobotModel) -> _Joints:
    """The states of the joints of arm and wheels at a snapshot; NaN is unknown."""
    wheels = model.wheel_positions(s.wheel_angles)
    names, unknown = [*model.description.arm.joints, *wheels], [nan] * len(wheels)
    position, effort = np.array([*s.q_m, *wheels.values()]), np.array([*s.u_a, *unknown])
    velocity = np.empty(0) if s.qd_m is None else np.array([*s.qd_m, *unknown])
    return _Joints(names, position, velocity, effort)


def _put_motion(log: _Log, trace: Trace, model: RobotModel) -> None:
    """Write the robot's URDF and its motion."""
    frames, urdf = _Frames(model), shown_urdf(model.description)
    log.put_ros("/robot_description", trace.snapshots[0].t, "std_msgs/msg/String", data=urdf)
    for s in trace.snapshots:
        log.put_joints("/joint_states", s.t, _joints_of(s, model))
        transforms = [_frame(s.t, *each) for each in frames.at(s)]
        log.put_ros("/tf", s.t, "tf2_msgs/msg/TFMessage", transforms=transforms)


def _put_scene(log: _Log, trace: Trace, model: RobotModel) -> None:
    begin, urdf = trace.snapshots[0].t, ElementTree.fromstring(shown_urdf(model.description))
    materials = {each.get("name"): each for each in urdf.iterfind("material")}
    links = {str(link.get("name")): link for link in urdf.iterfind("link")}
    bodies = [
        fg.SceneEntity(frame_id=body.frame, id=body.name, models=list(map(_body, body.shapes)))
        for body in model.description.bodies
    ]
    robot = []
    for name, link in links.items():
        models = [_visual(each, materials, name) for each in link.iterfind("visual")]
        entity = fg.SceneEntity(frame_id=name, id=name, models=list(filter(None, models)))
        robot.append(entity)
    log.put("/robot", begin, fg.SceneUpdate(entities=robot))
    log.put("/bodies", begin, fg.SceneUpdate(entities=bodies))
    for s in trace.snapshots:
        log.put("/markers", s.t, fg.SceneUpdate(entities=_markers(s)))


def _put_numbers(log: _Log, trace: Trace) -> None:
    config = None
    for s in trace.snapshots:
        row = trace.table[trace.row_at(s.t)]
        for quantity, columns in trace.groups.items():
            values = row[[trace.index[name] for name in columns]]
            log.put_joints(f"/curves/{quantity}", s.t, _Joints(columns, values))
        if s.config != config:
            config = s.config
            sections = config.model_dump(mode="json").items()
            flat = {f"{name}_{key}": x for name, section in sections for key, x in section.items()}
            log.put_record("/parameters", s.t, "Config", flat)
    names = _fields(column.name for column in trace.columns)
    for t, row in zip(trace.t.tolist(), trace.table.tolist(), strict=True):
        log.put_record("/step", t, "Step", dict(zip(names, row, strict=True)))


def _fields(names: Iterable[str]) -> list[str]:
    """Names of Protobuf fields for columns, which differ in more than underscores and case."""
    found: dict[str, str] = {}
    for name in names:
        plain = re.sub(r"\W", "_", name, flags=re.ASCII)
        while (core := plain.replace("_", "").lower()) in found:
            plain += "x"
        found[core] = plain
    return list(found.values())


def _visual(visual: Element, materials: Materials, link: str) -> fg.ModelPrimitive | None:
    """A visual of a link; None without a shape, or if a mesh is too large or of unknown format."""
    where, shape = f"link {link!r}", visual.find("geometry/*")
    if shape is None:
        return None
    T, rgba = origin(visual, where), colour(visual, materials)
    tint = fg.Color(**dict(zip("rgba", rgba, strict=True))) if rgba else None
    if shape.tag != "mesh":
        return _model(T, _GLB, _glb(primitive(shape, where)[0]), tint or _GREY)
    file = Path(unquote(urlsplit(shape.get("filename", "")).path))
    media = _MEDIA.get(file.suffix.lower())
    if media is None or file.stat().st_size > _LARGEST_MESH:
        return None
    tint = tint or (_GREY if media == _STL else None)  # other formats have their own colours
    return _model(T, media, file.read_bytes(), tint, numbers(shape, "scale", (1.0,) * 3, where))


def _body(shape: Any) -> fg.ModelPrimitive:
    return _model(shape.placement(), _GLB, _glb(shape_mesh(shape)), _BODY)


def _glb(mesh: trimesh.Trimesh) -> bytes:
    return bytes(mesh.export(file_type="glb"))  # pyright: ignore[reportArgumentType]


def _model(
    T: pin.SE3,
    media: str,
    data: bytes,
    colour: fg.Color | None,
    scale: Iterable[float] = (1.0, 1.0, 1.0),
) -> fg.ModelPrimitive:
    return fg.ModelPrimitive(
        pose=_pose(T),
        scale=fg.Vector3(**dict(zip("xyz", scale, strict=True))),
        color=colour,
        override_color=colour is not None,
        media_type=media,
        data=data,
    )


def _markers(s: Snapshot) -> list[fg.SceneEntity]:
    """Closest points, acting points and forces; a later entity replaces one with the same name."""
    lines = [
        fg.LinePrimitive(
            type=fg.LinePrimitiveLineType.LineList,
            pose=_pose(pin.SE3.Identity()),
            thickness=3.0,
            scale_invariant=True,
            points=[fg.Point3(**_xyz(pair.p_a)), fg.Point3(**_xyz(pair.p_b))],
            color=_CONTACT if pair.d < 0 else _INSIDE if pair.beta > 0 else _GREY,
        )
        for pair in s.pairs
    ]
    forces = [_arrow(each.p_act, each.f, _INSIDE) for each in s.acting]
    balls = [_ball(p) for each in s.acting for p in (each.p_n, each.p_t, each.p_act)]
    person = _arrow(s.p_ee, s.hand_force, _GREY)
    about = {"timestamp": _time(s.t), "frame_id": WORLD}
    return [
        fg.SceneEntity(id="closest points", lines=lines, **about),
        fg.SceneEntity(id="avoidance", arrows=forces, spheres=balls, **about),
        fg.SceneEntity(id="person", arrows=[person], **about),
    ]


def _arrow(start: Array, force: Array, colour: fg.Color) -> fg.ArrowPrimitive:
    """An arrow for a force (3,) [N] at a point (3,) [m]."""
    newtons = float(np.linalg.norm(force))
    turn = pin.Quaternion.FromTwoVectors(np.array([1.0, 0.0, 0.0]), np.asarray(force))
    still = pin.Quaternion.Identity()
    return fg.ArrowPrimitive(
        pose=_pose(pin.SE3(turn if newtons > 0 else still, np.asarray(start))),
        shaft_length=_METRES_PER_NEWTON * newtons,
        shaft_diameter=0.016,
        head_length=0.035 if newtons > 0 else 0.0,
        head_diameter=0.04,
        color=colour,
    )


def _ball(at: Array) -> fg.SpherePrimitive:
    size = fg.Vector3(x=0.025, y=0.025, z=0.025)
    return fg.SpherePrimitive(
        pose=_pose(pin.SE3(np.eye(3), np.array(at))), size=size, color=_INSIDE
    )


def _pose(T: pin.SE3) -> fg.Pose:
    turn = dict(zip("xyzw", pin.SE3ToXYZQUAT(T)[3:].tolist(), strict=True))
    at = fg.Vector3(**_xyz(T.translation))
    return fg.Pose(position=at, orientation=fg.Quaternion(**turn))


def _xyz(at: Array) -> dict[str, float]:
    return dict(zip("xyz", map(float, at), strict=True))


def _time(t: float) -> fg.Timestamp:
    return fg.Timestamp(*divmod(_nanoseconds(t), 10**9))


def _nanoseconds(t: float) -> int:
    return round(1e9 * t)


def _frame(t: float, parent: str, child: str, T: pin.SE3) -> Any:
    x, y, z, *turn = pin.SE3ToXYZQUAT(T).tolist()
    place = _ros("geometry_msgs/msg/Vector3", x=x, y=y, z=z)
    rotation = _ros("geometry_msgs/msg/Quaternion", **dict(zip("xyzw", turn, strict=True)))
    motion = _ros("geometry_msgs/msg/Transform", translation=place, rotation=rotation)
    header = _header(t, parent)
    return _ros(
        "geometry_msgs/msg/TransformStamped", header=header, child_frame_id=child, transform=motion
    )


def _header(t: float, frame: str) -> Any:
    seconds, rest = divmod(_nanoseconds(t), 10**9)
    stamp = _ros("builtin_interfaces/msg/Time", sec=seconds, nanosec=rest)
    return _ros("std_msgs/msg/Header", stamp=stamp, frame_id=frame)


def _ros(kind: str, **fields: Any) -> Any:
    """A ROS message, or a part of one, of the type with the name `kind`."""
    return _store().types[kind](**fields)


@cache
def _store() -> Any:
    return get_typestore(Stores.ROS2_JAZZY)
