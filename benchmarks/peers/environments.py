"""A Python environment for each library; they need different versions of pinocchio."""

from __future__ import annotations

import shutil
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

from app.errors import DbbError

_LONGEST = 600.0  # [s] timeout of a command
_MARK = "requirements.txt"  # file that marks a complete environment


class PeerError(DbbError):
    """A library cannot be installed or run; the message has the reason."""


def python_of(environment: Path) -> Path:
    """The interpreter of an environment."""
    return environment / "bin" / "python"


def installed(environment: Path, requirements: Sequence[str]) -> bool:
    """Whether an environment exists with the required packages."""
    mark = environment / _MARK
    return (
        python_of(environment).exists()
        and mark.is_file()
        and mark.read_text(encoding="utf-8") == _text(requirements)
    )


def ensure_environment(environment: Path, requirements: Sequence[str]) -> Path:
    """The interpreter of an environment with the required packages, which is created if necessary.

    `uv` creates the environment if it is installed, because it is faster; otherwise venv and pip
    do.

    Raises:
        PeerError: The environment cannot be created; the message quotes the installer's error.
    """
    if installed(environment, requirements):
        return python_of(environment)
    shutil.rmtree(environment, ignore_errors=True)
    try:
        environment.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise PeerError(f"not installed: cannot make {environment}: {error.strerror}") from None
    uv = shutil.which("uv")
    if uv is not None:
        _run([uv, "venv", "--quiet", "--python", sys.executable, str(environment)])
        install = [uv, "pip", "install", "--quiet", "--python", str(python_of(environment))]
    else:
        _run([sys.executable, "-m", "venv", str(environment)])
        install = [
            str(python_of(environment)),
            "-m",
            "pip",
            "install",
            "--quiet",
            "--disable-pip-version-check",
        ]
    _run([*install, *requirements])
    (environment / _MARK).write_text(_text(requirements), encoding="utf-8")
    return python_of(environment)


def _text(requirements: Sequence[str]) -> str:
    return "\n".join(requirements) + "\n"


def _run(command: Sequence[str]) -> None:
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=_LONGEST)
    except (OSError, subprocess.TimeoutExpired) as error:
        raise PeerError(f"not installed: {error}") from None
    if done.returncode:
        raise PeerError(f"not installed: {last_line(done.stderr or done.stdout)}")


def last_line(text: str) -> str:
    """The last line that begins with `ERROR:`, as errors of pip do; else the last line."""
    lines = [line.strip() for line in text.splitlines() if line.strip()]
    errors = [line for line in lines if line.startswith("ERROR:")]
    return (errors or lines or ["it gave no reason"])[-1]
