"""Panel "Why did it move?": one plain sentence, and below it every quantity behind it."""

from __future__ import annotations

from collections.abc import Sequence

import viser

from app.control.explanation import Explanation, ForceSplit
from app.control.levels import Level, LevelName
from app.dashboard.base_measures import measure_of
from app.dashboard.markup import FAINT, ONE_LINE, RIGHT, cell, minus, row, table
from app.dashboard.panels import phrases as words
from app.dashboard.panels.explain import sentence
from app.dashboard.panels.widgets import renew
from app.dashboard.scene.colours import FULL, REST, css, distance_colour
from app.robot.bases.kind import Axis, acceleration_symbol
from app.simulation.trace.snapshot import Snapshot

BOUNDS_SHOWN = 3
"""Lines for limits that were met; of more than that the number is shown."""

_NONE = '<span style="opacity:.45">–</span>'
_LEVELS: tuple[tuple[str, str, tuple[LevelName, ...]], ...] = (
    ("base gives way", "the base's rows of T_sca, (16), less what the base may do", ("base",)),
    ("arm against base", "the rows of T_rep: the repulsive method's", ("arm",)),
    ("between links", "the rows (20) that part links of the arm", ("links",)),
    ("hand's task", "w_2 of (26): the end-effector's task", ("hand",)),
    (
        "posture, or arm left alone",
        "what the arm's joints would do by themselves",
        ("posture", "free"),
    ),
)
_ZERO = ForceSplit((0, 0), (0, 0), (0, 0), (0, 0), (0, 0), 0, 0, 0, 0)


class WhyPanel:
    """The sentence and a table of fixed height."""

    def __init__(self, gui: viser.GuiApi) -> None:
        """Build the panel in the GUI container that is now open."""
        self._html = gui.add_html("")

    def update(self, snapshot: Snapshot) -> None:
        """Explain a snapshot; what has not changed is not sent."""
        renew(self._html, "content", why_html(snapshot))


def why_html(snapshot: Snapshot) -> str:
    """The whole panel; its number of lines is the same whatever it says."""
    why = snapshot.explanation
    tables = "" if why is None else _tables(snapshot, why)
    return (
        f'<div style="border-left:4px solid {_colour(snapshot)};margin:.4em .7em;padding-left:.6em;'
        f'height:7.1em;overflow:hidden;font-size:.85em;line-height:1.4">{sentence(snapshot)}</div>'
        f'<div style="font-size:.8em;line-height:1.55;padding:0 1.1em .4em .7em">{tables}</div>'
    )


def _colour(snapshot: Snapshot) -> str:
    """Grey while nothing is near, then the colour of the distance; red if something is wrong."""
    why, config = snapshot.explanation, snapshot.config
    if snapshot.in_contact or snapshot.arm_in_contact or (why is not None and not why.solved):
        return css(FULL)
    if why is None or why.bearing is None:
        return css(REST)
    return css(distance_colour(why.bearing.d, config.border.d_b, config.activation.d_full))


def _tables(snapshot: Snapshot, why: Explanation) -> str:
    return (
        _table("Near", _near_rows(snapshot, why))
        + _table("Force on the base", _force_rows(why), _columns(why.axes))
        + _table("Where it acts, p_act", _score_rows(why))
        + _table("Given up, what weighs most first", _level_rows(why.levels))
        + _table("Limited by", _bound_rows(why))
    )


def _near_rows(snapshot: Snapshot, why: Explanation) -> list[str]:
    pair = why.bearing
    more = f" and {len(why.near) - 1} more" if len(why.near) > 1 else ""
    buffer = f" of {1000 * snapshot.config.border.d_b:.0f} mm"
    if pair is None:
        a, b, d = why.nearest
        name, beta = words.pair(a, b, why.chain), 0.0
    else:
        name, d, beta = words.pair(pair.a, pair.b, why.chain), pair.d, pair.beta
    distance = minus(f"{1000 * d:.0f}")
    held = ", distance held" if pair is not None and pair.held else ""
    return [
        _row("pair", name + more, "the link pair that counts most"),
        _row("distance d, of buffer d_b", distance + buffer, "signed distance of its bodies"),
        _row("activation β", f"{beta:.2f}{held}", "0 outside of the buffer, 1 in full force"),
    ]


def _columns(axes: Sequence[Axis]) -> list[tuple[str, str]]:
    """Of the table of forces, with widths that do not follow the numbers."""
    if len(axes) == 2:
        return [("N", "13%"), ("v̇ [m/s²]", "19%"), ("ω̇ [rad/s²]", "23%")]
    share = f"{46 / len(axes):.0f}%"  # narrower, and without units
    return [("N", "10%"), *((acceleration_symbol(axis), share) for axis in axes)]


