"""The description of a parameter for sliders, files and help texts, derived from its field."""

from typing import Any, Literal, NamedTuple, get_args, get_origin

from pydantic.fields import FieldInfo

from app.strict import Strict

_DECADES = 1000  # [-] ratio of highest to lowest value from which a scale is logarithmic


class Shown(NamedTuple):
    """Display options of a field, in its `Annotated`."""

    label: str = ""
    """Label in place of the name."""
    advanced: bool = False
    """Hidden until the user displays all parameters."""


class _Tuned(Strict):
    path: str
    """Section and name, as in `border.d_b`."""
    help: str
    label: str
    """Name for people, then the symbol if there is one, without the unit."""
    advanced: bool

    @property
    def title(self) -> str:
        """Label and unit, as in `Buffer distance d_b [m]`; a word has no unit."""
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
        """As in `0.06 to 0.3 m`."""
        return f"{self.low:.15g} to {self.high:.15g} {self.unit}".removesuffix(" -")

    @property
    def log(self) -> bool:
        """Whether the scale is logarithmic, because the range spans decades."""
        return self.low > 0 and self.high / self.low >= _DECADES


class Choice(_Tuned):
    """A tunable choice among words."""

    choices: tuple[str, ...]
    default: str

    @property
    def allowed(self) -> str:
        """As in `surface or points`."""
        return " or ".join(self.choices)


Tunable = Parameter | Choice


class Section(NamedTuple):
    """Parameters that belong together."""

    name: str
    """As in `border`."""
    title: str
    """For people."""
    about: str
    """One sentence."""
    tunables: tuple[Tunable, ...]
    """In the order of the record."""


def read_tunable(section: str, name: str, field: FieldInfo) -> Tunable:
    """A parameter from its field.

    A unit stands in brackets at the start of a field's docstring; number fields have both bounds.
    """
    marks: dict[str, Any] = {type(mark).__name__: mark for mark in field.metadata}
    shown: Shown = marks.get("Shown", Shown())
    unit, _, text = (field.description or "[-]").removeprefix("[").partition("]")
    common = {
        "path": f"{section}.{name}",
        "default": field.default,
        "help": text.strip(),
        "label": shown.label or name.replace("_", " ").capitalize(),
        "advanced": shown.advanced,
    }
    if get_origin(field.annotation) is Literal:
        return Choice(choices=get_args(field.annotation), **common)
    return Parameter(low=marks["Ge"].ge, high=marks["Le"].le, unit=unit, **common)
