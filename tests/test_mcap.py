"""A run as MCAP, read back by the reader of the mcap library."""

from __future__ import annotations

import json
from collections import defaultdict
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from jsonschema import Draft202012Validator
from mcap.reader import make_reader

from app.errors import OutputError
from app.robot.model import RobotModel
from app.simulation.trace.mcap_file import WORLD, write_mcap
from app.simulation.trace.trace import Trace
from tests.logs import random_snapshots, trace_of

PROJECT = Path(__file__).resolve().parent.parent
TOPICS = {
    "/tf": "foxglove.FrameTransforms",
    "/joint_states": "foxglove.JointStates",
    "/bodies": "foxglove.SceneUpdate",
    "/markers": "foxglove.SceneUpdate",
    "/step": "dbb.Step",
    "/parameters": "dbb.Config",
}


@pytest.fixture(scope="module")
def trace() -> Trace:
    return trace_of(random_snapshots(3, 4))


@pytest.fixture(scope="module")
def read(
    robot: RobotModel, trace: Trace, tmp_path_factory: pytest.TempPathFactory
) -> dict[str, list[tuple[float, Any]]]:
    """Time [s] and message of each topic; every message keeps to the schema that the file has."""
    path = tmp_path_factory.mktemp("mcap") / "run.mcap"
    write_mcap(path, trace, robot)
    found = defaultdict(list)
    with path.open("rb") as file:
        for schema, channel, message in make_reader(file, validate_crcs=True).iter_messages():
            assert schema is not None
            assert (schema.encoding, channel.message_encoding) == ("jsonschema", "json")
            assert schema.name == TOPICS[channel.topic]
            told, content = json.loads(schema.data), json.loads(message.data)
            Draft202012Validator.check_schema(told)
            Draft202012Validator(told).validate(content)
            found[channel.topic].append((1e-9 * message.log_time, content))
    return found


def test_a_topic_has_a_message_for_each_row_or_snapshot(
    read: dict[str, list[tuple[float, Any]]], trace: Trace
) -> None:
    assert set(read) == set(TOPICS)
    for topic in ("/tf", "/joint_states", "/markers", "/step"):
        assert [t for t, _ in read[topic]] == pytest.approx(trace.t.tolist(), abs=1e-9)


def test_a_step_has_the_numbers_of_the_log(
    read: dict[str, list[tuple[float, Any]]], trace: Trace
) -> None:
    for row, (_, step) in zip(trace.table, read["/step"], strict=True):
        known = {
            column.name.replace("-", "_"): x
            for column, x in zip(trace.columns, row.tolist(), strict=True)
            if np.isfinite(x)
        }
        assert step == known


def test_the_links_stand_where_kinematics_put_them(
    read: dict[str, list[tuple[float, Any]]], trace: Trace, robot: RobotModel
) -> None:
    data = robot.pin.createData()
    for s, (_, message) in zip(trace.snapshots, read["/tf"], strict=True):
        placed = {WORLD: pin.SE3.Identity()}
        for each in message["transforms"]:
            numbers = [*each["translation"].values(), *each["rotation"].values()]
            step = pin.XYZQUATToSE3(np.array(numbers))
            placed[each["child_frame_id"]] = placed[each["parent_frame_id"]] * step
        pin.framesForwardKinematics(robot.pin, data, robot.configuration(s.base_pose, s.q_m))
        for name in ("end_effector", "panda_link4", "rear_left_wheel_link"):
            wanted = data.oMf[robot.pin.getFrameId(name)]
            scale = 1.0 + np.abs(wanted.translation).max()
            off = placed[name].translation - wanted.translation
            assert np.abs(off).max() / scale < 1e-9
            assert placed[name].rotation == pytest.approx(wanted.rotation, abs=1e-9)


def test_bodies_are_fixed_to_links_and_forces_point_as_they_act(
    read: dict[str, list[tuple[float, Any]]], trace: Trace, robot: RobotModel
) -> None:
    [(_, bodies)] = read["/bodies"]
    frames = {each["child_frame_id"] for each in read["/tf"][0][1]["transforms"]}
    assert [e["id"] for e in bodies["entities"]] == robot.body_names
    assert {e["frame_id"] for e in bodies["entities"]} <= frames
    for s, (_, message) in zip(trace.snapshots, read["/markers"], strict=True):
        arrows = [a for e in message["entities"] for a in e["arrows"]]
        forces = [*(each.f for each in s.acting), s.hand_force]
        for arrow, force in zip(arrows, forces, strict=True):
            turn = pin.Quaternion(np.array(list(arrow["pose"]["orientation"].values())))
            along = turn.matrix()[:, 0] * 400 * arrow["shaft_length"]
            assert along == pytest.approx(force, rel=1e-6, abs=1e-300)


def test_a_full_disk_is_one_line_and_leaves_nothing(
    robot: RobotModel, trace: Trace, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("mcap.writer.Writer.finish", full)
    with pytest.raises(OutputError, match=r"run\.mcap: No space left"):
        write_mcap(tmp_path / "run.mcap", trace, robot)
    assert list(tmp_path.iterdir()) == []


def test_the_layout_for_foxglove_shows_what_a_file_has(
    read: dict[str, list[tuple[float, Any]]],
) -> None:
    layout = json.loads((PROJECT / "examples" / "foxglove_layout.json").read_text("utf-8"))
    panels = layout["configById"]
    paths = [path["value"] for panel in panels.values() for path in panel.get("paths", [])]
    assert len(paths) == 6
    for path in paths:
        topic, name = path.split(".")
        assert name in read[topic][0][1]
    assert set(panels["3D!robot"]["topics"]) <= set(read)
    frames = {each["child_frame_id"] for each in read["/tf"][0][1]["transforms"]}
    assert panels["3D!robot"]["followTf"] in frames
