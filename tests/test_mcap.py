"""A run as MCAP, read by the libraries of other viewers: mcap, Rerun, rosbags."""

from __future__ import annotations

import json
import shutil
from collections import defaultdict
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pinocchio as pin
import pyarrow as pa
import pytest
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory
from mcap_ros2.decoder import DecoderFactory as RosDecoderFactory

from app.dashboard.scene.robot import LinkPoses
from app.errors import OutputError
from app.robot import assets
from app.robot.description import load_robot
from app.robot.model import RobotModel
from app.simulation.trace.log_file import read_trace, write_trace
from app.simulation.trace.mcap_file import WORLD, write_mcap
from app.simulation.trace.trace import Trace
from tests.logs import random_snapshots, trace_of

PROJECT = Path(__file__).resolve().parent.parent
TOPICS = {
    "/tf": "tf2_msgs/msg/TFMessage",
    "/joint_states": "sensor_msgs/msg/JointState",
    "/robot": "foxglove.SceneUpdate",
    "/bodies": "foxglove.SceneUpdate",
    "/markers": "foxglove.SceneUpdate",
    "/step": "dbb.Step",
    "/parameters": "dbb.Config",
    "/robot_description": "std_msgs/msg/String",
}
Read = dict[str, list[tuple[float, Any]]]


@pytest.fixture(scope="module")
def trace() -> Trace:
    return trace_of(random_snapshots(3, 4))


@pytest.fixture(scope="module")
def folder(robot: RobotModel, trace: Trace, tmp_path_factory: pytest.TempPathFactory) -> Path:
    made = tmp_path_factory.mktemp("mcap")
    write_mcap(made / "run.mcap", trace, robot)
    write_mcap(made / "ros.mcap", trace, robot, ros=True)
    return made


@pytest.fixture(scope="module")
def read(folder: Path) -> Read:
    """All messages by their topics, each with its time [s]."""
    found = defaultdict(list)
    with (folder / "run.mcap").open("rb") as file:
        decoders = [DecoderFactory(), RosDecoderFactory()]
        reader = make_reader(file, validate_crcs=True, decoder_factories=decoders)
        for schema, channel, message, content in reader.iter_decoded_messages():
            assert schema is not None
            kind = TOPICS.get(channel.topic, "sensor_msgs/msg/JointState")
            assert schema.name == kind
            assert schema.encoding == ("ros2msg" if "_msgs/" in kind else "protobuf")
            found[channel.topic].append((1e-9 * message.log_time, content))
    return found


def places(read: Read, k: int) -> dict[str, pin.SE3]:
    """T_world_link of each link by name, at the k-th snapshot."""
    placed = {WORLD: pin.SE3.Identity()}
    for each in read["/tf"][k][1].transforms:
        at, turn = each.transform.translation, each.transform.rotation
        step = pin.XYZQUATToSE3(np.array([at.x, at.y, at.z, turn.x, turn.y, turn.z, turn.w]))
        placed[each.child_frame_id] = placed[each.header.frame_id] * step
    return placed


def test_each_topic_has_one_message_per_row_or_snapshot(read: Read, trace: Trace) -> None:
    assert set(TOPICS) <= set(read)
    for topic in ("/tf", "/joint_states", "/markers", "/step", "/curves/pairs"):
        assert [t for t, _ in read[topic]] == pytest.approx(trace.t.tolist(), abs=1e-9)
    assert len(read["/robot"]) == len(read["/bodies"]) == len(read["/robot_description"]) == 1


def test_steps_and_curves_have_the_values_of_the_log(read: Read, trace: Trace) -> None:
    for k, (row, (_, step)) in enumerate(zip(trace.table, read["/step"], strict=True)):
        names = [column.name.replace("-", "_") for column in trace.columns]
        assert [getattr(step, name) for name in names] == pytest.approx(row, nan_ok=True, abs=0)
        assert "d_b" not in trace.groups, "it has no column in the table"
        for quantity, columns in trace.groups.items():
            _, curves = read[f"/curves/{quantity}"][k]
            assert curves.name == columns
            wanted = [trace[name][k] for name in columns]
            assert curves.position == pytest.approx(wanted, nan_ok=True, abs=0)


