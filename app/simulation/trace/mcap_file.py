"""A trace as an MCAP file: Protobuf with Foxglove's schemas and the robot, or ROS 2 messages.

| topic | schema | how often |
|---|---|---|
| `/tf` | `foxglove.FrameTransforms`, the links in the world | each snapshot |
| `/joint_states` | `foxglove.JointStates`, the joints of arm and wheels | each snapshot |
| `/robot` | `foxglove.SceneUpdate`, the visuals of the URDF, with their meshes | once |
| `/bodies` | `foxglove.SceneUpdate`, the convex bodies, fixed to their links | once |
| `/markers` | `foxglove.SceneUpdate`, closest points, acting points, forces | each snapshot |
| `/step` | `dbb.Step`, the columns of a log; names end in units, `-` is `_` | each row |
| `/parameters` | `dbb.Config` | each change |
| `/robot_description` | `std_msgs/msg/String`, the URDF with local paths of meshes | once |
| `/curves/…` | `sensor_msgs/msg/JointState`, the columns of a quantity by name | each snapshot |

The last two are ROS messages, because Rerun reads robots and named curves only from ROS messages.
With `ros` the file has only ROS messages: `/tf`, `/joint_states` and `/robot_description`.
"""

import io
import json
import re
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any, BinaryIO
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

from app.robot.assets import shown_urdf
from app.robot.model import RobotModel
from app.robot.shapes import shape_mesh
from app.robot.urdf import colour, numbers, origin, primitive
from app.simulation.trace.motion import (
    FRAMES,
    JOINTS,
    TEXT,
    WORLD,
    Frames,
    JointReading,
    joints_of,
    nanoseconds,
    ros_definition,
    ros_frames,
    ros_joints,
    ros_text,
)
from app.simulation.trace.snapshot import Snapshot
from app.simulation.trace.trace import Trace
from app.strict import Array
from app.system import write_whole

Materials = Mapping[str | None, Element]  # materials of the robot by name

_METRES_PER_NEWTON = 1 / 400  # [m/N] scale of drawn forces: 0.1 m represents 40 N
_BODY, _FREE, _INSIDE, _CONTACT, _GREY = (
    fg.Color(r=r, g=g, b=b, a=a)
    for r, g, b, a in (
        (0.25, 0.6, 0.9, 0.4),
        (0.6, 0.6, 0.6, 1),
        (1, 0.7, 0.1, 1),
        (1, 0.1, 0.1, 1),
        (0.6, 0.6, 0.6, 1),
    )
)
_GLB, _STL = "model/gltf-binary", "model/stl"
_MEDIA = {".glb": _GLB, ".stl": _STL, ".obj": "model/obj", ".dae": "model/vnd.collada+xml"}
_LARGEST_MESH = 20_000_000  # [bytes] largest mesh file that a log includes


def write_mcap(path: Path, trace: Trace, model: RobotModel, *, ros: bool = False) -> None:
    """Write a trace with snapshots completely or not at all.

    Args:
        path: The file.
        trace: The trace.
        model: The robot.
        ros: Whether to write ROS 2 messages in CDR only.

    Raises:
        OutputError: The file cannot be written.
        AssetError: The robot's URDF is missing.
        RobotFileError: A visual in the URDF is invalid.
    """
    file = io.BytesIO()  # in memory, so that a writing error occurs only at the end
    log = _Log(file, profile="ros2" if ros else None)
    with log.writer:
        about = trace.meta.model_dump(mode="json", exclude={"config"})
        log.writer.write_metadata("dbb", {name: json.dumps(x) for name, x in about.items()})
        _put_motion(log, trace, model, ros=ros)
        if not ros:
            _put_scene(log, trace, model)
            _put_numbers(log, trace)
    write_whole(path, file.getvalue())


