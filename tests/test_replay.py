"""A replay is one file that plays in a browser without a network."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from app.cli.main import main
from app.dashboard.export.browser import new_context
from app.simulation.trace.log_file import read_trace, write_trace
from app.simulation.trace.trace import Trace
from tests.robots import husky_panda

pytestmark = pytest.mark.slow

_PLACE = "() => dbbPage.viewer().nodePoseData['/robot']?.position ?? null"


@pytest.fixture(scope="module")
def replay(tmp_path_factory) -> Path:
    """The page of 1.5 s in which the base moves backwards, made by the commands."""
    folder = tmp_path_factory.mktemp("replay")
    run = ["run", "guiding-front", "--duration", "1.5", "--physics", "kinematic"]
    main([*run, "--log", str(folder / "run.parquet"), "--json"])
    main(["replay", str(folder / "run.parquet"), "--out", str(folder / "run.html"), "--json"])
    return folder / "run.html"


def test_dbb_replay_reports_a_missing_or_damaged_log_on_one_line(tmp_path, capsys):
    (tmp_path / "log.csv").write_text("t_s\n0\n")
    for name, out, words in (
        ("none.csv", "a.html", "no such file"),
        ("log.csv", "a.html", "damaged"),
        ("none.csv", "a.txt", "--out"),
    ):
        with pytest.raises(SystemExit) as end:
            main(["replay", str(tmp_path / name), "--out", str(tmp_path / out)])
        assert end.value.code == 2
        out, err = capsys.readouterr()
        assert (out, err.count("\n")) == ("", 1)
        assert words in err


@pytest.mark.browser
def test_a_replay_plays_from_a_file_without_a_network(browser, replay):
    requests, errors = [], []
    context = new_context(browser, (640, 480))
    context.set_offline(True)
    page = context.new_page()
    page.on("request", lambda r: requests.append(r.url))
    page.on("pageerror", lambda e: errors.append(str(e)))
    page.on("console", lambda m: errors.append(m.text) if m.type == "error" else None)
    page.goto(replay.as_uri())
    page.wait_for_function("() => dbbPage.ready() && dbbPage.has('/robot')", timeout=60_000)
    places = []
    for _ in range(100):
        places.append(page.evaluate(_PLACE))
        page.wait_for_timeout(50)
        if np.ptp([p[0] for p in places if p]) > 0.05:
            break
    x = [p[0] for p in places if p]
    assert np.ptp(x) > 0.05, "the base does not move"  # [m]
    assert min(x) < -0.05, "the base does not move backwards"
    for node in (
        "/robot/border_lm-lEE",
        "/trails/end-effector",
        "/distances",
        "/acting",
        "/person",
    ):
        assert page.evaluate("name => dbbPage.has(name)", node), node
    context.close()
    assert errors == []
    assert [url for url in requests if not url.startswith(("file:", "data:", "blob:"))] == []


def test_a_replay_of_ten_seconds_is_smaller_than_ten_megabytes(tmp_path, replay, capsys):
    """The log repeats the same run seven times."""
    log = read_trace(replay.with_suffix(".parquet"))
    rows = [replace(s, t=s.t + 1.5 * k) for k in range(7) for s in log.snapshots]
    again = Trace.of_snapshots(husky_panda(), rows)
    write_trace(tmp_path / "long.csv", again)
    page = tmp_path / "long.html"
    capsys.readouterr()
    look = ("--light", "--layer", "reachability")
    main(["replay", str(tmp_path / "long.csv"), "--out", str(page), *look, "--json"])
    printed = json.loads(capsys.readouterr().out)
    assert printed["duration_s"] == pytest.approx(10.48)
    assert printed["size_bytes"] == page.stat().st_size
    assert 0.5e6 < page.stat().st_size < 10e6
    text = page.read_text(encoding="utf-8")
    assert "<title>husky_panda: guiding-front, " in text
    assert "darkMode:false" in text
    assert "the arm reaches the point well" in text
    assert "yellow: high score" in replay.read_text(encoding="utf-8")
