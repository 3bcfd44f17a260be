"""Without pybullet and its meshes, everything works that does not need them."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from app.dashboard.scene.robot import RobotParts
from app.errors import AssetError
from app.robot.assets import resolve_package_uri
from app.robot.description import load_robot
from app.robot.model import RobotModel

PROJECT = Path(__file__).resolve().parent.parent


@pytest.fixture
def no_meshes(monkeypatch: pytest.MonkeyPatch) -> None:
    """pybullet_data is not installed."""
    monkeypatch.setitem(sys.modules, "pybullet_data", None)


@pytest.mark.usefixtures("no_meshes")
def test_missing_mesh_of_pybullet_is_reported_with_its_installation() -> None:
    with pytest.raises(AssetError, match="it comes with pybullet: pip install"):
        resolve_package_uri("package://pybullet_data/husky/meshes/base_link.stl")


@pytest.mark.usefixtures("no_meshes")
def test_robot_without_meshes_is_drawn_by_its_bodies_with_a_notice(caplog) -> None:
    model = RobotModel(load_robot("husky_panda"))
    parts = RobotParts(model)
    assert "convex bodies" in parts.title
    assert "drawn by its convex bodies" in caplog.text
    assert len(parts.visuals) == len(parts.bodies) > 0
    assert {v.name for v in parts.visuals}.isdisjoint(body.name for body in parts.bodies)
    for look, body in zip(parts.visuals, parts.bodies, strict=True):
        assert look.joint == body.joint
        assert look.placement == body.placement
        np.testing.assert_allclose(look.mesh.bounds, body.mesh.bounds, atol=1e-9)


def test_robot_with_meshes_is_drawn_by_its_meshes(robot) -> None:
    pytest.importorskip("pybullet_data")
    parts = RobotParts(robot)
    assert parts.title == robot.description.title
    assert len(parts.visuals) > len(parts.bodies)


@pytest.mark.usefixtures("no_meshes")
def test_dynamics_do_not_depend_on_meshes(robot) -> None:
    bare = RobotModel(load_robot("husky_panda")).pin
    assert bare.inertias.tolist() == robot.pin.inertias.tolist()
    assert bare == robot.pin


COMMANDS = """
import sys
for name in ("pybullet", "pybullet_data"):
    sys.modules[name] = None  # as if it were not installed
from app.cli.main import main
for command in sys.argv[1:]:
    try:
        main(command.split())
    except SystemExit as end:
        print(end.code)
    print("---")
"""


@pytest.mark.slow
def test_commands_run_or_report_the_missing_pybullet_in_one_line() -> None:
    short = "run guiding-lateral --duration 0.1 --json --physics"
    default = short.removesuffix(" --physics")
    commands = ["robots --json", f"{short} kinematic", default, f"{short} planar"]
    done = subprocess.run(
        [sys.executable, "-c", COMMANDS, *commands],
        cwd=PROJECT,
        capture_output=True,
        text=True,
        timeout=500,
    )
    robots, *runs, status, _ = done.stdout.split("---\n")
    (ours,) = [robot for robot in json.loads(robots)["robots"] if robot["name"] == "husky_panda"]
    assert not ours.get("problem")
    plants = [json.loads(run)["physics"] for run in runs]
    assert plants == ["kinematic", "mujoco"], done.stderr
    assert status.strip() == "2"
    (line,) = [each for each in done.stderr.splitlines() if "error" in each]
    assert "pybullet" in line
    assert "--physics mujoco" in line