class _Log:
    """An MCAP log; the first message of a topic opens the topic's channel."""

    def __init__(self, file: BinaryIO, profile: str | None) -> None:
        self._context = foxglove.Context()
        options = MCAPWriteOptions(profile=profile)
        self.writer = foxglove.open_mcap(file, context=self._context, writer_options=options)
        self._channels: dict[str, foxglove.Channel] = {}
        self._kinds: dict[str, Any] = {}

    def put(self, topic: str, t: float, message: Any) -> None:
        """Append a Foxglove message at time t [s]."""
        self._put(topic, t, message.encode(), "protobuf", message.get_schema)

    def put_ros(self, topic: str, t: float, kind: str, content: bytes) -> None:
        """Append an encoded ROS message of the type `kind` at time t [s]."""

        def schema() -> foxglove.Schema:
            return foxglove.Schema(name=kind, encoding="ros2msg", data=ros_definition(kind))

        self._put(topic, t, content, "cdr", schema)

    def put_record(self, topic: str, t: float, name: str, values: Mapping[str, Any]) -> None:
        """Append a record of numbers and texts at time t [s].

        The topic's first record determines the names of the fields.
        """
        if topic not in self._kinds:
            self._kinds[topic] = _record_kind(name, values)
        kind = self._kinds[topic]

        def schema() -> foxglove.Schema:
            file = descriptor_pb2.FileDescriptorProto()
            kind.DESCRIPTOR.file.CopyToProto(file)
            data = descriptor_pb2.FileDescriptorSet(file=[file]).SerializeToString()
            return foxglove.Schema(name=f"dbb.{name}", encoding="protobuf", data=data)

        self._put(topic, t, kind(**values).SerializeToString(), "protobuf", schema)

    def _put(self, topic: str, t: float, content: bytes, encoding: str, schema: Any) -> None:
        if topic not in self._channels:
            self._channels[topic] = foxglove.Channel(
                topic, schema=schema(), message_encoding=encoding, context=self._context
            )
        self._channels[topic].log(content, log_time=nanoseconds(t))


def _record_kind(name: str, example: Mapping[str, Any]) -> Any:
    """The Protobuf type for records like an example."""
    file = descriptor_pb2.FileDescriptorProto(name=f"{name}.proto", package="dbb", syntax="proto3")
    kind = file.message_type.add(name=name)
    for number, (field, value) in enumerate(example.items(), 1):
        kind.field.add(name=field, number=number, label=1, type=9 if isinstance(value, str) else 1)
    return message_factory.GetMessages([file])[f"dbb.{name}"]


def _put_motion(log: _Log, trace: Trace, model: RobotModel, *, ros: bool) -> None:
    """Write the robot's URDF and its motion."""
    frames, urdf = Frames(model), ros_text(shown_urdf(model.description))
    log.put_ros("/robot_description", trace.snapshots[0].t, TEXT, urdf)
    for s in trace.snapshots:
        joints, transforms = joints_of(s, model), frames.at(s)
        if ros:
            log.put_ros("/joint_states", s.t, JOINTS, ros_joints(s.t, joints))
            log.put_ros("/tf", s.t, FRAMES, ros_frames(s.t, transforms))
        else:
            states = [fg.JointState(**joint._asdict()) for joint in joints]
            log.put("/joint_states", s.t, fg.JointStates(timestamp=_time(s.t), joints=states))
            moved = [_transform(s.t, *each) for each in transforms]
            log.put("/tf", s.t, fg.FrameTransforms(transforms=moved))


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
            curves = [JointReading(name, row[trace.index[name]]) for name in columns]
            log.put_ros(f"/curves/{quantity}", s.t, JOINTS, ros_joints(s.t, curves))
        if s.config != config:
            config = s.config
            sections = config.model_dump(mode="json").items()
            flat = {f"{name}_{key}": x for name, section in sections for key, x in section.items()}
            log.put_record("/parameters", s.t, "Config", flat)
    names = _fields(column.name for column in trace.columns)
    for t, row in zip(trace.t.tolist(), trace.table.tolist(), strict=True):
        log.put_record("/step", t, "Step", dict(zip(names, row, strict=True)))


def _fields(names: Iterable[str]) -> list[str]:
    """Names of columns, changed to valid and unique names for Protobuf.

    Protobuf refuses two names that differ only in underscores and the case of letters.
    """
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
            color=_CONTACT if pair.d < 0 else _INSIDE if pair.beta > 0 else _FREE,
        )
        for pair in s.pairs
    ]
    forces = [_arrow(each.p_act, each.f, _INSIDE) for each in s.acting]
    balls = [_ball(p) for each in s.acting for p in (each.p_n, each.p_t, each.p_act)]
    person = _arrow(s.p_ee, s.hand_force, _FREE)
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


def _transform(t: float, parent: str, child: str, T: pin.SE3) -> fg.FrameTransform:
    return fg.FrameTransform(
        timestamp=_time(t),
        parent_frame_id=parent,
        child_frame_id=child,
        translation=fg.Vector3(**_xyz(T.translation)),
        rotation=_turn(T),
    )


def _pose(T: pin.SE3) -> fg.Pose:
    return fg.Pose(position=fg.Vector3(**_xyz(T.translation)), orientation=_turn(T))


def _turn(T: pin.SE3) -> fg.Quaternion:
    return fg.Quaternion(**dict(zip("xyzw", pin.SE3ToXYZQUAT(T)[3:].tolist(), strict=True)))


def _xyz(at: Array) -> dict[str, float]:
    return dict(zip("xyz", map(float, at), strict=True))


def _time(t: float) -> fg.Timestamp:
    return fg.Timestamp(*divmod(nanoseconds(t), 10**9))
