"""Options that several commands share, and checks whose messages name the option."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any

import tyro

from app.cli.records import Field, Given, from_fields, from_record
from app.config import Config, DisturbanceConfig, tunable
from app.config_file import NamedConfig, read_config
from app.control import CONTROLLERS
from app.errors import ConfigError, OutputError, check_name
from app.parameters import Parameter
from app.simulation.plants import chosen_plant, default_plant
from app.strict import MAX_SEEDS, check_range
from app.system import begun_folder, is_no_file, own_path, usable_cores

NO_DEFAULT = tyro.conf.arg(help_behavior_hint="")
"""Mark of an option whose default is not displayed."""
Flag = Annotated[bool, tyro.conf.FlagCreatePairsOff, NO_DEFAULT]  # an option without a value
Json = Annotated[Flag, tyro.conf.arg(help="Print only one JSON object.")]
ConfigOption = Annotated[
    Path | None,
    NO_DEFAULT,
    tyro.conf.arg(
        help="TOML file of parameters, written by `dbb config` or the dashboard. Parameters that "
        "are not in the file have the robot's defaults. Options for parameters override the file.",
    ),
]
Processes = Annotated[
    int | None,
    tyro.conf.arg(
        help="Number of parallel processes.",
        help_behavior_hint="(default: 2, or 1 on a single core)",
    ),
]

FORMERLY = {
    "--delay": "--base-delay",
    "--noise": "--encoder-noise",
    "--base-speed": "--v-max",
    "--strength": "--hand-f-max",
    "--replay-case": "--case",
}
"""Former names of options, which are still valid, and the present names."""
DISTURBANCES = {name: f"disturbance.{name}" for name in DisturbanceConfig.model_fields}
PARAMETERS = {"buffer_distance": "border.d_b", "border": "border.kind", **DISTURBANCES}
"""Options that set a parameter, and the parameter's path."""

_MAX_PROCESSES = 64
_USUAL_PROCESSES = 2  # each further process needs 0.5 GB


@dataclass(frozen=True)
class Setup:
    """Robot, controller, plant and seed of a run."""

    robot: str = "husky_panda"
    """Name of the robot; `dbb robots` lists all names."""
    controller: str = "dbb"
    """dbb; hqp (the paper's controller as printed, slower); repulsive or barrier (methods for
    comparison); or none (the same controller without avoidance)."""
    physics: str = field(default_factory=default_plant)
    """planar (pybullet, base on velocity-controlled joints), mujoco (the same model in MuJoCo),
    mujoco-contact (MuJoCo, base on wheels in contact) or kinematic (no physics engine)."""
    seed: int = 0
    """Seed of all random numbers."""

    def __post_init__(self) -> None:
        """Check all names before anything is loaded."""
        check_name("controller", self.controller, CONTROLLERS)
        object.__setattr__(self, "physics", chosen_plant(self.physics))
        check_seed(self.seed)


def parameter_options(paths: Mapping[str, str]) -> Any:
    """The annotation in `Annotated[Given, …]` for options that set one parameter each.

    `paths` has the path of each option's parameter, such as `border.d_b`.
    """
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
    """The robot's defaults, overridden by the file of `--config`, and then by the options.

    `given` are the values of the options that the user set; `paths` has the path of the parameter
    that each option sets, such as `border.d_b`.

    Raises:
        ConfigError: The file cannot be read, or a parameter is unknown or out of range.
        DbbError: The robot does not exist, or its description is invalid.
    """

    def override(usual: Config) -> Config:
        read = usual if file is None else _read(file, usual).config
        return changed(read, given or {}, paths)

    override(Config())  # finds an error before the import
    from app.robot.description import load_robot

    return override(load_robot(robot).config)


def hosts_of(file: Path | None) -> tuple[str, ...]:
    """Host names that the file of `--config` allows browsers to use.

    Raises:
        ConfigError: The file cannot be read.
    """
    return () if file is None else _read(file).hosts


def _read(file: Path, usual: Config | None = None) -> NamedConfig:
    try:
        return read_config(file, usual)
    except ConfigError as error:
        raise ConfigError(f"--config: {error}") from None


def changed(config: Config, given: Given, paths: Mapping[str, str] = PARAMETERS) -> Config:
    """A configuration with some parameters changed by options; arguments as in `configured`.

    Raises:
        ConfigError: A value is out of range; the message names the option and the range.
        UnknownNameError: A value is not one of the choices.
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
    """Check that all random number generators accept a seed.

    Raises:
        ConfigError: The seed is out of range; the message names the range.
    """
    check_range("--seed", seed, 0, MAX_SEEDS)


def check_processes(processes: int | None) -> int:
    """The requested number of processes, or the default: two, or one on a single core.

    Raises:
        ConfigError: The number is out of range; the message names the range.
    """
    if processes is not None:
        check_range("--processes", processes, 1, _MAX_PROCESSES)
    return processes or min(_USUAL_PROCESSES, usable_cores())


def check_once(words: list[str]) -> None:
    """Check that no option appears twice, because only the last one would count.

    Raises:
        ConfigError: An option appears twice; the message shows the correct form.
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
                f"{name} appears {len(each)} times; write it once, with several values if it "
                f"accepts them: {together}"
            )


def together(words: Iterable[str]) -> list[str]:
    """The words of a command line, with the values of all `--allow-host` in one option."""
    rest: list[str] = []
    hosts: list[str] = []
    into = rest
    for word in words:
        name, sign, value = word.partition("=")
        if name == "--allow-host":
            into = hosts = hosts or [name]
            into += [value] if sign else []
        else:
            into = rest if word.startswith("--") else into
            into.append(word)
    return rest + hosts


def check_file(option: str, path: Path | None, suffixes: tuple[str, ...]) -> None:
    """Check, before the work, that the file of an option has a valid ending and can be written.

    Raises:
        OutputError: The file has a different ending or cannot be written; the message names the
            option and the reason.
    """
    if path is None:
        return
    if path.suffix.lower() not in suffixes:
        raise OutputError(f"{option}: {path} must end in {' or '.join(suffixes)}")
    if is_no_file(own_path(path)):
        raise OutputError(f"{option}: {path} is a folder, a device, a pipe or a mount point")
    make_folder(own_path(path).parent, option)


def make_folder(out: Path | None, option: str = "--out") -> None:
    """Make the folder of an option, and check that it is writable, before the work.

    Raises:
        OutputError: The folder cannot be made, or is not writable.
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
    """The words of a command line, with former names of options replaced by the present names."""
    parted = (word.partition("=") for word in words)
    return ["".join((FORMERLY.get(name, name), sign, value)) for name, sign, value in parted]
