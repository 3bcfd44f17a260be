"""Options made from records: a field becomes an option, and the field's docstring its help text."""

import ast
import inspect
from collections.abc import Collection, Iterator, Mapping
from dataclasses import MISSING, fields
from itertools import pairwise
from textwrap import dedent
from types import NoneType
from typing import Annotated, Any, NamedTuple, get_args, get_origin, get_type_hints

import tyro
from pydantic import BaseModel
from typing_extensions import Required, TypedDict

Given = dict[str, Any]  # values of the options that the user set, by the names of the fields

_METAVARS = {
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


class Field(NamedTuple):
    """The description of an option."""

    kind: Any
    """Type of the value."""
    default: Any
    """Default value, or `MISSING` for a required option."""
    help: str
    """Help text."""


def from_record(
    record: object,
    *,
    only: Collection[str] | None = None,
    leave: Collection[str] = (),
    names: Mapping[str, str] | None = None,
    positional: str = "",
) -> Any:
    """The annotation in `Annotated[Given, …]` by which a command gets an option for each field.

    The command gets a dictionary that has only the options that the user set.

    Args:
        record: A dataclass or pydantic record; or a dataclass instance with the defaults.
        only: Names of the included fields; None means all fields.
        leave: Names of the excluded fields.
        names: Name of the option, for each field whose option has a different name.
        positional: The field that is a positional argument.
    """
    found = {
        name: each
        for name, each in fields_of(record)
        if (only is None or name in only) and name not in leave
    }
    return from_fields(found, names or {}, positional)


def from_fields(
    found: Mapping[str, Field], names: Mapping[str, str] | None = None, positional: str = ""
) -> Any:
    """The annotation of `from_record`, for fields that are described one by one."""
    kinds = {
        name: _option(name, each, (names or {}).get(name, name), positional == name)
        for name, each in found.items()
    }
    record = TypedDict("Options", kinds, total=False)  # type: ignore[operator]
    return tyro.conf.arg(name="", constructor=record)


def _option(name: str, about: Field, option: str, positional: bool) -> Any:
    needed = about.default is MISSING
    hint = "(required)" if needed else f"(default: {_text(about.default)})"
    marks = tyro.conf.arg(
        name=option,
        metavar=_metavar(name, about.kind, positional),
        help=about.help,
        help_behavior_hint="" if about.default in (None, (), "") else hint,
    )
    kind = Annotated[about.kind, marks]  # type: ignore[valid-type]
    if positional:
        kind = tyro.conf.Positional[kind]
    return Required[kind] if needed else kind


def _text(default: Any) -> str:
    """A default value as a user would type the value."""
    if isinstance(default, tuple):
        return " ".join(map(_text, default))
    if isinstance(default, bool):
        return "yes" if default else "no"
    return f"{default:g}" if isinstance(default, float) else str(default)


def _metavar(name: str, kind: Any, positional: bool) -> str | None:
    if get_origin(kind) is not tuple:
        return name.upper() if positional else None
    return _METAVARS.get(name) or {2: "LOW HIGH", 3: "X Y Z"}[len(get_args(kind))]


def fields_of(record: object) -> Iterator[tuple[str, Field]]:
    """The fields of a record, in order, with their names."""
    cls = record if isinstance(record, type) else type(record)
    kinds = {name: _not_none(kind) for name, kind in get_type_hints(cls).items()}
    if issubclass(cls, BaseModel):
        for name, each in cls.model_fields.items():
            default = each.get_default(call_default_factory=True)  # type: ignore[call-arg]
            yield name, Field(kinds[name], default, " ".join((each.description or "").split()))
        return
    docs = {name: text for each in reversed(cls.__mro__) for name, text in _docs(each)}
    for each in fields(cls):  # type: ignore[arg-type]
        default = each.default if each.default_factory is MISSING else each.default_factory()
        if cls is not record:
            default = getattr(record, each.name)
        yield each.name, Field(kinds[each.name], default, docs.get(each.name, ""))


def _docs(cls: type) -> Iterator[tuple[str, str]]:
    """The names and docstrings of the fields of a dataclass."""
    if "__dataclass_fields__" not in vars(cls):
        return
    body = ast.parse(dedent(inspect.getsource(cls))).body[0].body  # type: ignore[attr-defined]
    for before, after in pairwise(body):
        if isinstance(before, ast.AnnAssign) and isinstance(after, ast.Expr):
            text = inspect.cleandoc(ast.literal_eval(after.value))
            yield ast.unparse(before.target), " ".join(text.split())


def _not_none(kind: Any) -> Any:
    """The type of a field without None, because an option that is set has a value."""
    rest = [each for each in get_args(kind) if each is not NoneType]
    return rest[0] if len(rest) == 1 and NoneType in get_args(kind) else kind
