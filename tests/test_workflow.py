"""The workflow of CI is one that GitHub takes, and asks for what this project can make."""

from __future__ import annotations

import re
import shutil
import subprocess
from pathlib import Path

import pytest
from check_jsonschema import main as check_jsonschema
from click.testing import CliRunner

PROJECT = Path(__file__).resolve().parent.parent
WORKFLOW = PROJECT / ".github" / "workflows" / "ci.yml"
TEXT = WORKFLOW.read_text(encoding="utf-8")
TARGETS = sorted(set(re.findall(r"^ +- run: make (\S+)", TEXT, re.M)))


def is_a_workflow(path: Path) -> bool:
    """By GitHub's schema, as the library brings it."""
    arguments = ["--builtin-schema", "vendor.github-workflows", str(path)]
    return CliRunner().invoke(check_jsonschema, arguments).exit_code == 0


def can_be_made(target: str) -> bool:
    """Whether make knows the target; nothing is made."""
    make = shutil.which("make")
    if make is None:
        pytest.skip("no make")
    done = subprocess.run([make, "-n", target], cwd=PROJECT, capture_output=True, text=True)
    return done.returncode == 0


def test_github_takes_the_workflow() -> None:
    assert is_a_workflow(WORKFLOW)


@pytest.mark.parametrize(
    ("good", "bad"),
    [
        ("runs-on:", "run-on:"),
        ("    steps:", "   steps:"),
        ("if: always()", "iff: always()"),
        ("timeout-minutes: 60", "timeout-minutes: long"),
    ],
)
def test_a_slip_in_it_would_be_seen(tmp_path: Path, good: str, bad: str) -> None:
    assert good in TEXT
    path = tmp_path / "ci.yml"
    path.write_text(TEXT.replace(good, bad), encoding="utf-8")
    assert not is_a_workflow(path)


def test_it_tests_on_pushes_and_pull_requests_with_every_python_of_the_project() -> None:
    assert re.search(r"^on:\n  push:\n  pull_request:\n", TEXT, re.M)
    (low, high) = re.findall(
        r'requires-python = ">=3\.(\d+),<3\.(\d+)"', (PROJECT / "pyproject.toml").read_text()
    )[0]
    asked = sorted({int(minor) for minor in re.findall(r'python(?:-version)?: "3\.(\d+)"', TEXT)})
    assert asked == list(range(int(low), int(high)))


def test_it_tests_on_a_mac_too() -> None:
    assert re.search(r'system: macos-\d+\n +python: "3\.1[123]"', TEXT)
    assert re.search(r"system: ubuntu-", TEXT)


@pytest.mark.parametrize("target", TARGETS)
def test_make_has_each_target_that_it_asks_for(target: str) -> None:
    assert can_be_made(target)
    assert not can_be_made(f"no-{target}")


def test_it_tests_and_draws_and_keeps_reports_and_pictures_also_of_a_failure() -> None:
    assert {"test", "test-without-browser", "pictures"} <= set(TARGETS)
    kept = re.findall(r"if: always\(\)\n +uses: actions/upload-artifact@\S+\n.*\n.*\n +path: (\S+)",
                      TEXT)  # fmt: skip
    assert sorted(kept) == ["out/pictures", "out/tests", "out/tests"]
    assert "out/tests/" in (PROJECT / "tools" / "test.sh").read_text(encoding="utf-8")