def _force_rows(why: Explanation) -> list[str]:
    """The resultant (15), its two parts as in Figure 7, and the base's accelerations."""
    forces, on = why.forces, bool(why.forces)
    f = _sum([force.f for force in forces])
    away, turn = _sum([force.away for force in forces]), _sum([force.turn for force in forces])
    still = [(0.0,) * len(why.axes)]
    away_acc = _sum([force.away_acceleration for force in forces] or still)
    turn_acc = _sum([force.turn_acceleration for force in forces] or still)
    x, y = f
    towards = f"{words.direction(x, y)}, {words.angle(x, y)}" if _size(f) > 0.05 else _NONE
    return [
        _row("direction", towards, "from forward, as the base sees it", span=1 + len(why.axes)),
        _acceleration("moving away", away, away_acc, "the part along −n, Figure 7b", on=on),
        _acceleration(
            "to the better score",
            turn,
            turn_acc,
            "the part across, by (12) and (13), Figure 7c",
            on=on,
        ),
        _acceleration(
            "together, times β", f, why.base_avoidance, "(15); (16), (17), (18) times β_m", on=on
        ),
        _acceleration("asked of the base", None, why.base_asked, "the base's part of (29)"),
        _acceleration("the base really has", None, why.base_given, "of its drive, a command late"),
    ]


def _score_rows(why: Explanation) -> list[str]:
    first, measure = why.forces[0] if why.forces else _ZERO, measure_of(why.base_kind)
    unit = f" {measure.unit}"
    values = (
        (measure.label, words.scientific(first.determinant) + unit, measure.hint),
        ("reachability R", f"{first.reachability:.0f}", "(9): how well the arm reaches the point"),
        ("score S", words.scientific(first.score) + unit, f"(10): {measure.score}"),
        (
            "score without the step, p_n",
            words.scientific(first.score_near) + unit,
            "S where the force would act without (12)",
        ),
    )
    return [_row(label, text if why.forces else _NONE, hint) for label, text, hint in values]


def _level_rows(levels: Sequence[Level]) -> list[str]:
    by_name = {level.name: level for level in levels}
    rows = []
    for label, hint, names in _LEVELS:
        level = next((by_name[name] for name in names if name in by_name), None)
        rows.append(_row(label, _NONE if level is None else _given_up(level), hint))
    return rows


def _given_up(level: Level) -> str:
    parts = ((level.linear, "m/s²"), (level.angular, "rad/s²"))
    texts = [f"{value:.2f} {unit}" for value, unit in parts if value is not None and value >= 0.005]
    return ", ".join(texts) or '<span style="opacity:.65">nothing</span>'


def _bound_rows(why: Explanation) -> list[str]:
    texts = [words.bound(bound, why.chain) for bound in why.bounds]
    if len(texts) > BOUNDS_SHOWN:
        texts = [*texts[: BOUNDS_SHOWN - 1], f"and {len(texts) - BOUNDS_SHOWN + 1} more"]
    texts = texts or ['<span style="opacity:.65">no limit</span>']
    texts += ["&nbsp;"] * (BOUNDS_SHOWN - len(texts))
    return [row(cell(text, ONE_LINE)) for text in texts]


def _table(title: str, rows: Sequence[str], columns: Sequence[tuple[str, str]] = ()) -> str:
    heads = (cell(column, f"width:{width}", RIGHT, FAINT, ONE_LINE) for column, width in columns)
    head = row(cell(title, "font-weight:600", ONE_LINE), *heads)
    return table((head, *rows), "border-spacing:0;margin-bottom:.4em", tight=True)


def _row(label: str, value: str, hint: str, *, span: int = 1) -> str:
    return row(cell(label, FAINT, ONE_LINE), cell(value, RIGHT, ONE_LINE, span=span), hint=hint)


def _acceleration(
    label: str,
    f: Sequence[float] | None,
    acceleration: Sequence[float],
    hint: str,
    *,
    on: bool = True,
) -> str:
    """A row of newtons, m/s² and rad/s²; dashes where there is no force at all."""
    newtons = "" if f is None else f"{_size(f):.0f}"
    values = [newtons, *(words.signed(a) for a in acceleration)]
    values = values if on else [_NONE] * len(values)
    return row(cell(label, FAINT, ONE_LINE), *(cell(value, RIGHT) for value in values), hint=hint)


def _sum(vectors: Sequence[Sequence[float]]) -> tuple[float, ...]:
    return tuple(sum(parts) for parts in zip(*vectors, strict=True)) or (0.0, 0.0)


def _size(v: Sequence[float]) -> float:
    return (v[0] ** 2 + v[1] ** 2) ** 0.5
