"""Options from dataclasses and pydantic records, options of several commands, and their checks.

A field of a record becomes an option, and the field's docstring becomes its help text.
"""

import logging
import os
from collections.abc import Collection, Iterable, Iterator, Mapping
from dataclasses import MISSING, dataclass, field, fields
from pathlib import Path
from types import MappingProxyType, NoneType
from typing import Annotated, Any, NamedTuple, get_args, get_origin, get_type_hints

import tyro
from pydantic import BaseModel
from typing_extensions import Required, TypedDict

from app.config import Config, DisturbanceConfig, tunable
from app.config_file import NamedConfig, read_config
from app.control import CONTROLLERS
from app.errors import ConfigError, OutputError, check_name
from app.simulation.plants import chosen_plant, default_plant
from app.strict import MAX_SEEDS, check_range, field_docs
from app.system import is_no_file, own_path, unfinished_folder, usable_cores

_log = logging.getLogger(__name__)
Given = dict[str, Any]  # values of the options that the user set, by the names of the fields
NO_DEFAULT = tyro.conf.arg(help_behavior_hint="")  # for an option whose default is not displayed
Flag = Annotated[bool, tyro.conf.FlagCreatePairsOff, NO_DEFAULT]  # an option without a value
Robot = Annotated[str, tyro.conf.arg(help="Name of the robot; `dbb robots` lists all names.")]
Json = Annotated[Flag, tyro.conf.arg(help="Print only one JSON object.")]
ConfigOption = Annotated[
    Path | None,
    NO_DEFAULT,
    tyro.conf.arg(
        help="TOML file of parameters, as `dbb config` or the dashboard writes it; others have the "
        "robot's defaults. Any options for parameters override the file."
    ),
]
Processes = Annotated[
    int | None,
    NO_DEFAULT,
    tyro.conf.arg(help="Number of parallel processes; default: 2, or 1 on a single core."),
]

FORMERLY = {  # former names of options, which are still valid, with the present names
    "--delay": "--base-delay",
    "--noise": "--encoder-noise",
    "--base-speed": "--v-max",
    "--strength": "--hand-f-max",
    "--replay-case": "--case",
}
DISTURBANCES = {name: f"disturbance.{name}" for name in DisturbanceConfig.model_fields}
# Names of options that set a parameter, each with the parameter's path:
PARAMETERS = {"buffer_distance": "border.d_b", "border": "border.kind", **DISTURBANCES}
_TEXTS = "--title", "--licence"  # options with free text: a `~` in it is not a folder

_METAVARS = {  # placeholders of values in the help, by the name of the field
    "allow_host": "NAME",
    "base": "X Y YAW",
    "hinge_position": "X Y",
    "span": "BEGIN END",
    "wheels": "LEFT RIGHT",
    "ready": "Q1 Q2 …",
    "controllers": "NAME …",
    "heights": "Z …",
    "mount_rpy": "ROLL PITCH YAW",
    "tip_rpy": "ROLL PITCH YAW",
    "package": "NAME=FOLDER …",
    "speeds": "V …",
    "xacro": "NAME=VALUE …",
}


class Field(NamedTuple):  # the description of an option
    kind: Any  # its type
    default: Any  # `MISSING` for a required option
    help: str


def from_record(
    record: object,
    *,
    only: Collection[str] | None = None,
    leave: Collection[str] = (),
    names: Mapping[str, str] = MappingProxyType({}),
    positional: str = "",
) -> Any:
    """The second argument of `Annotated[Given, …]`: a command's options, one for each field.

    The command gets a dictionary with the values of only the options that the user set. `record`
    is a dataclass or pydantic class, a dataclass instance with the defaults, or a dictionary of
    `Field`s. `only` has the names of the included fields (None: all fields), `leave` those of the
    excluded fields. `names` maps a field to its option if their names differ. The field
    `positional` becomes a positional argument.
    """
    kinds: dict[str, Any] = {}
    for name, about in record.items() if isinstance(record, dict) else fields_of(record):
        if name in leave or (only is not None and name not in only):
            continue
        needed, metavar = about.default is MISSING, name.upper() if positional == name else None
        hint = "(required)" if needed else f"(default: {_text(about.default)})"
        if get_origin(about.kind) is tuple:
            usual = {2: "LOW HIGH", 3: "X Y Z"}.get(len(get_args(about.kind)))
            metavar = _METAVARS.get(name, usual)
        look = tyro.conf.arg(
            name=names.get(name, name),
            metavar=metavar,
            help=about.help,
            help_behavior_hint="" if about.default in (None, (), "") else hint,
        )
        kind: Any = Annotated[about.kind, look]
        if positional == name:
            kind = tyro.conf.Positional[kind]
        kinds[name] = Required[kind] if needed else kind
    options = TypedDict("Options", kinds, total=False)  # type: ignore[operator]
    return tyro.conf.arg(name="", constructor=options)


