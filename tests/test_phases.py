"""`make test` in two phases: every test in one of them, both always run, none is lost."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path
from xml.etree import ElementTree

import pytest

from tests.phases import PHASES

PROJECT = Path(__file__).resolve().parent.parent
VENV = Path(sys.executable).parent.parent
QUICK = ("-n", "0")  # without processes of their own
PLUGINS = {"PYTEST_DISABLE_PLUGIN_AUTOLOAD": "1", "PYTEST_PLUGINS": "xdist.plugin"}
"""Variables with which pytest loads what is needed here and not the rest, which takes its time."""
MARKERS = "[pytest]\nmarkers =\n    alone\n    browser\n    slow\n"
TESTS = """
import os, pytest
def told(test):
    with open("order", "a") as file:
        print(test, os.environ.get("PYTEST_XDIST_WORKER", "nobody"), file=file)
def test_plain(): told("plain")
@pytest.mark.alone
def test_alone(): told("alone")
@pytest.mark.browser
def test_browser(): told("browser")
@pytest.mark.slow
def test_broken_side_by_side(): assert not os.environ.get("BREAK_TOGETHER")
@pytest.mark.alone
def test_broken_alone(): assert not os.environ.get("BREAK_ALONE")
"""


@pytest.fixture
def project(tmp_path: Path) -> Path:
    """A project with one file of tests, in which each can be broken by a variable."""
    (tmp_path / "pytest.ini").write_text(MARKERS, encoding="utf-8")
    (tmp_path / "test_some.py").write_text(TESTS, encoding="utf-8")
    return tmp_path


def run(project: Path, *args: str, **variables: str) -> tuple[int, dict[str, list[str]]]:
    """The status of `tools/test.sh`, and the tests that each phase reports."""
    outer = {name: value for name, value in os.environ.items() if not name.startswith("PYTEST_")}
    variables = {**outer, **PLUGINS, "PYTHONPATH": str(PROJECT), **variables}
    done = subprocess.run(
        [PROJECT / "tools" / "test.sh", VENV, *args],
        cwd=project, env=variables, capture_output=True, text=True, timeout=120,
    )  # fmt: skip
    assert done.stderr == ""
    return done.returncode, {name: reported(project / f"out/tests/{name}.xml") for name in PHASES}


def reported(path: Path) -> list[str]:
    return sorted(case.attrib["name"] for case in ElementTree.parse(path).iter("testcase"))


def test_each_test_runs_once_side_by_side_or_after_that_alone(project: Path) -> None:
    status, ran = run(project)
    assert status == 0
    assert ran == {
        "together": ["test_broken_side_by_side", "test_plain"],
        "alone": ["test_alone", "test_broken_alone", "test_browser"],
    }
    (first, *others) = (project / "order").read_text(encoding="utf-8").splitlines()
    assert first.startswith("plain gw")
    assert others == ["alone nobody", "browser nobody"]


@pytest.mark.parametrize("broken", ["BREAK_TOGETHER", "BREAK_ALONE"])
def test_a_failure_in_one_phase_is_the_status_and_the_other_is_run_all_the_same(
    project: Path, broken: str
) -> None:
    status, ran = run(project, *QUICK, **{broken: "1"})
    assert status == 1
    assert [len(ran[name]) for name in PHASES] == [2, 3]


@pytest.mark.parametrize(
    ("args", "status", "chosen"),
    [
        (["-k", "plain or nothing"], 0, ["test_plain"]),
        (["-m", "browser"], 0, ["test_browser"]),
        (["-k", "nothing"], 5, []),
    ],
    ids=["together", "alone", "none"],
)
def test_what_is_chosen_is_obeyed_and_a_phase_without_any_is_no_failure(
    project: Path, args: list[str], status: int, chosen: list[str]
) -> None:
    ended, ran = run(project, *QUICK, *args)
    assert ended == status
    assert ran["together"] + ran["alone"] == chosen
