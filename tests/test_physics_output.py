"""pybullet writes nothing to the program's output and leaves no temporary files."""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
from pathlib import Path

import pytest

from app.config import Config
from app.errors import AssetError
from app.simulation.plants import PLANTS, make_physics
from app.simulation.plants.bullet_world import BulletWorld, pybullet
from app.simulation.plants.planar import Planar
from app.simulation.session import Session
from tests.robots import husky_panda, needs_pybullet

PROJECT = Path(__file__).resolve().parent.parent

RUN = """
from app.robot.description import load_robot
from app.robot.model import RobotModel
from app.simulation.plants import PLANTS, make_physics
import numpy as np
for kind in PLANTS:
    plant = make_physics(kind, RobotModel(load_robot("husky_panda")))
    for _ in range(10):
        plant.step(np.zeros(7), (0.1, 0.0), np.ones(3))
    plant.close()
    print(kind)
"""
LOUD = """
from app.simulation.plants.bullet_world import BulletWorld
urdf = '<robot name="r"><link name="a"/></robot>'  # pybullet warns of the missing inertia
print("before")
if {quietly}:
    BulletWorld(urdf, 0.001).close()
else:
    import pybullet, tempfile, pathlib
    pybullet.connect(pybullet.DIRECT)
    with tempfile.TemporaryDirectory() as folder:
        path = pathlib.Path(folder) / "r.urdf"
        path.write_text(urdf)
        pybullet.loadURDF(str(path))
print("after")
"""


def output(program: str) -> subprocess.CompletedProcess[str]:
    """The output of a program in pipes, so that the output of C is buffered."""
    return subprocess.run(
        [sys.executable, "-c", program],
        cwd=PROJECT,
        env={**os.environ, "PYTHONPATH": str(PROJECT), "PYTHONUNBUFFERED": ""},
        capture_output=True,
        text=True,
        check=True,
        timeout=120,
    )


@pytest.mark.slow
@needs_pybullet
def test_a_plant_prints_nothing():
    result = output(RUN)
    assert result.stdout.splitlines() == list(PLANTS)
    assert result.stderr == ""


@pytest.mark.slow
@needs_pybullet
def test_warnings_of_the_loader_do_not_reach_standard_output():
    assert len(output(LOUD.format(quietly=False)).stdout) > len("before\nafter\n")
    assert output(LOUD.format(quietly=True)).stdout == "before\nafter\n"


def test_buffered_output_of_c_code_is_silenced():
    program = """
import ctypes
from app.simulation.plants.bullet_world import silence
C = ctypes.CDLL(None)
C.puts(b"before")
with silence(1):
    C.puts(b"meanwhile")
C.puts(b"after")
"""
    assert output(program).stdout == "before\nafter\n"


def test_no_temporary_file_is_left(tmp_path, monkeypatch):
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    for kind in PLANTS:
        make_physics(kind, husky_panda()).close()
    assert list(tmp_path.iterdir()) == []


def test_a_urdf_that_pybullet_cannot_load_gives_a_clear_error():
    with pytest.raises(AssetError, match="pybullet cannot load the robot"):
        BulletWorld("this is no URDF", 0.001)


def test_closed_clients_of_pybullet_are_released():
    """The number of clients is limited in pybullet."""
    for _ in range(40):
        plant = BulletWorld('<robot name="r"><link name="a"/></robot>', 0.001)
        plant.close()
        plant.close()
    with pytest.raises(AssetError):
        BulletWorld("", 0.001)
    make_physics("planar", husky_panda()).close()


@pytest.mark.parametrize(
    ("part", "step"),
    [(BulletWorld, "allow_contacts"), (Planar, "reset"), (Session, "reset")],
)
def test_a_failed_setup_leaves_no_client_of_pybullet(border_data, monkeypatch, part, step):
    def clients() -> int:
        return sum(pybullet.getConnectionInfo(i)["isConnected"] for i in range(50))

    before = clients()
    monkeypatch.setattr(part, step, None)
    with pytest.raises(TypeError):
        Session(husky_panda(), border_data, Config(), physics="planar")
    assert clients() == before
