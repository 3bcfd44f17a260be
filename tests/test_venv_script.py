"""`tools/venv.sh` uses a suitable Python with uv or with venv and pip, or reports its absence."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

PROJECT = Path(__file__).resolve().parent.parent
SCRIPT = PROJECT / "tools" / "venv.sh"


def venv(
    folder: Path, *arguments: str, python: str = "", tools: tuple[str, ...] = ()
) -> subprocess.CompletedProcess[str]:
    """Run the script with a `PATH` that has only a shell and these tools."""
    programs = folder / "programs"
    programs.mkdir(exist_ok=True)
    for tool in ("bash", "env", *tools):
        found = shutil.which(tool, path=f"{Path(sys.executable).parent}{os.pathsep}{os.defpath}")
        if found is None:
            pytest.skip(f"no {tool}")
        (programs / tool).symlink_to(found)
    return subprocess.run(
        [str(SCRIPT), *arguments],
        cwd=folder,
        capture_output=True,
        text=True,
        timeout=300,
        env={**os.environ, "PATH": str(programs), "PYTHON": python},
    )


@pytest.fixture
def spaced(tmp_path: Path) -> Path:
    """A folder with a space in its path."""
    folder = tmp_path / "with a space"
    folder.mkdir()
    return folder


def test_without_python_one_line_names_the_packages_to_install(spaced: Path) -> None:
    done = venv(spaced, "made")
    assert done.returncode == 1
    (line,) = done.stderr.strip().splitlines()
    assert "3.10 to 3.14" in line
    assert "uv" in line
    assert "python3-venv" in line
    assert not (spaced / "made").exists()


def test_an_unsuitable_requested_python_is_an_error_without_fallback(
    spaced: Path,
) -> None:
    old = spaced / "python3.9"
    old.write_text("#!/bin/sh\nexit 1\n", encoding="utf-8")
    old.chmod(0o755)
    (spaced / "programs").mkdir()
    (spaced / "programs" / "python3").symlink_to(sys.executable)
    for python in (str(old), "/no/such/python"):
        done = venv(spaced, "made", python=python)
        assert done.returncode == 1
        assert (
            done.stderr.strip()
            == f"PYTHON={python} is not a 64-bit CPython 3.10 to 3.14 with venv."
        )
        assert not (spaced / "made").exists()
        for tool in ("bash", "env"):
            (spaced / "programs" / tool).unlink()


def test_the_newest_python_is_preferred_except_3_14(spaced: Path) -> None:
    """Each fake interpreter prints its name instead of creating an environment."""
    programs = spaced / "programs"
    programs.mkdir()
    for name in ("python3.10", "python3.12", "python3.14"):
        path = programs / name
        path.write_text(
            f'#!/bin/sh\n[ "$1" = - ] && exit 0\necho {name} "$@"\nexit 3\n', encoding="utf-8"
        )
        path.chmod(0o755)
    assert venv(spaced, "made").stdout == "python3.12 -m venv made\n"
    for gone, then in (("python3.12", "python3.10"), ("python3.10", "python3.14")):
        (programs / gone).unlink()
        for tool in ("bash", "env"):
            (programs / tool).unlink()
        assert venv(spaced, "made").stdout == f"{then} -m venv made\n"


@pytest.mark.parametrize("tools", [(), ("uv",)], ids=["venv", "uv"])
@pytest.mark.slow
def test_an_environment_in_a_path_with_a_space_is_created_once(
    spaced: Path, tools: tuple[str, ...]
) -> None:
    done = venv(spaced, "made", python=sys.executable, tools=tools)
    assert done.returncode == 0, done.stderr
    made = spaced / "made" / "bin" / "python"
    code = "import pip, sys; print(sys.version_info[:2] >= (3, 10), sys.prefix)"
    result = subprocess.run([str(made), "-c", code], capture_output=True, text=True, check=True)
    assert result.stdout.strip() == f"True {spaced / 'made'}"
    before = made.parent.stat().st_mtime_ns
    for tool in ("bash", "env", *tools):
        (spaced / "programs" / tool).unlink()
    assert venv(spaced, "made", python="/no/such/python", tools=tools).returncode == 0
    assert made.parent.stat().st_mtime_ns == before
