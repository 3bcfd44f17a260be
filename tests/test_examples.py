"""The examples run without changes, in short runs, and are short enough for reading."""

from __future__ import annotations

import importlib.util
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from app.control.control_loop import ControlLoop
from app.robot.state import at_rest

pytestmark = pytest.mark.slow

EXAMPLES = Path(__file__).resolve().parent.parent / "examples"


def example(name: str) -> ModuleType:
    """The module of an example."""
    spec = importlib.util.spec_from_file_location(name, EXAMPLES / f"{name}.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.mark.parametrize("path", sorted(EXAMPLES.glob("*.py")), ids=lambda path: path.stem)
def test_an_example_has_at_most_sixty_lines_and_says_how_it_is_run(path: Path) -> None:
    text = path.read_text(encoding="utf-8")
    assert len(text.splitlines()) <= 60
    assert f"python examples/{path.name}" in text


def test_in_ones_own_loop_the_base_gives_way_to_the_pulled_arm(capsys) -> None:
    assert example("own_loop").main(duration=1.0) < -0.05
    assert "lm-lEE" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("name", "holds"),
    [
        ("track_pose", lambda error: error < 1e-3),
        ("filter", lambda errors: errors[0] < 0.2 * errors[1]),
        ("own_gains", lambda moved: moved[1] < moved[0] - 0.01),
        ("own_robot", lambda torques: torques.shape == (7,) and np.abs(torques).max() > 1.0),
        ("joint_states", lambda faults: faults == ("velocity", "repeated")),
        ("planner", lambda speed: 0.03 < speed < 0.2),
        ("load", lambda found: found[0] == pytest.approx(2.0, abs=0.1) and found[1] < 0.1),
    ],
)
def test_a_case_of_ones_own_loop_runs(name: str, holds) -> None:
    assert holds(example(name).main())


def test_the_table_of_a_step_is_printed_with_units_and_frames(capsys) -> None:
    step = example("step_table").main()
    assert step.solved[()] == 1.0
    printed = capsys.readouterr().out
    assert "p_act" not in printed
    assert "p_ee  [m] world: position of the end-effector" in printed
    assert f"{step.pairs[0].name}: {step.d[0]:.3f} m" in printed


def test_a_run_is_replayed_and_plotted(tmp_path: Path) -> None:
    page = example("replay").main(tmp_path, duration=0.5)
    assert page.read_text(encoding="utf-8").lstrip().lower().startswith("<!doctype html>")
    picture = example("plot").main(tmp_path / "distances.png", duration=0.5)
    assert picture.read_bytes().startswith(b"\x89PNG")


def test_a_node_sends_what_the_loop_gives_for_its_messages(robot, border_data) -> None:
    sent = example("ros2_shape").main(steps=5)
    ready = np.array(robot.description.arm.ready_position)
    expected = ControlLoop(robot, border_data).step(at_rest(robot, ready))
    np.testing.assert_allclose(sent["/arm/effort"].effort, expected.u_a, atol=0.05)
    np.testing.assert_allclose(sent["/cmd_vel"].velocity, 0.0, atol=1e-9)


def test_a_body_that_is_put_on_the_base_is_kept_clear_of() -> None:
    module = example("obstacle_body")
    hit, kept = module.main("none"), module.main("dbb")
    assert hit["min_clearance_m"] < 0.0
    assert kept["min_clearance_m"] > 0.03
    assert kept["contacts"] == 0
    assert kept["base_path_m"] > 0.05
