"""Every robot in the same cases: a row has the figures of a run."""

from __future__ import annotations

from dataclasses import replace

import pytest
import tyro

from app.border.cache import BorderData
from app.border.mobile import MobileBody
from app.cli.common import print_table
from app.errors import UnknownNameError
from app.robot import assets
from app.robot.model import RobotModel
from app.studies.sweep.sweep import StartFinder
from benchmarks import robots as table
from benchmarks.robots import CASES, Case
from tests.robots import husky_panda

SHORT = Case("short", "guiding", (10.0,), length=0.12, speed=0.1)


def test_paths_have_heights_of_the_base_and_on_axis_cases_its_direction():
    robot = husky_panda()
    top = MobileBody(robot).upper[2]
    for case in CASES:
        paths = list(case.approaches(robot))
        assert paths
        assert all(0.1 < path.height <= top for path in paths)
        if case.on_axis:
            assert {path.kind for path in paths} == {"wheel_axis"}
            assert all(abs(path.inwards[0]) < 1e-9 and path.offset == 0.0 for path in paths)


@pytest.mark.slow
def test_table_has_a_row_per_controller_and_more_clearance_with_avoidance():
    """Paths outside the inner half of the buffer have nothing to show."""
    cases = [SHORT, SHORT._replace(length=0.04)]
    none, dbb, short = table.robot_table(["husky_panda"], cases=cases)["rows"]
    assert (none["controller"], dbb["controller"]) == table.COMPARED
    assert dbb["clearance_m"] > none["clearance_m"] > 0.03
    assert none["base_path_m"] < 1e-6 < dbb["base_path_m"]
    assert none["direction_deg"] == dbb["direction_deg"] == 10.0
    assert none["passed"] is True
    assert "nothing to show" in short["reason"]
    assert "controller" not in short


def test_robot_that_cannot_be_loaded_has_a_row_with_the_reason(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(assets, "share_folders", list)
    (row,) = table.robot_table(["tiago"], cases=[SHORT])["rows"]
    assert row["robot"] == "tiago"
    assert "pip install" in row["reason"]


def test_robot_without_a_pair_of_arm_and_base_has_a_row_with_the_reason(
    robot: RobotModel, border_data: BorderData, monkeypatch: pytest.MonkeyPatch
):
    data = replace(border_data, pairs=replace(border_data.pairs, mobile=()))
    monkeypatch.setattr(table, "load", lambda _, d_b: StartFinder(robot, data, d_b))
    (row,) = table.robot_table(["husky_panda"], cases=[SHORT])["rows"]
    assert "no monitored part of the arm can meet the base" in row["reason"]


@pytest.mark.parametrize("words", [["--robots", "r2d2"], ["--case", "dancing"]])
def test_unknown_name_is_rejected(words: list[str]):
    with pytest.raises(UnknownNameError, match=words[1]):
        tyro.cli(table.main, args=words)


def test_printed_table_shows_brackets_verbatim(capsys):
    """A unit in brackets is not markup."""
    print_table(("least clearance [m]", ""), [("0.1", "[bold]")], "speed [m/s]")
    out = capsys.readouterr().out
    assert all(text in out for text in ("least clearance [m]", "[bold]", "speed [m/s]"))
