"""Functions for loading and printing that the subcommands share."""

from __future__ import annotations

import json
import sys
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from app.errors import printable
from app.simulation.trace.words import number_text

if TYPE_CHECKING:
    from app.border.cache import BorderData
    from app.robot.model import RobotModel
    from app.studies.page import Part


def load_model(robot: str) -> RobotModel:
    """Load the model of a robot by its name."""
    from app.robot.description import load_robot
    from app.robot.model import RobotModel

    return RobotModel(load_robot(robot))


def load_robot_and_border(robot: str) -> tuple[RobotModel, BorderData]:
    """Load a robot's model, link pairs and border clouds; missing pairs and clouds are sampled."""
    from app.border.cache import load_border_data

    model = load_model(robot)
    return model, load_border_data(model)


def say(text: str) -> None:
    """Print a line on standard error; standard output is for results."""
    print(printable(f"… {text}"), file=sys.stderr, flush=True)


def show(text: str) -> None:
    """Print a line on standard output; its text possibly comes from an untrusted source."""
    print(printable(text))


def print_json(result: object) -> None:
    """Print one JSON object on standard output."""
    print(json.dumps(result, indent=2, allow_nan=False))


def print_result(result: Mapping[str, Any], *, json: bool) -> None:
    """Print a command's results, as one JSON object or with one result on each line."""
    print_json(result) if json else _print_lines(result)


def _print_lines(result: Mapping[str, Any], indent: str = "") -> None:
    for key, value in result.items():
        if isinstance(value, dict):
            show(f"{indent}{key}")
            _print_lines(value, indent + "  ")
        else:
            text = f"{value:.4g}" if isinstance(value, float) else number_text(value)
            show(f"{indent}{key:28} {text}".rstrip())


def print_table(head: Sequence[str], rows: Sequence[Sequence[str]], title: str = "") -> None:
    """Print a table of plain texts, at most 140 characters wide, on standard output."""
    from rich.console import Console
    from rich.markup import escape  # otherwise rich reads a unit such as [m] as a style
    from rich.table import Table

    table = Table(*map(escape, head), title=escape(title) or None)
    for row in rows:
        table.add_row(*(escape(printable(cell)) for cell in row))
    Console(width=140, force_terminal=False, file=sys.stdout).print(table)


def print_part(part: Part) -> None:
    """Print the texts and tables of a part of a report's page on standard output."""
    for text in part.text:
        show(text)
    for grid in part.tables:
        print_table(grid.head, [list(map(str, row)) for row in grid.rows], part.title)
