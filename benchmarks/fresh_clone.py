"""Duration of `make run` in a fresh clone: `python -m benchmarks.fresh_clone`.

The committed state is cloned into a folder with a space in its path, and installed with packages
from the user's caches. The kernels are compiled again. The measurement ends when the page answers.
`download_mb` is the size of all wheels, which a machine with empty caches downloads first.
"""

from __future__ import annotations

import argparse
import json
import os
import re
import shutil
import signal
import subprocess
import tempfile
import time
import urllib.request
from pathlib import Path
from typing import Any

PROJECT = Path(__file__).resolve().parent.parent
STAGES = {"venv.sh": "install_s", "import app": "compile_s", "dbb serve": "serve_s"}
"""A part of a line in make's output, and the name of the stage that starts with this line."""


def main() -> None:
    """Measure and print one JSON object."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--python", default="", help="interpreter, as in `make PYTHON=…`")
    options = parser.parse_args()
    found: dict[str, Any] = {
        "cores": os.cpu_count(),
        "load_before": os.getloadavg()[0],
        "installer": "uv" if shutil.which("uv") else "pip",
    }
    with tempfile.TemporaryDirectory(prefix="fresh clone ") as folder:
        clone = Path(folder) / "clone"
        found.update(start(clone, options.python), download_mb=wheels(clone) / 1e6)
    print(json.dumps(found, indent=2))


def start(clone: Path, python: str) -> dict[str, float]:
    """Clone, run and request the page; return the duration [s] of each stage and in total.

    Raises:
        RuntimeError: make ended without an address.
    """
    begin = time.perf_counter()
    subprocess.run(["git", "clone", "--quiet", str(PROJECT), str(clone)], check=True)
    command = ["make", "run", "ARGS=--port 0", *([f"PYTHON={python}"] if python else [])]
    make = subprocess.Popen(
        command,
        cwd=clone,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        start_new_session=True,
    )
    marks = [("clone_s", begin)]
    lines: list[str] = []
    try:
        assert make.stdout is not None
        for line in make.stdout:
            lines.append(line)
            marks += [(name, time.perf_counter()) for sign, name in STAGES.items() if sign in line]
            if address := re.search(r"http://\S+", line):
                urllib.request.urlopen(address.group(), timeout=60).read()
                marks.append(("", time.perf_counter()))
                break
        else:
            raise RuntimeError("".join(lines[-20:]))
    finally:
        os.killpg(make.pid, signal.SIGINT)
        make.wait(timeout=60)
    stages = {marks[i][0]: marks[i + 1][1] - marks[i][1] for i in range(len(marks) - 1)}
    return {**stages, "page_answers_s": marks[-1][1] - begin}


def wheels(clone: Path) -> int:
    """[bytes] size of all wheels of the environment of a clone, which are downloaded into it."""
    download = "-m pip download --quiet --no-deps -r requirements/all.txt --dest wheels"
    subprocess.run([".venv/bin/python", *download.split()], cwd=clone, check=True)
    return sum(file.stat().st_size for file in (clone / "wheels").iterdir())


if __name__ == "__main__":
    main()
