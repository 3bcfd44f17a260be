"""A run from the name of a scenario or the file of a case, and the execution of this run."""

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
from app.simulation.case import RunCase, RunSpec, read_case
from app.simulation.scenarios import SCENARIOS, scenario_of
from app.simulation.scenarios.leading import Scenario

if TYPE_CHECKING:
    from app.border.cache import BorderData
    from app.robot.model import RobotModel
    from app.simulation.run import RunResult
    from app.simulation.trace.snapshot import Snapshot
    from app.simulation.trace.trace import Trace

_CASE = ".json"


def spec_named(word: str, setup: Given, config: Path | None) -> RunSpec:
    """The run of a scenario or a case.

    Args:
        word: Name of the scenario, or file of the case.
        setup: Options of `Setup` that the user set.
        config: File of parameters, or None.

    Raises:
        DbbError: The scenario or case does not exist; or `robot`, `seed` or `config` is set
            together with a case. A controller or plant in `setup` replaces that of the case.
    """
    # Imported here, because the import takes longer than finding an error in the options.
    from app.robot.description import load_robot

    if not is_case(word):
        chosen = Setup(**setup)
        tuned = configured(chosen.robot, config)
        return spec_with(chosen, scenario_of(load_robot(chosen.robot), word), tuned)
    own = {name: setup.get(name) for name in ("robot", "seed")}
    check_no_others({**own, "config": config}, word)
    return spec_of_case(read(Path(word)), setup)


def spec_with(setup: Setup, scenario: Scenario, config: Config) -> RunSpec:
    """The run of a scenario with the options of `Setup`."""
    return RunSpec(scenario=scenario, config=config, **asdict(setup))


def spec_of_case(case: RunCase, setup: Given) -> RunSpec:
    """The run of a case; a controller or plant in `setup` replaces that of the case."""
    own = {name: getattr(case, name) for name in ("robot", "controller", "physics", "seed")}
    return spec_with(Setup(**(own | setup)), case.scenario(), case.config())


def result_of(run: RunSpec, model: RobotModel, data: BorderData, *, drawn: bool) -> RunResult:
    """Execute a run with a progress bar; see `run_from_spec`."""
    # Imported here: the options are checked before anything is loaded.
    from app.simulation.run import run_from_spec

    duration = run.scenario.duration
    with progress_bar(f"{run.scenario.name}, {run.controller}", duration) as on_progress:
        return run_from_spec(run, model, data, on_progress=on_progress, drawn=drawn)


def filmed(
    run: RunSpec, model: RobotModel, data: BorderData, times: Sequence[float]
) -> list[Snapshot]:
    """Execute a run up to the last of some times [s] with a progress bar; return its snapshots."""
    from app.simulation import run as simulation

    with progress_bar(f"{run.scenario.name}, {run.controller}", max(times)) as on_progress:
        return simulation.filmed(run, model, data, times, on_progress)


def is_case(word: str) -> bool:
    """Whether a word is the file of a case, and not the name of a scenario.

    Raises:
        UnknownNameError: The word does not end in .json and is not the name of a scenario.
    """
    if not word.lower().endswith(_CASE):
        check_name("scenario", word, SCENARIOS)
        return False
    return True


def read(path: Path) -> RunCase:
    """Read a case from a file, and print its `differences`.

    Raises:
        CaseError: The file cannot be read or is not a valid case.
    """
    case = read_case(path)
    for difference in case.differences():
        say(difference)
    return case


def check_no_others(options: Mapping[str, object], case: str = "--case") -> None:
    """Check that none of some options, which a case already sets, is set by the user.

    Args:
        options: Values of options by name; None means that an option is not set. `border` and
            `buffer_distance` are ignored, because these options override the case.
        case: Origin of the case for the message: the option `--case`, or the case's file.

    Raises:
        ConfigError: An option is set; the message names the first such option.
    """
    for name, value in options.items():
        if value is not None and name not in ("border", "buffer_distance"):
            option = "SCENARIO" if name == "scenario" else f"--{name.replace('_', '-')}"
            raise ConfigError(
                f"{option}: {case} already sets this option; remove the option or the case"
            )


def trace_of(path: Path) -> Trace:
    """Read the trace of a log, or execute the run of a case and return its trace.

    Raises:
        DbbError: The file is neither a log nor a case.
    """
    from app.simulation.trace.log_file import read_trace

    if path.suffix.lower() != _CASE:
        return read_trace(path)
    run = spec_of_case(read(path), {})
    return result_of(run, *load_robot_and_border(run.robot), drawn=True).trace
