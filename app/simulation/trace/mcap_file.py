"""A trace as MCAP, which Foxglove, PlotJuggler and ROS tools open: JSON by Foxglove's schemas.

| topic | schema | how often |
|---|---|---|
| `/tf` | `foxglove.FrameTransforms`, the links in the world | each snapshot |
| `/joint_states` | `foxglove.JointStates`, of arm and wheels | each snapshot |
| `/bodies` | `foxglove.SceneUpdate`, the convex bodies, fixed to their links | once |
| `/markers` | `foxglove.SceneUpdate`, closest points, acting points, forces | each snapshot |
| `/step` | `dbb.Step`, the columns of a log; names end in units, `-` is `_` | each row |
| `/parameters` | `dbb.Config`, with units in its schema | when they change |
"""

import json
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
from mcap.writer import Writer

from app.config import sections
from app.parameters import Parameter, Section
from app.robot.model import RobotModel
from app.robot.shapes import shape_mesh
from app.simulation.trace.snapshot import Snapshot
from app.simulation.trace.trace import Trace
from app.strict import Array
from app.system import whole_file

Json = dict[str, Any]

WORLD = "world"  # the frame in which base and links are
_METRES_PER_NEWTON = 1 / 400  # [m/N] of a force: 0.1 m is 40 N
_BODY, _FREE, _INSIDE, _CONTACT = (
    {"r": r, "g": g, "b": b, "a": a}
    for r, g, b, a in (
        (0.25, 0.6, 0.9, 0.4),
        (0.6, 0.6, 0.6, 1),
        (1, 0.7, 0.1, 1),
        (1, 0.1, 0.1, 1),
    )
)
_LINE_LIST = 2
_PRIMITIVES = ("arrows", "cubes", "spheres", "cylinders", "lines", "triangles", "texts", "models")


def write_mcap(path: Path, trace: Trace, model: RobotModel) -> None:
    """Write a trace with snapshots whole or not at all.

    Raises:
        OutputError: It cannot be written there.
    """
    with whole_file(path) as beside, beside.open("wb") as file:
        writer = Writer(file)
        writer.start(profile="", library="dbb")
        about = trace.meta.model_dump(mode="json", exclude={"config"})
        writer.add_metadata("dbb", {name: json.dumps(value) for name, value in about.items()})
        topics = _Topics(writer, trace)
        topics.put("/bodies", trace.snapshots[0].t, {"deletions": [], "entities": _bodies(model)})
        frames, config = _Frames(model), None
        for s in trace.snapshots:
            topics.put("/tf", s.t, {"transforms": frames.transforms(s)})
            topics.put("/joint_states", s.t, _joint_states(s, model))
            topics.put("/markers", s.t, {"deletions": [], "entities": _markers(s)})
            if s.config != config:
                config = s.config
                topics.put("/parameters", s.t, config.model_dump(mode="json"))
        names = [_plain(column.name) for column in trace.columns]
        for t, row in zip(trace.t.tolist(), trace.table.tolist(), strict=True):
            known = zip(names, row, strict=True)
            topics.put("/step", t, {name: x for name, x in known if math.isfinite(x)})
        writer.finish()


class _Topics:
    """Channels of a file, one a topic, and how a message comes into them."""

    def __init__(self, writer: Writer, trace: Trace) -> None:
        step = _object("dbb.Step", **{_plain(c.name): {"type": "number"} for c in trace.columns})
        step["required"] = ["t_s"]  # what is not known at a time is left out
        schemas = {
            "/tf": _schema("FrameTransforms"),
            "/joint_states": _schema("JointStates"),
            "/bodies": _schema("SceneUpdate"),
            "/markers": _schema("SceneUpdate"),
            "/step": step,
            "/parameters": _object("dbb.Config", **{s.name: _section(s) for s in sections()}),
        }
        self._writer, self._numbers = writer, dict.fromkeys(schemas, 0)
        self._channels = {}
        for topic, schema in schemas.items():
            text = json.dumps(schema).encode()
            number = writer.register_schema(schema["title"], "jsonschema", text)
            self._channels[topic] = writer.register_channel(topic, "json", number)

    def put(self, topic: str, t: float, message: Json) -> None:
        """Append a message of a time [s]."""
        ns = round(1e9 * t)
        self._numbers[topic] += 1
        self._writer.add_message(
            self._channels[topic],
            ns,
            json.dumps(message, allow_nan=False).encode(),
            ns,
            self._numbers[topic],
        )