def _text(default: Any) -> str:
    """A default value as the help displays it, for example `yes` or `no` for a bool."""
    if isinstance(default, tuple):
        return " ".join(map(_text, default))
    if isinstance(default, bool):
        return "yes" if default else "no"
    return f"{default:g}" if isinstance(default, float) else str(default)


def fields_of(record: object) -> Iterator[tuple[str, Field]]:
    """The fields of a record, in order, with their names."""
    cls = record if isinstance(record, type) else type(record)
    kinds = {name: _not_none(kind) for name, kind in get_type_hints(cls).items()}
    if issubclass(cls, BaseModel):
        for name, each in cls.model_fields.items():
            default = each.get_default(call_default_factory=True)  # type: ignore[call-arg]
            yield name, Field(kinds[name], default, " ".join((each.description or "").split()))
        return
    docs = {name: text for each in reversed(cls.__mro__) for name, text in field_docs(each)}
    for each in fields(cls):  # type: ignore[arg-type]
        default = each.default if each.default_factory is MISSING else each.default_factory()
        if cls is not record:
            default = getattr(record, each.name)
        yield each.name, Field(kinds[each.name], default, docs.get(each.name, ""))


def _not_none(kind: Any) -> Any:
    """The type of a field without None, because an option that is set has a value."""
    rest = [each for each in get_args(kind) if each is not NoneType]
    return rest[0] if len(rest) == 1 and NoneType in get_args(kind) else kind


@dataclass(frozen=True)
class Setup:
    """Robot, controller, plant and seed of a run."""

    robot: str = "husky_panda"
    """Name of the robot; `dbb robots` lists all names."""
    controller: str = "dbb"
    """dbb (the paper's method), hqp (dbb with hierarchy (26) to (29), a border of points, and no
    joint limits or barriers; slower), repulsive, barrier (to compare), or none (no avoidance)."""
    physics: str = field(default_factory=default_plant)
    """planar (pybullet; three velocity-controlled joints move the base), mujoco (the same model in
    MuJoCo), mujoco-contact (MuJoCo, base on driven wheels) or kinematic (no physics engine)."""
    seed: int = 0
    """Seed of all random numbers."""

    def __post_init__(self) -> None:
        check_name("controller", self.controller, CONTROLLERS)
        object.__setattr__(self, "physics", chosen_plant(self.physics))
        check_seed(self.seed)


def parameter_options(paths: Mapping[str, str]) -> Any:
    """The second argument of `Annotated[Given, …]`: an option for each parameter in `paths`."""
    found = {}
    for name, path in paths.items():
        about = tunable(path)
        kind, unit = (str, about.allowed) if about.choices else (float, about.unit)
        usual = f"{_text(about.default)}, unless robot.toml or an input file sets another value"
        found[name] = Field(kind, usual, f"[{unit}] {about.help}")
    return from_record(found)


SetupOptions = Annotated[Given, from_record(Setup)]
ParameterOptions = Annotated[Given, parameter_options(PARAMETERS)]


def configured(
    robot: str, file: Path | None, given: Given | None = None, paths: Mapping[str, str] = PARAMETERS
) -> Config:
    """The robot's defaults, overridden by the file of `--config`, and then by the options `given`.

    `paths` has the path of the parameter that each option sets, such as `border.d_b`. A second
    robot of the same name (`hidden_robot`) causes a warning of `logging`.
    """
    changed(read(file).config, given or {}, paths)  # finds an error before the import
    from app.robot.assets import hidden_robot
    from app.robot.description import load_robot

    tuned = changed(read(file, load_robot(robot).config).config, given or {}, paths)
    if hidden := hidden_robot(robot):
        _log.warning("%s", hidden)
    return tuned


