"""Measure the tables of the documentation: `python -m tools.results [NAME ...]`.

A set is the content of one table; NAME is its name. One command that prints JSON measures each row
of a set. The displayed numbers of its output are stored in docs/results/NAME.json with the commit
and the machine, immediately after the command. Only rows that are missing, that belong to an older
commit, or that were measured with uncommitted changes, are measured; thus the same call continues
after an interruption. Without names, the program measures the sets whose `default` is true.
`python -m tools.pages` puts the tables into the pages.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import subprocess
import sys
from collections.abc import Collection, Mapping
from datetime import datetime, timezone
from pathlib import Path
from typing import Any

from tools.measured import SETS

PROJECT = Path(__file__).resolve().parent.parent
RESULTS = PROJECT / "docs" / "results"
CODE = ("app", "robot_assets", "benchmarks")
"""Folders of the code: a row is up to date if nothing in them has changed since its commit."""

Rows = dict[str, dict[str, Any]]


def read(name: str) -> Rows:
    """The rows of a set by their names, each with `commit`, `machine`, `date` and `figures`."""
    path = RESULTS / f"{name}.json"
    return json.loads(path.read_text(encoding="utf-8")) if path.is_file() else {}


def write(name: str, rows: Mapping[str, Any]) -> None:
    """Store the rows of a set; the file is complete at every moment."""
    RESULTS.mkdir(exist_ok=True)
    path = RESULTS / f"{name}.json"
    part = path.with_suffix(".part")
    part.write_text(json.dumps(rows, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")
    part.replace(path)


def figures(name: str) -> dict[str, Any]:
    """The stored numbers of a set, by the names of the rows."""
    return {row: kept["figures"] for row, kept in read(name).items()}


def caption(name: str) -> str:
    """A text with the command, the commits and machines of the rows, and the latest date."""
    found = read(name)
    if not found:
        return f"*Not measured yet; `make results ARGS={name}` does it.*"
    rows = found.values()
    missing = " Empty cells are not measured yet." if set(SETS[name].runs) - set(found) else ""
    *others, last = sorted({row["commit"] for row in rows})
    commits = f"commits {', '.join(others)} and {last}" if others else f"commit {last}"
    machines = "; ".join(sorted({row["machine"] for row in rows}))
    date = max(row["date"] for row in rows)
    return f"*`make results ARGS={name}`, at {commits}, on {machines}, {date}.{missing}*"


def table(name: str) -> str:
    """Table and caption of a set in Markdown; only the caption if no row is measured."""
    found = figures(name)
    return f"{SETS[name].table(found)}\n\n{caption(name)}" if found else caption(name)


def commit() -> str:
    """The commit that last changed `CODE`, with a `+` if files in it have uncommitted changes.

    Raises:
        SystemExit: This is not a git checkout.
    """
    last = _git("log", "-1", "--format=%h", "--", *CODE)
    return f"{last}+" if _git("status", "--porcelain", "--", *CODE) else last


def machine() -> str:
    """The machine on which times depend: `Intel Xeon (2 cores), Linux x86_64, Python 3.11`."""
    name = platform.processor() or platform.machine()
    cpus = Path("/proc/cpuinfo")
    if cpus.is_file():
        lines = cpus.read_text(encoding="utf-8").splitlines()
        name = next((x.partition(": ")[2] for x in lines if x.startswith("model name")), name)
    system = f"{platform.system()} {platform.machine()}"
    return f"{name} ({os.cpu_count()} cores), {system}, Python {platform.python_version()}"


def measure(name: str, again: bool, only: Collection[str] = ()) -> bool:
    """Measure the rows of a set that are not up to date (see `CODE`); False if a command failed.

    Args:
        name: Name of the set.
        again: Also measure rows that are up to date.
        only: Names of the rows that can be measured; empty means all rows.
    """
    rows, at, good = read(name), commit(), True
    wanted = SETS[name].runs
    for row in set(rows) - set(wanted):
        del rows[row]
    for row, arguments in wanted.items():
        kept = row in rows and rows[row]["commit"] == at and not at.endswith("+")
        if (kept and not again) or (only and row not in only):
            continue
        print(f"{name}: {row}", file=sys.stderr, flush=True)
        command = [sys.executable, "-m", *arguments]
        done = subprocess.run(
            command, cwd=PROJECT, capture_output=True, text=True, env=_environment()
        )
        if done.returncode:
            print(f"{' '.join(command)}: {done.stderr.strip()[-500:]}", file=sys.stderr)
            good = False
            continue
        rows[row] = {
            "commit": at,
            "machine": machine(),
            "date": datetime.now(timezone.utc).date().isoformat(),
            "figures": rounded(SETS[name].keep(json.loads(done.stdout))),
        }
        write(name, {each: rows[each] for each in wanted if each in rows})
    return good


def rounded(value: Any) -> Any:
    """The value with six significant digits in each number, because the last digits vary."""
    if isinstance(value, dict):
        return {key: rounded(each) for key, each in value.items()}
    if isinstance(value, list):
        return [rounded(each) for each in value]
    return float(f"{value:.6g}") if isinstance(value, float) else value


def _environment() -> dict[str, str]:
    """An environment that imports from this checkout, with one thread for numerics."""
    return {"OMP_NUM_THREADS": "1", **os.environ, "PYTHONPATH": str(PROJECT)}


def _git(*arguments: str) -> str:
    done = subprocess.run(["git", *arguments], cwd=PROJECT, capture_output=True, text=True)
    if done.returncode:
        sys.exit(f"results are stored with their commit, but git fails: {done.stderr.strip()}")
    return done.stdout.strip()


def main() -> int:
    """Measure the requested sets; returns 1 if a command failed."""
    parser = argparse.ArgumentParser(prog="python -m tools.results", description=__doc__)
    parser.add_argument("names", nargs="*", metavar="NAME", help=f"names among {', '.join(SETS)}")
    parser.add_argument(
        "--again", action="store_true", help="also measure rows that are up to date"
    )
    options = parser.parse_args()
    if unknown := set(options.names) - set(SETS):
        parser.error(f"no results {', '.join(sorted(unknown))}; there are {', '.join(SETS)}")
    names = options.names or [name for name in SETS if SETS[name].default]
    good = [measure(name, options.again) for name in names]
    return int(not all(good))


if __name__ == "__main__":
    sys.exit(main())
