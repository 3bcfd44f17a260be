"""`dbb check-robot`: whether a description holds what it promises."""

from __future__ import annotations

import sys
from typing import Annotated

import tyro
from rich.table import Table

from app.cli.common import console, print_json
from app.cli.options import Json
from app.robot.assets import load_robot

_MARKS = {"passed": "✓", "warned": "!", "failed": "✗"}


def check_robot(
    name: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="NAME")],
    *,
    runs: Annotated[bool, tyro.conf.arg(name="runs")] = True,
    json: Json = False,
) -> None:
    """Check a robot: both libraries, limits, bodies over meshes, pairs, border, a guiding run.

    Ends with status 0 only if no check fails; what is only warned of is told.

    Args:
        name: Name of the robot; `dbb robots` lists them.
        runs: Guide the hand towards the base too, which takes longest.
        json: Print one JSON object on standard output and nothing else there.
    """
    # Imported here: it needs scipy, trimesh and the engines.
    from app.onboarding.check import checks

    description = load_robot(name)
    rows = []
    for row in checks.check_robot(description, runs=runs, tell=lambda t: console.print(f"… {t}")):
        rows.append(row)
    failed = any(row.outcome == "failed" for row in rows)
    if json:
        told = [row._asdict() for row in rows]
        print_json({"robot": name, "passed": not failed, "checks": told})
    else:
        table = Table("", "check", "result", title=description.title)
        for row in rows:
            table.add_row(_MARKS[row.outcome], row.name, f"{row.outcome}: {row.text}")
        sys.stdout.write(_text(table))
    if failed:
        sys.exit(1)


def _text(table: Table) -> str:
    from rich.console import Console

    wide = Console(width=120, force_terminal=False)
    with wide.capture() as captured:
        wide.print(table)
    return captured.get()
