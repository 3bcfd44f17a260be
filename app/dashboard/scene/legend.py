"""Legend: colour bars of the borders, in their units, and the key to all other signs."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from app.dashboard.markup import mark, minus
from app.dashboard.scene.canvas import METRES_PER_ACCELERATION, METRES_PER_NEWTON
from app.dashboard.scene.colours import (
    ACCELERATION,
    ACTING,
    PERSON,
    TRAIL_BASE,
    TRAIL_HAND,
    Rgb,
    css,
    viridis_css,
)
from app.dashboard.verdict import COLOURS, State
from app.robot.bases.kind import BaseKind

Array = np.ndarray

_BOX = "padding:.3em .8em .4em;font-size:.8em;line-height:1.5"

QUANTITIES = ("determinant", "reachability", "score")
"""What the border can be coloured by."""


class BaseMeasure(NamedTuple):
    """Words for what (10) makes its score of, by kind of base: `BaseKind.singularity`.

    Texts are HTML; `unit` is also the score's, and `score` says how (10) makes it.
    """

    title: str = "measure of the base"
    unit: str = ""
    label: str = "measure of the base"
    hint: str = "how well the base moves the point; in the place of (7)"
    score: str = "measure · R"


_DETERMINANT = BaseMeasure(
    title="det(J<sub>c</sub>J<sub>c</sub><sup>T</sup>), (7)",
    unit="m⁴/rad⁴",
    label="far from singular, det",
    hint="(7): 0 on the wheels' axis, where the base cannot move the point sideways",
    score="sign · det · R",
)


def measure_of(kind: str) -> BaseMeasure:
    """The words for a kind of base, by its name in a description."""
    return _DETERMINANT if kind == "differential" else BaseMeasure()


class Legend(NamedTuple):
    """What the colour bar says.

    Attributes:
        title: What is shown, as HTML.
        unit: Of it, and of the least and the largest value on the border; may be empty.
        d_b: [m] buffer distance.
        drawn, total: Points drawn, and points of the border.
        top: [m] height up to which it is drawn, None if all of it.
    """

    pair: str
    title: str
    unit: str
    d_b: float
    low: float
    high: float
    drawn: int
    total: int
    top: float | None


def make_legend(
    pair: str,
    quantity: str,
    base: BaseKind,
    d_b: float,
    values: Array,
    drawn: int,
    top: float | None,
) -> Legend:
    """The legend of a border from the values (N,) of all its points, N ≥ 1.

    Args:
        pair: The link pair.
        quantity: One of `QUANTITIES`.
        base: Whose measure stands in the score.
        d_b: [m] buffer distance.
        values: (N,) values of all points.
        drawn: How many of the N points are drawn.
        top: [m] height up to which it is drawn, None if all of it.
    """
    low, high = float(values.min()), float(values.max())
    measure = measure_of(base.kind)
    title, unit = {
        "determinant": (measure.title, measure.unit),
        "reachability": ("reachability R, (9)", ""),
        "score": ("score S, (10)", measure.unit),
    }[quantity]
    return Legend(pair, title, unit, d_b, low, high, drawn, len(values), top)


def normalised(values: Array, legend: Legend) -> Array:
    """(N,) position of values on the colour bar, 0 to 1; a constant field lies in its middle."""
    span = legend.high - legend.low
    return np.full(len(values), 0.5) if span <= 0 else (values - legend.low) / span


def legend_html(legends: list[Legend]) -> str:
    """The colour bars of all drawn borders as HTML; without one, a line that says so."""
    if not legends:
        return f'<div style="{_BOX};opacity:.65">no border drawn (tab View)</div>'
    return "".join(map(_bar_html, legends))


def key_html(d_b: float) -> str:
    """What the other colours and arrows mean, as HTML, for d_b [m]."""
    force, push = 0.1 / METRES_PER_NEWTON, 0.2 / METRES_PER_ACCELERATION
    states: dict[State, str] = {
        "clear": "closest points, pair outside its buffer",
        "near": f"inside d<sub>b</sub> = {d_b:.2f} m, nothing acts on it",
        "giving way": "the base gives way",
        "resisting": "the arm keeps the distance itself",
        "contact": "contact: one is inside the other",
    }
    acting = _signs("●", ACTING) + _signs("→", ACTING)
    rows = [
        *((_signs("―", COLOURS[state]), text) for state, text in states.items()),
        (acting, f"acting point and its force: 0.1 m is {force:.0f} N"),
        (_signs("→", PERSON), f"person's force: 0.1 m is {force:.0f} N"),
        (_signs("→", ACCELERATION), f"asked of the base: v̇, 0.2 m is {push:.0f} m/s²; ω̇ as an arc"),
        (_signs("―", TRAIL_BASE, TRAIL_HAND), "ways of base and hand"),
        ("<b>―</b>", "border at the hand's height"),
    ]
    body = "".join(
        f'<div style="display:flex;gap:.6em"><span style="width:2.6em;text-align:center;'
        f'white-space:nowrap">{sign}</span><span style="opacity:.75">{text}</span></div>'
        for sign, text in rows
    )
    return f'<div style="{_BOX}">{body}</div>'


def _bar_html(legend: Legend) -> str:
    texts, factor = tick_texts(legend.low, legend.high)
    ticks = "".join(f"<span>{text}</span>" for text in texts)
    share = "all" if legend.drawn == legend.total else f"{legend.drawn:,} of the"
    part = "" if legend.top is None else f" up to z = {legend.top:.2f} m"
    unit = f" [{factor}{legend.unit}]" if factor or legend.unit else ""
    return (
        f'<div style="{_BOX}">'
        f'<div style="display:flex;justify-content:space-between"><b>{legend.title}{unit}</b>'
        f"<span>{legend.pair}</span></div>"
        f'<div style="height:.9em;border-radius:3px;margin:.2em 0;'
        f'background:linear-gradient(to right,{viridis_css()})"></div>'
        '<div style="display:flex;justify-content:space-between;'
        f'font-variant-numeric:tabular-nums">{ticks}</div>'
        f'<div style="opacity:.65">d<sub>b</sub> = {legend.d_b:.3f} m, '
        f"{share} {legend.total:,} points{part}. Where there are none, the arm cannot be at that "
        "distance.</div></div>"
    )


def _signs(sign: str, *colours: Rgb) -> str:
    return "".join(mark(sign, css(colour)) for colour in colours)


def tick_texts(low: float, high: float) -> tuple[list[str], str]:
    """Numbers at the ends and in the middle of the bar, and the power of ten that they share.

    Returns:
        Three numbers of three digits, and a factor such as `10<sup>−3</sup> `, or an empty text.
    """
    largest = max(abs(low), abs(high))
    power = 0 if largest == 0 else math.floor(math.log10(largest))
    power = 0 if -1 <= power <= 3 else 3 * (power // 3)
    digits = 2 - (0 if largest == 0 else math.floor(math.log10(largest)) - power)
    ticks = [(low + u * (high - low)) / 10.0**power for u in (0.0, 0.5, 1.0)]
    texts = [minus(f"{tick:.{max(digits, 0)}f}") for tick in ticks]
    return texts, f"10<sup>{minus(str(power))}</sup> " if power else ""
