"""The gallery of robots: each has a process, and a failure is a row with its reason."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

from app.onboarding.request import Request, check_request
from benchmarks import gallery


def test_options_of_every_robot_are_consistent(tmp_path: Path) -> None:
    for name, given in gallery.ROBOTS.items():
        check_request(Request(**given, out=tmp_path / f"new_{name}"))
    assert len(gallery.ROBOTS) == 23


def test_options_become_the_command_line_of_a_user() -> None:
    given = gallery.ROBOTS["frankie"] | {"package": ()}
    words = list(gallery.words_of(given))
    assert words[0] == given["urdf"]
    assert " ".join(words[1:]) == (
        "--base panda_base_arm --tip frankie_hand --wheel-radius 0.1 --half-track 0.2 "
        "--tip-xyz 0.0 0.0 0.1034 --assume-inertia"
    )


def test_refused_robot_is_a_row_with_the_reason(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(gallery, "FOLDER", tmp_path)
    given = {"urdf": "package://no_such_package/a.urdf", "base": "a", "tip": "b"}
    monkeypatch.setitem(gallery.ROBOTS, "gone", given)
    row = gallery.outcome("gone", quick=True)
    assert row["verdict"] == "refused"
    assert "'no_such_package' is not installed" in row["refusal"]
    assert row["cpu_s"] > 0.0


def test_native_crash_is_a_row_that_names_the_step(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    dying = tmp_path / "python"
    dying.write_text("#!/bin/sh\necho '… fitting bodies' >&2\nkill -SEGV $$\n", encoding="utf-8")
    dying.chmod(0o755)
    monkeypatch.setattr(sys, "executable", str(dying))
    monkeypatch.setattr(gallery, "FOLDER", tmp_path)
    row = gallery.outcome("pr2", quick=True)
    assert row["verdict"] == "crashed"
    assert row["refusal"] == "dbb new-robot ended by SIGSEGV at: … fitting bodies"


def test_verdict_follows_from_the_outcomes_of_the_checks() -> None:
    def of(**ends: str) -> str:
        return gallery.verdict({k.replace("_", "-"): {"outcome": v} for k, v in ends.items()})

    assert of(limits="warned", guiding_lateral="warned", guiding_front="passed") == "passed"
    assert of(limits="passed", guiding_lateral="warned", guiding_front="warned") == "warned"
    assert of(guiding_lateral="passed", guiding_front="nothing to show") == "nothing to show"
    assert of(guiding_lateral="warned", guiding="failed") == "nothing to show"
    assert of(limits="failed", guiding_lateral="passed") == "failed"
    assert of(guiding_lateral="failed", guiding_front="passed") == "failed"
