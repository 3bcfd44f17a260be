"""A trace as an MCAP file: ROS 2 messages in CDR, and Protobuf messages.

| topic | schema | how often |
|---|---|---|
| `/robot_description` | `std_msgs/msg/String`, the URDF with local paths of meshes | once |
| `/joint_states` | `sensor_msgs/msg/JointState`, the joints of arm and wheels | each snapshot |
| `/tf` | `tf2_msgs/msg/TFMessage`, each link in its parent, the root in the world | each snapshot |
| `/curves/…` | `sensor_msgs/msg/JointState`, a quantity's columns as joints | each snapshot |
| `/robot` | `foxglove.SceneUpdate`, the visuals of the URDF, with their meshes | once |
| `/bodies` | `foxglove.SceneUpdate`, the convex bodies, fixed to their links | once |
| `/markers` | `foxglove.SceneUpdate`, closest points, acting points, forces | each snapshot |
| `/step` | `dbb.Step`, columns of the table, their special characters as `_` | each row |
| `/parameters` | `dbb.Config`, the parameters as SECTION_NAME | at the start and each change |

The schemas `foxglove.…` and `dbb.…` are Protobuf. The others are ROS 2 messages, because Rerun
reads robots and named curves only from ROS 2 messages. `--ros` writes only the first three topics.
"""

import io
import json
import re
from collections.abc import Iterable, Mapping
from functools import cache
from itertools import chain, groupby
from pathlib import Path
from typing import Any
from urllib.parse import unquote, urlsplit
from xml.etree import ElementTree
from xml.etree.ElementTree import Element

import numpy as np
import pinocchio as pin
from foxglove import Channel, Context, Schema, open_mcap
from foxglove import messages as fg
from foxglove.mcap import MCAPWriteOptions
from google.protobuf import descriptor_pb2, message_factory
from rosbags.typesys import Stores, get_typestore
from trimesh.exchange.gltf import export_glb

from app.robot.assets import shown_urdf
from app.robot.model import RobotModel, configured, whole_model
from app.robot.shapes import shape_mesh
from app.robot.urdf import colour, numbers, origin, primitive
from app.simulation.trace.snapshot import Snapshot
from app.simulation.trace.trace import Trace
from app.strict import Array
from app.system import write_whole

WORLD = "world"  # name of the world's frame
Records = Iterable[Mapping[str, Any]]  # fields of each record
Materials = Mapping[str | None, Element]  # materials of the robot by name

_METRES_PER_NEWTON = 1 / 400  # [m/N] scale of drawn forces: 0.1 m represents 40 N
_BODY = fg.Color(r=0.25, g=0.6, b=0.9, a=0.4)
_GREY = fg.Color(r=0.6, g=0.6, b=0.6, a=1)
_INSIDE = fg.Color(r=1, g=0.7, b=0.1, a=1)  # of the buffer
_CONTACT = fg.Color(r=1, g=0.1, b=0.1, a=1)
_MEDIA = {".glb": "gltf-binary", ".stl": "stl", ".obj": "obj", ".dae": "vnd.collada+xml"}
_UNSCALED = np.ones(3)  # [-] scale of a mesh in metres
_LARGEST_MESH = 20_000_000  # [bytes] largest mesh file that a log includes
_STORE: Any = get_typestore(Stores.ROS2_JAZZY)
_ROS = _STORE.types  # constructors of messages by their types


def write_mcap(path: Path, trace: Trace, model: RobotModel, *, ros: bool = False) -> None:
    """Write a trace that has snapshots, completely or not at all.

    With `ros`, the file has only the topics `/robot_description`, `/joint_states` and `/tf`. If the
    file cannot be written, this raises an OutputError; if the robot's URDF is missing or invalid,
    an AssetError, a DescriptionError or a RobotFileError.
    """
    file = io.BytesIO()  # in memory, so that a writing error occurs only at the end
    log, options = Context(), MCAPWriteOptions(profile="ros2" if ros else None)
    with open_mcap(file, context=log, writer_options=options) as writer:
        about = trace.meta.model_dump(mode="json", exclude={"config"})
        writer.write_metadata("dbb", {name: json.dumps(x) for name, x in about.items()})
        _put_motion(log, trace, model)
        if not ros:
            _put_scene(log, trace, model)
            _put_numbers(log, trace)
    write_whole(path, file.getvalue())


def _put(log: Context, topic: str, t: float, message: Any) -> None:
    """Append a message of ROS or foxglove at t [s]; foxglove reuses the channel of a topic."""
    if kind := getattr(message, "__msgtype__", ""):
        schema, encoding = _ros_schema(kind), "cdr"
        content = bytes(_STORE.serialize_cdr(message, kind))
    else:
        schema, encoding, content = message.get_schema(), "protobuf", message.encode()
    channel = Channel(topic, schema=schema, message_encoding=encoding, context=log)
    channel.log(content, log_time=round(1e9 * t))


