"""The colour bar of the border: the numbers of the points that are drawn, with their unit."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from app.dashboard.acting_points import METRES_PER_NEWTON
from app.dashboard.colours import ACTING, css, viridis_css

Array = np.ndarray


class Quantity(NamedTuple):
    """What the border can be coloured by."""

    title: str
    unit: str
    """Empty if it has none."""


QUANTITIES = {
    "determinant": Quantity("det(J<sub>c</sub>J<sub>c</sub><sup>T</sup>), (7)", "m⁴/rad⁴"),
    "reachability": Quantity("reachability R, (9)", ""),
    "score": Quantity("score S, (10)", "m⁴/rad⁴"),
}


class Legend(NamedTuple):
    """What the colour bar says.

    Attributes:
        pair: The link pair of the border.
        quantity: A key of `QUANTITIES`.
        d_b: [m] buffer distance.
        low, high: Least and largest value on the border, in the quantity's unit.
        drawn, total: Points drawn, and points of the border.
        top: [m] height up to which it is drawn, None if all of it.
    """

    pair: str
    quantity: str
    d_b: float
    low: float
    high: float
    drawn: int
    total: int
    top: float | None


def make_legend(
    pair: str, quantity: str, d_b: float, values: Array, drawn: int, top: float | None
) -> Legend:
    """The legend of a border from the values of all its points.

    Args:
        pair: The link pair.
        quantity: A key of `QUANTITIES`.
        d_b: [m] buffer distance.
        values: (N,) values of all points, N ≥ 1.
        drawn: How many of the N points are drawn.
        top: [m] height up to which it is drawn, None if all of it.
    """
    low, high = float(values.min()), float(values.max())
    return Legend(pair, quantity, d_b, low, high, drawn, len(values), top)


def normalised(values: Array, legend: Legend) -> Array:
    """(N,) position of values on the colour bar, 0 to 1; a constant field lies in its middle."""
    span = legend.high - legend.low
    return np.full(len(values), 0.5) if span <= 0 else (values - legend.low) / span


def legend_html(legend: Legend | None) -> str:
    """The colour bar as HTML; without a border, a line that says so."""
    if legend is None:
        return '<div style="padding:.4em .8em;opacity:.65;font-size:.8em">border hidden</div>'
    quantity = QUANTITIES[legend.quantity]
    texts, factor = tick_texts(legend.low, legend.high)
    ticks = "".join(f"<span>{text}</span>" for text in texts)
    share = "all" if legend.drawn == legend.total else f"{legend.drawn:,} of the"
    part = "" if legend.top is None else f" up to z = {legend.top:.2f} m"
    unit = f" [{factor}{quantity.unit}]" if factor or quantity.unit else ""
    return (
        '<div style="padding:.35em .8em .5em;font-size:.8em;line-height:1.5">'
        f'<div style="display:flex;justify-content:space-between"><b>{quantity.title}{unit}</b>'
        f"<span>{legend.pair}</span></div>"
        f'<div style="height:.9em;border-radius:3px;margin:.2em 0;'
        f'background:linear-gradient(to right,{viridis_css()})"></div>'
        '<div style="display:flex;justify-content:space-between;'
        f'font-variant-numeric:tabular-nums">{ticks}</div>'
        f'<div style="opacity:.65">d<sub>b</sub> = {legend.d_b:.3f} m, '
        f"{share} {legend.total:,} points{part}</div>{_force_scale()}</div>"
    )


def _force_scale() -> str:
    """How long the arrow of a force is."""
    arrow = f'<b style="color:{css(ACTING)}">→</b>'
    return (
        f'<div><span style="opacity:.65">acting point and force</span> {arrow} '
        f'<span style="opacity:.65">0.1 m = {0.1 / METRES_PER_NEWTON:.0f} N</span></div>'
    )


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
    texts = [_minus(f"{tick:.{max(digits, 0)}f}") for tick in ticks]
    return texts, f"10<sup>{_minus(str(power))}</sup> " if power else ""


def _minus(text: str) -> str:
    return text.replace("-", "−")