def test_link_poses_match_forward_kinematics(read: Read, trace: Trace, robot: RobotModel) -> None:
    data = robot.pin.createData()
    for k, s in enumerate(trace.snapshots):
        placed = places(read, k)
        pin.framesForwardKinematics(robot.pin, data, robot.configuration(s.base_pose, s.q_m))
        for name in ("end_effector", "panda_link4", "base_link"):
            wanted = data.oMf[robot.pin.getFrameId(name)]
            scale = 1.0 + np.abs(wanted.translation).max()
            off = placed[name].translation - wanted.translation
            assert np.abs(off).max() / scale < 1e-9
            assert placed[name].rotation == pytest.approx(wanted.rotation, abs=1e-6)


def test_bodies_are_fixed_to_links_and_arrows_match_forces(
    read: Read, trace: Trace, robot: RobotModel
) -> None:
    [(_, bodies)], [(_, looks)] = read["/bodies"], read["/robot"]
    frames = set(places(read, 0))
    assert [e.id for e in bodies.entities] == robot.body_names
    assert {e.frame_id for e in (*bodies.entities, *looks.entities)} <= frames
    models = [model for e in (*bodies.entities, *looks.entities) for model in e.models]
    assert len(models) > 20
    assert all(model.data and model.media_type for model in models)
    dark = next(e for e in looks.entities if e.frame_id == "base_link").models[0].color
    assert (dark.r, dark.g, dark.b) == pytest.approx((0.16, 0.17, 0.18), abs=0.02)
    for s, (_, message) in zip(trace.snapshots, read["/markers"], strict=True):
        arrows = [a for e in message.entities for a in e.arrows]
        forces = [*(each.f for each in s.acting), s.hand_force]
        for arrow, force in zip(arrows, forces, strict=True):
            turn = arrow.pose.orientation
            axis = pin.Quaternion(turn.w, turn.x, turn.y, turn.z).matrix()[:, 0]
            along = axis * 400 * arrow.shaft_length
            off = 1e-12 * float(np.linalg.norm(force)) + 1e-150  # [N] tolerance that is not zero
            assert along == pytest.approx(force, abs=off)


def test_rerun_shows_robot_transforms_and_curves(folder: Path, trace: Trace) -> None:
    chunk = pytest.importorskip("rerun.chunk", reason="rerun-sdk has no wheel here")
    columns: dict[str, dict[str, list[Any]]] = defaultdict(lambda: defaultdict(list))
    for each in chunk.McapReader(folder / "run.mcap").stream().to_chunks():
        batch = each.to_record_batch()
        for name in batch.schema.names:
            if pa.types.is_timestamp(batch.schema.field(name).type):
                continue
            columns[each.entity_path][name] += batch.column(name).to_pylist()
    meshes = [path for path, has in columns.items() if "Asset3D:blob" in has]
    shown = [path for path in meshes if "/visual_geometries/" in path]
    assert len(shown) >= 15, "too few of the URDF's meshes"
    linked = {frame for path in shown for [frame] in columns[path]["CoordinateFrame:frame"]}
    assert linked <= {child for [child] in columns["/tf"]["Transform3D:child_frame"]}
    curves = columns["/curves/pairs/position"]
    names = [name for name in trace.groups["pairs"] if name.startswith("d_")]
    for row, found, labels in zip(
        trace.table, curves["Scalars:scalars"], curves["SeriesLines:names"], strict=True
    ):
        for name in names:
            assert found[labels.index(name)] == row[trace.index[name]]


def test_ros_tools_read_joints_and_transforms(folder: Path, trace: Trace, read: Read) -> None:
    from rosbags.highlevel import AnyReader

    with AnyReader([folder / "ros.mcap"]) as bag:
        topics: dict[str, list[Any]] = defaultdict(list)
        for connection, at, content in bag.messages():
            topics[connection.topic].append((at, bag.deserialize(content, connection.msgtype)))
    assert set(topics) == {"/tf", "/joint_states", "/robot_description"}
    assert "<robot" in topics["/robot_description"][0][1].data
    for s, (at, joints), (_, tf), k in zip(
        trace.snapshots, topics["/joint_states"], topics["/tf"], range(9), strict=False
    ):
        assert at == round(1e9 * s.t)
        assert joints.header.stamp.sec * 10**9 + joints.header.stamp.nanosec == at
        assert joints.name[:7] == [f"panda_joint{i}" for i in range(1, 8)]
        assert joints.position[:7].tolist() == s.q_m.tolist()
        expected = [each.child_frame_id for each in read["/tf"][k][1].transforms]
        assert [each.child_frame_id for each in tf.transforms] == expected
    assert len(topics["/tf"]) == len(trace.snapshots)


