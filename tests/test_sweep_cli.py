"""`dbb sweep`: its files and its errors."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from app.cli import main


@pytest.mark.slow
def test_sweep_prints_one_object_and_writes_the_files_that_it_names(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    parameters = tmp_path / "parameters.toml"
    parameters.write_text("[border]\nd_b = 0.14\n", encoding="utf-8")
    out = tmp_path / "made" / "on demand"
    args = [
        "--controller",
        "none,barrier",
        "none",
        "--step",
        "90",
        "--length",
        "0.02",
        "--speed",
        "0.4",
        "--hold",
        "0",
        "--no-wheel-axis",
        "--physics",
        "kinematic",
        "--processes",
        "1",
        "--base-weight",
        "7",
        "--config",
        str(parameters),
        "--out",
        str(out),
        "--json",
    ]
    main(["sweep", *args])
    result = json.loads(capfd.readouterr().out)
    assert json.loads((out / "sweep.json").read_text(encoding="utf-8")) == result
    assert sorted(p.name for p in out.iterdir()) == sorted(result["files"])
    assert result["files"] == ["sweep.json", "sweep.csv", "sweep_h0.3_v0.4.png"]
    assert list(result["summary"]) == result["controllers"] == ["none", "barrier"]
    assert result["base_weight"] == result["parameters"]["task"]["base_weight"] == 7.0
    assert result["start_distance_m"] == pytest.approx(0.16)
    assert (result["wheel_axis"], result["above"]) == ([], [])


@pytest.mark.parametrize(
    ("args", "words"),
    [
        (["--controller", "dbb,barier"], ["barier", "did you mean 'barrier'"]),
        (["--controller", ","], ["--controller", "dbb"]),
        (["--height", "0.3", "nan"], ["--height", "0.02 to 2 m"]),
        (["--speed", "0"], ["--speed", "0.001 to 1 m/s"]),
        (["--step", "7"], ["--step", "7"]),
        (["--step", "0.1"], ["--step", "0.5 to 90 deg"]),
        (["--length", "-0.2"], ["--length", "0.01 to 0.5 m"]),
        (["--hold", "-1"], ["--hold", "0 to 60 s"]),
        (["--start-distance", "0.1"], ["--start-distance", "0.155"]),
        (["--base-weight", "0.1"], ["--base-weight", "1 to 1e+06"]),
        (["--above-spacing", "0"], ["--above-spacing", "0.02 to 1 m"]),
        (["--physics", "magic"], ["magic", "planar"]),
        (["--robot", "husky"], ["husky", "husky_panda"]),
        (["--processes", "0"], ["--processes", "0"]),
        (["--seed", "-1"], ["--seed", "-1"]),
        (["--config", "nowhere.toml"], ["--config", "nowhere.toml"]),
    ],
)
def test_invalid_options_are_rejected_in_one_line_before_any_work(
    args: list[str], words: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as ended:
        main(["sweep", *args, "--out", str(tmp_path / "out")])
    printed = capsys.readouterr()
    assert (ended.value.code, printed.out) == (2, "")
    (line,) = printed.err.splitlines()
    assert all(word in line for word in words), line
    assert not (tmp_path / "out").exists()
