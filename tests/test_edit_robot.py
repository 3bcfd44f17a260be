"""A robot edited by hand: shapes follow gizmos, and a save changes nothing else."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest

from app.border.cache import BorderData, kept_border_data
from app.config import Config
from app.dashboard import robots
from app.dashboard.panels.edit import SIZE, changes_html, half_extents, placed, resized
from app.errors import DescriptionError, OutputError
from app.jobs.bounded import Budget
from app.onboarding.write import BY_HAND, HandMade, save_by_hand
from app.robot.assets import robot_folder
from app.robot.description import load_description
from app.robot.model import RobotModel
from app.robot.shapes import Box, Capsule, Cylinder, Hull, Shape, Sphere, Superquadric
from tests.browser import DashboardTab, wait_for
from tests.dashboards import Served, served_dashboard
from tests.fakes import ScriptedLoop
from tests.robots import husky_panda

SHAPES: list[Shape] = [
    Box(type="box", size_m=(0.2, 0.3, 0.4)),
    Sphere(type="sphere", radius_m=0.1),
    Cylinder(type="cylinder", radius_m=0.1, length_m=0.4),
    Capsule(type="capsule", start_m=(0.0, 0.0, -0.1), end_m=(0.0, 0.0, 0.1), radius_m=0.1),
    Hull(type="hull", vertices_m=((0.1, 0, 0), (-0.1, 0, 0), (0, 0.2, 0), (0, 0, 0.3))),
    Superquadric(type="superquadric", semi_axes_m=(0.1, 0.2, 0.3), e1=0.5, e2=0.5),
]
T = pin.SE3(pin.rpy.rpyToMatrix(0.3, -0.5, 1.1), np.array([0.1, -0.2, 0.3]))


@pytest.mark.parametrize("shape", SHAPES, ids=lambda shape: shape.type)
def test_placing_a_shape_sets_its_pose_and_preserves_its_size(shape: Shape) -> None:
    moved = placed(shape, T)
    assert moved.placement().translation == pytest.approx(T.translation, abs=1e-4)
    assert half_extents(moved) == pytest.approx(half_extents(shape), abs=2e-4)
    assert moved.placement().rotation[:, 2] == pytest.approx(T.rotation[:, 2], abs=2e-3)


@pytest.mark.parametrize("shape", SHAPES, ids=lambda shape: shape.type)
def test_resizing_a_shape_sets_its_extents_and_preserves_its_pose(shape: Shape) -> None:
    shape = placed(shape, T)
    half = half_extents(shape) * (1.5 if shape.type == "sphere" else np.array([1.5, 1.5, 2.0]))
    larger = resized(shape, half)
    assert half_extents(larger) == pytest.approx(half, abs=1e-3)
    assert larger.placement().isApprox(shape.placement(), 1e-3)


def test_resizing_one_side_of_a_cylinder_sets_its_radius() -> None:
    cylinder = Cylinder(type="cylinder", radius_m=0.1, length_m=0.4)
    wider = resized(cylinder, np.array([0.1, 0.15, 0.2]))
    assert isinstance(wider, Cylinder)
    assert (wider.radius_m, wider.length_m) == (0.15, 0.4)


CHANGES = HandMade(
    {("lEE", 0): Box(type="box", size_m=(0.1, 0.1, 0.2))},
    {"l1-lEE": BY_HAND},
    (0.0, -0.5, 0.0, -2.0, 0.0, 1.6, 0.8),
)


def test_the_panel_lists_every_kind_of_unsaved_change() -> None:
    before = {"lm-l3": "far apart"}
    robot = husky_panda().description.model_copy(update={"unwatched": before})
    text = changes_html(CHANGES, robot)
    for change in (
        "end-effector: box",
        "end-effector – shoulder: not monitored",
        "forearm – base: monitored",
        "ready posture 0, -0.5",
    ):
        assert change in text
    assert "Not saved" not in changes_html(HandMade({}, before, None), robot)


def test_saved_edits_are_marked_and_everything_else_is_unchanged(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("DBB_ROBOTS", str(tmp_path))
    source = robot_folder("husky_panda")
    save_by_hand(source, tmp_path / "mine", CHANGES)
    before = load_description(source / "robot.toml")
    after = load_description(tmp_path / "mine" / "robot.toml")
    assert after.body("lEE").shapes == (CHANGES.shapes["lEE", 0],)
    assert after.unwatched == CHANGES.unwatched
    assert after.arm.ready_position == CHANGES.ready
    assert {after.body("lEE").source, after.arm.source["ready_position"]} == {BY_HAND}
    assert after.name == "mine"
    changed = {"name": "x", "title": "x", "bodies": (), "arm": before.arm, "unwatched": {}}
    assert after.model_copy(update=changed) == before.model_copy(update=changed)
    assert after.bodies[:-1] == before.bodies[:-1]
    comments = [
        [line for line in (folder / "robot.toml").read_text().splitlines() if line[:1] == "#"]
        for folder in (source, tmp_path / "mine")
    ]
    assert comments[0] == comments[1]
    RobotModel(after)  # its URDF was copied


@pytest.mark.budget
def test_the_source_description_is_read_within_its_budget(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    source = tmp_path / "before"
    source.mkdir()
    text = (robot_folder("husky_panda") / "robot.toml").read_text()
    (source / "robot.toml").write_text(text + "# nothing\n" * 20_000)
    monkeypatch.setattr("app.jobs.bounded.Budget.of", lambda _: Budget(1.0, 1000))
    with pytest.raises(DescriptionError, match=f"{source}.*takes more than"):
        save_by_hand(source, tmp_path / "mine", CHANGES)


def test_missing_source_description_is_named(tmp_path: Path) -> None:
    with pytest.raises(DescriptionError, match=r"gone.robot\.toml: cannot be read"):
        save_by_hand(tmp_path / "gone", tmp_path / "mine", CHANGES)


def test_a_save_overwrites_only_the_edited_robot_itself(tmp_path: Path) -> None:
    source, own = robot_folder("husky_panda"), tmp_path / "mine"
    save_by_hand(source, own, CHANGES)
    text = (own / "robot.toml").read_text()
    save_by_hand(own, own, CHANGES._replace(shapes={}, unwatched={}, ready=None))
    again = load_description(own / "robot.toml")
    assert (again.name, again.unwatched) == ("mine", {})
    assert "unwatched" not in (own / "robot.toml").read_text()
    wrong = CHANGES._replace(unwatched={"l1-nobody": BY_HAND})
    with pytest.raises(DescriptionError, match="there is no pair l1-nobody"):
        save_by_hand(own, own, wrong)
    assert load_description(own / "robot.toml") == again
    with pytest.raises(OutputError, match="exists; remove it"):
        save_by_hand(source, own, CHANGES)
    assert text != (own / "robot.toml").read_text()


@pytest.fixture
def served(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Served]:
    monkeypatch.setenv("DBB_ROBOTS", str(tmp_path))
    data = kept_border_data(husky_panda())
    monkeypatch.setattr(robots, "kept_border_data", lambda model: data)

    def begin(model: RobotModel, data: BorderData, config: Config, controller: str) -> ScriptedLoop:
        return ScriptedLoop(model)

    with served_dashboard(start_loop=begin) as served:
        yield served


@pytest.mark.browser
@pytest.mark.slow
def test_a_body_is_dragged_resized_and_saved_in_the_page(
    browser: Any, served: Served, tmp_path: Path
) -> None:
    tab = DashboardTab(browser, served.server.address)
    tab.open_tab("Robot")
    tab.page.get_by_text("Edit this robot").click()
    tab.choose("Body", "end-effector")
    panel = served.page().robot_panel
    assert panel is not None
    gizmo = "/robot/panda_joint6/edited_end-effector/move"
    tab.wait("n => dbbPage.has(n)", f"{gizmo}/{SIZE}")
    before = husky_panda().description.body("lEE").shapes[0]
    assert isinstance(before, Capsule)
    tab.drag_gizmo(gizmo, 2, 0.08, 0.22)
    tab.drag_gizmo(f"{gizmo}/{SIZE}", 2, 0.05, 0.09)
    tab.page.get_by_text("Monitored pairs").click()
    tab.check("end-effector – upper arm", on=False)
    tab.click("Use this posture as ready posture")
    wait_for(lambda: panel.edit.changes.ready and panel.edit.changes.unwatched, what="changes")
    shared = served.server.shared
    tab.click("Save and use")
    wait_for(lambda: served.server.shared is not shared, what="the saved robot")
    saved = load_description(tmp_path / "husky_panda_by_hand" / "robot.toml")
    after = saved.body("lEE").shapes[0]
    assert isinstance(after, Capsule)
    moved = after.placement().translation - before.placement().translation
    along = before.placement().rotation[:, 2]
    assert moved @ along == pytest.approx(0.08, abs=0.02)
    assert np.linalg.norm(moved - (moved @ along) * along) < 0.005
    assert after.length_m == pytest.approx(before.length_m + 0.1, abs=0.02)
    assert saved.unwatched == {"l2-lEE": BY_HAND}
    # The page of the previous robot stays until the page of the saved robot is complete.
    tab.page.get_by_role("button", name="Save and use").wait_for(state="hidden")
    tab.wait_for_scene()
