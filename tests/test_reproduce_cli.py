"""`dbb reproduce`: its files, its refusals, and its agreement with `dbb run`."""

from __future__ import annotations

import csv
import json
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from app.cli.main import main
from app.studies.paper.report import FIGURES

PROJECT = Path(__file__).parent.parent
TIMES = {"step_p50_us", "step_p99_us", "realtime_factor"}


@pytest.fixture
def refused(capfd) -> Callable[..., None]:
    """Return a check that a command ends with status 2 and one line that has certain words."""

    def refused(args: list[str], *words: str) -> None:
        with pytest.raises(SystemExit) as end:
            main(args)
        out, err = capfd.readouterr()
        assert (end.value.code, out) == (2, "")
        (line,) = err.splitlines()
        assert all(word in line for word in words), line

    return refused


@pytest.mark.slow
def test_a_figure_without_runs_is_written_with_its_data_and_page(tmp_path, capfd):
    out = tmp_path / "made" / "on demand"
    main(["reproduce", "fig10", "--out", str(out), "--json"])
    printed, errors = capfd.readouterr()
    assert errors == ""
    result = json.loads(printed)
    assert json.loads((out / "metrics.json").read_text(encoding="utf-8")) == result
    assert list(result["figures"]) == ["fig10"]
    assert (result["claims"], result["runs"]) == ([], {})
    assert sorted(p.name for p in out.iterdir()) == [
        "fig10.csv",
        "fig10.png",
        "index.html",
        "metrics.json",
    ]
    assert (out / "fig10.png").read_bytes().startswith(b"\x89PNG")
    with (out / "fig10.csv").open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert (float(rows[0]["beta"]), float(rows[-1]["beta"])) == (1.0, 0.0)


def test_unknown_figure_is_refused_with_the_valid_names(refused, tmp_path):
    refused(["reproduce", "fig9", "--out", str(tmp_path)], "fig9", *FIGURES)
    assert list(tmp_path.iterdir()) == []


def test_bad_options_are_refused_before_any_work(refused, tmp_path):
    out = ["--out", str(tmp_path)]
    refused(["reproduce", "fig12", "--seed", "-1", *out], "--seed", "-1")
    refused(["reproduce", "fig12", "--processes", "0", *out], "--processes", "0")
    file = tmp_path / "file"
    file.touch()
    refused(["reproduce", "fig12", "--out", str(file)], "--out", str(file))


def test_other_commands_start_without_matplotlib():
    code = "import sys, app.cli.main; print('matplotlib' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], cwd=PROJECT, capture_output=True, text=True)
    assert done.stdout.strip() == "False"


@pytest.mark.slow
def test_a_figure_agrees_with_the_run_of_its_scenario(tmp_path, capfd):
    out = ["--out", str(tmp_path), "--seed", "1", "--json"]
    main(["reproduce", "fig14", "--processes", "1", *out])
    result = json.loads(capfd.readouterr().out)
    log = tmp_path / "run"
    main(["run", "guiding-lateral", "--seed", "1", "--out", str(log), "--json"])
    figures = json.loads(capfd.readouterr().out)
    mine = result["runs"]["guiding-lateral, dbb"]
    assert {k: v for k, v in mine.items() if k not in TIMES} == {
        k: v for k, v in figures.items() if k not in TIMES
    }
    for key, value in result["figures"]["fig14"]["measured"]["lateral"].items():
        assert value == figures[key]
    with (tmp_path / "fig14.csv").open(encoding="utf-8") as file:
        drawn = [row for row in csv.DictReader(file) if row["direction"] == "lateral"]
    with (log / "log.csv").open(encoding="utf-8") as file:
        next(file)  # metadata of the run
        logged = list(csv.DictReader(file))[::10]
    for column in ("t_s", "d_lm-lEE_m", "beta_lm-l3"):
        assert [float(row[column]) for row in drawn] == [float(row[column]) for row in logged]
    (claim,) = result["claims"]
    assert claim["holds"] is True
    assert claim["limits"]
    assert "data:image/png" in (tmp_path / "index.html").read_text(encoding="utf-8")


@pytest.mark.slow
def test_ctrl_c_ends_the_command_and_its_workers(tmp_path):
    psutil = pytest.importorskip("psutil")
    with subprocess.Popen(
        [sys.executable, "-m", "app", "reproduce", "fig12", "--out", str(tmp_path)],
        cwd=PROJECT,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    ) as process:
        parent = psutil.Process(process.pid)
        until = time.monotonic() + 30.0
        while len(parent.children()) < 3 and time.monotonic() < until:
            time.sleep(0.1)
        time.sleep(1.0)
        children = parent.children(recursive=True)
        assert len(children) >= 3  # two workers and the guard
        process.send_signal(signal.SIGINT)
        _, err = process.communicate(timeout=30)
    assert process.returncode == 130
    assert err.splitlines()[-1] == "dbb: interrupted"
    assert "Traceback" not in err
    assert psutil.wait_procs(children, timeout=10)[1] == []
