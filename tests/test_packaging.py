"""The wheel works outside a checkout, without network, and contains its border."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path
from zipfile import ZipFile

import pytest

import app
from app.border.cache import border_key
from app.border.sampling import SamplingConfig
from tests.robots import husky_panda

PROJECT = Path(__file__).resolve().parent.parent
PIP = (sys.executable, "-m", "pip", "--quiet", "--disable-pip-version-check")
SHIPPED = f"husky_panda-{border_key(husky_panda().description, SamplingConfig())}.npz"
FOREIGN = ("husky_panda-" + "0" * 32 + ".npz", "other_robot-" + "1" * 32 + ".npz")

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A wheel of copied sources whose cache also has borders that the wheel must not contain."""
    source, out = tmp_path_factory.mktemp("source"), tmp_path_factory.mktemp("wheel")
    for name in ("app", "robot_assets", "dbb_cache"):
        shutil.copytree(PROJECT / name, source / name, ignore=shutil.ignore_patterns("__pycache__"))
    for name in ("pyproject.toml", "README.md", "LICENSE", ".gitignore"):
        shutil.copy(PROJECT / name, source)
    for name in FOREIGN:
        (source / "dbb_cache" / name).write_bytes(b"not for others")
    run(*PIP, "wheel", "--no-deps", "--no-build-isolation", "-w", str(out), str(source), cwd=out)
    (built,) = out.glob("*.whl")
    return built


@pytest.fixture(scope="module")
def installed(wheel: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the wheel alone; the libraries are those of this interpreter."""
    folder = tmp_path_factory.mktemp("installed")
    run(*PIP, "install", "--no-deps", "--no-index", "--target", str(folder), str(wheel), cwd=folder)
    return folder


@pytest.fixture
def elsewhere(tmp_path: Path) -> Path:
    """A working directory outside the checkout; its `cache` is the user's cache folder."""
    assert PROJECT not in tmp_path.parents
    return tmp_path


def test_one_version_is_built_cited_and_described(wheel: Path) -> None:
    assert wheel.name.split("-")[1] == app.__version__
    assert f"version: {app.__version__}\n" in (PROJECT / "CITATION.cff").read_text("utf-8")
    changes = (PROJECT / "CHANGELOG.md").read_text("utf-8")
    assert next(line for line in changes.splitlines() if line.startswith("## ")).startswith(
        f"## {app.__version__},"
    )


def test_wheel_contains_descriptions_and_only_the_shipped_border(wheel: Path) -> None:
    with ZipFile(wheel) as archive:
        names = archive.namelist()
    robots = sorted(path.parent.name for path in (PROJECT / "robot_assets").glob("*/robot.toml"))
    packed = sorted(name.split("/")[2] for name in names if name.endswith("/robot.toml"))
    assert packed == robots
    assert [name for name in names if name.endswith(".npz")] == [f"app/dbb_cache/{SHIPPED}"]
    assert "app/studies/page.html.j2" in names
    outside = {name for name in names if not name.startswith(("app/", "dbb_mobile_manipulator-"))}
    assert outside == set()
    assert wheel.stat().st_size < 12e6  # [byte]


def test_installed_command_finds_its_descriptions(installed: Path, elsewhere: Path) -> None:
    robots = dbb(installed, elsewhere, "robots", "--json")["robots"]
    assert "husky_panda" in [robot["name"] for robot in robots]


def test_installed_command_reads_the_shipped_border(installed: Path, elsewhere: Path) -> None:
    border = dbb(installed, elsewhere, "border", "--json")
    assert border["origin"] == "shipped"
    assert {pair: b["points"] >= 50_000 for pair, b in border["borders"].items()} == {
        "lm-lEE": True,
        "lm-l3": True,
    }


def test_sampled_border_is_cached_for_the_user_and_found_again(
    installed: Path, elsewhere: Path
) -> None:
    code = """
from pathlib import Path
import app
from app.border.cache import load_border_data
from app.border.sampling import SamplingConfig
from app.robot.description import load_robot
from app.robot.model import RobotModel
tiny = SamplingConfig(pair_samples=2000, cloud_samples=1000, voxel_plan=0.1, voxel_height=0.1,
                      sectors=2, retries=0)
model = RobotModel(load_robot("husky_panda"))
origins = [
    load_border_data(model, sampling=tiny, progress=False, processes=1).origin for _ in range(2)
]
print(Path(app.__file__).parent, *origins)
"""
    before = sorted((installed / "app").rglob("*.npz"))
    printed = run(sys.executable, "-c", code, cwd=elsewhere, env=environment(installed, elsewhere))
    assert printed.split() == [str(installed / "app"), "sampled", "cache"]
    assert len(list((elsewhere / "cache" / "dbb").glob("husky_panda-*.npz"))) == 1
    assert sorted((installed / "app").rglob("*.npz")) == before


def dbb(installed: Path, cwd: Path, *arguments: str) -> dict:
    """The output of the installed console command."""
    command = str(installed / "bin" / "dbb")
    return json.loads(run(command, *arguments, cwd=cwd, env=environment(installed, cwd)))


def environment(installed: Path, cwd: Path) -> dict[str, str]:
    """An environment in which the installed package comes first and `cwd` has the user's cache."""
    return {
        **os.environ,
        "PYTHONPATH": str(installed),
        "XDG_CACHE_HOME": str(cwd / "cache"),
        "NUMBA_DISABLE_JIT": "1",  # compilation would take half a minute
    }


def run(*command: str, cwd: Path, env: dict[str, str] | None = None) -> str:
    """Standard output of a command that must succeed; shows its errors if it fails."""
    done = subprocess.run(command, cwd=cwd, env=env, capture_output=True, text=True, timeout=80)
    assert done.returncode == 0, done.stderr[-3000:]
    return done.stdout
