"""The gallery of robots: rows are kept, and what cannot be made says why."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from app.onboarding.request import Request, check_request
from benchmarks import gallery


def test_the_options_of_every_robot_go_together(tmp_path: Path) -> None:
    for name, given in gallery.ROBOTS.items():
        check_request(Request(**given, out=tmp_path / name))
    assert len(gallery.ROBOTS) == 23


def test_a_row_is_kept_and_a_missing_package_is_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(gallery, "find_spec", lambda _: None)
    file = tmp_path / "rows.json"
    gallery.main("stretch_re1", file)
    row = json.loads(file.read_text(encoding="utf-8"))["stretch_re1"]
    assert (row["verdict"], row["refusal"][:11]) == ("refused", "the package")
    monkeypatch.setattr(gallery, "outcome", lambda *_: pytest.fail("it was there already"))
    gallery.main("stretch_re1", file)