class _Frames:
    """Where the links are, each in the one that carries it."""

    def __init__(self, model: RobotModel) -> None:
        self._model, self._data = model, model.pin.createData()
        frames = model.pin.frames
        links = [i for i, f in enumerate(frames) if f.type == pin.FrameType.BODY]
        self._pairs = [(self._carrier(i), i) for i in (*links, model.ee_frame)]

    def _carrier(self, number: int) -> int | None:
        """The link that carries another one; None is the world."""
        frames = self._model.pin.frames
        while parent := frames[number].parentFrame:
            if parent == number:  # what pinocchio makes of a joint that is locked, such as a wheel
                return self._model.base_frame
            if frames[parent].type == pin.FrameType.BODY:
                return parent
            number = parent
        return None

    def transforms(self, snapshot: Snapshot) -> list[Json]:
        """All of them at a snapshot."""
        model, data = self._model, self._data
        q = model.configuration(snapshot.base_pose, snapshot.q_m)
        pin.framesForwardKinematics(model.pin, data, q)
        found = []
        for carrier, link in self._pairs:
            T = data.oMf[link] if carrier is None else data.oMf[carrier].actInv(data.oMf[link])
            pose = _pose(T)
            found.append(
                {
                    "timestamp": _time(snapshot.t),
                    "parent_frame_id": WORLD if carrier is None else model.pin.frames[carrier].name,
                    "child_frame_id": model.pin.frames[link].name,
                    "translation": pose["position"],
                    "rotation": pose["orientation"],
                }
            )
        return found


def _joint_states(s: Snapshot, model: RobotModel) -> Json:
    base, arm = model.description.base, model.description.arm
    joints = [
        {"name": name, "position": q, "velocity": qd, "effort": u}
        for name, q, qd, u in zip(
            arm.joints,
            s.q_m.tolist(),
            (np.zeros(model.n_m) if s.qd_m is None else s.qd_m).tolist(),
            s.u_a.tolist(),
            strict=True,
        )
    ]
    for wheels, angle in zip(base.wheels, s.wheel_angles.tolist(), strict=True):
        joints += [{"name": name, "position": angle} for name in wheels.joints]
    return {"timestamp": _time(s.t), "joints": joints}


def _bodies(model: RobotModel) -> list[Json]:
    """The convex bodies that distances are measured to, fixed to their links."""
    entities = []
    for body in model.description.bodies:
        triangles = []
        for shape in body.shapes:
            mesh = shape_mesh(shape)
            triangles.append(
                {
                    "pose": _pose(shape.placement()),
                    "points": list(map(_xyz, np.asarray(mesh.vertices))),
                    "color": _BODY,
                    "colors": [],
                    "indices": np.asarray(mesh.faces).ravel().tolist(),
                }
            )
        entities.append(_entity(0.0, body.name, body.frame, triangles=triangles))
    return entities


def _markers(s: Snapshot) -> list[Json]:
    """Closest points, acting points and forces; an entity replaces the one of its name."""
    lines = [
        {
            "type": _LINE_LIST,
            "pose": _pose(pin.SE3.Identity()),
            "thickness": 3.0,
            "scale_invariant": True,
            "points": [_xyz(pair.p_a), _xyz(pair.p_b)],
            "color": _CONTACT if pair.d < 0 else _INSIDE if pair.beta > 0 else _FREE,
            "colors": [],
            "indices": [],
        }
        for pair in s.pairs
    ]
    forces = [_arrow(each.p_act, each.f, _INSIDE) for each in s.acting]
    points = [_ball(p) for each in s.acting for p in (each.p_n, each.p_t, each.p_act)]
    person = _arrow(s.p_ee, s.hand_force, _FREE)
    return [
        _entity(s.t, "closest points", WORLD, lines=lines),
        _entity(s.t, "avoidance", WORLD, arrows=forces, spheres=points),
        _entity(s.t, "person", WORLD, arrows=[person]),
    ]


def _entity(t: float, name: str, frame: str, **primitives: Sequence[Json]) -> Json:
    return {
        "timestamp": _time(t),
        "frame_id": frame,
        "id": name,
        "lifetime": _time(0.0),
        "frame_locked": True,
        "metadata": [],
        **{kind: list(primitives.get(kind, ())) for kind in _PRIMITIVES},
    }


def _arrow(start: Array, force: Array, colour: Json) -> Json:
    """A force (3,) [N] at a place (3,) [m]."""
    newtons = float(np.linalg.norm(force))
    turn = pin.Quaternion.FromTwoVectors(np.array([1.0, 0.0, 0.0]), np.asarray(force))
    still = pin.Quaternion.Identity()
    return {
        "pose": _pose(pin.SE3(turn if newtons > 0 else still, np.asarray(start))),
        "shaft_length": _METRES_PER_NEWTON * newtons,
        "shaft_diameter": 0.016,
        "head_length": 0.035 if newtons > 0 else 0.0,
        "head_diameter": 0.04,
        "color": colour,
    }


