"""The description of a parameter for sliders, files and help texts, derived from its field."""

from typing import Any, Literal, NamedTuple, get_args, get_origin

from pydantic import Field
from pydantic.fields import FieldInfo

from app.strict import Strict

_DECADES = 1000  # [-] smallest ratio of highest to lowest value of a logarithmic scale


def number(
    default: float,
    low: float,
    high: float,
    label: str = "",
    *,
    advanced: bool = False,
    source: str = "",
) -> Any:
    """A field of a section: a number from `low` to `high`; `label` replaces the field's name.

    An `advanced` parameter is hidden until the user displays all parameters. `source` is the source
    of the default, or a reason for it; a default without a source is this project's choice.
    """
    extra: dict[str, Any] = {"advanced": advanced, "source": source}
    return Field(default=default, ge=low, le=high, title=label or None, json_schema_extra=extra)


class _Tuned(Strict):
    path: str
    """Section and name, such as `border.d_b`."""
    help: str
    label: str
    """Displayed name, followed by the symbol if there is one, without the unit."""
    advanced: bool
    source: str
    """Source of the default, or a reason for it; empty if it is this project's choice."""

    @property
    def title(self) -> str:
        """Label and unit, such as `Buffer distance d_b [m]`; a choice has no unit."""
        return self.label


class Parameter(_Tuned):
    """A tunable number."""

    low: float
    high: float
    default: float
    unit: str

    @property
    def title(self) -> str:
        return self.label if self.unit == "-" else f"{self.label} [{self.unit}]"

    @property
    def allowed(self) -> str:
        """The range, such as `0.05 to 0.3 m`."""
        return f"{self.low:.15g} to {self.high:.15g} {self.unit}".removesuffix(" -")

    @property
    def log(self) -> bool:
        """Whether the scale is logarithmic, because the range spans three decades or more."""
        return self.low > 0 and self.high / self.low >= _DECADES


class Choice(_Tuned):
    """A tunable choice among words."""

    choices: tuple[str, ...]
    default: str

    @property
    def allowed(self) -> str:
        """The choices, such as `surface or points`."""
        return " or ".join(self.choices)


Tunable = Parameter | Choice


class Section(NamedTuple):
    """Parameters that belong together."""

    name: str
    """Name in paths, such as `border`."""
    title: str
    about: str
    """Description in one sentence."""
    tunables: tuple[Tunable, ...]


def read_tunable(section: str, name: str, field: FieldInfo) -> Tunable:
    """The parameter that the field `name` of a section's record describes.

    The field's docstring starts with the unit in brackets. A number must have both bounds.
    """
    unit, _, text = (field.description or "[-]").removeprefix("[").partition("]")
    extra = field.json_schema_extra if isinstance(field.json_schema_extra, dict) else {}
    common: dict[str, Any] = {
        "path": f"{section}.{name}",
        "default": field.default,
        "help": " ".join(text.split()),
        "label": field.title or name.replace("_", " ").capitalize(),
        "advanced": extra.get("advanced", False),
        "source": extra.get("source", ""),
    }
    if get_origin(field.annotation) is Literal:
        return Choice(choices=get_args(field.annotation), **common)
    marks: dict[str, Any] = {type(mark).__name__: mark for mark in field.metadata}
    return Parameter(low=marks["Ge"].ge, high=marks["Le"].le, unit=unit, **common)
