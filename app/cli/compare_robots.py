"""`dbb compare-robots`: every robot through the same cases, as a table."""

from __future__ import annotations

import sys
from typing import Annotated, Any

import tyro
from rich.console import Console
from rich.table import Table

from app.cli.common import print_json, progress_bar
from app.cli.options import Json, check_name, check_range, check_seed
from app.robot.assets import robot_names

_MOST_PROCESSES = 64


def compare_robots(
    robots: Annotated[tuple[str, ...], tyro.conf.arg(metavar="NAME …")] = (),
    case: Annotated[tuple[str, ...], tyro.conf.arg(metavar="NAME …")] = (),
    processes: int | None = None,
    seed: int = 0,
    json: Json = False,
) -> None:
    """Lead each robot's hand towards its own base, without avoidance and with it.

    Each robot is pulled by its hand from the side and from the front, and tracks a path of 0.2 m at
    its side and one along its wheel axis, p_b at x = 0. The starts are searched, 0.02 m outside of
    the buffer; a robot whose hand cannot come there has a row that says so.

    Args:
        robots: Names of the robots (default: all); `dbb robots` lists them.
        case: Some of guiding-lateral, guiding-front, tracking and wheel-axis (default: all).
        processes: How many to work side by side (default: 2, or as many as there are cores).
        seed: Seed of everything random.
        json: Print one JSON object on standard output and nothing else there.
    """
    # Imported here: pybullet and scipy would make every other command start later.
    from app.studies.paper.experiments import default_processes
    from app.studies.sweep.robot_cases import CASES
    from app.studies.sweep.robot_table import robot_table

    for name in robots:
        check_name("robot", name, robot_names())
    known = {each.name: each for each in CASES}
    for name in case:
        check_name("case", name, known)
    if processes is not None:
        check_range("--processes", processes, 1, _MOST_PROCESSES)
    check_seed(seed)
    with progress_bar("robots", 1.0) as on_progress:
        result = robot_table(
            robots or robot_names(),
            cases=[known[name] for name in case] or CASES,
            seed=seed,
            processes=processes or default_processes(),
            on_progress=on_progress,
        )
    if json:
        print_json(result)
    else:
        sys.stdout.write(_text(result["rows"]))


def _text(rows: list[dict[str, Any]]) -> str:
    table = Table(
        "robot", "case", "from", "controller", "clearance", "hand off", "base drove", "contacts", ""
    )
    for row in rows:
        title, clearance = row["title"], row.get("clearance_m")
        if "reason" in row:
            table.add_row(title, row["case"], "", "", row["reason"])
            continue
        where = f"{row['direction_deg']:g}°, {row['height_m']:.2f} m"
        table.add_row(
            title,
            row["case"],
            where,
            row["controller"],
            "–" if clearance is None else f"{clearance:.3f} m",
            f"{1000 * row['hand_error_m']:.3g} mm",
            f"{row['base_path_m']:.2f} m",
            str(row["contacts"]),
            "✓" if row["passed"] else "✗",
        )
    wide = Console(width=140, force_terminal=False)
    with wide.capture() as captured:
        wide.print(table)
    return captured.get()
