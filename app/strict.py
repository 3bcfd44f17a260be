"""Validated, frozen records, explanations of errors, readers of untrusted text, check of ranges."""

import ast
import codecs
import errno
import inspect
import json
import re
import sys
from collections.abc import Callable, Iterator
from functools import partial
from itertools import pairwise
from pathlib import Path
from textwrap import dedent
from typing import Annotated, Any

import numpy as np
from pydantic import AllowInfNan, BaseModel, ConfigDict, Field, ValidationError, model_validator
from pydantic_core import ErrorDetails
from typing_extensions import Self

from app.errors import ConfigError, cut, did_you_mean, shown
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
Place = tuple[int | str, ...]  # the names of fields and numbers of items that lead to a value
ValidText = Callable[[Place, str], str | None]

MAX_SEEDS = 2**32 - 1  # [-] the largest seed that every generator accepts
LARGEST_TEXT = 10_000_000  # [bytes] size of the largest text file
LARGEST_DATA = 10**6  # [characters] longest TOML or JSON text; each value needs 400 bytes


class Strict(BaseModel):
    """A frozen record without unknown fields; the docstring of a field is its help text."""

    model_config = ConfigDict(frozen=True, extra="forbid", use_attribute_docstrings=True)


def field_docs(cls: type) -> Iterator[tuple[str, str]]:
    """Name and docstring, as one line, of each documented field that is defined in a dataclass."""
    if "__dataclass_fields__" not in vars(cls):
        return
    body = ast.parse(dedent(inspect.getsource(cls))).body[0].body  # type: ignore[attr-defined]
    for before, after in pairwise(body):
        if isinstance(before, ast.AnnAssign) and isinstance(after, ast.Expr):
            text = inspect.cleandoc(ast.literal_eval(after.value))
            yield ast.unparse(before.target), " ".join(text.split())


class Sourced(Strict):
    """A record in which every stated number needs an entry in `source`."""

    source: dict[str, str] = Field(default_factory=dict)  # sources of numbers by fields' names

    @model_validator(mode="after")
    def _every_number_has_a_source(self) -> Self:
        fields = self.model_fields_set - {"source"}
        stated = {name for name in fields if _holds_a_number(getattr(self, name))}
        if missing := sorted(stated - self.source.keys()):
            raise ValueError(f"state the source of {', '.join(missing)} in the table `source`")
        if unknown := self.source.keys() - type(self).model_fields.keys():
            raise ValueError(f"`source` names unknown fields: {', '.join(sorted(unknown))}")
        return self


def _holds_a_number(value: object) -> bool:
    if isinstance(value, tuple | list):
        return any(_holds_a_number(item) for item in value)
    return isinstance(value, int | float) and not isinstance(value, bool)


def explain(
    error: ValidationError, model: type[BaseModel], valid_text: ValidText = lambda loc, kind: None
) -> str:
    """The error of a record `model` as one line: field and valid value of the first eight problems.

    `valid_text` returns the valid values for the place and kind of a problem; if it returns None,
    the line has pydantic's text. With more than 1000 problems, the line has only their number.
    """
    texts = [_explain(each, model, valid_text) for each in problems_of(error)[:8]]
    if more := error.error_count() - len(texts):
        texts.append(f"and {more} more" if texts else f"{more:,} wrong values, too many to list")
    return "; ".join(texts)


def problems_of(error: ValidationError) -> list[ErrorDetails]:
    """The problems of a validation error; empty if there are more than 1000 (each needs 1 kB)."""
    return error.errors() if error.error_count() <= 1000 else []


def _explain(problem: ErrorDetails, model: type[BaseModel], valid_text: ValidText) -> str:
    records, place = _followed(model, problem["loc"])
    path = _path(place)
    if problem["type"] == "missing":
        return f"{path}: missing"
    if problem["type"] in ("union_tag_invalid", "union_tag_not_found"):
        context = problem.get("ctx", {})
        path += "." + str(context["discriminator"]).strip("'")
        if "tag" not in context:
            return f"{path}: missing"
        return f"{path}: must be one of {context['expected_tags']} (was {context['tag']!r})"
    if problem["type"] == "extra_forbidden":
        names = sorted({name for record in records for name in record.model_fields})
        hint = did_you_mean(str(problem["loc"][-1]), names)
        return f"{path}: unknown field{hint}; known: {', '.join(names)}"
    text = valid_text(problem["loc"], problem["type"])
    text = text or problem["msg"].removeprefix("Value error, ")
    if not place:  # the input is the whole file
        return text
    if isinstance(problem["input"], str) and problem["type"].startswith(("float", "int")):
        text += ", a number without quotes"
    return f"{path}: {text} (was {shown(problem['input'])})"


