"""`dbb reach`: what it prints, what it writes, what it refuses, and Ctrl-C."""

from __future__ import annotations

import csv
import json
import logging
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import psutil
import pytest

from app.border.reach.map import load_reach_map
from app.border.score import fit_reachability
from app.cli.main import main
from app.robot.model import RobotModel

PROJECT = Path(__file__).parent.parent


@pytest.fixture
def dbb(capfd, monkeypatch):
    """Runs the command line in this process; gives status, standard output and error."""
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


def test_json_holds_the_fit_beside_the_papers_and_the_descriptions(dbb, robot: RobotModel):
    status, out, _ = dbb("reach", "--json")
    assert status == 0
    result = json.loads(out)
    assert (result["robot"], result["seed"]) == ("husky_panda", 0)
    assert list(result["bodies"]) == ["lEE", "l3"]
    hand, forearm = result["bodies"]["lEE"], result["bodies"]["l3"]
    assert hand["paper"] == {"A_per_m2": 525.9, "B_m": 0.575, "C": 100.0}
    assert forearm["paper"] is None
    for body, figures in result["bodies"].items():
        fit = fit_reachability(load_reach_map(robot, body))
        assert (figures["A_per_m2"], figures["B_m"], figures["C"]) == fit[:3]
        assert figures["origin"] in ("cache", "shipped")
        assert figures["description"] == {
            key: getattr(robot.description.reachability[body], key)
            for key in ("A_per_m2", "B_m", "C")
        }
        assert 0.5 < figures["r_squared"] <= 1.0


def test_people_are_told_the_same_of_the_body_they_ask_for(dbb):
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
    found = load_reach_map(robot, "l3")
    rows = list(csv.DictReader((tmp_path / "new" / "reach-l3.csv").open(encoding="utf-8")))
    assert len(rows) == len(found.found)
    assert sum(int(row["solutions"]) for row in rows) == found.found.sum()
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
def test_what_cannot_be_done_is_one_clear_line(dbb, args, words):
    status, out, err = dbb("reach", *args, "--json")
    assert (status, out) == (2, "")
    assert len(err.splitlines()) == 1
    assert err.startswith("dbb: error: ")
    assert not [word for word in words if word not in err], err


@pytest.mark.slow
def test_ctrl_c_ends_the_counting_and_its_processes_and_keeps_nothing(tmp_path):
    out = tmp_path / "out"
    # Another seed than the one that ships: an unfinished map must not be kept.
    process = subprocess.Popen(
        [sys.executable, "-m", "app", "reach", "--seed", "987", "--json", "--out", str(out)],
        cwd=PROJECT,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )
    before = set((PROJECT / "dbb_cache").iterdir())
    deadline = time.monotonic() + 60
    while not (family := busy(process.pid)) and time.monotonic() < deadline:
        time.sleep(0.1)
    assert family
    os.killpg(process.pid, signal.SIGINT)  # as a terminal does
    printed, err = process.communicate(timeout=30)
    assert process.returncode == 130
    assert printed == ""
    assert err == "dbb: interrupted\n"
    assert not psutil.wait_procs(family, timeout=10)[1]
    assert set((PROJECT / "dbb_cache").iterdir()) - before == set()
    assert list(out.iterdir()) == []


def busy(pid: int) -> list[psutil.Process]:
    """What a process has started, once its workers have long begun to count."""
    family = psutil.Process(pid).children(recursive=True)
    times = sorted(process.cpu_times().user for process in family)
    cores = os.cpu_count() or 1
    return family if len(times) >= cores and times[-cores] > 2.0 else []
