"""A configuration as a TOML file with comments: functions that write, read and check the file."""

import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import tomlkit

from app.config import Config, make_config, sections
from app.errors import ConfigError
from app.strict import content_of, from_toml, text_of

MAX_BYTES = 64_000  # [bytes] largest file, six times as large as a file with all parameters
LONGEST_NAME = 60  # [-] characters of the longest name
_NAME = "name"  # key of the configuration's name, which is in no section
_SERVER, _HOSTS = "server", "allow_host"  # a separate section, without parameters of the controller
_HOST = re.compile(r"[a-z0-9_]([a-z0-9_.-]*[a-z0-9_])?")


class NamedConfig(NamedTuple):
    """The content of a configuration file."""

    name: str  # name of the configuration in the file, empty if there is none
    config: Config
    hosts: tuple[str, ...] = ()  # names in `[server] allow_host`, which only `dbb serve` uses


def save_config(config: Config, name: str = "", hosts: Sequence[str] = ()) -> str:
    """The text of a file: value, range (or choices), unit and meaning of each parameter.

    A comment marks a parameter that differs from the program's default. `hosts` are the names for
    `[server] allow_host`. Raises the error of `checked_name`.
    """
    document = tomlkit.document()
    document.add(tomlkit.comment("Parameters for `dbb run`, `dbb serve` and others: --config FILE"))
    document.add(tomlkit.comment("A parameter without a line has the robot's default."))
    if name := checked_name(name):
        document.add(_NAME, tomlkit.item(name))
    for section in sections():
        table = tomlkit.table()
        table.add(tomlkit.comment(section.about))
        for each in section.tunables:
            value, allowed = config.value(each.path), each.allowed
            if not each.choices:
                allowed = f"[{each.unit}] {each.low:.15g} to {each.high:.15g}"
            table.add(tomlkit.nl())
            table.add(tomlkit.comment(f"{allowed}: {each.help}"))
            item = tomlkit.item(value)
            if value != each.default:
                usual = tomlkit.item(each.default).as_string()
                item.comment(f"the program's default is {usual}")
            table.add(each.path.partition(".")[2], item)
        document.add(tomlkit.nl())
        document.add(section.name, table)
    if hosts:
        document.add(tomlkit.nl())
        document.add(_SERVER, tomlkit.item({_HOSTS: list(hosts)}))
    return tomlkit.dumps(document)


def decode_config(content: bytes, usual: Config | None = None) -> NamedConfig:
    """The content of a file; a missing parameter has its value in `usual` or else its default.

    Raises a ConfigError if the file is too large or not TOML, a parameter is unknown, or a value,
    the name or a host is invalid.
    """
    if (size := len(content)) > MAX_BYTES:
        raise ConfigError(f"the file has {size} bytes; a configuration has at most {MAX_BYTES}")
    try:
        data: dict[str, Any] = from_toml(text_of(content))
    except ValueError as error:
        raise ConfigError(f"the file is not TOML: {error}") from None
    name = data.pop(_NAME, "")
    if not isinstance(name, str):
        raise ConfigError(f"{_NAME}: must be a string")
    server = data.pop(_SERVER, {})
    hosts = server.pop(_HOSTS, []) if isinstance(server, dict) else None
    if server or not isinstance(hosts, list) or not all(isinstance(host, str) for host in hosts):
        text = f'must have only {_HOSTS}, a list of names such as ["robot.local"]'
        raise ConfigError(f"[{_SERVER}]: {text}")
    name, config = checked_name(name), make_config(data, usual)
    return NamedConfig(name, config, tuple(map(checked_host, hosts)))


def read_config(path: Path, usual: Config | None = None) -> NamedConfig:
    """Read a file as `decode_config` does; missing parameters have the values of `usual`.

    If the file is not readable or not valid, this raises a ConfigError that names the file.
    """
    try:
        return decode_config(content_of(path), usual)
    except OSError as error:
        raise ConfigError(f"cannot read {path}: {error.strerror}") from None
    except (ConfigError, ValueError) as error:
        raise ConfigError(f"{path}: {error}") from None


def checked_name(name: str) -> str:
    """A configuration's name without blanks around it; raises a ConfigError for an invalid name."""
    name = name.strip()
    if len(name) > LONGEST_NAME or not name.isprintable():
        raise ConfigError(f"name: must have at most {LONGEST_NAME} characters, all printable")
    return name


def checked_host(name: str) -> str:
    """A host's name, converted to the form that browsers send; ConfigError if it is invalid."""
    try:
        host = name.strip().rstrip(".").lower().encode("idna").decode()
    except UnicodeError:  # a label is empty or too long
        host = ""
    if not _HOST.fullmatch(host):
        helps = "write the name without http://, port and path, such as robot.local"
        raise ConfigError(f"{name!r} is not the name of a host; {helps}")
    return host
