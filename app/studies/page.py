"""The page of a report: a self-contained HTML file of parts with text, pictures and tables."""

from base64 import b64encode
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

from jinja2 import Environment, PackageLoader, StrictUndefined

from app.simulation.trace.metrics import DOOR, FIGURES
from app.simulation.trace.words import missing, number_text
from app.studies.runs import flattened

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
"""Units by the ending of a key. A longer ending is before an ending that is a part of it."""
_STEMS = {
    "base_speed_max": "Largest speed of the base",
    "base_turn_max": "Largest turning speed of the base",
    "duration": "Duration",
    "effort_max_u_": "Largest torque or force, ",
    "min_distance_": "Smallest distance, ",
}
"""Words for the start of a key that is neither in `FIGURES` nor in `DOOR`."""


class Cell(NamedTuple):
    """A cell of a table with notes or a colour."""

    text: str
    notes: Sequence[str] = ()  # lines in small print below the text
    mark: str = ""  # colour of the text: green for `yes`, red for `no`


class Grid(NamedTuple):
    """A table."""

    head: Sequence[str]  # titles of the columns; empty for a table without titles
    rows: Sequence[Sequence[str | Cell]]
    numbers: bool = False  # whether the columns after the first have numbers


class Part(NamedTuple):
    """A part of a page; the page shows the fields in this order."""

    title: str = ""  # heading, and alternative text of the picture
    name: str = ""  # anchor to which the top of the page links; empty for a part without a link
    text: Sequence[str] = ()  # paragraphs
    png: bytes | None = None
    tables: Sequence[Grid] = ()
    points: Sequence[str] = ()  # sentences of a list with bullets
    note: str = ""  # a last paragraph, in grey
    sides: "Sequence[Part]" = ()  # two parts side by side, which have no name and no sides


def page_html(title: str, lead: str, parts: Sequence[Part]) -> str:
    """The HTML of a page with the first paragraph `lead`; markup in the texts is escaped."""
    how: dict[str, Any] = {"autoescape": True, "trim_blocks": True, "lstrip_blocks": True}
    environment = Environment(
        **how, undefined=StrictUndefined, loader=PackageLoader("app", "studies")
    )
    environment.filters["base64"] = lambda png: b64encode(png).decode("ascii")
    return environment.get_template("page.html.j2").render(title=title, lead=lead, parts=parts)


def measured_grids(measured: Mapping[str, Any]) -> list[Grid]:
    """Up to two tables of `measured`: its single values, and its mappings in a column each."""
    single = {k: v for k, v in measured.items() if not isinstance(v, Mapping)}
    cases = {k: flattened(v) for k, v in measured.items() if isinstance(v, Mapping)}
    keys = dict.fromkeys(key for case in cases.values() for key in case)

    def row(key: str, *values: Any) -> tuple[str, ...]:
        return label(key), *(number_text(value, missing(key)) for value in values)

    alone = [row(key, value) for key, value in single.items()]
    compared = [row(key, *(case.get(key) for case in cases.values())) for key in keys]
    grids = Grid((), alone, numbers=True), Grid(("", *cases), compared, numbers=True)
    return [grid for grid in grids if grid.rows]


def label(key: str) -> str:
    """The words for a key of results, with the unit of its ending: `d_m` becomes `d [m]`."""
    ending, unit = next(((e, u) for e, u in _UNITS.items() if key.endswith(e)), ("", ""))
    known = (FIGURES | DOOR).get(key)
    about = known.about.partition(";")[0].rstrip(".") if known else ""
    stem = next((each for each in _STEMS if key.startswith(each)), "")
    rest = key.removeprefix(stem).removesuffix(ending)
    text = about or (f"{_STEMS[stem]}{rest}" if stem else rest.replace("_", " "))
    return f"{text} [{unit}]" if unit else text
