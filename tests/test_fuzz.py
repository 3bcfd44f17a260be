"""Files and messages of the fuzz test reach the code that they test."""

from __future__ import annotations

import json
import os
from collections import Counter
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from viser import _viser

from app.errors import DbbError
from benchmarks.fuzz import expand, files, messages

N = 300  # [-] repetitions


@pytest.mark.parametrize("text", expand._JSON)
def test_expanded_json_is_well_formed(text: Callable[[int], str]) -> None:
    json.loads(text(N))


def test_each_kind_of_file_has_expanded_files_and_no_other_kind_has() -> None:
    assert expand._TEXTS.keys() | expand._MAKERS.keys() == files.KINDS.keys()


@pytest.mark.parametrize(
    ("kind", "outcomes"),
    [
        ("log csv", {"right", "column 'c' appears twice", "unknown column"}),
        ("log parquet", {"the times are not in order"}),
    ],
)
def test_expanded_logs_are_read_up_to_their_content(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, kind: str, outcomes: set[str]
) -> None:
    monkeypatch.setattr(expand, "_MAX_POWER", 2.5)
    path = tmp_path / files.KINDS[kind].name
    files.KINDS[kind].seed(path)
    right, found = path.read_bytes(), set()
    for seed in range(12):
        path.write_bytes(expand.expanded(kind, right, np.random.default_rng(seed)))
        try:
            files.KINDS[kind].take(path)
            found.add("right")
        except DbbError as error:
            found |= {words for words in outcomes if words in str(error)} or {str(error)}
    assert found == outcomes


def test_the_test_of_messages_restores_the_process(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("DBB_ROBOTS", "mine")
    before = dict(os.environ), os.getcwd(), _viser._make_uuid
    with messages._elsewhere():
        assert os.environ["DBB_ROBOTS"] != "mine"
        assert _viser._make_uuid() == messages._asked[-1]
    assert (dict(os.environ), os.getcwd(), _viser._make_uuid) == before


def test_the_fragments_of_a_message_are_counted() -> None:
    fuzz = messages._Fuzz.__new__(messages._Fuzz)
    fuzz._rng, fuzz._tally = np.random.default_rng(0), Counter()
    sent = [len(list(fuzz._in_parts(b"x"))) for _ in range(50)]
    assert fuzz._tally["parts"] == sum(sent) - len(sent)