@cache
def _ros_schema(kind: str) -> Schema:
    definition, _ = _STORE.generate_msgdef(kind, ros_version=2)
    return Schema(name=kind, encoding="ros2msg", data=definition.encode())


def _put_joints(log: Context, topic: str, t: float, names: list[str], *values: Array) -> None:
    """Write positions and, if they are known, velocities and efforts of joints."""
    columns = *values, *[np.empty(0)] * (3 - len(values))
    _put(log, topic, t, _ROS["sensor_msgs/msg/JointState"](_header(t, ""), names, *columns))


def _put_motion(log: Context, trace: Trace, model: RobotModel) -> None:
    """Write the URDF, the states of arm joints and wheels, and the poses of all links and of the
    end-effector's frame in their parent links. Speeds and torques of wheels are unknown: NaN.
    """
    whole, urdf = whole_model(model.description), shown_urdf(model.description)
    _put(log, "/robot_description", trace.snapshots[0].t, _ROS["std_msgs/msg/String"](urdf))
    data, frames = whole.createData(), whole.frames
    links = [i for i, frame in enumerate(frames) if frame.type == pin.FrameType.BODY]
    parents = [frames[frames[i].parentFrame].parentFrame for i in links]  # of the joint: a link
    names = [WORLD, *(frame.name for frame in frames[1:])]
    tip = model.pin.frames[model.ee_frame]
    link = model.pin.frames[tip.parentFrame]
    for s in trace.snapshots:
        positions = model.joint_positions(s.q_m, s.wheel_angles)
        unknown = [np.nan] * (len(positions) - model.n_m)
        speeds = [] if s.qd_m is None else [*s.qd_m, *unknown]
        values = map(np.array, ([*positions.values()], speeds, [*s.u_a, *unknown]))
        _put_joints(log, "/joint_states", s.t, [*positions], *values)
        q = configured(whole, positions)
        q[:4] = model.configuration(s.base_pose, s.q_m)[:4]
        pin.framesForwardKinematics(whole, data, q)
        T, ends = data.oMf, zip(parents, links, strict=True)
        poses = [_frame(s.t, names[k], names[i], T[k].actInv(T[i])) for k, i in ends]
        poses.append(_frame(s.t, link.name, tip.name, link.placement.actInv(tip.placement)))
        _put(log, "/tf", s.t, _ROS["tf2_msgs/msg/TFMessage"](poses))


def _put_scene(log: Context, trace: Trace, model: RobotModel) -> None:
    begin, urdf = trace.snapshots[0].t, ElementTree.fromstring(shown_urdf(model.description))
    materials = {each.get("name"): each for each in urdf.iterfind("material")}
    robot, bodies = [], []
    for link in urdf.iterfind("link"):
        name = str(link.get("name"))
        models = [_visual(each, materials, name) for each in link.iterfind("visual")]
        robot.append(fg.SceneEntity(frame_id=name, id=name, models=[*filter(None, models)]))
    for body in model.description.bodies:
        shapes = [_model(s.placement(), export_glb(shape_mesh(s)), _BODY) for s in body.shapes]
        bodies.append(fg.SceneEntity(frame_id=body.frame, id=body.name, models=shapes))
    _put(log, "/robot", begin, fg.SceneUpdate(entities=robot))
    _put(log, "/bodies", begin, fg.SceneUpdate(entities=bodies))
    for s in trace.snapshots:
        _put(log, "/markers", s.t, fg.SceneUpdate(entities=_markers(s)))


def _put_numbers(log: Context, trace: Trace) -> None:
    for s in trace.snapshots:
        row = trace.table[trace.row_at(s.t)]
        for quantity, columns in trace.groups.items():
            values = row[[trace.index[name] for name in columns]]
            _put_joints(log, f"/curves/{quantity}", s.t, columns, values)
    changed = [next(of) for _, of in groupby(trace.snapshots, key=lambda s: s.config)]
    parameters = ({f"{name}_{k}": x for name, part in s.config for k, x in part} for s in changed)
    _put_records(log, "/parameters", "Config", [s.t for s in changed], parameters)
    names = _fields(column.name for column in trace.columns)
    rows = (dict(zip(names, row, strict=True)) for row in trace.table.tolist())
    _put_records(log, "/step", "Step", trace.t.tolist(), rows)


