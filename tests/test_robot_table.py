"""Every robot through the same cases: a row has the figures of a run."""

from __future__ import annotations

import pytest
import tyro

from app.border.mobile import MobileBody
from app.cli.common import print_table
from app.errors import UnknownNameError
from app.robot import assets
from benchmarks import robots as table
from benchmarks.robots import CASES, Case
from tests.robots import husky_panda

SHORT = Case("short", "guiding", (10.0,), length=0.12, speed=0.1)


def test_paths_keep_to_the_heights_of_the_base_and_those_on_the_axis_lead_along_it():
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
def test_a_row_for_each_controller_with_avoidance_farther_away():
    """Paths that do not come into the inner half of the buffer show nothing."""
    cases = [SHORT, SHORT._replace(length=0.04)]
    none, dbb, short = table.robot_table(["husky_panda"], cases=cases)["rows"]
    assert (none["controller"], dbb["controller"]) == table.COMPARED
    assert dbb["clearance_m"] > none["clearance_m"] > 0.03
    assert none["base_path_m"] < 1e-6 < dbb["base_path_m"]
    assert none["direction_deg"] == dbb["direction_deg"] == 10.0
    assert none["passed"] is True
    assert "nothing to show" in short["reason"]
    assert "controller" not in short


def test_a_robot_that_cannot_be_loaded_has_a_row_that_says_why(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(assets, "share_folders", list)
    (row,) = table.robot_table(["tiago"], cases=[SHORT])["rows"]
    assert row["robot"] == "tiago"
    assert "pip install" in row["reason"]


@pytest.mark.parametrize("words", [["--robots", "r2d2"], ["--case", "dancing"]])
def test_a_name_that_does_not_exist_is_refused(words: list[str]):
    with pytest.raises(UnknownNameError, match=words[1]):
        tyro.cli(table.main, args=words)


def test_a_printed_table_shows_its_texts_as_they_are(capsys):
    """A unit in brackets is no markup."""
    print_table(("least clearance [m]", ""), [("0.1", "[bold]")], "speed [m/s]")
    out = capsys.readouterr().out
    assert all(text in out for text in ("least clearance [m]", "[bold]", "speed [m/s]"))
