"""The page of a report: a self-contained HTML file of parts with text, pictures and tables."""

from __future__ import annotations

from base64 import b64encode
from collections.abc import Mapping, Sequence
from functools import cache
from importlib.resources import files
from typing import Any, NamedTuple

from jinja2 import Environment, StrictUndefined, Template

from app.simulation.trace.words import missing, number_text

_UNITS = {
    "_m4prad4": "m⁴/rad⁴",
    "_radps2": "rad/s²",
    "_mps2": "m/s²",
    "_per_m2": "1/m²",
    "_per_m": "1/m",
    "_rad": "rad",
    "_nm": "N m",
    "_us": "µs",
    "_m": "m",
    "_n": "N",
    "_s": "s",
    "_radps": "rad/s",
    "_mps": "m/s",
}
"""Units by the ending of a key; if an ending is part of a longer one, the longer one is first."""


class Cell(NamedTuple):
    """A cell of a table with notes or a colour."""

    text: str
    """The text."""
    notes: Sequence[str] = ()
    """Lines in small print below the text."""
    mark: str = ""
    """`yes`, `no` or empty, which selects the colour."""


class Grid(NamedTuple):
    """A table."""

    head: Sequence[str]
    """Titles of the columns, or empty."""
    rows: Sequence[Sequence[str | Cell]]
    """Rows of cells, plain text or `Cell`."""
    numbers: bool = False
    """Whether the columns after the first have numbers, which must not be broken into lines."""


class Part(NamedTuple):
    """A part of a page, with its fields in the order of display."""

    title: str = ""
    """Heading, which also describes the picture."""
    name: str = ""
    """Name of the anchor to which the page links; empty without a link."""
    text: Sequence[str] = ()
    """Paragraphs."""
    png: bytes | None = None
    """A picture, which is embedded in the page."""
    tables: Sequence[Grid] = ()
    """Tables."""
    points: Sequence[str] = ()
    """A list of sentences."""
    note: str = ""
    """A last line, in grey."""
    sides: Sequence[Part] = ()
    """Two parts side by side."""


def page_html(title: str, lead: str, parts: Sequence[Part]) -> str:
    """The HTML of a page; all texts are without markup.

    Args:
        title: Title of the page.
        lead: One or two sentences below the title, before the links to the named parts.
        parts: The parts.
    """
    return _template().render(title=title, lead=lead, parts=parts)


@cache
def _template() -> Template:
    environment = Environment(
        autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True
    )
    environment.filters["base64"] = lambda png: b64encode(png).decode("ascii")
    return environment.from_string(files("app.studies").joinpath("page.html.j2").read_text("utf-8"))


def measured_grids(measured: Mapping[str, Any]) -> list[Grid]:
    """Tables of figures: one of the plain figures, one with a column for each nested mapping."""
    plain = _flat({k: v for k, v in measured.items() if not isinstance(v, Mapping)})
    cases = {k: _flat(v) for k, v in measured.items() if isinstance(v, Mapping)}
    keys = dict.fromkeys(key for case in cases.values() for key in case)
    grids = [
        Grid(
            (),
            [(label(key), number_text(value, missing(key))) for key, value in plain.items()],
            numbers=True,
        ),
        Grid(
            ("", *cases),
            [
                (label(key), *(number_text(case.get(key), missing(key)) for case in cases.values()))
                for key in keys
            ],
            numbers=True,
        ),
    ]
    return [grid for grid in grids if grid.rows]


def label(key: str) -> str:
    """A key in readable form, with its unit in brackets."""
    for ending, unit in _UNITS.items():
        if key.endswith(ending) and len(key) > len(ending):
            return f"{key.removesuffix(ending).replace('_', ' ')} [{unit}]"
    return key.replace("_", " ")


def _flat(values: Mapping[str, Any]) -> dict[str, Any]:
    flat: dict[str, Any] = {}
    for key, value in values.items():
        if isinstance(value, Mapping):
            flat |= {f"{key}, {inner}": v for inner, v in value.items()}
        else:
            flat[key] = value
    return flat
