"""The style of all figures, functions that apply it, and the record of a picture."""

import io
import logging
from collections.abc import Callable, Mapping
from contextlib import AbstractContextManager
from typing import Any, NamedTuple

import matplotlib
from matplotlib import patheffects
from matplotlib.axes import Axes
from matplotlib.figure import Figure

_METHODS = {
    "dbb": ("#0072B2", "proposed (DBB)"),
    "hqp": ("#C9B400", "hierarchy (HQP)"),
    "points": ("#56B4E9", "proposed, border of points"),
    "repulsive": ("#D55E00", "repulsive force"),
    "barrier": ("#CC79A7", "barrier rows"),
    "none": ("#7A7F87", "no avoidance"),
}
"""Colour and title of each controller, and of `dbb` with a border of points (`points`)."""
METHOD_COLOURS = {name: colour for name, (colour, _) in _METHODS.items()}
METHOD_NAMES = {name: title for name, (_, title) in _METHODS.items()}
PAIR_COLOURS = {"lm-lEE": "#009E73", "lm-l3": "#E69F00", "lm-door": "#882E72"}
"""One colour for each pair of the paper's arm and base, and for the pair of base and door."""
PAIR_NAMES = {
    "lm-lEE": r"$\mathcal{L}_m(1)$: base, end-effector",
    "lm-l3": r"$\mathcal{L}_m(2)$: base, forearm",
    "lm-door": "base, door",
}
INK = "#1F2933"
SOFT = "#9AA5B1"
ACTING = "#C2185B"  # the acting point and its force
TARGET = "#D7263D"  # the target of the end-effector; contacts, failures and limits
PATH = "#0072B2"  # the path of the base
EE = "#009E73"  # the path of the end-effector
SCORE_MAP = "viridis"  # low scores are dark, high scores are yellow
WIDTH = 11.0  # [in] default width of a figure
DPI = 150
_RULES: dict[Any, Any] = {
    **dict.fromkeys(("figure.dpi", "savefig.dpi"), DPI),
    **dict.fromkeys(("axes.labelcolor", "text.color", "xtick.color", "ytick.color"), INK),
    **dict.fromkeys(("axes.spines.top", "axes.spines.right"), False),
    **dict.fromkeys(("axes.grid", "axes.axisbelow"), True),
    **dict.fromkeys(("axes.linewidth", "grid.linewidth"), 0.8),
    "figure.facecolor": "white",
    "font.family": "sans-serif",
    "font.sans-serif": ["DejaVu Sans"],
    "font.size": 11,
    "axes.titlesize": 12,
    "axes.titleweight": "bold",
    "axes.titlelocation": "left",
    "axes.edgecolor": SOFT,
    "grid.color": "#E4E7EB",
    "lines.linewidth": 2.0,
    "lines.solid_capstyle": "round",
    "legend.frameon": False,
    "legend.fontsize": 10,
    "mathtext.fontset": "dejavusans",
}

# At the level INFO matplotlib reports each letter that it takes from another font.
logging.getLogger("matplotlib").setLevel(logging.WARNING)


def styled() -> AbstractContextManager[None]:
    """Apply the style of all figures during the `with`."""
    return matplotlib.rc_context(_RULES)


def new_figure(height: float, width: float = WIDTH) -> Figure:
    """Make an empty figure with a height and a width [in]; it needs no display and no closing."""
    return Figure(figsize=(width, height), layout="compressed")


def new_panels(height: float, *shape: int, width: float = WIDTH, **how: Any) -> tuple[Figure, Any]:
    """Make a figure and its axes, in the rows and columns `shape`; `how` as for `subplots`."""
    figure = new_figure(height, width)
    return figure, figure.subplots(*shape, **how)


def png_of(figure: Figure) -> bytes:
    """The figure as a PNG; equal figures give equal bytes."""
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", metadata={"Software": None})
    return buffer.getvalue()


class Picture(NamedTuple):
    """A picture for a page."""

    name: str  # in commands, files and links
    title: str
    needs: tuple[Any, ...]  # the runs whose results the picture shows
    draw: Callable[..., Any]
    caption: str  # text below the title


def picture(name: str, title: str, *needs: Any) -> Callable[[Callable[..., Any]], Picture]:
    """Decorator that makes a `Picture` of a drawing function, whose docstring is the caption."""
    return lambda draw: Picture(name, title, needs, draw, docstring_of(draw))


def pictures_in(module: Mapping[str, Any]) -> dict[str, Picture]:
    """The pictures of a module by their names, in the order of the module's text."""
    return {each.name: each for each in module.values() if isinstance(each, Picture)}


def docstring_of(function: Callable[..., Any]) -> str:
    """A function's docstring as one line."""
    return " ".join((function.__doc__ or "").split())


def panel_title(axes: Axes, letter: str, text: str) -> None:
    """Write a title, such as `(a) plan`, above the upper left corner; `letter` can be empty."""
    title = f"({letter}) {text}" if letter else text
    # The title of three-dimensional axes is inside the axes, so the layout ignores it.
    axes.set_title(title, y=0.97 if axes.name == "3d" else None)


def level(axes: Axes, value: float, text: str) -> None:
    """Draw a dashed horizontal line at a value, with a text above its right end."""
    axes.axhline(value, color=SOFT, linewidth=1.2, linestyle=(0, (4, 3)), zorder=1)
    place: dict[str, Any] = {"xytext": (-2, 3), "textcoords": "offset points"}
    place |= {"xycoords": axes.get_yaxis_transform(), "ha": "right", "va": "bottom"}
    halo = patheffects.withStroke(linewidth=3, foreground="white")
    axes.annotate(text, (1.0, value), fontsize=9, color="#616E7C", path_effects=[halo], **place)


def marker_style(colour: str, marker: str = "o", size: float = 9.0) -> dict[str, Any]:
    """Keyword arguments of `plot` for a point that is visible on any background."""
    edge = {"markeredgecolor": "white", "markeredgewidth": 1.2, "linestyle": "none", "zorder": 6}
    return {"color": colour, "marker": marker, "markersize": size, **edge}
