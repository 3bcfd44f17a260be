"""Functions that the subcommands share: loading, printing, and runs of scenarios and cases."""

from __future__ import annotations

import sys
from collections.abc import Mapping, Sequence
from dataclasses import asdict, fields
from pathlib import Path
from typing import TYPE_CHECKING, Any

from app.cli.options import Given, Setup, configured
from app.errors import ConfigError, check_name, printable
from app.jobs.progress import progress_bar
from app.simulation.case import RunSpec, read_case
from app.simulation.scenarios import SCENARIOS, scenario_of
from app.simulation.trace.words import number_text
from app.studies.runs import json_text

if TYPE_CHECKING:
    from app.border.cache import BorderData
    from app.robot.model import RobotModel
    from app.simulation.run import RunResult
    from app.simulation.trace.snapshot import Snapshot
    from app.simulation.trace.trace import Trace


def load_model(robot: str) -> RobotModel:
    from app.robot.description import load_robot
    from app.robot.model import RobotModel

    return RobotModel(load_robot(robot))


def load_robot_and_border(robot: str) -> tuple[RobotModel, BorderData]:
    """Load a robot's model, and its border data, which are sampled if they are missing."""
    from app.border.cache import load_border_data

    model = load_model(robot)
    return model, load_border_data(model)


def say(text: str) -> None:
    """Print a line on standard error; standard output is for results."""
    print(printable(f"… {text}"), file=sys.stderr, flush=True)


def show(text: str) -> None:
    """Print a line on standard output; `printable` replaces its control characters."""
    print(printable(text))


def print_json(result: object) -> None:
    print(json_text(result))


def print_result(result: Mapping[str, Any], *, json: bool, indent: str = "") -> None:
    """Print results: with `json` as one JSON object, otherwise as lines that `indent` precedes."""
    if json:
        print_json(result)
        return
    for key, value in result.items():
        if isinstance(value, dict) and value:
            show(f"{indent}{key}")
            print_result(value, json=False, indent=indent + "  ")
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


def spec_named(word: str, setup: Given, config: Path | None) -> RunSpec:
    """The run of the scenario or the case file `word`; `setup` has values for `Setup`."""
    if is_case(word):
        return spec_of_case(Path(word), setup, word, config=config)
    return spec_of_scenario(word, setup, config)


def spec_of_scenario(
    name: str, setup: Given, config: Path | None, parameters: Given | None = None, **own: object
) -> RunSpec:
    """The run of a scenario with the values `setup` for `Setup`, and the scenario's options `own`.

    `config` and `parameters` are the arguments `file` and `given` of `configured`.
    """
    from app.robot.description import load_robot

    chosen = Setup(**setup)
    tuned = configured(chosen.robot, config, parameters)
    scenario = scenario_of(load_robot(chosen.robot), name, **own)
    return RunSpec(scenario=scenario, config=tuned, **asdict(chosen))


def spec_of_case(file: Path, setup: Given, word: str = "--case", **others: object) -> RunSpec:
    """The run of a case; prints the `RunCase.differences` of the case.

    `setup` can replace controller and plant. `check_no_others` refuses a robot and a seed in
    `setup`, and the options `others`; its error message calls the case `word`. An unreadable or
    invalid file raises a CaseError.
    """
    check_no_others({name: setup.get(name) for name in ("robot", "seed")} | others, word)
    case = read_case(file)
    for difference in case.differences():
        say(difference)
    run = case.spec()
    own = {each.name: getattr(run, each.name) for each in fields(Setup)}
    return run._replace(**asdict(Setup(**(own | setup))))


def result_of(run: RunSpec, model: RobotModel, data: BorderData, *, drawn: bool) -> RunResult:
    """Execute a run with a progress bar; `drawn` and the result are those of `run_from_spec`."""
    from app.simulation.run import run_from_spec

    duration = run.scenario.duration
    with progress_bar(f"{run.scenario.name}, {run.controller}", duration) as on_progress:
        return run_from_spec(run, model, data, on_progress=on_progress, drawn=drawn)


def filmed(
    run: RunSpec, model: RobotModel, data: BorderData, times: Sequence[float]
) -> list[Snapshot]:
    """Execute a run with a progress bar; return its snapshots at 50 Hz and at `times` [s]."""
    from app.simulation import run as simulation

    with progress_bar(f"{run.scenario.name}, {run.controller}", max(times)) as on_progress:
        return simulation.filmed(run, model, data, times, on_progress)


def is_case(word: str) -> bool:
    """True for the file of a case (.json), False for a scenario; else raises UnknownNameError."""
    if word.lower().endswith(".json"):
        return True
    check_name("scenario", word, SCENARIOS)
    return False


def check_no_others(options: Mapping[str, object], case: str = "--case") -> None:
    """Raise a ConfigError for the first option that is not None: a case already sets this option.

    `border` and `buffer_distance` are allowed: they override the case. The message calls the case
    `case`: this is the option `--case`, or the file.
    """
    for name, value in options.items():
        if value is not None and name not in ("border", "buffer_distance"):
            option = "SCENARIO" if name == "scenario" else f"--{name.replace('_', '-')}"
            reason = f"{case} already sets this option; remove the option or the case"
            raise ConfigError(f"{option}: {reason}")


def trace_of(path: Path) -> Trace:
    """The trace of a log or, for the file of a case (.json), of a new run of the case."""
    from app.simulation.trace.log_file import read_trace

    if path.suffix.lower() != ".json":
        return read_trace(path)
    run = spec_of_case(path, {})
    return result_of(run, *load_robot_and_border(run.robot), drawn=True).trace
