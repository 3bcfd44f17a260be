"""What the README offers to copy works: its loop and its commands."""

from __future__ import annotations

import re
from typing import Any

import numpy as np
import pytest

from app.border.cache import BorderData
from app.cli.main import main
from app.config import Config
from app.robot.model import RobotModel
from app.robot.state import RobotState
from app.simulation.scenarios.start import StartSolver
from tests.readme import README, section


def run_loop(**changes: tuple[str, str]) -> dict[str, Any]:
    """The names that the README's loop leaves behind; each change is (old text, new text)."""
    (code,) = re.findall(r"^```python\n(.*?)^```", README, re.M | re.S)
    for old, new in changes.values():
        assert code.count(old) == 1
        code = code.replace(old, new)
    names: dict[str, Any] = {}
    exec(compile(code, "README.md", "exec"), names)
    return names


def test_the_loop_of_the_readme_runs_and_holds_the_arm() -> None:
    """Gravity compensation without a person: nothing moves, and no QP fails."""
    names = run_loop()
    measured = names["robot"].measure()
    ready = np.array(names["model"].description.arm.ready_position)
    np.testing.assert_allclose(measured.q_m, ready, atol=1e-6)
    np.testing.assert_allclose(measured.base_pose, 0.0, atol=1e-9)
    state = RobotState(names["model"])
    state.update(measured)
    assert np.abs(state.g[2:]).max() > 1.0  # [N m] there is something to hold
    np.testing.assert_allclose(names["output"].u_a, state.g[2:], atol=1e-4)
    assert names["controller"].failures == 0


@pytest.mark.slow
@pytest.mark.parametrize(("controller", "moves"), [("dbb", True), ("none", False)])
def test_in_the_loop_of_the_readme_the_base_gives_way_to_a_pulled_hand(
    robot: RobotModel, border_data: BorderData, controller: str, moves: bool
) -> None:
    """The same lines with a person who pulls the hand from the front towards the base."""
    q_start = StartSolver(robot, border_data.pairs, Config().border.d_b).solve((0.92, 0.10, 0.30))
    names = run_loop(
        start=("for _ in", f"robot.reset([0.0, 0.0, 0.0], {q_start.tolist()})\nfor _ in"),
        pull=("hand_force=[0.0, 0.0, 0.0]", "hand_force=[-15.0, 0.0, 0.0]"),
        name=("border_data(model), config)", f"border_data(model), config, name={controller!r})"),
    )
    assert (names["robot"].measure().base_pose[0] < -0.02) == moves  # [m]


def examples() -> list[str]:
    """The examples of the section on commands."""
    return re.findall(r"^\| `dbb .*\| `(dbb .*?)` \|$", section("Commands"), re.M)


@pytest.mark.parametrize("example", examples())
def test_every_option_of_an_example_is_one_of_its_command(
    example: str, capsys: pytest.CaptureFixture[str]
) -> None:
    _, command, *rest = example.split()
    with pytest.raises(SystemExit) as end:
        main([command, "--help"])
    assert end.value.code in (0, None)
    told = capsys.readouterr().out
    for option in (word for word in rest if word.startswith("--")):
        assert re.search(rf"{option}\b", told), option


def test_there_is_an_example_of_every_command() -> None:
    assert {example.split()[1] for example in examples()} == {
        "serve",
        "run",
        "report",
        "replay",
        "screenshot",
        "pairs",
        "border",
        "reproduce",
        "reach",
        "robots",
        "study",
        "sweep",
        "config",
        "new-robot",
        "check-robot",
        "bench",
        "compare-robots",
    }
