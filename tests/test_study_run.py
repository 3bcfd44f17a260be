"""`dbb study`: the same table in all modes, its files and its errors."""

from __future__ import annotations

import io
import json
import os
import signal
import subprocess
import sys
import time
from contextlib import redirect_stdout, suppress
from pathlib import Path

import psutil
import pyarrow.parquet as pq
import pytest

from app.cli.main import main
from app.studies.pulls import study as module
from app.studies.pulls.case import TIMES
from app.studies.pulls.parameters import StudyParameters, StudyRange
from app.studies.pulls.study import study
from app.studies.runs import rounded

pytestmark = pytest.mark.slow

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib


PROJECT = Path(__file__).parent.parent
CASES = 6
OPTIONS = ("--physics", "kinematic", "--duration", "0.2", "--seed", "7")
PARAMETERS = StudyParameters(seed=7, physics="kinematic", ranges=StudyRange(duration=0.2))
FAST = (
    "--controller",
    "none",
    "--released",
    "0",
    "--speed",
    "0.99",
    "1",
    "--height",
    "0.2",
    "0.4",
    "--duration",
    "0.9",
)


def start(*args: str) -> subprocess.Popen[str]:
    return subprocess.Popen(
        [sys.executable, "-m", "app", *args],
        cwd=PROJECT,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )


def printed_here(*args: str) -> str:
    """The output of a successful command, in this process."""
    with redirect_stdout(io.StringIO()) as out:
        main(list(args))
    return out.getvalue()


def here(capfd: pytest.CaptureFixture[str], *args: str) -> tuple[int, str, str]:
    """Status and output of a failing command, in this process."""
    with pytest.raises(SystemExit) as end:
        main(list(args))
    return (int(str(end.value.code)), *capfd.readouterr())


def refused(outcome: tuple[int, str, str], *words: str) -> None:
    """Check a refusal: status 2, no standard output, one error line that contains these words."""
    status, out, err = outcome
    assert (status, out) == (2, ""), err
    (line,) = err.splitlines()
    assert all(word in line for word in words), line


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory) -> Path:
    """The folder of an uninterrupted study of one process."""
    out = tmp_path_factory.mktemp("undisturbed")
    printed = printed_here(
        "study", "--cases", str(CASES), *OPTIONS, "--processes", "1", "--out", str(out), "--json"
    )
    assert json.loads(printed) == json.loads((out / "study.json").read_text(encoding="utf-8"))
    return out


def test_table_has_one_row_per_case_with_inputs_and_figures(undisturbed):
    table = pq.read_table(undisturbed / "results.parquet")
    assert table["case"].to_pylist() == list(range(CASES))
    names = set(table.column_names)
    assert {
        "kind",
        "start_x_m",
        "move_z_m",
        "speed_mps",
        "base_delay_s",
        "encoder_noise_rad",
        "mass_error",
        "slip",
        "v_max_mps",
        "hand_f_max_n",
        "hand_stiffness_npm",
        "hand_mass_kg",
        "release_at_s",
        "regrasp_at_s",
        "hand_force_max_n",
        "hand_force_clear_max_n",
        "q7_rad",
        "seed",
        "min_distance_lm-lEE_m",
        "min_clearance_m",
        "contacts",
        "arm_contacts",
        "ee_error_final_m",
        "solver_failures",
        "nan",
        "error",
    } <= names
    assert not names & set(TIMES)
    assert set(table["nan"].to_pylist()) == {False}
    assert all(0.0 < d < 2.0 for d in table["min_clearance_m"].to_pylist())


def test_report_is_self_contained_and_has_its_figures(undisturbed):
    page = (undisturbed / "report.html").read_text(encoding="utf-8")
    assert page.count('src="data:image/png;base64,') == 3
    assert "http" not in page
    for name in ("envelope", "clearance", "errors"):
        assert f'id="{name}"' in page
        assert (undisturbed / f"{name}.png").read_bytes().startswith(b"\x89PNG")
    fitted = tomllib.loads((undisturbed / "envelope.toml").read_text(encoding="utf-8"))
    assert fitted["source"]["cases"] == CASES
    summary = json.loads((undisturbed / "study.json").read_text(encoding="utf-8"))
    assert fitted["envelope"].items() <= summary["envelope"].items()
    assert f"of {CASES} cases failed" in page


