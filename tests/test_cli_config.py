"""Parameters from a file on the command line, and the file that `dbb config` writes."""

from __future__ import annotations

import json
from contextlib import nullcontext
from pathlib import Path

import pytest

import app.dashboard.server
from app.cli.main import main
from app.cli.options import configured
from app.config import Config, sections
from app.config_file import decode_config, read_config, save_config
from app.robot.description import load_robot
from app.simulation.case import RunCase, RunSpec
from app.simulation.scenarios import SCENARIOS

QUICK = ["run", "guiding-lateral", "--physics", "kinematic", "--duration", "0.01", "--json"]


class SeenError(Exception):
    """Carries the configuration of a command, and prevents its work."""


@pytest.fixture
def config_of(monkeypatch):
    """The configuration with which `dbb run` or `dbb sweep` would start."""

    def stop(run, *_, **__):
        raise SeenError(run.config)

    def stop_sweep(plan, **_):
        raise SeenError(plan.config)

    monkeypatch.setattr("app.simulation.run.run_from_spec", stop)
    monkeypatch.setattr("app.studies.sweep.sweep.sweep", stop_sweep)

    def of(*args: str) -> Config:
        with pytest.raises(SeenError) as caught:
            main(list(args))
        return caught.value.args[0]

    return of


@pytest.fixture
def mine(tmp_path: Path) -> Path:
    path = tmp_path / "mine.toml"
    path.write_text("[border]\nd_b = 0.2\nkind = 'points'\n[disturbance]\nslip = 0.1\n")
    return path


CONFIG = (
    Config()
    .replace("border.d_b", 0.2)
    .replace("border.kind", "points")
    .replace("disturbance.slip", 0.1)
)


def refused(capsys, *args: str) -> str:
    with pytest.raises(SystemExit) as end:
        main(list(args))
    output = capsys.readouterr()
    assert (end.value.code, output.out) == (2, "")
    assert len(output.err.splitlines()) == 1
    return output.err


@pytest.mark.slow
def test_run_uses_the_parameters_of_its_file_and_options_override_them(config_of, mine):
    assert configured("husky_panda", None) == Config()
    assert configured("husky_panda", mine) == CONFIG
    file = ["--config", str(mine)]
    assert config_of(*QUICK, *file) == CONFIG
    changed = config_of(
        *QUICK, *file, "--slip", "0.3", "--border", "surface", "--buffer-distance", "0.1"
    )
    assert changed == CONFIG.replace("disturbance.slip", 0.3).replace(
        "border.kind", "surface"
    ).replace("border.d_b", 0.1)
    assert config_of(*QUICK) == Config()


def test_parameters_of_a_robot_override_the_defaults(config_of, mine, monkeypatch, capsys):
    own = Config().changed({"border.d_b": 0.1, "border.eps": 0.005})
    robot = load_robot("husky_panda").model_copy(update={"config": own})
    monkeypatch.setattr("app.robot.description.load_robot", lambda _: robot)
    assert configured("husky_panda", None) == own
    assert configured("husky_panda", mine) == CONFIG.replace("border.eps", 0.005)
    assert configured("husky_panda", None, {"buffer_distance": 0.2}) == own.replace(
        "border.d_b", 0.2
    )
    assert config_of(*QUICK) == config_of("sweep", "--out", str(mine.parent / "out")) == own
    main(["config"])
    assert decode_config(capsys.readouterr().out.encode()).config == own


def test_sweep_uses_the_parameters_of_its_file(config_of, mine, tmp_path):
    args = ["sweep", "--out", str(tmp_path / "out"), "--config", str(mine)]
    assert config_of(*args) == CONFIG
    assert config_of(*args, "--base-weight", "7") == CONFIG.replace("task.base_weight", 7.0)


@pytest.mark.slow
def test_dashboard_begins_with_the_parameters_of_its_file(mine, monkeypatch):
    def stop(loop, *_, **__):
        raise SeenError(loop.latest().config)

    monkeypatch.setattr(app.dashboard.server, "serve_dashboard", stop)
    args = ["serve", "--config", str(mine), "--physics", "kinematic"]
    with pytest.raises(SeenError) as caught:
        main([*args, "--port", "0", "--slip", "0.2"])
    assert caught.value.args[0] == CONFIG.replace("disturbance.slip", 0.2)


@pytest.mark.parametrize("command", [QUICK, ["serve"], ["sweep"], ["config"]])
def test_unknown_parameter_in_the_file_gives_one_line_that_names_it(capsys, tmp_path, command):
    path = tmp_path / "bad.toml"
    path.write_text("[border]\nd_bb = 0.2\n")
    output = refused(capsys, *command, "--config", str(path))
    for word in ("--config", "bad.toml", "border.d_bb", "did you mean 'd_b'"):
        assert word in output


def test_replayed_case_excludes_a_parameter_file(capsys, mine, tmp_path):
    played = SCENARIOS["guiding-front"]
    case = RunCase.of(RunSpec("husky_panda", played, Config(), "dbb", "planar"))
    path = tmp_path / "case.json"
    path.write_text(case.text())
    for command in ("run", "serve"):
        output = refused(capsys, command, "--replay-case", str(path), "--config", str(mine))
        assert "--config" in output


def test_config_prints_the_defaults_and_overwrites_no_file(capsys, tmp_path):
    main(["config"])
    assert decode_config(capsys.readouterr().out.encode()).config == Config()
    out = tmp_path / "all.toml"
    main(["config", "--out", str(out)])
    assert read_config(out)[:2] == ("all", Config())
    capsys.readouterr()
    out.write_text("kept")
    assert "exists" in refused(capsys, "config", "--out", str(out))
    assert out.read_text() == "kept"
    nowhere = str(tmp_path / "no" / "all.toml")
    assert nowhere in refused(capsys, "config", "--out", nowhere)


def test_config_completes_the_parameters_of_a_file(capsys, mine):
    main(["config", "--config", str(mine)])
    assert capsys.readouterr().out == save_config(CONFIG)


def test_config_copies_name_and_hosts_of_the_file(capsys, tmp_path):
    mine, out = tmp_path / "a.toml", tmp_path / "b.toml"
    mine.write_text('name = "mine"\n[border]\nd_b = 0.2\n[server]\nallow_host = ["a.b", "c"]\n')
    main(["config", "--config", str(mine), "--out", str(out)])
    assert read_config(out) == read_config(mine) != ("", Config(), ())
    capsys.readouterr()
    main(["config", "--config", str(mine)])
    assert capsys.readouterr().out == out.read_text(encoding="utf-8")


def test_config_as_json_describes_every_parameter(capsys, mine):
    main(["config", "--config", str(mine), "--json"])
    rows = json.loads(capsys.readouterr().out)["parameters"]
    assert [row["path"] for row in rows] == [t.path for s in sections() for t in s.tunables]
    assert {row["path"]: row["value"] for row in rows} == {
        row["path"]: CONFIG.value(row["path"]) for row in rows
    }
    assert {"low", "high", "default", "unit", "help"} <= set(rows[0])


def test_hosts_are_allowed_by_repeated_options_and_by_the_file(tmp_path, monkeypatch):
    served = []
    monkeypatch.setattr("app.cli.serve._serve", lambda first: served.append(first.asked))
    monkeypatch.setattr("app.simulation.loop.process_loop.loop_child", nullcontext)
    file = tmp_path / "lab.toml"
    file.write_text('[server]\nallow_host = ["lab"]\n', encoding="utf-8")
    main(["serve", "--allow-host", "Robot.local", "--allow-host", "proxy", "--config", str(file)])
    assert served[0].allow_host == ("robot.local", "proxy", "lab")
