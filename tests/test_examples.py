"""The examples work in short runs and are short to read."""

from __future__ import annotations

import importlib.util
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from app.control.controller import ControlLoop
from app.robot.state import at_rest

pytestmark = pytest.mark.slow

EXAMPLES = Path(__file__).resolve().parent.parent / "examples"


def example(name: str) -> ModuleType:
    """Import the example with this name, and return its module."""
    spec = importlib.util.spec_from_file_location(name, EXAMPLES / f"{name}.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.mark.parametrize("path", sorted(EXAMPLES.glob("*.py")), ids=lambda path: path.stem)
def test_example_has_at_most_sixty_lines_and_its_command(path: Path) -> None:
    text = path.read_text(encoding="utf-8")
    assert len(text.splitlines()) <= 60
    assert f"python examples/{path.name}" in text


def test_base_moves_away_in_the_own_loop_example(capsys) -> None:
    assert example("own_loop").main(duration=1.0) < -0.05
    assert "lm-lEE" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("name", "holds"),
    [
        ("track_pose", lambda error: error < 1e-3),
        ("filter", lambda errors: errors[0] < 0.2 * errors[1]),
        ("own_gains", lambda moved: moved[1] < moved[0] - 0.03),
        ("own_robot", lambda torques: torques.shape == (7,) and np.abs(torques).max() > 1.0),
        ("joint_states", lambda faults: faults == ("velocity", "repeated")),
        ("planner", lambda speed: 0.03 < speed < 0.2),
        ("load", lambda found: found[0] == pytest.approx(2.0, abs=0.1) and found[1] < 0.1),
    ],
)
def test_own_loop_variants_work(name: str, holds) -> None:
    assert holds(example(name).main())


def test_step_table_has_units_and_frames(capsys) -> None:
    step = example("step_table").main()
    assert step.solved[()] == 1.0
    printed = capsys.readouterr().out
    assert "p_act" not in printed
    assert "p_ee  [m] world: position of the end-effector" in printed
    assert f"{step.pairs[0].name}: {step.d[0]:.3f} m" in printed


def test_replay_and_plot_examples_write_their_files(tmp_path: Path) -> None:
    page = example("replay").main(tmp_path, duration=0.5)
    assert page.read_text(encoding="utf-8").lstrip().lower().startswith("<!doctype html>")
    picture = example("plot").main(tmp_path / "distances.png", duration=0.5)
    assert picture.read_bytes().startswith(b"\x89PNG")


def test_ros2_example_publishes_the_loops_command(robot, border_data) -> None:
    sent = example("ros2_shape").main(steps=5)
    ready = np.array(robot.description.arm.ready_position)
    expected = ControlLoop(robot, border_data).step(at_rest(robot, ready))
    np.testing.assert_allclose(sent["/arm/effort"].effort, expected.u_a, atol=0.05)
    np.testing.assert_allclose(sent["/cmd_vel"].velocity, 0.0, atol=1e-9)


def test_cargo_on_the_base_is_avoided() -> None:
    module = example("cargo")
    hit, kept = module.main("none"), module.main("dbb")
    assert hit["min_clearance_m"] < 0.0
    assert kept["min_clearance_m"] > 0.03
    assert kept["contacts"] == 0
    assert kept["base_path_m"] > 0.05
