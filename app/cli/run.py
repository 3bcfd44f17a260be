"""`dbb run`: a scenario, headless and faster than real time."""

import sys
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple

import tyro

from app.cli.common import as_json, load_robot_and_border, print_json, rounded_text
from app.cli.options import (
    PARAMETERS,
    ConfigOption,
    Json,
    ParameterOptions,
    Setup,
    SetupOptions,
    changed,
    check_file,
    check_name,
    check_point,
    configured,
    make_folder,
    parameter_options,
)
from app.cli.records import Given, from_record
from app.config import Config
from app.jobs.progress import progress_bar
from app.simulation.scenarios.leading import Scenario
from app.simulation.scenarios.names import SCENARIOS, scenario_of
from app.strict import check_range

if TYPE_CHECKING:
    from app.simulation.run import RunResult

_DURATIONS = 0.01, 3600.0  # [s] shortest and longest run
_PLACES = {"start": 3, "move": 3, "hinge_position": 2, "base": 2}  # and how many are metres
_OF_A_CASE = {name: PARAMETERS[name] for name in ("buffer_distance", "border")}
_OF_SCENARIOS = {name for each in SCENARIOS.values() for name in each.options}

OutOption = Annotated[
    Path | None,
    tyro.conf.arg(help="Folder for `log.csv` and `metrics.json`.", help_behavior_hint=""),
]
LogOption = Annotated[
    Path | None,
    tyro.conf.arg(
        help="File ending in .csv or .parquet for 50 rows a second with all that the dashboard "
        "draws; `dbb report` and `dbb replay` take it.",
        help_behavior_hint="",
    ),
]


class _Files(NamedTuple):
    """Where results go: a folder, a log, and whether standard output is JSON."""

    out: Path | None
    log: Path | None
    json: bool


def choose(words: list[str]) -> tuple[str, Callable[..., Any], list[str]]:
    """The scenario of a command line, the command that runs it, and the other words.

    Raises:
        UnknownNameError: No such scenario.
        ConfigError: A scenario or an option of one beside --replay-case.
    """
    if any(word.partition("=")[0] == "--replay-case" for word in words):
        _check_replay(words)
        return "", run_case, words
    first = words[:1] if words and not words[0].startswith("-") else []
    named = first or [word for word in words if word in SCENARIOS][:1]
    if not named:
        return "", run, words
    check_name("scenario", named[0], SCENARIOS)
    scenario, rest = SCENARIOS[named[0]], list(words)
    rest.remove(scenario.name)
    for name in map(_field, rest):
        if name in _OF_SCENARIOS and name not in scenario.options:
            raise scenario.without(name)
    return scenario.name, command_of(scenario), rest


def _field(word: str) -> str:
    """The field that an option sets; other words are none."""
    option = word.partition("=")[0]
    return option[2:].replace("-", "_") if option.startswith("--") else ""


def run(
    setup: SetupOptions,
    parameters: ParameterOptions,
    config: ConfigOption = None,
    out: OutOption = None,
    log: LogOption = None,
    json: Json = False,
) -> None:
    """Run a scenario, or a case of a study again; print its figures."""
    del setup, parameters, config, out, log, json
    print(f"usage: dbb run SCENARIO …\n\n{_LIST}", file=sys.stderr)
    sys.exit(2)


_LIST = "\n".join(
    [
        "Scenarios, each with its own options (dbb run SCENARIO --help):",
        *(f"  {name:16} {each.about}" for name, each in SCENARIOS.items()),
        f"  {'--replay-case':16} a case of a study again (dbb run --replay-case FILE)",
    ]
)
run.__doc__ = f"{run.__doc__}\n\n{_LIST}\n\nThe options of all scenarios:"


def command_of(scenario: Scenario) -> Callable[..., None]:
    """The command that runs a scenario, with its own options."""

    def command(
        scenario_options: Annotated[Given, from_record(scenario, only=scenario.options)],
        setup: SetupOptions,
        parameters: ParameterOptions,
        config: ConfigOption = None,
        out: OutOption = None,
        log: LogOption = None,
        json: Json = False,
    ) -> None:
        chosen = Setup(**setup)
        for name, size in _PLACES.items():
            check_point(f"--{name.replace('_', '-')}", scenario_options.get(name, ())[:size])
        if "duration" in scenario_options:
            check_range("--duration", scenario_options["duration"], *_DURATIONS, "s")
        tuned = configured(config, parameters)
        # Imported here: it takes longer than to find a mistake in what was asked.
        from app.robot.assets import load_robot

        own = scenario_of(load_robot(chosen.robot), scenario.name).changed(**scenario_options)
        _run(own, chosen, tuned, _Files(out, log, json))

    command.__doc__ = f"Run {scenario.name}: {scenario.about}."
    return command


def run_case(
    replay_case: Path,
    setup: Annotated[Given, from_record(Setup, only=("controller", "physics"))],
    parameters: Annotated[Given, parameter_options(_OF_A_CASE)],
    out: OutOption = None,
    log: LogOption = None,
    json: Json = False,
) -> None:
    """Run a case of a study again: its start, pull, robot, disturbances and seed, so its figures.

    Args:
        replay_case: File of a case, such as those in `failures` of a study.
    """
    from app.studies.pulls.case import read_case

    case = read_case(replay_case)
    own = {name: getattr(case, name) for name in ("robot", "controller", "physics", "seed")}
    tuned = changed(case.config(), parameters)
    _run(case.scenario(), Setup(**(own | setup)), tuned, _Files(out, log, json))


def _check_replay(words: list[str]) -> None:
    """Refuse what a replayed case answers itself."""
    from app.studies.pulls.case import check_no_others

    own = _OF_SCENARIOS | {"scenario", "config", "robot", "seed", *PARAMETERS}
    given = ("scenario" if word in SCENARIOS else _field(word) for word in words)
    check_no_others(dict.fromkeys(sorted(own & set(given)), True))


def _run(scenario: Scenario, setup: Setup, config: Config, files: _Files) -> None:
    """Run it, write what is asked for, and say how it went."""
    make_folder(files.out)
    check_file("--log", files.log, (".csv", ".parquet"))
    # Imported here: it takes longer than to find a mistake in what was asked.
    from app.control.buffer_watch import buffer_warning
    from app.simulation.run import run_scenario
    from app.simulation.trace.metrics import verdict

    model, data = load_robot_and_border(setup.robot)
    with progress_bar(f"{scenario.name}, {setup.controller}", scenario.duration) as on_progress:
        result = run_scenario(
            model,
            data,
            scenario,
            config,
            controller=setup.controller,
            physics=setup.physics,
            seed=setup.seed,
            on_progress=on_progress,
            drawn=files.out is not None or files.log is not None,
        )
    written = _write(result, files.out, files.log)
    if warning := buffer_warning(result.trace.buffer, config):
        print(f"warning: {warning}", file=sys.stderr)
    if files.json:
        print_json(result.figures)
        for path in written:
            print(f"wrote {path}", file=sys.stderr)
        return
    print(verdict(result.figures))
    for key, value in result.figures.items():
        print(f"  {key:34} {rounded_text(value)}")
    for path in written:
        print(f"wrote {path}")


def _write(result: "RunResult", out: Path | None, log: Path | None) -> list[Path]:
    """Write what was asked for; returns what was written."""
    written = []
    if out is not None:
        written += [out / "log.csv", out / "metrics.json"]
        result.trace.write(written[0])
        written[1].write_text(as_json(result.figures), encoding="utf-8")
    if log is not None:
        written.append(log)
        result.trace.write(log)
    return written
