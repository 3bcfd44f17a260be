"""What the subcommands load and how they print."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from rich.console import Console
from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeRemainingColumn

from app.border.cache import BorderData, load_border_data
from app.cli.signals import check_signals
from app.robot.assets import load_robot
from app.robot.model import RobotModel

console = Console(stderr=True)
"""Progress and logs; standard output belongs to the results."""


def load_model(robot: str) -> RobotModel:
    """The compiled model of a robot by its name."""
    return RobotModel(load_robot(robot))


def load_robot_and_border(robot: str) -> tuple[RobotModel, BorderData]:
    """A robot's model with its pairs and clouds, sampled if they are not in the cache."""
    model = load_model(robot)
    return model, load_border_data(model)


def print_json(result: object) -> None:
    """One JSON object on standard output."""
    sys.stdout.write(as_json(result))


def as_json(result: object) -> str:
    """The text of one JSON object, with a line's end."""
    return json.dumps(result, indent=2, allow_nan=False) + "\n"


@contextmanager
def progress_bar(text: str, total: float) -> Iterator[Callable[[float], None]]:
    """A progress bar on standard error; gives the function that says how far it is.

    That function is where a signal is heard again if it was lost.
    """
    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        TaskProgressColumn(),
        TimeRemainingColumn(),
    )
    # Without a terminal a bar that vanishes would leave an empty line behind.
    hidden = not console.is_terminal
    with Progress(*columns, console=console, transient=True, disable=hidden) as progress:
        task = progress.add_task(text, total=total)

        def tell(done: float) -> None:
            check_signals()
            progress.update(task, completed=done)

        yield tell
