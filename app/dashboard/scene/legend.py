"""Legend: colour bars of the borders, and a key to most other signs of scene and timeline."""

import math
from typing import NamedTuple

from app.dashboard.markup import FAINT, ONE_LINE, cell, mark, minus, row, small, table
from app.dashboard.scene import colours
from app.dashboard.scene.colours import BETA, GHOSTS, VIRIDIS, Rgb, css
from app.dashboard.verdict import COLOURS, State

METRES_PER_NEWTON = 1 / 400  # [m/N] length of a force's arrow: 0.1 m is 40 N
METRES_PER_ACCELERATION = 0.2  # [s²] length of an acceleration's arrow: 0.2 m is 1 m/s²
QUANTITIES: tuple[str, ...] = ("determinant", "reachability", "score")  # that colour a border


class BaseMeasure(NamedTuple):
    """Words for the base's factor in the score (10), which is `BaseKind.measure`."""

    title: str  # HTML
    unit: str  # of the measure and of the score; empty without one
    label: str
    hint: str
    score: str  # formula of the score


def measure_of(kind: str) -> BaseMeasure:
    """Return the words for the base's factor in the score; `kind` is a base's `base.kind`."""
    title, unit, label = "Mobility of the base", "", "measure of the base"
    hint, score = "how well the base moves the point; replaces (7)", "measure · R"
    if kind == "differential":
        title += ", det(J<sub>c</sub>J<sub>c</sub><sup>T</sup>) (7)"
        unit, label = "m⁴/rad⁴", "mobility det(J Jᵀ)"
        hint = "(7): 0 on the wheel axis, where the base cannot move the point sideways"
        score = "sign · det · R"
    return BaseMeasure(title=title, unit=unit, label=label, hint=hint, score=score)


class Legend(NamedTuple):
    pair: str  # displayed name of the pair of arm and base
    title: str  # name of the quantity, as HTML
    unit: str  # of the quantity; may be empty
    d_b: float  # [m] buffer distance
    low: float  # smallest value of the quantity
    high: float  # largest value
    drawn: int  # number of drawn points
    total: int  # number of points of the shown part
    top: float | None  # [m] largest height of this part; None for the whole border


def title_of(quantity: str, kind: str) -> tuple[str, str]:
    """Return name (HTML) and unit of one of `QUANTITIES`; `kind` is a base's `base.kind`."""
    measure = measure_of(kind)
    return {
        "determinant": (measure.title, measure.unit),
        "reachability": ("Reachability by the arm, R (9)", ""),
        "score": ("Score S, equation (10): signed mobility × reachability", measure.unit),
    }[quantity]


def legend_html(legends: list[Legend]) -> str:
    """Return the colour bars of all drawn borders as HTML, or a note if no border is drawn."""
    if not legends:
        return small("No border is shown (see tab View).", FAINT)
    return "".join(map(_bar_html, legends))


def key_html(d_b: float) -> str:
    """Return a key to most lines, dots and arrows, not border colours, as HTML; d_b in [m]."""
    force, push = 0.1 / METRES_PER_NEWTON, 0.2 / METRES_PER_ACCELERATION
    states: dict[State, str] = {
        "clear": "closest points of a pair outside its buffer",
        "near": f"inside the buffer d<sub>b</sub> = {d_b:.3f} m, none of the states below",
        "giving way": "the base gives way",
        "resisting": "the arm keeps the distance",
        "contact": "contact or overlap",
    }
    acting = _signs("●", colours.ACTING) + _signs("→", colours.ACTING)
    accelerates = _signs("→", colours.ACCELERATION)
    activation = f'<span style="color:{BETA}">▮</span>'
    rows = [
        *((_signs("―", COLOURS[state]), text) for state, text in states.items()),
        (acting, f"acting point and force on the base (0.1 m: {force:.0f} N)"),
        (_signs("→", colours.PERSON), f"force of the person (0.1 m: {force:.0f} N)"),
        (accelerates, f"commanded base acceleration (0.2 m: {push:.0f} m/s²), ω̇ as an arc"),
        (activation, "timeline: activation β, downwards; marks are events (hover for their names)"),
        (_signs("●", *GHOSTS), "ghosts: other controllers (tab Compare)"),
        (_signs("―", colours.TRAIL_BASE, colours.TRAIL_EE), "trails of base and end-effector"),
        ("<b>―</b>", "border at the height of the arm's point nearest to the base"),
    ]
    signs = "width:2.6em;text-align:center"
    cells = ((cell(sign, signs, ONE_LINE), cell(text, "opacity:.85")) for sign, text in rows)
    return small(table(row(*each) for each in cells))


def _bar_html(legend: Legend) -> str:
    texts, factor = tick_texts(legend.low, legend.high)
    share = "all" if legend.drawn == legend.total else f"{legend.drawn:,} of"
    part = "" if legend.top is None else f" up to z = {legend.top:.2f} m"
    unit = factor + legend.unit
    unit = f' <span style="{ONE_LINE}">[{unit}]</span>' if unit else ""
    shades = ", ".join(f"#{shade}" for shade in VIRIDIS.split())
    gradient = f"background:linear-gradient(to right,{shades})"
    return small(
        f"<b>{legend.title}{unit}</b>"
        f'<div style="height:.9em;border-radius:3px;margin:.2em 0;{gradient}"></div>'
        '<div style="display:flex;justify-content:space-between">'
        f'{"".join(f"<span>{text}</span>" for text in texts)}</div><div style="{FAINT}">'
        f"Coloured points: border around the base for {legend.pair}, d<sub>b</sub> = "
        f"{legend.d_b:.3f} m ({share} {legend.total:,} points{part}). Closed line: the border at "
        "the height of the arm's nearest point. Gaps: the arm cannot reach these points.</div>"
    )


def _signs(sign: str, *each: Rgb) -> str:
    return "".join(mark(sign, css(colour)) for colour in each)


def tick_texts(low: float, high: float) -> tuple[list[str], str]:
    """Return numbers for a bar's ends and middle, and their factor as HTML, "" for the factor 1."""
    largest = max(abs(low), abs(high))
    order = 0 if largest == 0 else math.floor(math.log10(largest))
    power = 0 if -1 <= order <= 3 else 3 * (order // 3)
    digits = 2 - (order - power)
    ticks = [(low + u * (high - low)) / 10.0**power for u in (0.0, 0.5, 1.0)]
    texts = [minus(f"{tick:.{max(digits, 0)}f}") for tick in ticks]
    return texts, f"10<sup>{minus(str(power))}</sup> " if power else ""
