"""The description file: TOML with the source of each number in its table and as a comment."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import tomlkit
from tomlkit.items import Table

_HEADER = (
    "Made by `dbb new-robot`. Lengths in metres, angles in radians, masses in kilograms.",
    "Each number is measured, from the URDF, given, chosen, counted or assumed; check what is "
    "assumed.",
)


def description_text(content: Mapping[str, Any], title: str) -> str:
    """The text of `robot.toml`.

    Args:
        content: As `RobotDescription` takes it.
        title: First line of the comment at the top.
    """
    document = tomlkit.document()
    document.add(tomlkit.comment(title))
    for line in _HEADER:
        document.add(tomlkit.comment(line))
    document.add(tomlkit.nl())
    for key, value in content.items():
        if not isinstance(value, (Mapping, list)):
            document.add(key, value)
    for key, value in content.items():
        if isinstance(value, Mapping):
            document.add(key, _table(value))
        elif isinstance(value, list):
            document.add(key, _tables(value))
    return tomlkit.dumps(document)


def _table(content: Mapping[str, Any]) -> Table:
    """A table; a field with a source has the first word of it as a comment."""
    table = tomlkit.table()
    sources = content.get("source", {})
    sources = sources if isinstance(sources, Mapping) else {}
    for key, value in content.items():
        if isinstance(value, Mapping):
            table.add(key, _table(value))
        elif isinstance(value, list) and value and isinstance(value[0], Mapping):
            table.add(key, _tables(value))
        else:
            item = tomlkit.item(list(map(_plain, value)) if isinstance(value, tuple) else value)
            if key in sources:
                item.comment(_kind(sources[key]))
            table.add(key, item)
    return table


def _tables(contents: list[Mapping[str, Any]]) -> Any:
    tables = tomlkit.aot()
    for content in contents:
        tables.append(_table(content))
    return tables


def _plain(value: Any) -> Any:
    return list(map(_plain, value)) if isinstance(value, tuple) else value


def _kind(source: str) -> str:
    """What a source says before its colon; a mixed one in full."""
    return source if ";" in source and len(source) < 80 else source.partition(":")[0]
