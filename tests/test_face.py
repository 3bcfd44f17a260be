"""The public interface: the names of `app`, the documented loop and the modules it loads."""

from __future__ import annotations

import inspect
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import app
from app.border.cache import BorderData
from app.config import Config
from app.robot.model import RobotModel
from app.simulation.session import Session

PROJECT = Path(__file__).resolve().parent.parent

NOT_IN_A_STEP = {
    "matplotlib",
    "mujoco",
    "playwright",
    "pyarrow",
    "pybullet",
    "rich",
    "scipy",
    "tomlkit",
    "trimesh",
    "tyro",
    "viser",
}
"""Libraries that the control of a robot does not need."""


def test_package_exports_about_fifteen_documented_names() -> None:
    assert 12 <= len(app.__all__) <= 18
    assert all(inspect.getdoc(getattr(app, name)) for name in app.__all__)
    assert set(app.__all__) <= set(dir(app))
    with pytest.raises(AttributeError, match="no attribute 'nothing'"):
        app.__getattr__("nothing")


def test_import_of_the_package_loads_no_other_module() -> None:
    code = "import sys; before = set(sys.modules); import app; print(*set(sys.modules) - before)"
    loaded = set(printed(code).split())
    assert {name for name in loaded if name.split(".")[0] not in sys.stdlib_module_names} == {"app"}


@pytest.mark.slow
def test_control_step_needs_neither_simulator_nor_dashboard() -> None:
    """The loop of the documentation runs where none of those libraries can be imported."""
    without = f"import sys\nsys.modules.update(dict.fromkeys({sorted(NOT_IN_A_STEP)}))\n"
    assert printed(f"{without}\n{READINGS}\n{loop()}\nprint(len(sent))") == "1\n"


def test_documented_loop_is_short_and_compensates_gravity(robot: RobotModel) -> None:
    assert len(loop().splitlines()) <= 12
    names: dict[str, Any] = {}
    exec(f"{READINGS}\n{loop()}", names)
    state = app.RobotState(robot)
    (sent,) = names["sent"]
    np.testing.assert_allclose(sent[0], state.g[robot.n_b :], atol=1e-6)
    np.testing.assert_allclose(sent[1], 0.0, atol=1e-9)


def test_simulation_uses_the_public_control_loop(
    robot: RobotModel, border_data: BorderData, monkeypatch: pytest.MonkeyPatch
) -> None:
    session = Session(robot, border_data, Config(), physics="kinematic")
    commands: list[app.Command] = []

    def step(self: app.ControlLoop, *args: Any) -> app.Command:
        commands.append(plain(self, *args))
        return commands[-1]

    plain = app.ControlLoop.step
    monkeypatch.setattr(app.ControlLoop, "step", step)
    taken = session.step()
    assert isinstance(session.loop, app.ControlLoop)
    assert commands[0].step is taken.control
    assert commands[0].base_velocity is taken.base_command


READINGS = """
ready = (0.0, -0.7854, 0.0, -2.3562, 0.0, 1.5708, 0.7854)
rows = iter([([0, 0, 0], [0, 0], ready, [0] * 7), None])
sent = []
def sensors(): return next(rows)
def send(*command): sent.append(command)
"""


def loop() -> str:
    """The loop in the documentation of the package."""
    text = inspect.cleandoc(app.__doc__ or "").partition("::\n\n")[2]
    lines = text.splitlines()
    end = next(i for i, line in enumerate(lines) if line and not line.startswith("    "))
    return "\n".join(line[4:] for line in lines[:end]).strip()


def printed(code: str) -> str:
    """The output of a fresh interpreter for some code."""
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=PROJECT, capture_output=True, text=True, check=True
    )
    return done.stdout
