"""A run that is asked for, by a scenario's name or by a case: whole, or up to some times."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING

from app.cli.common import load_robot_and_border, say
from app.cli.options import Setup, configured
from app.cli.records import Given
from app.config import Config
from app.errors import ConfigError, check_name
from app.jobs.progress import progress_bar
from app.simulation.case import Planned, RunCase, read_case
from app.simulation.scenarios import SCENARIOS, scenario_of
from app.simulation.scenarios.leading import Scenario

if TYPE_CHECKING:
    from app.border.cache import BorderData
    from app.robot.model import RobotModel
    from app.simulation.run import RunResult
    from app.simulation.trace.snapshot import Snapshot
    from app.simulation.trace.trace import Trace

_CASE = ".json"


def wanted(word: str, setup: Given, config: Path | None) -> Planned:
    """The run of a scenario by its name, or of a case by its file.

    Raises:
        DbbError: There is no such scenario or case, or the case has already what is given.
    """
    # Imported here: it takes longer than to find a mistake in what was asked.
    from app.robot.description import load_robot

    if not is_case(word):
        chosen = Setup(**setup)
        tuned = configured(chosen.robot, config)
        return planned(chosen, scenario_of(load_robot(chosen.robot), word), tuned)
    own = {name: setup.get(name) for name in ("robot", "seed")}
    check_no_others({**own, "config": config}, word)
    return of_case(read(Path(word)), setup)


def planned(setup: Setup, scenario: Scenario, config: Config) -> Planned:
    """The run of a scenario by what `Setup` says."""
    return Planned(scenario=scenario, config=config, **asdict(setup))


def of_case(case: RunCase, setup: Given) -> Planned:
    """The run of a case, with another controller or plant if they are given."""
    own = {name: getattr(case, name) for name in ("robot", "controller", "physics", "seed")}
    return planned(Setup(**(own | setup)), case.scenario(), case.config())


def result_of(run: Planned, model: RobotModel, data: BorderData, *, drawn: bool) -> RunResult:
    """All of a run, under a bar of progress; see `run_planned`."""
    # Imported here: what is asked for is checked before anything is loaded.
    from app.simulation.run import run_planned

    duration = run.scenario.duration
    with progress_bar(f"{run.scenario.name}, {run.controller}", duration) as on_progress:
        return run_planned(run, model, data, on_progress=on_progress, drawn=drawn)


def filmed(
    run: Planned, model: RobotModel, data: BorderData, times: Sequence[float]
) -> list[Snapshot]:
    """Snapshots of a run up to the last of some times [s]."""
    from app.simulation import run as simulation

    with progress_bar(f"{run.scenario.name}, {run.controller}", max(times)) as on_progress:
        return simulation.filmed(run, model, data, times, on_progress)


def is_case(word: str) -> bool:
    """Whether a word is the file of a case rather than the name of a scenario.

    Raises:
        UnknownNameError: It is neither.
    """
    if not word.lower().endswith(_CASE):
        check_name("scenario", word, SCENARIOS)
        return False
    return True


def read(path: Path) -> RunCase:
    """The case of a file; what differs since it was written is said.

    Raises:
        DbbError: It is none.
    """
    case = read_case(path)
    for difference in case.differences():
        say(difference)
    return case


def check_no_others(options: Mapping[str, object], case: str = "--case") -> None:
    """Refuse options that a replayed case already answers; None was not given.

    Raises:
        ConfigError: Names the first that was.
    """
    for name, value in options.items():
        if value is not None and name not in ("border", "buffer_distance"):
            option = "SCENARIO" if name == "scenario" else f"--{name.replace('_', '-')}"
            raise ConfigError(f"{option}: {case} takes it from its file; leave one of them")


def trace_of(path: Path) -> Trace:
    """The run of a log, or of a case, which is run for it.

    Raises:
        DbbError: It is neither.
    """
    from app.simulation.trace.log_file import read_trace

    if path.suffix.lower() != _CASE:
        return read_trace(path)
    run = of_case(read(path), {})
    return result_of(run, *load_robot_and_border(run.robot), drawn=True).trace
