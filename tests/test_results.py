"""Measurements of the documentation's tables: stored row by row with commit and machine."""

from __future__ import annotations

import json
import os
from pathlib import Path

import pytest

from tools import results
from tools.measured import SETS, ResultSet, keep_run, millimetres, run_cell

COUNT = "import json, pathlib, sys; p = pathlib.Path(sys.argv[1]); n = len(p.read_text()) + 1; "
COUNT += "p.write_text('x' * n); print(json.dumps({'n': n})) if n < 4 else sys.exit('no more')"


@pytest.fixture
def counting(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A set of two rows; its command counts its runs and fails from the fourth run on."""
    counter = tmp_path / "counter"
    counter.write_text("", encoding="utf-8")
    module = tmp_path / "counted.py"
    module.write_text(COUNT, encoding="utf-8")
    runs = {name: ("counted", str(counter)) for name in ("a", "b")}
    found = ResultSet(runs, lambda printed: printed, lambda rows: f"{rows}")
    monkeypatch.setitem(SETS, "counting", found)
    monkeypatch.setattr(results, "RESULTS", tmp_path / "results")
    monkeypatch.setattr(results, "commit", lambda: "abc1234")
    monkeypatch.setattr(
        results, "_environment", lambda: {**os.environ, "PYTHONPATH": str(tmp_path)}
    )
    return counter


def test_a_row_is_measured_once_for_a_commit(counting: Path) -> None:
    assert results.measure("counting", again=False)
    assert results.measure("counting", again=False)
    assert results.figures("counting") == {"a": {"n": 1}, "b": {"n": 2}}


def test_rows_that_are_not_selected_stay_unchanged(counting: Path) -> None:
    assert results.measure("counting", again=False, only=["b"])
    assert results.measure("counting", again=True, only=["a"])
    assert results.figures("counting") == {"a": {"n": 2}, "b": {"n": 1}}


def test_an_ended_measurement_continues_and_a_failed_row_is_unchanged(counting: Path) -> None:
    results.write("counting", {"a": {"commit": "abc1234", "figures": {"n": 0}}})
    assert results.measure("counting", again=False)
    assert results.figures("counting") == {"a": {"n": 0}, "b": {"n": 1}}
    assert results.measure("counting", again=True)
    assert not results.measure("counting", again=True)
    assert results.figures("counting") == {"a": {"n": 2}, "b": {"n": 3}}


def test_rows_of_another_commit_or_of_changed_files_are_measured_again(
    counting: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    results.write("counting", {"a": {"commit": "older00", "figures": {}}, "gone": {"commit": "x"}})
    assert results.measure("counting", again=False)
    assert results.figures("counting") == {"a": {"n": 1}, "b": {"n": 2}}
    monkeypatch.setattr(results, "commit", lambda: "abc1234+")
    assert not results.measure("counting", again=False)


def test_a_caption_names_command_commit_and_machine(counting: Path) -> None:
    assert "Not measured" in results.caption("counting")
    assert "`make results ARGS=counting`" in results.caption("counting")
    assert results.measure("counting", again=False)
    caption = results.caption("counting")
    for stated in ("`make results ARGS=counting`", "abc1234", results.machine()):
        assert stated in caption
    assert "not measured" not in caption
    rows = results.read("counting")
    results.write("counting", {"a": rows["a"]})
    assert results.caption("counting").endswith(" Empty cells are not measured yet.*")
    results.write("counting", {"a": rows["a"], "b": rows["b"] | {"commit": "other00"}})
    assert "at commits abc1234 and other00, on" in results.caption("counting")


def test_stored_numbers_have_six_digits_and_other_values_stay() -> None:
    given = {"a": [0.123456789, 12345678.9, 3], "b": None, "c": "0.123456789", "d": -1e-13 / 3}
    kept = {"a": [0.123457, 12345700.0, 3], "b": None, "c": "0.123456789", "d": -3.33333e-14}
    assert results.rounded(given) == kept


@pytest.mark.parametrize("name", SETS)
def test_every_table_is_markdown_with_equal_numbers_of_cells(name: str) -> None:
    found = results.figures(name)
    if not found:
        pytest.skip("not measured yet")
    assert set(found) <= set(SETS[name].runs)
    tables = [block for block in SETS[name].table(found).split("\n\n") if block.startswith("|")]
    assert tables
    for block in tables:
        cells = {len(line.replace("\\|", "").split("|")) for line in block.splitlines()}
        assert len(cells) == 1


def test_stored_files_contain_the_fields_of_a_caption() -> None:
    files = sorted(results.PROJECT.glob("docs/results/*.json"))
    assert files
    for path in files:
        assert path.stem in SETS
        for row in json.loads(path.read_text(encoding="utf-8")).values():
            assert {"commit", "machine", "date", "figures"} == set(row)


def test_a_cell_marks_contact() -> None:
    printed = {
        "scenario": "guiding-fold",
        "min_clearance_m": 0.2,
        "arm_min_clearance_m": -0.1012,
        "ee_error_final_m": 0.00214,
        "contacts": 0,
        "arm_contacts": 3,
        "base_displacement_m": 0.0,
        "solver_failures": 0,
    }
    assert run_cell(keep_run(printed)) == "−0.101 m, error 2.1 mm, **contact**"
    assert run_cell(keep_run({**printed, "arm_contacts": 0})) == "−0.101 m, error 2.1 mm"
    assert millimetres(0.3279) == "328 mm"
    assert run_cell(None) == ""