def _put_records(
    log: Context, topic: str, name: str, times: Iterable[float], records: Records
) -> None:
    """Write records of numbers and texts at `times` [s]; the first record defines the fields."""
    records = iter(records)
    example = next(records)
    file = descriptor_pb2.FileDescriptorProto(name=f"{name}.proto", package="dbb", syntax="proto3")
    fields = file.message_type.add(name=name).field
    for number, (field, value) in enumerate(example.items(), 1):
        fields.add(name=field, number=number, label=1, type=9 if isinstance(value, str) else 1)
    data, name = descriptor_pb2.FileDescriptorSet(file=[file]).SerializeToString(), f"dbb.{name}"
    schema = Schema(name=name, encoding="protobuf", data=data)
    channel = Channel(topic, schema=schema, message_encoding="protobuf", context=log)
    kind = message_factory.GetMessages([file])[name]
    for t, values in zip(times, chain([example], records), strict=True):
        channel.log(kind(**values).SerializeToString(), log_time=round(1e9 * t))


def _fields(names: Iterable[str]) -> list[str]:
    """Names of Protobuf fields for columns; they differ in more than underscores and case."""
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
        return _model(T, export_glb(primitive(shape, where)[0]), tint or _GREY)
    file = Path(unquote(urlsplit(shape.get("filename", "")).path))
    end = file.suffix.lower()
    if end not in _MEDIA or file.stat().st_size > _LARGEST_MESH:
        return None
    tint = tint or (_GREY if end == ".stl" else None)  # other formats have their own colours
    scale = numbers(shape, "scale", (1.0, 1.0, 1.0), where)
    return _model(T, file.read_bytes(), tint, end, scale)


def _model(
    T: pin.SE3, content: bytes, colour: fg.Color | None, end: str = ".glb", scale: Array = _UNSCALED
) -> fg.ModelPrimitive:
    """A mesh file with the ending `end` at the pose T; a `colour` replaces the file's own ones."""
    return fg.ModelPrimitive(
        pose=_pose(T),
        scale=fg.Vector3(**_xyz(scale)),
        color=colour,
        override_color=colour is not None,
        media_type=f"model/{_MEDIA[end]}",
        data=content,
    )


def _markers(s: Snapshot) -> list[fg.SceneEntity]:
    """Entities for closest points, acting points and forces; they replace the previous ones."""
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
    points = (p for each in s.acting for p in (each.p_n, each.p_t, each.p_act))
    poses = (_pose(pin.SE3(np.eye(3), p)) for p in points)
    size = fg.Vector3(x=0.025, y=0.025, z=0.025)
    balls = [fg.SpherePrimitive(pose=pose, size=size, color=_INSIDE) for pose in poses]
    person = _arrow(s.p_ee, s.hand_force, _GREY)
    time = fg.Timestamp(*divmod(round(1e9 * s.t), 10**9))  # seconds and nanoseconds
    about = {"timestamp": time, "frame_id": WORLD}
    return [
        fg.SceneEntity(id="closest points", lines=lines, **about),
        fg.SceneEntity(id="avoidance", arrows=forces, spheres=balls, **about),
        fg.SceneEntity(id="person", arrows=[person], **about),
    ]


def _arrow(start: Array, force: Array, colour: fg.Color) -> fg.ArrowPrimitive:
    """An arrow for a force (3,) [N] at a point (3,) [m]."""
    newtons, x = float(np.linalg.norm(force)), np.array([1.0, 0.0, 0.0])
    turn = pin.Quaternion.FromTwoVectors(x, force if newtons > 0 else x)
    return fg.ArrowPrimitive(
        pose=_pose(pin.SE3(turn, start)),
        shaft_length=_METRES_PER_NEWTON * newtons,
        shaft_diameter=0.016,
        head_length=0.035 if newtons > 0 else 0.0,
        head_diameter=0.04,
        color=colour,
    )


def _pose(T: pin.SE3) -> fg.Pose:
    at, turn = _xyz(T.translation), _xyz(pin.Quaternion(T.rotation).coeffs())
    return fg.Pose(position=fg.Vector3(**at), orientation=fg.Quaternion(**turn))


def _xyz(values: Iterable[float]) -> dict[str, float]:
    """Values by the names x, y, z, and w for the fourth value of a quaternion."""
    return dict(zip("xyzw", map(float, values), strict=False))


def _frame(t: float, parent: str, child: str, T: pin.SE3) -> Any:
    place = _ROS["geometry_msgs/msg/Vector3"](*T.translation)
    turn = _ROS["geometry_msgs/msg/Quaternion"](*pin.Quaternion(T.rotation).coeffs())
    motion = _ROS["geometry_msgs/msg/Transform"](place, turn)
    return _ROS["geometry_msgs/msg/TransformStamped"](_header(t, parent), child, motion)


def _header(t: float, frame: str) -> Any:
    stamp = _ROS["builtin_interfaces/msg/Time"](*divmod(round(1e9 * t), 10**9))
    return _ROS["std_msgs/msg/Header"](stamp, frame)