def _ball(place: Array) -> Json:
    pose = _pose(pin.SE3(np.eye(3), np.asarray(place)))
    return {"pose": pose, "size": dict.fromkeys("xyz", 0.025), "color": _INSIDE}


def _time(t: float) -> dict[str, int]:
    sec, nsec = divmod(round(1e9 * t), 10**9)
    return {"sec": sec, "nsec": nsec}


def _xyz(place: Array) -> dict[str, float]:
    return dict(zip("xyz", map(float, place), strict=True))


def _pose(T: pin.SE3) -> Json:
    x, y, z, *quaternion = pin.SE3ToXYZQUAT(T).tolist()
    turn = dict(zip("xyzw", quaternion, strict=True))
    return {"position": {"x": x, "y": y, "z": z}, "orientation": turn}


def _plain(name: str) -> str:
    """A column's name as a path of a message may have it."""
    return name.replace("-", "_")


def _object(title: str, /, **properties: Json) -> Json:
    """A schema of an object that has all of these and nothing else."""
    return {
        "title": title,
        "type": "object",
        "properties": properties,
        "required": list(properties),
        "additionalProperties": False,
    }


def _section(section: Section) -> Json:
    found = {}
    for each in section.tunables:
        name = each.path.partition(".")[2]
        if isinstance(each, Parameter):
            found[name] = {"type": "number", "description": f"[{each.unit}] {each.help}"}
        else:
            found[name] = {"type": "string", "description": each.help}
    return _object(f"dbb.{section.name}", **found)


_PLAIN: dict[str, Json] = {
    "number": {"type": "number"},
    "text": {"type": "string"},
    "truth": {"type": "boolean"},
    "count": {"type": "integer", "minimum": 0},
    "nanoseconds": {"type": "integer", "minimum": 0, "maximum": 999_999_999},
    "line-list": {"oneOf": [{"title": "LINE_LIST", "const": _LINE_LIST}]},
    "nothing": {"type": "object", "properties": {}},
}
_RECORDS = {
    "time": "sec:count nsec:nanoseconds",
    "duration": "sec:count nsec:nanoseconds",
    "Vector3": "x y z",
    "Point3": "x y z",
    "Quaternion": "x y z w",
    "Color": "r g b a",
    "Pose": "position:Vector3 orientation:Quaternion",
    "FrameTransforms": "transforms:FrameTransform[]",
    "FrameTransform": "timestamp:time parent_frame_id:text child_frame_id:text "
    "translation:Vector3 rotation:Quaternion",
    "JointStates": "timestamp:time joints:JointState[]",
    "JointState": "name:text position? velocity? effort?",
    "LinePrimitive": "type:line-list pose:Pose thickness scale_invariant:truth points:Point3[] "
    "color:Color colors:Color[] indices:count[]",
    "TriangleListPrimitive": "pose:Pose points:Point3[] color:Color colors:Color[] indices:count[]",
    "ArrowPrimitive": "pose:Pose shaft_length shaft_diameter head_length head_diameter color:Color",
    "SpherePrimitive": "pose:Pose size:Vector3 color:Color",
    "SceneUpdate": "deletions:nothing[] entities:SceneEntity[]",
    "SceneEntity": "timestamp:time frame_id:text id:text lifetime:duration frame_locked:truth "
    "metadata:nothing[] arrows:ArrowPrimitive[] cubes:nothing[] spheres:SpherePrimitive[] "
    "cylinders:nothing[] lines:LinePrimitive[] triangles:TriangleListPrimitive[] texts:nothing[] "
    "models:nothing[]",
}
"""Fields of Foxglove's records, as far as they are used here: `name:kind`, a number without a kind,
`[]` a list, `?` not always there."""


def _schema(kind: str) -> Json:
    """The schema of a kind of `_PLAIN` or `_RECORDS`, or of a list of it."""
    if kind.endswith("[]"):
        few = {"maxItems": 0} if kind == "nothing[]" else {}
        return {"type": "array", "items": _schema(kind[:-2]), **few}
    if kind in _PLAIN:
        return _PLAIN[kind]
    fields = [field.partition(":")[::2] for field in _RECORDS[kind].split()]
    title = kind if kind in ("time", "duration") else f"foxglove.{kind}"
    found = _object(title, **{n.rstrip("?"): _schema(each or "number") for n, each in fields})
    return found | {"required": [name for name, _ in fields if not name.endswith("?")]}
