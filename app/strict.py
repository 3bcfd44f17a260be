"""Validated, frozen records for descriptions and configurations."""

import codecs
import re
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from pydantic import (
    AllowInfNan,
    BaseModel,
    ConfigDict,
    Field,
    ValidationError,
    model_validator,
)
from pydantic_core import ErrorDetails
from typing_extensions import Self

from app.errors import ConfigError, did_you_mean
from app.jobs.bounded import SMALL, within_budget

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

Finite = Annotated[float, AllowInfNan(False)]
Positive = Annotated[float, AllowInfNan(False), Field(gt=0)]
NonNegative = Annotated[float, AllowInfNan(False), Field(ge=0)]
Vector3 = tuple[Finite, Finite, Finite]
Array = np.ndarray

MAX_SEEDS = 2**32 - 1  # [-] the largest seed that every generator accepts

_MAX_PARTS = 500  # [-] most dots and brackets of a TOML line that this process reads
LARGEST_TEXT = 10_000_000  # [bytes] of a file of XML, or of a log as CSV
LARGEST_DATA = 10**6  # [characters] of TOML or JSON; the checks of each value take 400 bytes
_MAX_PROBLEMS = 8  # [-] most reported problems of a file
_MAX_LISTED = 1000  # [-] of a file that are looked at, which takes 1 kB each


class Strict(BaseModel):
    """A frozen record that refuses unknown fields; the docstrings of fields are their help."""

    model_config = ConfigDict(
        frozen=True, extra="forbid", use_attribute_docstrings=True, arbitrary_types_allowed=False
    )


class Sourced(Strict):
    """A record in which every stated number needs a line in `source`."""

    source: dict[str, str] = Field(default_factory=dict)
    """The source of each number: one entry per numeric field, by the field's name."""

    @model_validator(mode="after")
    def _every_number_has_a_source(self) -> Self:
        stated = {
            name
            for name in self.model_fields_set
            if name != "source" and _holds_a_number(getattr(self, name))
        }
        if missing := stated - self.source.keys():
            raise ValueError(
                f"give the source of {', '.join(sorted(missing))} in the table `source`"
            )
        if unknown := self.source.keys() - type(self).model_fields.keys():
            raise ValueError(f"`source` names unknown fields: {', '.join(sorted(unknown))}")
        return self


def _holds_a_number(value: object) -> bool:
    if isinstance(value, tuple | list):
        return any(_holds_a_number(item) for item in value)
    return isinstance(value, int | float) and not isinstance(value, bool)


def explain(
    error: ValidationError,
    model: type[BaseModel],
    wanted: Callable[[tuple[int | str, ...], str], str | None] = lambda loc, kind: None,
) -> str:
    """A validation error on one line, with one `field: valid value` per problem.

    `wanted` gives the valid values from a problem's place and kind, or None for pydantic's own
    words.
    """
    told = [_explain(each, model, wanted) for each in problems_of(error)[:_MAX_PROBLEMS]]
    if more := error.error_count() - len(told):
        told.append(f"and {more} more" if told else f"{more:,} wrong values, too many to list")
    return "; ".join(told)


def problems_of(error: ValidationError) -> list[ErrorDetails]:
    """The problems of a validation error; none if there are too many to list."""
    return error.errors() if error.error_count() <= _MAX_LISTED else []


def _explain(
    problem: ErrorDetails,
    model: type[BaseModel],
    wanted: Callable[[tuple[int | str, ...], str], str | None],
) -> str:
    path = _path(_without_kinds(model, problem["loc"]))
    if problem["type"] == "missing":
        return f"{path}: missing"
    if problem["type"] in ("union_tag_invalid", "union_tag_not_found"):
        told = problem.get("ctx", {})
        path += "." + str(told["discriminator"]).strip("'")
        if "tag" not in told:
            return f"{path}: missing"
        return f"{path}: one of {told['expected_tags']} (was {told['tag']!r})"
    if problem["type"] == "extra_forbidden":
        names = sorted({n for c in _records_at(model, problem["loc"][:-1]) for n in c.model_fields})
        hint = did_you_mean(str(problem["loc"][-1]), names)
        return f"{path}: unknown field{hint}; known: {', '.join(names)}"
    right = wanted(problem["loc"], problem["type"]) or problem["msg"]
    return f"{path}: {right} (was {_short(problem['input'])})"


def _path(loc: tuple[int | str, ...]) -> str:
    text = ""
    for part in loc:
        text += f"[{part}]" if isinstance(part, int) else f".{part}" if text else part
    return _cut(text) or "(whole file)"


def _short(value: object) -> str:
    try:
        return _cut(repr(value.tolist() if isinstance(value, np.ndarray) else value))
    except (ValueError, RecursionError):  # an integer too long to be printed, lists too deep
        return "too large to be shown"


def _cut(text: str) -> str:
    return text if len(text) <= 60 else text[:57] + "…"