def test_killed_study_resumes_and_gives_the_same_table(undisturbed, tmp_path):
    """The study is killed with two processes and resumed with one.

    No process listens on a port, or remains after the kill.
    """
    args = ("study", "--cases", str(CASES), *OPTIONS, "--processes", "2", "--out", str(tmp_path))
    journal = tmp_path / "cases.jsonl"
    process = start(*args)
    until = time.monotonic() + 120
    while time.monotonic() < until and not (journal.exists() and journal.read_bytes().count(b"\n")):
        time.sleep(0.02)
    workers = psutil.Process(process.pid).children(recursive=True)
    assert len(workers) >= 2
    assert not set().union(*map(listening, [psutil.Process(process.pid), *workers]))
    os.kill(process.pid, signal.SIGKILL)
    process.communicate()
    done = journal.read_bytes().count(b"\n")
    assert 1 <= done < CASES
    assert not (tmp_path / "results.parquet").exists()
    assert psutil.wait_procs(workers, timeout=30)[1] == []
    kept = journal.read_bytes()
    printed_here(*args[:-4], "--processes", "1", *args[-2:])
    assert journal.read_bytes().startswith(kept[: kept.rfind(b"\n") + 1])
    assert journal.read_bytes().count(b"\n") == CASES
    for name in ("results.parquet", "study.json", "report.html"):
        assert (tmp_path / name).read_bytes() == (undisturbed / name).read_bytes(), name


def test_running_scheduler_gives_the_same_table_and_adds_cases(undisturbed, tmp_path):
    from distributed import LocalCluster  # no other test needs this slow import

    with LocalCluster(
        n_workers=1, threads_per_worker=1, host="127.0.0.1", dashboard_address="127.0.0.1:0"
    ) as local:
        for cases in (3, CASES):
            study(PARAMETERS, cases, tmp_path, scheduler=local.scheduler_address)
        assert local.scheduler_info["workers"]  # the study must not end it
    table = (tmp_path / "results.parquet").read_bytes()
    assert table == (undisturbed / "results.parquet").read_bytes()


def listening(process: psutil.Process) -> set[tuple[str, int]]:
    """The addresses at which a process accepts connections."""
    with suppress(psutil.NoSuchProcess):
        found = process.net_connections("inet")
        return {c.laddr for c in found if c.status == psutil.CONN_LISTEN}
    return set()


def test_finished_study_is_not_repeated(undisturbed):
    """No scheduler is at that address, and none is needed."""
    before = (undisturbed / "cases.jsonl").read_bytes()
    args = ("study", "--cases", str(CASES), *OPTIONS, "--scheduler", "tcp://127.0.0.1:9")
    printed_here(*args, "--out", str(undisturbed))
    assert (undisturbed / "cases.jsonl").read_bytes() == before


def test_folder_of_another_study_is_rejected_and_not_changed(undisturbed, capfd):
    before = {path: path.read_bytes() for path in undisturbed.glob("*.*")}
    args = ("study", "--cases", str(CASES), *OPTIONS, "--out", str(undisturbed))
    other = ["8" if word == "7" else word for word in args]
    assert other.count("8") == 1 + args.count("8")
    refused(here(capfd, *other), "another study", "seed: 7, not 8")
    refused(here(capfd, *args, "--speed", "0.1", "0.2"), "another study", "speed")
    assert {path: path.read_bytes() for path in undisturbed.glob("*.*")} == before


