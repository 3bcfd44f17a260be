"""The input of `dbb new-robot`: one check of its numbers, for the command and for the page."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from app.errors import ConfigError, UnknownNameError
from app.onboarding.request import BOUNDS, Request, check_request, named, package_folders
from app.robot.assets import ASSETS


def toy_request(**fields: object) -> Request:
    return Request("toy.urdf", "base", "hand", Path("toy"), **fields)  # type: ignore[arg-type]


@pytest.mark.parametrize("field", BOUNDS)
def test_number_is_accepted_within_its_bounds_and_for_its_kind_of_base(field: str) -> None:
    bounds, kind = BOUNDS[field], BOUNDS[field].kind or "differential"
    others = {"half_track": 0.3} if field == "wheel_radius" else {}
    for value in (bounds.low, bounds.high):
        check_request(toy_request(kind=kind, **others, **{field: value}))
    option = "--" + field.replace("_", "-")
    for value in (bounds.low * 0.99, bounds.high * 1.01, float("nan"), 0.0):
        with pytest.raises(ConfigError, match=f"{option}: .* is not within"):
            check_request(toy_request(kind=kind, **others, **{field: value}))
    if bounds.kind:
        with pytest.raises(ConfigError, match=f"{option}: a holonomic base does not.*{kind}"):
            check_request(toy_request(kind="holonomic", **{field: bounds.high}))


def test_contradictory_options_are_refused() -> None:
    for words, fields in (
        ("--wheels: a holonomic base", {"kind": "holonomic", "wheels": ("l", "r")}),
        ("--wheel-radius: needs --half-track", {"wheel_radius": 0.1}),
        ("--mount-xyz: places an arm with its own URDF", {"mount_xyz": (0.1, 0.0, 0.0)}),
        ("--mount-rpy: places an arm with its own URDF", {"mount_rpy": (0.0, 0.0, 0.1)}),
        ("--file: names a URDF in a zip", {"file": "other.urdf"}),
        ("--tip-rpy: 180 radians", {"tip_rpy": (0.0, 180.0, 0.0)}),
        ("and excludes --wheels", {"wheel_radius": 0.1, "half_track": 0.3, "wheels": ("l", "r")}),
    ):
        with pytest.raises(ConfigError, match=words):
            check_request(toy_request(**fields))
    with pytest.raises(UnknownNameError, match="choose from: car-like, differential, holonomic"):
        check_request(toy_request(kind="hovering"))


@pytest.mark.parametrize("name", ["tiago", "mine"], ids=["delivered", "own"])
def test_the_name_of_an_existing_robot_is_refused(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    own = shutil.copytree(ASSETS / "tiago", tmp_path / "first" / "mine")
    monkeypatch.setenv("DBB_ROBOTS", f"{own.parent}:{tmp_path / 'second'}")
    with pytest.raises(ConfigError, match=f"--out: the robot '{name}' exists in .*/{name}; choose"):
        check_request(Request("toy.urdf", "base", "hand", tmp_path / "second" / name))
    check_request(Request("toy.urdf", "base", "hand", own))  # `whole_folder` refuses its content
    check_request(Request("toy.urdf", "base", "hand", tmp_path / "second" / "new"))


def test_home_is_expanded_in_the_folder_of_a_package(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("HOME", str(tmp_path))
    (tmp_path / "a").mkdir()
    assert package_folders(("a=~/a",)) == {"a": tmp_path / "a"}


@pytest.mark.parametrize("sign", ["=", ":="])
def test_arguments_of_a_xacro_are_accepted_in_the_form_of_ros(sign: str) -> None:
    assert named("--xacro", [f"a{sign}1", f"b{sign}x:=y"], "VALUE") == {"a": "1", "b": "x:=y"}
    with pytest.raises(ConfigError, match="not of the form NAME=VALUE"):
        named("--xacro", [f"{sign}1"], "VALUE")
