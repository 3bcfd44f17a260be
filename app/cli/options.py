"""Options that several commands have, and checks that name the option."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Annotated, Any

import tyro

from app.cli.records import Field, Given, from_fields, from_record
from app.config import Config, DisturbanceConfig, tunable
from app.config_file import read_config
from app.control import CONTROLLERS
from app.errors import ConfigError, OutputError, check_name
from app.parameters import Parameter
from app.simulation.plants import chosen_plant, default_plant
from app.strict import MAX_SEEDS, check_range
from app.system import begun_folder, is_no_file, own_path, usable_cores

Flag = Annotated[bool, tyro.conf.FlagCreatePairsOff]  # present or absent
Json = Annotated[
    Flag,
    tyro.conf.arg(name="json", help="Print one JSON object, nothing else.", help_behavior_hint=""),
]
ConfigOption = Annotated[
    Path | None,
    tyro.conf.arg(
        help="TOML file of parameters, as written by `dbb config` or the dashboard; parameters "
        "that are not in it have the robot's defaults, and other options override it.",
        help_behavior_hint="",
    ),
]
Processes = Annotated[
    int | None,
    tyro.conf.arg(
        help="Number of parallel processes.",
        help_behavior_hint="(default: 2, or 1 on a single core)",
    ),
]

NO_DEFAULT = tyro.conf.arg(help_behavior_hint="")
"""Option whose default is None and whose help states the effective default."""

FORMERLY = {
    "--delay": "--base-delay",
    "--noise": "--encoder-noise",
    "--base-speed": "--v-max",
    "--strength": "--hand-f-max",
    "--replay-case": "--case",
}
"""Former names of options, which still work."""
_REPEATED = {"--allow-host"}
DISTURBANCES = {name: f"disturbance.{name}" for name in DisturbanceConfig.model_fields}
PARAMETERS = {"buffer_distance": "border.d_b", "border": "border.kind", **DISTURBANCES}
"""Options that set one parameter each, by its path."""

_MAX_PROCESSES = 64
_USUAL_PROCESSES = 2  # each more needs 0.5 GB


@dataclass(frozen=True)
class Setup:
    """What runs."""

    robot: str = "husky_panda"
    """Name of the robot; `dbb robots` lists them."""
    controller: str = "dbb"
    """dbb, hqp (the paper's controller as printed; slower), a compared method
    (repulsive, barrier), or none: the same controller without avoidance."""
    physics: str = field(default_factory=default_plant)
    """planar (pybullet, base on velocity motors), mujoco (the same in MuJoCo), mujoco-contact
    (MuJoCo, base on its own wheels) or kinematic (a stand-in without physics)."""
    seed: int = 0
    """Seed of all random numbers."""

    def __post_init__(self) -> None:
        """Refuse names that do not exist before anything is loaded."""
        check_name("controller", self.controller, CONTROLLERS)
        object.__setattr__(self, "physics", chosen_plant(self.physics))
        check_seed(self.seed)


def parameter_options(paths: Mapping[str, str]) -> Any:
    """The content of `Annotated[Given, …]` for options that set one parameter each, by name."""
    found = {}
    for name, path in paths.items():
        about = tunable(path)
        if isinstance(about, Parameter):
            kind, usual, text = float, f"{about.default:g}", f"[{about.unit}] {about.help}"
        else:
            kind, usual = str, about.default
            text = f"{about.help.rstrip('.')}: {about.allowed}"
        found[name] = Field(kind, f"{usual}, or the robot's own", text)
    return from_fields(found)


SetupOptions = Annotated[Given, from_record(Setup)]
ParameterOptions = Annotated[Given, parameter_options(PARAMETERS)]


def configured(
    robot: str,
    file: Path | None,
    given: Given | None = None,
    paths: Mapping[str, str] = PARAMETERS,
) -> Config:
    """The robot's defaults, overridden by the file of `--config`, then by the options.

    Raises:
        ConfigError: The file cannot be read, has an unknown parameter, or a value out of range.
        DbbError: The robot does not exist, or its description is invalid.
    """
    asked = partial(_configured, file, given or {}, paths)
    asked(Config())
    # Imported here, because the import takes longer than finding an error in the options.
    from app.robot.description import load_robot

    return asked(load_robot(robot).config)


def _configured(file: Path | None, given: Given, paths: Mapping[str, str], usual: Config) -> Config:
    try:
        config = usual if file is None else read_config(file, usual).config
    except ConfigError as error:
        raise ConfigError(f"--config: {error}") from None
    return changed(config, given, paths)


def hosts_of(file: Path | None) -> tuple[str, ...]:
    """Names under which browsers may reach a server, from the file of `--config`.

    Raises:
        ConfigError: The file cannot be read.
    """
    try:
        return () if file is None else read_config(file).hosts
    except ConfigError as error:
        raise ConfigError(f"--config: {error}") from None


def changed(config: Config, given: Given, paths: Mapping[str, str] = PARAMETERS) -> Config:
    """A configuration with the parameters of the options that were set.

    Raises:
        ConfigError: A value is out of range; names the option and the range.
        UnknownNameError: A word is not one of the choices.
    """
    for name, value in given.items():
        about = tunable(paths[name])
        if isinstance(about, Parameter):
            option = f"--{name.replace('_', '-')}"
            check_range(option, value, about.low, about.high, about.unit.removeprefix("-"))
        else:
            check_name(name, value, about.choices)
    return config.changed({paths[name]: value for name, value in given.items()})


def check_seed(seed: int) -> None:
    """Refuse a seed that not every generator accepts.

    Raises:
        ConfigError: Names the valid range.
    """
    check_range("--seed", seed, 0, MAX_SEEDS)


def check_processes(processes: int | None) -> int:
    """The requested number of processes, or the default: two, or one on a single core.

    Raises:
        ConfigError: Names the valid range.
    """
    if processes is not None:
        check_range("--processes", processes, 1, _MAX_PROCESSES)
    return processes or min(_USUAL_PROCESSES, usable_cores())


def check_once(words: list[str]) -> None:
    """Refuse an option that appears twice, because only the last would count.

    Raises:
        ConfigError: Shows the correct form.
    """
    given: dict[str, list[list[str]]] = {}
    values: list[str] = []
    for word in words:
        if word.startswith("--"):
            name, _, value = word.partition("=")
            values = [value] if value else []
            given.setdefault(name, []).append(values)
        else:
            values.append(word)
    for name, each in given.items():
        if len(each) > 1:
            together = " ".join([name, *(value for values in each for value in values)])
            raise ConfigError(
                f"{name} is given {len(each)} times; give it once, with several values if it "
                f"takes them: {together}"
            )


def together(words: Iterable[str]) -> list[str]:
    """The words, with all values of each option of `_REPEATED` behind one occurrence of it."""
    rest: list[str] = []
    found: dict[str, list[str]] = {}
    into = rest
    for word in words:
        name, sign, value = word.partition("=")
        if name in _REPEATED:
            into = found.setdefault(name, [])
            into += [value] if sign else []
        else:
            into = rest if word.startswith("--") else into
            into.append(word)
    return [*rest, *(word for name, values in found.items() for word in (name, *values))]


def check_file(option: str, path: Path | None, suffixes: tuple[str, ...]) -> None:
    """Refuse, before the work, a file with a wrong ending or in a folder that is not writable.

    Raises:
        OutputError: Names the option, and the valid endings or the problem of the folder.
    """
    if path is None:
        return
    if path.suffix.lower() not in suffixes:
        raise OutputError(f"{option}: {path} should end in {' or '.join(suffixes)}")
    if is_no_file(path):
        raise OutputError(f"{option}: {path} is a folder or a device")
    make_folder(own_path(path).parent, option)


def make_folder(out: Path | None, option: str = "--out") -> None:
    """Make the folder of an option and test that it is writable, before the work.

    Raises:
        OutputError: The folder cannot be made or written to.
    """
    if out is None:
        return
    try:
        out = own_path(out)
        out.mkdir(parents=True, exist_ok=True)
        with begun_folder(out):
            pass
    except OutputError as error:
        raise OutputError(f"{option}: {error}") from None
    except OSError as error:
        raise OutputError(f"{option}: cannot write to {out}: {error.strerror}") from None


def in_present_words(words: Iterable[str]) -> list[str]:
    """Options with former names replaced by present ones."""
    parted = (word.partition("=") for word in words)
    return ["".join((FORMERLY.get(name, name), sign, value)) for name, sign, value in parted]
