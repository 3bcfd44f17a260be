"""The journal of a study loses, repeats and mixes no case."""

from __future__ import annotations

import json
import tracemalloc
from contextlib import nullcontext
from pathlib import Path

import pytest

from app.errors import StudyError
from app.studies.pulls import study as module
from app.studies.pulls.parameters import StudyParameters
from app.studies.pulls.study import Journal

IDENTITY = {"seed": 1, "ranges": {"speed": [0.1, 0.5]}, "code": "abc"}


def rows(count: int) -> list[dict]:
    return [{"case": k, "value_m": 0.1 * k} for k in range(count)]


def fill(folder: Path, count: int) -> bytes:
    with Journal(folder, IDENTITY) as journal:
        for row in rows(count):
            journal.add(row)
    return (folder / "cases.jsonl").read_bytes()


def test_added_rows_are_read_when_the_journal_is_reopened(tmp_path):
    fill(tmp_path, 3)
    with Journal(tmp_path, IDENTITY) as journal:
        assert journal.rows == {row["case"]: row for row in rows(3)}


def test_row_is_on_the_disk_before_add_returns(tmp_path):
    with Journal(tmp_path, IDENTITY) as journal:
        for k, row in enumerate(rows(3), start=1):
            journal.add(row)
            lines = (tmp_path / "cases.jsonl").read_text(encoding="utf-8").splitlines()
            assert len(lines) == k
            assert json.loads(lines[-1]) == row


def test_progress_counts_only_the_cases_of_the_study(tmp_path, monkeypatch):
    class Workers(nullcontext):
        def map(self, _, numbers, **__):
            return ({"case": number} for number in numbers)

    parameters = StudyParameters()
    with Journal(tmp_path, module.identity_of(parameters)) as journal:
        for number in (0, 1, 7, 8, 9):
            journal.add({"case": number})
    monkeypatch.setattr(module, "Workers", lambda *_: Workers())
    monkeypatch.setattr(module.case, "load_sources", lambda _: None)
    monkeypatch.setattr(module, "_write", lambda rows, *_: {"cases": len(rows)})
    seen: list[float] = []
    assert module.study(parameters, 4, tmp_path, on_progress=seen.append) == {"cases": 4}
    assert seen == [2, 3, 4]


@pytest.mark.parametrize("left", range(1, 24))
def test_incomplete_last_line_is_dropped_and_its_case_added_again(tmp_path, left):
    whole = fill(tmp_path, 2)
    last = whole.splitlines(keepends=True)[-1]
    (tmp_path / "cases.jsonl").write_bytes(whole[: len(whole) - len(last) + left])
    assert left < len(last)
    with Journal(tmp_path, IDENTITY) as journal:
        assert set(journal.rows) == {0}
        journal.add(rows(2)[1])
    assert (tmp_path / "cases.jsonl").read_bytes() == whole


def test_repeated_case_is_ignored(tmp_path):
    whole = fill(tmp_path, 2)
    with Journal(tmp_path, IDENTITY) as journal:
        journal.add({"case": 1, "value_m": 9.0})
        assert journal.rows[1] == rows(2)[1]
    assert (tmp_path / "cases.jsonl").read_bytes() == whole


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"seed": 2}, ["another study", "seed: 1, not 2"]),
        ({"ranges": {"speed": [0.1, 0.9]}}, ["speed: [0.1, 0.5], not [0.1, 0.9]"]),
        ({"code": "def"}, ["code of another version"]),
        ({"code": "def", "seed": 2}, ["(code of another version: abc, not def);"]),
        ({"envelope": 1}, ["envelope: None, not 1"]),
    ],
)
def test_folder_of_another_study_is_refused_and_not_changed(tmp_path, change, words):
    whole = fill(tmp_path, 2)
    with pytest.raises(StudyError) as caught:
        Journal(tmp_path, {**IDENTITY, **change})
    assert all(word in str(caught.value) for word in [str(tmp_path), *words]), caught.value
    assert (tmp_path / "cases.jsonl").read_bytes() == whole


def test_second_journal_in_one_folder_is_refused(tmp_path):
    busy = pytest.raises(StudyError, match="another dbb study uses")
    with Journal(tmp_path, IDENTITY), busy:
        Journal(tmp_path, IDENTITY)
    fill(tmp_path, 1)


def test_folder_without_locks_is_used(tmp_path, monkeypatch):
    monkeypatch.setattr(module, "claim", lambda file: None)
    fill(tmp_path, 1)


def test_damaged_line_in_the_middle_is_reported_by_number(tmp_path):
    whole = fill(tmp_path, 3)
    (tmp_path / "cases.jsonl").write_bytes(whole.replace(b'"case": 1', b'"case" 1'))
    with pytest.raises(StudyError, match="line 2 of"):
        Journal(tmp_path, IDENTITY)


def test_line_without_an_end_is_refused_with_little_memory(tmp_path):
    fill(tmp_path, 3)
    with (tmp_path / "cases.jsonl").open("ab") as file:
        file.truncate(file.tell() + 30_000_000)
    tracemalloc.start()
    try:
        with pytest.raises(StudyError, match="line 4 of"):
            Journal(tmp_path, IDENTITY)
        assert tracemalloc.get_traced_memory()[1] < 15_000_000
    finally:
        tracemalloc.stop()