def read(file: Path | None, usual: Config | None = None) -> NamedConfig:
    """Read the file of `--config`, if any; other parameters are as in `usual`, or the defaults."""
    try:
        return read_config(file, usual) if file else NamedConfig("", usual or Config())
    except ConfigError as error:
        raise ConfigError(f"--config: {error}") from None


def changed(config: Config, given: Given, paths: Mapping[str, str] = PARAMETERS) -> Config:
    """A configuration with some parameters changed by options; arguments as in `configured`.

    A value out of its range raises a ConfigError, and a wrong choice an UnknownNameError.
    """
    for name, value in given.items():
        about = tunable(paths[name])
        if about.choices:
            check_name(name, value, about.choices)
        else:
            option = f"--{name.replace('_', '-')}"
            check_range(option, value, about.low, about.high, about.unit.removeprefix("-"))
    return config.changed({paths[name]: value for name, value in given.items()})


def check_seed(seed: int) -> None:
    check_range("--seed", seed, 0, MAX_SEEDS)


def check_processes(processes: int | None) -> int:
    """The requested number of processes, 1 to 64, or the default: two, or one on a single core."""
    if processes is not None:
        check_range("--processes", processes, 1, 64)
    return processes or min(2, usable_cores())  # each further process needs 0.5 GB


def in_order(words: Iterable[str]) -> list[str]:
    """The words of a command line with the present names of options, and one merged `--allow-host`.

    The home folder replaces `~` at the start of a value (a shell does not replace it in
    `--out=~/a`), except in the values of `_TEXTS`. If another option than `--allow-host` appears
    several times, or a value not of `_TEXTS` is empty, this raises a ConfigError.
    """
    before: list[str] = []
    groups: dict[str, list[list[str]]] = {}  # each option with its values
    group, name = before, ""
    for word in words:
        head, sign, value = word.partition("=")
        if head.startswith("--"):
            name = FORMERLY.get(head, head)
            group = [name + sign + (value if name in _TEXTS else os.path.expanduser(value))]
            groups.setdefault(name, []).append(group)
        else:
            group.append(word if name in _TEXTS else os.path.expanduser(word))
        if name not in _TEXTS and group[-1] in ("", name and f"{name}="):
            hint = "a variable of the shell is probably unset"
            raise ConfigError(f"{name or 'an argument'}: the value is empty; {hint}")
    for name, each in groups.items():
        once = [name, *(v for head, *rest in each for v in (*head.split("=", 1)[1:], *rest))]
        if name == "--allow-host":
            groups[name] = [once]
        elif len(each) > 1:
            helps = f"write it once, with several values if it accepts them: {' '.join(once)}"
            raise ConfigError(f"{name} appears {len(each)} times; {helps}")
    return before + [word for each in groups.values() for group in each for word in group]


def check_file(option: str, path: Path | None, suffixes: tuple[str, ...]) -> None:
    """Check an option's output file before the work, and make its folder; None is valid.

    If `path` does not end in one of `suffixes` or is not writable, this raises an OutputError.
    """
    if path is None:
        return
    if path.suffix.lower() not in suffixes:
        raise OutputError(f"{option}: {path} must end in {' or '.join(suffixes)}")
    if is_no_file(own_path(path)):
        raise OutputError(f"{option}: {path} is a folder, a device, a pipe or a mount point")
    make_folder(own_path(path).parent, option)


def make_folder(out: Path | None, option: str = "--out") -> None:
    """Make the folder of an option, if `out` is not None; raises an OutputError if this fails."""
    if out is None:
        return
    try:
        out = own_path(out)
        out.mkdir(parents=True, exist_ok=True)
        with unfinished_folder(out):
            pass
    except OutputError as error:
        raise OutputError(f"{option}: {error}") from None
    except OSError as error:
        raise OutputError(f"{option}: cannot write to {out}: {error.strerror}") from None