@pytest.fixture
def mirrored(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> RobotModel:
    """The paper's robot with left wheel axes that point to the right."""
    made = shutil.copytree(assets.ASSETS / "husky_panda", tmp_path / "mirrored")
    tree = ElementTree.parse(made / "robot.urdf")
    for joint in tree.iterfind("joint"):
        if str(joint.get("name")).endswith("left_wheel"):
            axis = joint.find("axis")
            assert axis is not None
            axis.set("xyz", "0 -1 0")
    tree.write(made / "robot.urdf")
    text = (made / "robot.toml").read_text("utf-8").replace('"husky_panda"', '"mirrored"', 1)
    (made / "robot.toml").write_text(text, "utf-8")
    monkeypatch.setenv("DBB_ROBOTS", str(tmp_path))
    return RobotModel(load_robot("mirrored"))


def test_wheel_rotation_matches_the_drive_for_any_axis_direction(
    mirrored: RobotModel, robot: RobotModel, trace: Trace
) -> None:
    q_m = trace.snapshots[0].q_m
    turned = mirrored.joint_positions(q_m, [0.3, 0.3])
    assert turned["front_right_wheel"] == 0.3 == -turned["front_left_wheel"]
    assert {*robot.joint_positions(q_m, [0.3, 0.3]).values()} == {*q_m, 0.3}
    drawn, wanted = (
        LinkPoses(each).update(q_m, np.array([0.3, 0.2])) for each in (mirrored, robot)
    )
    assert all(a.isApprox(b, 1e-9) for a, b in zip(drawn, wanted, strict=True))


NAMES = ("arm_1", "arm1", "Arm-1", "a.b/c", "Gelenk;1", "Gelenk, ü", "7")


def test_joints_with_any_names_are_logged(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Protobuf rejects names that differ only in underscores or case."""
    made = shutil.copytree(assets.ASSETS / "husky_panda", tmp_path / "named")
    for file in ("robot.toml", "robot.urdf"):
        text = (made / file).read_text("utf-8").replace('name = "husky_panda"', 'name = "named"', 1)
        for number, name in enumerate(NAMES, 1):
            text = text.replace(f'"panda_joint{number}"', f'"{name}"')
        (made / file).write_text(text, "utf-8")
    monkeypatch.setenv("DBB_ROBOTS", str(tmp_path))
    named = RobotModel(load_robot("named"))
    trace = Trace.of_snapshots(named, random_snapshots(3, 2))
    write_mcap(tmp_path / "run.mcap", trace, named)
    with (tmp_path / "run.mcap").open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        steps = [content for *_, content in reader.iter_decoded_messages(topics=["/step"])]
    for row, step in zip(trace.table, steps, strict=True):
        found = [getattr(step, field.name) for field in step.DESCRIPTOR.fields]
        assert found == pytest.approx(row, nan_ok=True, abs=0)
    for ending in ("csv", "parquet"):
        write_trace(tmp_path / f"log.{ending}", trace)
        assert read_trace(tmp_path / f"log.{ending}").meta.joints == NAMES


def test_full_disk_is_one_line_and_leaves_no_file(
    robot: RobotModel, trace: Trace, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(Path, "write_bytes", full)
    with pytest.raises(OutputError, match=r"run\.mcap: No space left"):
        write_mcap(tmp_path / "run.mcap", trace, robot)
    assert list(tmp_path.iterdir()) == []


def test_foxglove_layout_shows_topics_of_the_file(read: Read) -> None:
    layout = json.loads((PROJECT / "examples" / "foxglove_layout.json").read_text("utf-8"))
    panels = layout["configById"]
    paths = [path["value"] for panel in panels.values() for path in panel.get("paths", [])]
    assert len(paths) == 6
    for path in paths:
        topic, name = path.split(".")
        assert hasattr(read[topic][0][1], name)
    assert set(panels["3D!robot"]["topics"]) <= set(read)
    assert panels["3D!robot"]["followTf"] in places(read, 0)
