"""Platforms with published wheels of all dependencies: `python -m tools.wheels [--write]`.

Every dependency of the package and of all its extras is resolved for each Python and platform
of the table, without building anything and without an interpreter of that Python. The program
prints the table of docs/install.md; with `--write` it also writes it there, between two marks.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from itertools import product
from pathlib import Path

PROJECT = Path(__file__).resolve().parent.parent
DOCUMENT = PROJECT / "docs" / "install.md"
BEGIN, END = "<!-- wheels: begin -->\n", "<!-- wheels: end -->\n"

PYTHONS = ("3.10", "3.11", "3.12", "3.13", "3.14")
PLATFORMS = {
    "Linux x86-64": "x86_64-unknown-linux-gnu",
    "Linux aarch64": "aarch64-unknown-linux-gnu",
    "macOS arm64": "aarch64-apple-darwin",
}
PROMISED = {*product(["Linux x86-64", "macOS arm64"], PYTHONS)}
"""Platforms and Pythons for which every dependency must have a wheel."""
OPTIONAL = {
    "pybullet": "pybullet",
    "pybullet-arm64": "pybullet's fork",
    "mujoco": "MuJoCo",
    "mujoco-core": "MuJoCo",
}
"""Packages that differ between platforms, and their names in the table."""
_MACOS = "14.0"  # oldest supported version
_AT_ONCE = 4  # [-] number of parallel resolutions
_PATIENCE = 300  # [s] timeout of a resolution
_ALL = (str(PROJECT / "pyproject.toml"), "--all-extras")


class IndexUnreachableError(Exception):
    """The required packages are not in uv's cache, and no package index answers."""


Outcome = str | frozenset[str]
"""Names of all resolved packages, or uv's message about a package without a wheel."""


def resolve(platform: str, python: str) -> Outcome:
    """The outcome of resolving this project with all its extras, from wheels alone.

    The index is read only if uv's cache does not suffice.

    Raises:
        IndexUnreachableError: No package index answers.
    """
    cell = [*_ALL, "--python-platform", PLATFORMS[platform], "--python-version", python]
    known = compiled([*cell, "--offline"])
    return known if isinstance(known, frozenset) else compiled(cell)


def compiled(arguments: Sequence[str]) -> Outcome:
    """The result of `uv pip compile` with these arguments, from wheels alone.

    Raises:
        IndexUnreachableError: No package index answers.
    """
    # Any interpreter is sufficient without a build; otherwise uv searches for that Python.
    uv = [sys.executable, "-m", "uv", "pip", "compile", "--python", sys.executable]
    command = [*uv, "--quiet", "--only-binary", ":all:"]
    done = subprocess.run(
        [*command, "--no-header", "--no-annotate", "--color", "never", *arguments],
        cwd=PROJECT,
        env={**os.environ, "MACOSX_DEPLOYMENT_TARGET": _MACOS},
        capture_output=True,
        text=True,
        timeout=_PATIENCE,
    )
    if done.returncode == 0:
        lines = (line.partition("==")[0].strip() for line in done.stdout.splitlines())
        return frozenset(line for line in lines if line and not line.startswith("#"))
    if "Failed to fetch" in done.stderr or "error sending request" in done.stderr:
        raise IndexUnreachableError(" ".join(done.stderr.split())[:200])
    return " ".join(done.stderr.split())


def resolve_all() -> dict[tuple[str, str], Outcome]:
    """The outcome for each platform and Python.

    A first resolution for all platforms renews uv's cache, because otherwise each resolution would
    query the index again for every package.

    Raises:
        IndexUnreachableError: No package index answers.
    """
    compiled([*_ALL, "--universal", "--python-version", PYTHONS[0]])
    cells = list(product(PLATFORMS, PYTHONS))
    with ThreadPoolExecutor(_AT_ONCE) as threads:
        return dict(zip(cells, threads.map(lambda cell: resolve(*cell), cells), strict=True))


def table(outcomes: Mapping[tuple[str, str], Outcome]) -> str:
    """The outcomes in Markdown."""
    rows = [["", *(f"CPython {python}" for python in PYTHONS)], ["---"] * (1 + len(PYTHONS))]
    for platform in PLATFORMS:
        rows.append([platform, *(_cell(outcomes[platform, python]) for python in PYTHONS)])
    return "".join(f"| {' | '.join(row)} |\n" for row in rows)


def _cell(outcome: Outcome) -> str:
    if isinstance(outcome, str):
        return "no"
    return ", ".join(text for name, text in OPTIONAL.items() if name in outcome)


def written() -> str:
    """The present table of the document."""
    return DOCUMENT.read_text(encoding="utf-8").partition(BEGIN)[2].partition(END)[0]


def write(new: str) -> None:
    """Replace the table in the document."""
    text = DOCUMENT.read_text(encoding="utf-8")
    before, _, rest = text.partition(BEGIN)
    DOCUMENT.write_text(f"{before}{BEGIN}{new}{END}{rest.partition(END)[2]}", encoding="utf-8")


def main() -> int:
    """Print the table; `--write` also writes it. Returns 1 if one of `PROMISED` lacks a wheel."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument(
        "--write", action="store_true", help=f"write the table into {DOCUMENT.name}"
    )
    options = parser.parse_args()
    try:
        outcomes = resolve_all()
    except IndexUnreachableError as error:
        sys.exit(f"no package index answers: {error}")
    print(table(outcomes), end="")
    if options.write:
        write(table(outcomes))
    missing = [(cell, why) for cell, why in outcomes.items() if isinstance(why, str)]
    for (platform, python), why in missing:
        print(f"{platform}, {python}: {why}", file=sys.stderr)
    return int(any(cell in PROMISED for cell, _ in missing))


if __name__ == "__main__":
    sys.exit(main())