def _path(loc: Place) -> str:
    text = ""
    for part in loc:
        text += f"[{part}]" if isinstance(part, int) else f".{part}" if text else part
    return cut(text) or "(whole file)"


def _followed(model: type[BaseModel], loc: Place) -> tuple[list[type[BaseModel]], Place]:
    """First, the records to which the last part of `loc` can belong as a field. Second, `loc`
    without the values of `kind`, which pydantic inserts for a union.
    """
    found, records, place = [model], [model], list[int | str]()
    for part in loc:
        records = found
        if fields := [c.model_fields[part] for c in found if part in c.model_fields]:
            found = [record for field in fields for record in _records_in(field.annotation)]
        elif tagged := [c for c in found if part in _tags(c, "kind")]:
            found = tagged
            continue
        else:  # the tag of another union, or the number or key of an item
            found = [c for c in found if part in _tags(c, "type")] or found
        place.append(part)
    return records, tuple(place)


def _tags(model: type[BaseModel], name: str) -> tuple[object, ...]:
    field = model.model_fields.get(name)
    return getattr(field.annotation, "__args__", ()) if field else ()


def _records_in(annotation: object) -> list[type[BaseModel]]:
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return [annotation]
    return [r for a in getattr(annotation, "__args__", ()) for r in _records_in(a)]


def regular(path: Path) -> Path:
    """The `path`; an OSError if it is a pipe or a device, because reading it could last forever."""
    if path.exists() and not (path.is_file() or path.is_dir()):
        raise OSError(errno.EINVAL, "it is a device or a pipe; name a file", str(path))
    return path


def content_of(path: Path) -> bytes:
    """The bytes of an untrusted text file; raises an OSError, or a ValueError above 10 MB."""
    with regular(path).open("rb") as file:
        content = file.read(LARGEST_TEXT + 1)
    if len(content) > LARGEST_TEXT:
        raise ValueError(f"it has more than {LARGEST_TEXT / 1e6:.0f} MB, the largest valid size")
    return content


def file_text(path: Path) -> str:
    """The text of a file; raises the errors of `text_of` and `content_of`."""
    return text_of(content_of(path))


def parsed(loads: Callable[[str], Any], text: str, *, heavy: bool = False) -> Any:
    """Parse an untrusted text by `loads` (TOML or JSON); a long or `heavy` one `within_budget`.

    A ValueError means that the text is invalid, too deeply nested or longer than a million
    characters, or that parsing exceeds the budget.
    """
    if len(text) > LARGEST_DATA:
        raise ValueError(f"it has more than {LARGEST_DATA / 1e6:.0f} MB, the largest valid size")
    return within_budget(_loaded, loads, text, size=max(len(text), heavy * (SMALL + 1)))


def from_toml(text: str) -> dict[str, Any]:
    """Parse an untrusted TOML text; raises the errors of `parsed`."""
    # The time for a key or for nested brackets grows with the square of the number of parts.
    heavy = any(sum(map(line.count, ".[{")) > 500 for line in text.splitlines())
    return parsed(tomllib.loads, text, heavy=heavy)


def from_json(text: str) -> Any:
    """Parse an untrusted JSON text; raises the errors of `parsed`, also for a repeated key."""
    return parsed(partial(json.loads, object_pairs_hook=_unique), text)


