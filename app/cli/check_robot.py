"""`dbb check-robot`: whether a description holds what it promises."""

from __future__ import annotations

import sys
from typing import Annotated

import tyro

from app.cli.common import print_json, print_table, say
from app.cli.options import Json

_MARKS = {"passed": "✓", "warned": "!", "failed": "✗"}


def check_robot(
    name: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="NAME")],
    *,
    runs: Annotated[bool, tyro.conf.arg(name="runs")] = True,
    json: Json = False,
) -> None:
    """Check that a robot's description holds what it promises.

    Both libraries, limits, bodies over meshes, pairs, border, a guiding run; warnings are shown.
    Ends with status 0 only if no check fails.

    Args:
        name: Name of the robot; `dbb robots` lists them.
        runs: Guide the hand towards the base too, which takes longest.
    """
    from app.robot.assets import load_robot

    description = load_robot(name)
    # Imported here: it needs scipy, trimesh and the engines.
    from app.onboarding.check import checks

    rows = list(checks.check_robot(description, runs=runs, tell=say))
    failed = any(row.outcome == "failed" for row in rows)
    if json:
        told = [row._asdict() for row in rows]
        print_json({"robot": name, "passed": not failed, "checks": told})
    else:
        from rich.table import Table

        table = Table("", "check", "result", title=description.title)
        for row in rows:
            table.add_row(_MARKS[row.outcome], row.name, f"{row.outcome}: {row.text}")
        print_table(table)
    if failed:
        sys.exit(1)
