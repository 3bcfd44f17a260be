"""The loop, the commands and the snippets of README and documentation work."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import app
from app.cli.main import main
from app.robot.state import RobotState
from tests.readme import PROJECT, README, page, section
from tools.pages import command_names

LONGEST_LOOP = 12  # [-] lines


def run_loop() -> dict[str, Any]:
    """The variables of the README's loop after its run."""
    (code,) = re.findall(r"^```python\n(.*?)^```", README, re.M | re.S)
    assert len(code.splitlines()) <= LONGEST_LOOP
    names: dict[str, Any] = {}
    exec(compile(code, "README.md", "exec"), names)
    return names


def test_readme_loop_runs_and_compensates_gravity() -> None:
    """Without a pull the base stays at rest."""
    names = run_loop()
    state = RobotState(names["model"])
    state.update(names["measured"])
    assert np.abs(state.g[2:]).max() > 1.0  # [N m] gravity torques are not zero
    np.testing.assert_allclose(names["command"].u_a, state.g[2:], atol=1e-4)
    np.testing.assert_allclose(names["command"].base_velocity, 0.0, atol=1e-6)
    assert names["loop"].controller.last.failures == 0


def test_api_page_covers_every_name_with_a_running_example(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    text = page("api")
    assert sorted(re.findall(r"^### `(\w+)`$", text, re.M)) == app.__all__
    assert sorted(re.findall(r"^\.\. auto\w+:: app\.(\w+)$", text, re.M)) == app.__all__
    parts = re.split(r"^### ", text, flags=re.M)[1:]
    assert [part.split("\n")[0] for part in parts if "```python" not in part] == []
    (tmp_path / "robot_assets").symlink_to(PROJECT / "robot_assets")
    monkeypatch.chdir(tmp_path)
    code = "".join(re.findall(r"^```python\n(.*?)^```", text, re.M | re.S))
    exec(compile(code, "docs/api.md", "exec"), {})
    assert "did you mean 'husky_panda'" in capsys.readouterr().out


def examples() -> list[str]:
    """The examples on the page of the commands."""
    return re.findall(r"^\| `dbb .*\| `(dbb .*?)` \|$", section("Examples", page("commands")), re.M)


@pytest.mark.parametrize("example", examples())
def test_options_of_each_example_exist_in_its_command(
    example: str, capsys: pytest.CaptureFixture[str]
) -> None:
    _, command, *rest = example.split()
    about = [word for word in rest[:1] if word == "robots"]  # subcommand of `dbb sweep`
    with pytest.raises(SystemExit) as end:
        main([command, *about, "--help"])
    assert end.value.code in (0, None)
    printed = capsys.readouterr().out
    for option in (word for word in rest if word.startswith("--")):
        assert re.search(rf"{option}\b", printed), option


def test_every_command_has_an_example() -> None:
    assert {"serve", "run", "new-robot"} <= set(command_names())
    assert {example.split()[1] for example in examples()} == {
        name.split()[0] for name in command_names()
    }
