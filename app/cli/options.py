"""Kinds of options that the subcommands share, and checks that name the option."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Annotated

import tyro

from app.config import Config, parameter
from app.config_file import read_config
from app.errors import ConfigError, OutputError, UnknownNameError
from app.strict import check_range

Point = tuple[float, float, float]
PointOption = Annotated[Point | None, tyro.conf.arg(metavar="X Y Z")]
PlaceOption = Annotated[tuple[float, float] | None, tyro.conf.arg(metavar="X Y")]
PoseOption = Annotated[Point | None, tyro.conf.arg(metavar="X Y YAW")]
Json = Annotated[bool, tyro.conf.FlagCreatePairsOff, tyro.conf.arg(name="json")]
"""Print one JSON object on standard output and nothing else there."""

_FARTHEST = 10.0  # [m] from the origin; a longer way is a slip of the keys
_MOST_SEEDS = 2**32 - 1  # [-] what every generator takes


def check_name(kind: str, name: str, choices: Iterable[str]) -> None:
    """Refuse a name that does not exist, before anything is loaded.

    Raises:
        UnknownNameError: Lists those that exist.
    """
    if name not in (existing := tuple(choices)):
        raise UnknownNameError(kind, name, existing)


def check_parameter(option: str, value: float, path: str) -> None:
    """Refuse a value that the parameter of that path would refuse, in the option's own name.

    Raises:
        ConfigError: Names the option and its range.
    """
    known = parameter(path)
    check_range(option, value, known.low, known.high, known.unit.removeprefix("-"))


def configured(file: Path | None) -> Config:
    """The parameters of the file of `--config`, or the defaults.

    Raises:
        ConfigError: It cannot be read, or names what is no parameter or out of its range.
    """
    if file is None:
        return Config()
    try:
        return read_config(file).config
    except ConfigError as error:
        raise ConfigError(f"--config: {error}") from None


def disturbed(config: Config, **given: float | None) -> Config:
    """The configuration with the disturbances of the options of the same names; None keeps what is.

    Raises:
        ConfigError: Names the option that is out of its range, and the range.
    """
    for name, value in given.items():
        if value is not None:
            path = f"disturbance.{name}"
            check_parameter(f"--{name.replace('_', '-')}", value, path)
            config = config.replace(path, value)
    return config


def check_point(option: str, point: tuple[float, ...] | None) -> None:
    """Refuse a point whose coordinates are not numbers within 10 m; None is fine.

    Raises:
        ConfigError: Names the option and its range.
    """
    for coordinate in point or ():
        check_range(option, coordinate, -_FARTHEST, _FARTHEST, "m")


def check_seed(seed: int) -> None:
    """Refuse a seed that no generator takes.

    Raises:
        ConfigError: Says what is possible.
    """
    check_range("--seed", seed, 0, _MOST_SEEDS)


def check_file(option: str, path: Path | None, suffixes: tuple[str, ...]) -> None:
    """Refuse a file of the wrong ending or in a folder that cannot be written, before the work.

    Raises:
        OutputError: Names the option, and the endings or why the folder cannot be written.
    """
    if path is None:
        return
    if path.suffix.lower() not in suffixes:
        raise OutputError(f"{option}: {path} should end in {' or '.join(suffixes)}")
    if path.is_dir():
        raise OutputError(f"{option}: {path} is a folder")
    make_folder(path.parent, option)


def make_folder(out: Path | None, option: str = "--out") -> None:
    """Make the folder of an option and try to write there, before the work and not after it.

    Raises:
        OutputError: It cannot be made or written to.
    """
    if out is None:
        return
    probe = out / ".writable"
    try:
        out.mkdir(parents=True, exist_ok=True)
        probe.touch()
        probe.unlink()
    except OSError as error:
        raise OutputError(f"{option}: cannot write to {out}: {error.strerror}") from None