def _records_at(model: type[BaseModel], loc: tuple[int | str, ...]) -> list[type[BaseModel]]:
    """The records that are possible at a place."""
    candidates: list[type[BaseModel]] = [model]
    for part in loc:
        annotations = [
            c.model_fields[part].annotation for c in candidates if part in c.model_fields
        ]
        if annotations:
            candidates = [r for a in annotations for r in _records_in(a)]
        elif isinstance(part, str):  # the tag of a union: keep the record that carries it
            tagged = [c for c in candidates if part in _tags(c)]
            candidates = tagged or candidates
    return candidates


def _without_kinds(model: type[BaseModel], loc: tuple[int | str, ...]) -> tuple[int | str, ...]:
    """A place without the parts that are values of a field `kind`, not names of fields."""
    return tuple(
        part
        for i, part in enumerate(loc)
        if not any(
            part not in c.model_fields and part in _tags(c, ("kind",))
            for c in _records_at(model, loc[:i])
        )
    )


def _tags(model: type[BaseModel], names: tuple[str, ...] = ("type", "kind")) -> tuple[object, ...]:
    fields = (model.model_fields.get(name) for name in names)
    return tuple(tag for f in fields if f for tag in getattr(f.annotation, "__args__", ()))


def _records_in(annotation: object) -> list[type[BaseModel]]:
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return [annotation]
    return [r for a in getattr(annotation, "__args__", ()) for r in _records_in(a)]


def content_of(path: Path) -> bytes:
    """The bytes of an untrusted text file.

    Raises:
        OSError: The file cannot be read.
        ValueError: The file exceeds the largest size that this program reads.
    """
    with path.open("rb") as file:
        content = file.read(LARGEST_TEXT + 1)
    if len(content) > LARGEST_TEXT:
        raise ValueError(f"it has more than the {LARGEST_TEXT / 1e6:.0f} MB of any such file")
    return content


def file_text(path: Path) -> str:
    """`text_of` a file; raises the errors of `text_of` and `content_of`."""
    return text_of(content_of(path))


def parsed(loads: Callable[[str], Any], text: str) -> Any:
    """The content of an untrusted text, by a reader of TOML or JSON.

    Raises:
        ValueError: It is none, is too long, takes more than its budget to read, nests too deeply,
            or an integer in it has thousands of digits.
    """
    return _read(loads, text, len(text))


def from_toml(text: str) -> dict[str, Any]:
    """The tables of a TOML text; raises the errors of `parsed`."""
    # The work for a key, or for nested brackets, grows with the square of its parts.
    heavy = max(map(_parts, text.splitlines()), default=0) > _MAX_PARTS
    return _read(tomllib.loads, text, max(len(text), heavy * (SMALL + 1)))


def _read(loads: Callable[[str], Any], text: str, size: int) -> Any:
    if len(text) > LARGEST_DATA:
        raise ValueError(f"it has more than the {LARGEST_DATA / 1e6:.0f} MB of any such file")
    return within_budget(_loaded, loads, text, size=size)


def _loaded(loads: Callable[[str], Any], text: str) -> Any:
    """The content of a text; an error names the probable slip, within the same budget."""
    try:
        return loads(text)
    except RecursionError:
        raise ValueError("its brackets nest too deeply") from None
    except ValueError as error:
        raise ValueError(f"{error}{_slip(text)}") from None


def text_of(content: bytes) -> str:
    """The text of a user's file: UTF-8, or UTF-16 from editors of Windows.

    It has no byte order mark, and line feeds alone as line ends.

    Raises:
        ValueError: The file has another encoding; names the line.
    """
    wide = content.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE))
    try:
        text = content.decode("utf-16" if wide else "utf-8-sig")
    except UnicodeDecodeError as error:
        line = content.count(b"\n", 0, error.start) + 1
        raise ValueError(f"not UTF-8 in line {line}; save the file as UTF-8") from None
    return text.replace("\r\n", "\n").replace("\r", "\n")


_SLIPS = {
    r"[“”„‘’‚«»]": 'is a typographic quote; write "',
    r"[:=\[]\s*-?\d+,\d+\s*([,}\]]\s*)?(#|$)": "has a decimal comma; write a point",
    r"[\u00a0\u2007\u202f]": "is a space of a special kind; write a plain one",
    r"[−–—]": "is no minus sign of a keyboard; write -",
}
"""Typical slips of word processors and spreadsheets, as patterns of linear time."""


def _slip(text: str) -> str:
    """The slip of `_SLIPS` in an invalid text, and its line."""
    for number, line in enumerate(text.splitlines(), 1):
        for pattern, why in _SLIPS.items():
            if found := re.search(pattern, line.partition("#")[0] or line):
                return f"; in line {number} {found[0].strip()!r} {why}"
    return ""


def _parts(line: str) -> int:
    return line.count(".") + line.count("[") + line.count("{")


def check_range(option: str, value: float, low: float, high: float, unit: str = "") -> None:
    """Refuse a number outside of [low, high], or not-a-number.

    Raises:
        ConfigError: Names the option and its range.
    """
    if not low <= value <= high:
        given, least, most = (n if isinstance(n, int) else f"{n:g}" for n in (value, low, high))
        space = f" {unit}" if unit else ""
        raise ConfigError(f"{option}: {given}{space} is not within {least} to {most}{space}")
