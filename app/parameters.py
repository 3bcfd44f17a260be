"""The description of a parameter for sliders, files and help texts, derived from its field."""

from typing import Any, Literal, NamedTuple, get_args, get_origin

from pydantic.fields import FieldInfo

from app.strict import Strict

_DECADES = 1000  # [-] smallest ratio of highest to lowest value of a logarithmic scale


class Shown(NamedTuple):
    """Display options of a field, part of the field's `Annotated` type."""

    label: str = ""
    """Label that replaces the name."""
    advanced: bool = False
    """Whether the parameter is hidden until the user displays all parameters."""


class _Tuned(Strict):
    path: str
    """Section and name, such as `border.d_b`."""
    help: str
    label: str
    """Displayed name, followed by the symbol if there is one, without the unit."""
    advanced: bool

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
    """The parameter of the field `name` of the record of a section.

    The field's docstring starts with the unit in brackets. A number must have both bounds.
    """
    marks: dict[str, Any] = {type(mark).__name__: mark for mark in field.metadata}
    shown: Shown = marks.get("Shown", Shown())
    unit, _, text = (field.description or "[-]").removeprefix("[").partition("]")
    common = {
        "path": f"{section}.{name}",
        "default": field.default,
        "help": " ".join(text.split()),
        "label": shown.label or name.replace("_", " ").capitalize(),
        "advanced": shown.advanced,
    }
    if get_origin(field.annotation) is Literal:
        return Choice(choices=get_args(field.annotation), **common)
    return Parameter(low=marks["Ge"].ge, high=marks["Le"].le, unit=unit, **common)
