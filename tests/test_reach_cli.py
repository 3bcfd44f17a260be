"""`dbb reach`: its output, its files and its errors."""

from __future__ import annotations

import csv
import errno
import json
import logging

import numpy as np
import pytest

from app.border import reach as reach_map
from app.border.reach import FINE_SPACING, ReachMap, fit_reachability, sample_reach_map
from app.cli.main import main
from app.cli.method import _write_csv
from app.errors import OutputError
from app.robot.model import RobotModel

FEW = 6000


@pytest.fixture(autouse=True)
def quick(monkeypatch):
    """Few samples."""
    monkeypatch.setattr(reach_map, "FINE_SAMPLES", FEW)


def fine(robot: RobotModel, body: str) -> ReachMap:
    """The map of the command."""
    return sample_reach_map(robot, body, samples=FEW, spacing=FINE_SPACING)


@pytest.fixture
def dbb(capfd, monkeypatch):
    """Run the command line in this process; return status, standard output and standard error."""
    monkeypatch.setattr(logging, "basicConfig", lambda **_: None)  # pytest owns the logging here

    def run(*args: str) -> tuple[int, str, str]:
        capfd.readouterr()
        try:
            main(list(args))
            status = 0
        except SystemExit as end:
            status = int(end.code or 0)
        return (status, *capfd.readouterr())

    return run


def test_json_contains_the_fit_and_the_values_of_paper_and_description(dbb, robot: RobotModel):
    status, out, _ = dbb("reach", "--json")
    assert status == 0
    result = json.loads(out)
    assert (result["robot"], result["seed"]) == ("husky_panda", 0)
    assert list(result["bodies"]) == ["lEE", "l3"]
    end_effector, forearm = result["bodies"]["lEE"], result["bodies"]["l3"]
    assert end_effector["paper"] == {"A_per_m2": 525.9, "B_m": 0.575, "C": 100.0}
    assert forearm["paper"] is None
    for body, figures in result["bodies"].items():
        fit = fit_reachability(fine(robot, body))
        assert (figures["A_per_m2"], figures["B_m"], figures["C"]) == fit[:3]
        assert figures["description"] == {
            key: getattr(robot.description.reachability[body], key)
            for key in ("A_per_m2", "B_m", "C")
        }
        assert 0.5 < figures["r_squared"] <= 1.0


def test_the_text_output_reports_only_the_requested_body(dbb):
    status, out, _ = dbb("reach", "--body", "lEE")
    assert status == 0
    assert "525.9" in out
    assert "0.575" in out
    assert "l3" not in out


def test_out_writes_the_map_and_its_shells(dbb, tmp_path, robot):
    assert dbb("reach", "--body", "l3", "--out", str(tmp_path / "new"))[0] == 0
    assert sorted(path.name for path in (tmp_path / "new").iterdir()) == [
        "reach-l3-radial.csv",
        "reach-l3.csv",
    ]
    found = fine(robot, "l3")
    rows = list(csv.DictReader((tmp_path / "new" / "reach-l3.csv").open(encoding="utf-8")))
    assert len(rows) == len(found.found)
    solutions = np.array([float(row["solutions"]) for row in rows])
    np.testing.assert_allclose(solutions, found.found, rtol=1e-5)
    points = np.array([[float(row[f"{axis}_m"]) for axis in "xyz"] for row in rows])
    np.testing.assert_allclose(points, found.points, atol=1e-4)
    shells = list(csv.DictReader((tmp_path / "new" / "reach-l3-radial.csv").open(encoding="utf-8")))
    assert max(float(row["mean"]) for row in shells) == pytest.approx(100.0, abs=1e-3)


@pytest.mark.parametrize(
    ("args", "words"),
    [
        (["--body", "l2"], ["body", "'l2'", "choose from", "all", "l3", "lEE"]),
        (["--body", "hand"], ["'hand'", "lEE"]),
        (["--seed", "-1"], ["--seed", "0 to"]),
        (["--robot", "husky"], ["robot", "husky_panda"]),
        (["--out", "/dev/null/x"], ["--out"]),
    ],
)
def test_each_wrong_option_gives_one_clear_line(dbb, args, words):
    status, out, err = dbb("reach", *args, "--json")
    assert (status, out) == (2, "")
    assert len(err.splitlines()) == 1
    assert err.startswith("dbb: error: ")
    assert not [word for word in words if word not in err], err


def test_full_disk_leaves_the_previous_table(tmp_path, monkeypatch):
    """Also a table of `dbb border`."""
    before, path = np.savetxt, tmp_path / "a.csv"

    def half(file, rows, *others, **more):
        before(file, rows[:1], *others, **more)
        raise OSError(errno.ENOSPC, "No space left on device")

    path.write_text("old")
    monkeypatch.setattr(np, "savetxt", half)
    with pytest.raises(OutputError, match=r"cannot write .*a\.csv: No space left"):
        _write_csv(path, "x_m", np.ones((3, 1)), "%.1f")
    assert [(each.name, each.read_text()) for each in tmp_path.iterdir()] == [("a.csv", "old")]