def _unique(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    content: dict[str, Any] = {}
    for name, value in pairs:
        if name in content:
            raise ValueError(f"the key {cut(repr(name))} appears twice in an object; remove one")
        content[name] = value
    return content


def _loaded(loads: Callable[[str], Any], text: str) -> Any:
    """Parse a text; an error message also quotes the line and names a probable typo."""
    try:
        return loads(text)
    except RecursionError:
        raise ValueError("its brackets nest too deeply") from None
    except ValueError as error:
        raise ValueError(f"{error}{_quoted(error, text)}") from None


_SLIPS = {  # typical errors at the place of an error, as patterns that take linear time
    r"([“”„‘’‚«»]),?\n?": 'is a typographic quote; write "',
    r"([:=] *-?[\d.]*\d,\d+)": "has a decimal comma; write a point",
    r"([\u00a0\u2007\u202f\u200b\u2060\u2028\ufeff])": "is a special space; write a plain one",
    r"e?([−–—])": "is a typographic minus or dash; write -",
    r"(,)\s*[}\]]": "is before a closing bracket; take away the comma",
}


def _quoted(error: ValueError, text: str) -> str:
    """The quoted line that an error of `loads` names, and a typo there (`_SLIPS`); or empty."""
    place = re.search(r"line (\d+),? column (\d+)", str(error))
    lines = text.split("\n")
    if place is None or int(place[1]) > len(lines):
        return ""
    row = int(place[1]) - 1
    at = sum(len(line) + 1 for line in lines[:row]) + int(place[2]) - 1
    found = ((m, why) for p, why in _SLIPS.items() for m in re.finditer(p, f"{text}\n"))
    slips = (f"; {m[1]!r} {why}" for m, why in found if m.start() <= at < m.end())
    return f": {cut(repr(lines[row].strip(' ')))}{next(slips, '')}"


COMMENT = rb"<!--(?:(?!-->).)*-->"  # one of XML; `.*?` could also match several: exponential time
_PLACEHOLDERS = (
    (rb"version https://git-lfs", "a Git LFS pointer; get the file by: git lfs pull"),
    (rb"[./\\\w]*annex[/\\]objects", "a git-annex pointer; get the file by: git annex get"),
    (rb"(" + COMMENT + rb"|\s)*<(!doctype\s+html|html)", "a web page; download the file itself"),
    (rb"(404: Not Found|\{\s*\"(message|error))", "a server's error; download the file again"),
    (rb"(<\?xml[^>]*>\s*)?<Error>", "a server's error; download the file again"),
    (rb"\[InternetShortcut\]", "a link to a web page; download the file itself"),
    (rb"\x1f\x8b|PK\x03\x04|7z\xbc\xaf|Rar!", "an archive; unpack it"),
    (rb"\.{0,2}/[\w./ -]+\Z", "the text of a symbolic link; put the file that it names here"),
    (rb"\s*\Z", "an empty file; download it again"),
)


def placeholder(content: bytes) -> str:
    """Description, with advice, of a content that is no proper file (`_PLACEHOLDERS`); or empty."""
    begin = content[:1024].removeprefix(codecs.BOM_UTF8)
    found = (n for p, n in _PLACEHOLDERS if re.match(p, begin, re.IGNORECASE | re.DOTALL))
    return next(found, "")


def text_of(content: bytes) -> str:
    """Decode a user's file, UTF-8 or UTF-16 with a byte order mark; line ends become line feeds.

    A ValueError means that the file has a different encoding (the message names the line), or that
    it is a `placeholder` other than an empty file.
    """
    if content.strip() and (name := placeholder(content)):
        raise ValueError(f"in the place of the file is {name}")
    wide = content.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE))
    encoding = "UTF-16" if wide else "UTF-8"
    try:
        text = content.decode("utf-16" if wide else "utf-8-sig")
    except UnicodeDecodeError as error:
        line = content[: error.start].decode(encoding, "ignore").count("\n") + 1
        raise ValueError(f"not {encoding} in line {line}; save the file as UTF-8") from None
    return text.replace("\r\n", "\n").replace("\r", "\n")


def check_range(option: str, value: float, low: float, high: float, unit: str = "") -> None:
    """Raise a ConfigError with option and range if a number is outside [low, high] or NaN."""
    if not low <= value <= high:
        number, least, most = (n if isinstance(n, int) else f"{n:g}" for n in (value, low, high))
        space = f" {unit}" if unit else ""
        raise ConfigError(f"{option}: {number}{space} is not within {least} to {most}{space}")
