"""The delivered robots: their descriptions are valid, and both engines load them."""

from __future__ import annotations

import importlib.util
import re
from collections.abc import Iterator
from functools import cache
from types import SimpleNamespace

import numpy as np
import pytest

from app.errors import AssetError
from app.onboarding import check
from app.onboarding.check import arm_row, base_row, dynamics_row, limits_row
from app.onboarding.fit import grouping, meetings
from app.robot import assets
from app.robot.assets import package_roots, resolve_package_uri, resolved_urdf, robot_names
from app.robot.description import load_robot
from app.robot.model import RobotModel

PACKAGES = {
    "husky_panda": "pybullet_data",
    "husky_ur5": "example-robot-data",
    "stretch_se3": "stretch_urdf",
    "frankie": "rtbdata",
    "tiago": "example-robot-data",
}
"""The package of each robot's meshes; all but the first belong to the extra `robots`."""


@cache
def model_of(name: str) -> RobotModel:
    return RobotModel(load_robot(name))


@pytest.fixture(scope="module", autouse=True)
def _geometry_read_once() -> Iterator[None]:
    """Both tests of a robot's bodies share the convex pieces of its links."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(check, "_geometry", cache(check._geometry))
        yield


def test_all_robots_of_the_list_are_shipped() -> None:
    assert set(PACKAGES) <= set(robot_names())


@pytest.mark.parametrize("name", PACKAGES)
def test_description_is_read_without_meshes_and_states_its_sources(
    name: str,
) -> None:
    description = load_robot(name)
    assert description.name == name
    assert description.licence
    assert all(description.arm.source.values())


@pytest.mark.parametrize("name", PACKAGES)
def test_robot_has_the_same_dynamics_in_both_engines(name: str) -> None:
    if not package_roots(PACKAGES[name]):
        pytest.skip("pip install '.[robots]'")
    model = model_of(name)
    engines = (dynamics_row(model, "pybullet"), dynamics_row(model, "mujoco"))
    for row in (*engines, limits_row(model), base_row(model)):
        assert row.outcome == "passed", row


@pytest.mark.slow
@pytest.mark.parametrize("name", [*PACKAGES, "racecar_panda"])
def test_a_pair_detects_each_collision_of_random_postures(
    name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(grouping, "TEST_POSTURES", 300)
    monkeypatch.setattr(grouping, "ENOUGH", 5)
    monkeypatch.setattr(meetings, "_NEAREST", 10)
    monkeypatch.setattr(meetings, "_TRIES", 3)
    row = arm_row(model_of(name))
    assert row.outcome in {"passed", "warned"}, row


def test_missing_package_is_reported_with_its_installation(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    monkeypatch.setattr(assets, "share_folders", list)
    for name, how in (
        ("husky_ur5", r"pip install 'dbb-mobile-manipulator\[robots\]'|pybullet_data"),
        ("stretch_se3", r"pip install 'dbb-mobile-manipulator\[robots\]'"),
    ):
        with pytest.raises(AssetError, match=how):
            resolved_urdf(load_robot(name))
    with pytest.raises(AssetError, match="'something' is not installed"):
        resolve_package_uri("package://something/a.stl")


@pytest.mark.parametrize("name", [n for n in PACKAGES if n != "husky_panda"])
def test_no_mesh_is_copied_and_all_mesh_paths_are_package_uris(name: str) -> None:
    folder = assets.ASSETS / name
    assert not [p for p in folder.rglob("*") if p.suffix.lower() in {".stl", ".dae", ".obj"}]
    if load_robot(name).urdf.startswith("package://"):
        assert not list(folder.glob("*.urdf"))
        return
    text = (folder / "robot.urdf").read_text(encoding="utf-8")
    files = [part.split('"')[0] for part in text.split('filename="')[1:]]
    assert files
    assert all(file.startswith("package://") for file in files)


def test_a_named_limit_prevents_the_contacts_that_no_pair_monitors(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The wrist of a UR folds back into the forearm; formerly the check named no limit.

    For a UR10e the named buffer distance is 0.06 m, and a pair then detects all these contacts. For
    a UR5 it is below the range of d_b.
    """
    monkeypatch.setattr(grouping, "TEST_POSTURES", 800)
    monkeypatch.setattr(grouping, "ENOUGH", 0)
    monkeypatch.setattr(meetings, "_TRIES", 3)
    monkeypatch.setattr(meetings, "parameter", lambda _: SimpleNamespace(low=0.01))
    description = load_robot("husky_ur5")
    row = arm_row(model_of("husky_ur5"))
    assert row.numbers["left_out_poses"] > 50
    assert row.outcome == "warned"
    assert ", which a pair can detect with --buffer-distance 0.0" in row.text
    arm = description.arm
    lower, upper = np.full((2, 6), [[-np.pi], [np.pi]])
    named = re.findall(r"none with (\w+) from (-?[\d.]+) to (-?[\d.]+)", row.text)
    assert named
    for joint, low, high in named:
        assert joint.startswith("wrist")
        k = arm.joints.index(joint)
        lower[k], upper[k] = max(lower[k], float(low)), min(upper[k], float(high))
    assert (upper - lower > np.pi / 2).all()
    limits = {"position_lower": tuple(lower), "position_upper": tuple(upper)}
    limited = description.model_copy(update={"arm": arm.model_copy(update=limits)})
    assert arm_row(RobotModel(limited)).numbers["left_out_poses"] < 5