def test_unreachable_scheduler_is_one_line(tmp_path, capfd, monkeypatch):
    monkeypatch.setattr(module, "_PATIENCE", 1.0)
    args = ("study", "--cases", "2", *OPTIONS, "--out", str(tmp_path), "--scheduler")
    for address in ("tcp://127.0.0.1:9", "tls://127.0.0.1:9", "no address"):
        refused(here(capfd, *args, address), "--scheduler", address, "dask scheduler")


@pytest.mark.parametrize(
    ("args", "words"),
    [
        (["--cases", "0"], ["--cases", "0"]),
        (["--processes", "0"], ["--processes"]),
        (["--speed", "0.5", "0.1"], ["--speed", "LOW 0.5 is above HIGH 0.1"]),
        (["--speed", "nan", "0.1"], ["--speed", "nan"]),
        (["--base-delay", "0", "0.6"], ["--base-delay", "0 to 0.5 s"]),
        (["--hand-f-max", "40", "400"], ["--hand-f-max", "1 to 150 N"]),
        (["--hand-stiffness", "300", "9000"], ["--hand-stiffness", "10 to 3000 N/m"]),
        (["--hand-mass", "-1", "0"], ["--hand-mass", "0 to 5 kg"]),
        (["--released", "1.1"], ["--released", "0 to 1"]),
        (["--mass-error", "-0.5", "0"], ["--mass-error", "-0.3 to 0.3"]),
        (["--controller", "dbx"], ["did you mean 'dbb'"]),
        (["--robot", "r2d2"], ["r2d2", "husky_panda"]),
        (["--seed", "-1"], ["--seed"]),
    ],
)
def test_invalid_study_options_are_one_line_with_the_valid_values(tmp_path, capfd, args, words):
    refused(here(capfd, "study", "--out", str(tmp_path), *args), *words)
    assert not (tmp_path / "cases.jsonl").exists()


def test_ctrl_c_ends_the_study_cleanly_and_keeps_finished_cases(tmp_path):
    args = ("study", "--cases", "500", *OPTIONS, "--processes", "2", "--out", str(tmp_path))
    process = start(*args)
    journal = tmp_path / "cases.jsonl"
    until = time.monotonic() + 120
    while time.monotonic() < until and not (journal.exists() and journal.read_bytes().count(b"\n")):
        time.sleep(0.02)
    workers = psutil.Process(process.pid).children(recursive=True)
    os.killpg(process.pid, signal.SIGINT)  # as a terminal does
    out, err = process.communicate(timeout=60)
    assert (process.returncode, out) == (130, "")
    kept, last = err.splitlines()[-2:]
    assert "of 500 cases are stored in" in kept
    assert last == "dbb: interrupted"
    assert "Traceback" not in err
    assert psutil.wait_procs(workers, timeout=30)[1] == []
    lines = journal.read_bytes().splitlines()
    assert [json.loads(line)["error"] for line in lines] == [None] * len(lines)


def test_failed_case_is_stored_and_replayed_with_the_same_figures(tmp_path):
    """In fast, low pulls without avoidance, an end-effector hits the base."""
    args = ("study", "--cases", "2", "--physics", "kinematic", "--seed", "3", *FAST)
    printed_here(*args, "--processes", "1", "--out", str(tmp_path))
    result = json.loads((tmp_path / "study.json").read_text(encoding="utf-8"))
    assert result["contact"] >= 1 <= result["bodies_overlap"]
    files = sorted((tmp_path / "failures").iterdir())
    assert [path.name for path in files] == [f"case-{n:05d}.json" for n in result["failures"]]
    rows = map(json.loads, (tmp_path / "cases.jsonl").read_text(encoding="utf-8").splitlines())
    kept = next(row for row in rows if row["case"] == result["failures"][0])
    played = json.loads(printed_here("run", "--case", str(files[0]), "--json"))
    assert played["contacts"] == kept["contacts"]
    for name in ("min_clearance_m", "ee_error_final_m", "base_path_m", "torque_jump_max_nm"):
        assert rounded(played[name]) == kept[name], name
    for pair, distance in played["min_distance_m"].items():
        assert rounded(distance) == kept[f"min_distance_{pair}_m"]
