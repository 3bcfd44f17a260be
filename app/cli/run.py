"""`dbb run`: a run of a scenario or a case without a display, as fast as possible."""

import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, NoReturn

import tyro

from app.cli import common, options
from app.cli.options import Given, from_record
from app.errors import ConfigError, check_name, printable
from app.simulation.case import RunSpec
from app.simulation.scenarios import SCENARIOS
from app.simulation.scenarios.leading import Scenario
from app.studies.runs import write_json

_OF_A_CASE = {name: options.PARAMETERS[name] for name in ("buffer_distance", "border")}
_OF_SCENARIOS = {name for each in SCENARIOS.values() for name in each.options}


@dataclass(frozen=True)
class Files:
    out: Path | None = None
    """Folder for `log.csv` and `metrics.json`."""
    log: Path | None = None
    """File that ends in .csv or .parquet, for `dbb report` and `dbb replay`, or in .mcap, for
    Foxglove, Rerun and other viewers. A .csv or .parquet file has one row per control step; only
    every 20th row has all quantities that the dashboard displays."""
    ros: bool = False
    """Write only the ROS 2 messages (CDR) into the .mcap file, for `ros2 bag play`."""

    def __post_init__(self) -> None:
        options.make_folder(self.out)
        options.check_file("--log", self.log, (".csv", ".parquet", ".mcap"))
        if self.ros and (self.log is None or self.log.suffix.lower() != ".mcap"):
            raise ConfigError("--ros: needs --log with a file that ends in .mcap")


FilesOptions = Annotated[Given, from_record(Files)]
ContactOption = Annotated[
    options.Flag,
    tyro.conf.arg(help="End with status 1 if the plant reported a contact, also with the floor."),
]


def choose_run(words: list[str]) -> tuple[str, Callable[..., Any], list[str]]:
    """Split the words after `dbb run`: scenario's name or "", its command, and remaining words."""
    if any(word.partition("=")[0] == "--case" for word in words):
        own = _OF_SCENARIOS | {"scenario", "config", "robot", "seed", *options.PARAMETERS}
        given = {"scenario" if word in SCENARIOS else _field(word) for word in words}
        common.check_no_others(dict.fromkeys(sorted(own & given), True))
        return "", run_case, words
    first = words[:1] if words and not words[0].startswith("-") else []
    named = first or [word for word in words if word in SCENARIOS][:1]
    if not named:
        return "", command_of(None), words
    check_name("scenario", named[0], SCENARIOS)
    scenario, rest = SCENARIOS[named[0]], list(words)
    rest.remove(scenario.name)
    for name in map(_field, rest):
        if name in _OF_SCENARIOS and name not in scenario.options:
            raise scenario.unknown_option(name)
    return scenario.name, command_of(scenario), rest


def _field(word: str) -> str:
    """Name of the field that an option sets; empty for a word that is not an option."""
    option = word.partition("=")[0]
    return option[2:].replace("-", "_") if option.startswith("--") else ""


def run() -> NoReturn:
    """Run a scenario, or repeat a case, and print the results."""
    # The docstring is for the help; this function runs only if the user names no scenario.
    print(f"usage: dbb run SCENARIO …\n\n{_LIST}", file=sys.stderr)
    sys.exit(2)


_LIST = (
    "Scenarios (dbb run SCENARIO --help lists the options of each):\n"
    + "".join(f"  {name:16} {each.about}\n" for name, each in SCENARIOS.items())
    + f"  {'--case':16} repeat a case from the dashboard or a study (dbb run --case FILE)"
)


def command_of(scenario: Scenario | None) -> Callable[..., None]:
    """The command that runs a scenario, with its options; for None, a command that calls `run`."""
    own = from_record(scenario, only=scenario.options) if scenario else from_record({})

    def command(
        scenario_options: Annotated[Given, own],
        setup: options.SetupOptions,
        parameters: options.ParameterOptions,
        files: FilesOptions,
        config: options.ConfigOption = None,
        fail_on_contact: ContactOption = False,
        json: options.Json = False,
    ) -> None:
        if scenario is None:
            run()
        spec = common.spec_of_scenario(scenario.name, setup, config, parameters, **scenario_options)
        _run(spec, Files(**files), json=json, fail_on_contact=fail_on_contact)

    help_without = f"{run.__doc__}\n\n{_LIST}"
    command.__doc__ = f"Run {scenario.name}: {scenario.about}." if scenario else help_without
    return command


def run_case(
    case: Path,
    setup: Annotated[Given, from_record(options.Setup, only=("controller", "physics"))],
    parameters: Annotated[Given, options.parameter_options(_OF_A_CASE)],
    files: FilesOptions,
    fail_on_contact: ContactOption = False,
    json: options.Json = False,
) -> None:
    """Repeat a case: the same robot, scenario, parameters and seed.

    Unless options change the run, only computing times differ, with the same version and machine.

    Args:
        case: JSON file of a case, saved in the dashboard or in the folder `failures` of a study.
    """
    again = common.spec_of_case(case, setup)
    again = again._replace(config=options.changed(again.config, parameters))
    _run(again, Files(**files), json=json, fail_on_contact=fail_on_contact)


def _run(asked: RunSpec, files: Files, *, json: bool, fail_on_contact: bool) -> None:
    from app.control.buffer_watch import buffer_warning
    from app.simulation.trace.log_file import write_trace
    from app.simulation.trace.metrics import touches, verdict
    from app.simulation.trace.words import missing, number_text

    model, data = common.load_robot_and_border(asked.robot)
    drawn = files.out is not None or files.log is not None
    result = common.result_of(asked, model, data, drawn=drawn)
    written = []
    if files.out is not None:
        written += [files.out / "log.csv", files.out / "metrics.json"]
        write_trace(written[0], result.trace)
        write_json(written[1], result.figures)
    if files.log is not None:
        written.append(files.log)
        if files.log.suffix.lower() == ".mcap":
            from app.simulation.trace.mcap_file import write_mcap

            write_mcap(files.log, result.trace, model, ros=files.ros)
        else:
            write_trace(files.log, result.trace)
    if warning := buffer_warning(result.trace.buffer, asked.config):
        print(f"warning: {warning}", file=sys.stderr)
    if json:
        common.print_json(result.figures)
    else:
        print(verdict(result.figures, model.body_names))
        for key, value in result.figures.items():
            print(f"  {key:34} {number_text(value, missing(key))}")
    for path in written:
        print(printable(f"wrote {path}"), file=sys.stderr if json else None)
    if fail_on_contact and touches(result.figures):
        sys.exit(1)
