"""Header over the scene, and tab "Why": the cause of the robot's motion in words and numbers."""

import math
from collections.abc import Mapping, Sequence

from app.control.explanation import Explanation, Level, LevelName, NearPair
from app.dashboard import phrases as words
from app.dashboard.markup import FAINT, ONE_LINE, RIGHT, bar, cell, row, small, table, tag
from app.dashboard.panels import Moment, Panel, Viewer
from app.dashboard.scene.colours import css, ink
from app.dashboard.scene.legend import legend_html, measure_of
from app.dashboard.verdict import COLOURS, STEEP, State, Verdict, contacts, is_slow, links_repel
from app.robot.bases.kind import Axis, acceleration_symbol, planar
from app.simulation.trace.snapshot import Snapshot
from app.simulation.trace.words import millimetres

UNDISTURBED = 0.05, 0.2  # [m/s²], [rad/s²] largest slack of an end-effector's task that is met
BOUNDS_SHOWN = 3  # [-] lines for active limits; further limits are only counted
BAR_RANGE = 0.5  # [m] distance that fills a bar
_NONE = "–"
_BODY = "font-size:.8em;line-height:1.55;padding:0 1.1em .4em .7em"
_LEVELS: dict[tuple[LevelName, ...], tuple[str, str]] = {  # label and hint of a row for levels
    ("base",): ("base avoidance", "rows of the base in T_sca, (16)"),
    ("arm",): ("arm–base repulsion", "rows of the repulsive method"),
    ("links",): ("arm self-repulsion", "rows (20) between links of the arm"),
    ("ee",): ("end-effector task", "slack w_2 of (26)"),
    ("posture", "free"): ("posture", "joint accelerations of the posture task, or of the free arm"),
}


class WhyPanel(Panel):
    def __init__(self, viewer: Viewer) -> None:
        super().__init__(viewer)
        gui = self._gui
        self._why = gui.add_html("")
        with gui.add_folder("Details", expand_by_default=False):
            self._details = gui.add_html("")
        self.legend = gui.add_html(legend_html([]))
        self._head = ""

    def update(self, moment: Moment) -> None:
        _, shown, verdict = moment
        self._why.content = why_html(shown, verdict)
        self._details.content = details_html(shown)
        head = header_html(shown, verdict, self._viewer.shared.spoken)
        if head != self._head:
            self._head = head
            self._viewer.channel.tell("head", head)


def why_html(snapshot: Snapshot, verdict: Verdict) -> str:
    """Return as HTML: verdict, cause of the motion, and rows for force, base motion and limits."""
    why, colour = snapshot.explanation, css(COLOURS[verdict.state])
    x, y = _total(why, "f", 2) if why else (0.0, 0.0)
    size, bounds = math.hypot(x, y), why.bounds if why and why.bearing else ()
    force = f"{size:.0f} N {words.direction(x, y)}" if size >= 0.5 else "none"
    limit = words.bound(bounds[0], why.chain) if why and bounds else "nothing"
    rows = (
        _row("Force on the base", "sum of the forces (14) at the acting points", force),
        _row("Base motion", "true velocity of the base", words.speeds(snapshot.base_velocity)),
        _row("Limited by", "active limits while a pair is in its buffer", limit + _more(bounds)),
    )
    return (
        f'<div style="border-left:6px solid {colour};margin:.4em .7em;padding-left:.6em;'
        f'min-height:5.6em;font-size:.85em;line-height:1.4">{state_chip(verdict.state)}'
        f'<br>{sentence(snapshot)}</div><div style="{_BODY}">{table(rows)}</div>'
    )


def details_html(snapshot: Snapshot) -> str:
    """Return tables, as HTML, of the quantities behind `sentence`, or a note if there are none."""
    if (why := snapshot.explanation) is None:
        return small("There are no details for this instant.")
    if (pair := why.bearing) is None:
        return small("Avoidance does not act: no link pair is inside its buffer.")
    name = words.pair(pair.a, pair.b, why.chain) + _more(why.near)
    distance = f"{millimetres(pair.d)} (buffer {millimetres(snapshot.d_b)})"
    beta = f"{pair.beta:.2f}" + (", approach limited" if pair.limited else "")
    near = (
        _row("pair", "deepest overlap; otherwise most active pair, those of the base first", name),
        _row("distance d", "signed distance of its convex bodies", distance),
        _row("activation β", "0 outside the buffer, 1 at full activation", beta),
    )
    bounds = [words.bound(each, why.chain) for each in why.bounds] or [tag("span", "none", FAINT)]
    if len(bounds) > BOUNDS_SHOWN:
        bounds = [*bounds[: BOUNDS_SHOWN - 1], f"and {len(bounds) - BOUNDS_SHOWN + 1} more"]
    bounds += ["&nbsp;"] * (BOUNDS_SHOWN - len(bounds))
    tables = (
        _table("Link pair", near)
        + _table("Force on the base", _force_rows(why), why.axes)
        + _table("Acting point p_act", _score_rows(why))
        + _table("Task error, by priority", _level_rows(why.levels))
        + _table("Active limits", [row(cell(text, ONE_LINE)) for text in bounds])
    )
    return f'<div style="{_BODY}">{tables}</div>'


def header_html(snapshot: Snapshot, verdict: Verdict, spoken: Mapping[str, str]) -> str:
    """Return as HTML: verdict, `sentence`, nearest pair, base speed, real-time factor or pause."""
    pair, d_b, factor = snapshot.nearest, snapshot.d_b, snapshot.realtime_factor
    share = distance_bar(pair.d, d_b, verdict.state)
    pace = "" if math.isnan(factor) else f"{factor:.2f} × real time"
    pace = "paused" if snapshot.paused else pace
    late = ' title="busy computer" class="dbb-late"' if is_slow(snapshot) else ""
    hint = f"Nearest link pair; the mark is its buffer d_b = {millimetres(d_b)}"
    return (
        f'<div class="dbb-say">{state_chip(verdict.state)} {sentence(snapshot)}</div>'
        f'<div class="dbb-numbers"><span title="{hint}">{spoken[pair.name]} '
        f'<b>{millimetres(pair.d)}</b></span><span class="dbb-bar" title="{hint}">{share}</span>'
        f"<span>base {words.speeds(snapshot.base_velocity)}</span><span{late}>{pace}</span></div>"
    )


def distance_bar(d: float, d_b: float, state: State) -> str:
    """Return a bar for d [m] with a mark at d_b [m]; it is full for d < 0 and d >= `BAR_RANGE`."""
    share = 1.0 if d < 0.0 else min(d / BAR_RANGE, 1.0)
    return bar(share, css(COLOURS[state]), min(d_b / BAR_RANGE, 1.0))


def state_chip(state: State, text: str = "") -> str:
    """Return a text, by default the state, on the colour of a state, legible in both themes."""
    ground, look = COLOURS[state], "border-radius:4px;padding:.1em .5em"
    text = text or state.capitalize()
    return tag("b", text, f"background:{css(ground)};color:{ink(ground)}", look)


def sentence(snapshot: Snapshot) -> str:
    """Return the first reported contact, if any, and the cause of the robot's motion in words."""
    if (why := snapshot.explanation) is None:
        return "There is no explanation for this instant."
    touches = contacts(snapshot)
    first = f"{touches[0].capitalize()} touch{_more(touches)}. " if touches else ""
    return first + _answer(snapshot, why)


def _answer(snapshot: Snapshot, why: Explanation) -> str:
    if not why.solved:
        cause = "the readings are invalid or the solver found no solution"
        return f"Fallback command, because {cause}: torques damp the arm, and the base brakes."
    if (pair := why.bearing) is None:
        name, _, d, *_ = snapshot.nearest
        a, _, b = name.partition("-")
        near = f"{_the(b, why)} is {millimetres(d)} from {_the(a, why)}"
        if why.controller == "none":
            return f"Nothing is inside the buffer: {near}. Avoidance is off."
        text = f"Nothing is inside the buffer: {near} (buffer {millimetres(snapshot.d_b)})"
        moves = words.motion(planar(why.axes, snapshot.base_velocity), ahead=False)
        aim = "to follow the end-effector's task" if why.mode == "tracking" else "and comes to rest"
        return f"{text}; the base {moves} {aim}." if moves else f"{text}."
    if why.controller == "barrier":
        return _barrier(snapshot, why, pair)
    cause = _cause(pair, why, snapshot.d_b)
    if why.controller == "none":
        return f"{cause}, but avoidance is off: nothing gives way."
    if not pair.mobile:
        apart = ", so the arm pushes the two links apart" if links_repel(pair) else ""
        tracks = why.mode == "tracking"
        effect = f"; {_task_effect(why)}" if tracks else _off_target(snapshot)
        return f"{cause}{apart}; the base is not involved{effect}."
    if why.controller == "repulsive":
        text = f"{cause}, so this method pushes the arm away and does not move the base"
        return f"{text}; {_task_effect(why, limited=True)}{_off_target(snapshot)}."
    return _gives_way(snapshot, why, pair, cause)


def _gives_way(snapshot: Snapshot, why: Explanation, pair: NearPair, cause: str) -> str:
    """Describe dbb or hqp: the base gives way; with dbb, the arm can also limit the approach."""
    also = ""
    if apart := next(filter(links_repel, why.near), None):  # the most active one
        a, b = words.body(apart.a, why.chain), words.body(apart.b, why.chain)
        also = f" {b.capitalize()} and {a} are also pushed apart."
    if pair.above >= STEEP:  # base motion cannot help
        if why.controller == "hqp":
            rest = ", and the paper's hierarchy has no other constraint on the arm"
        elif pair.limited:
            rest = f"; the arm itself limits the approach{_off_target(snapshot)}"
        else:
            least = millimetres(snapshot.config.barrier.d_min)
            rest = f"; the arm itself comes no nearer than {least}"
        return f"{cause}, where base motion cannot help{rest}.{also}"
    moves = _base_moves(snapshot, why, pair)
    (x, y), (forward, left, _) = _total(why, "f", 2), planar(why.axes, snapshot.base_velocity)
    opposed = x * forward + y * left < -0.5 * math.hypot(x, y) * math.hypot(forward, left)
    moved = f", {'but' if opposed else 'so'} {moves}" if moves else "; the base stays where it is"
    limits = ", and the arm itself limits the approach"
    return f"{cause}{moved}{limits if pair.limited else f'; {_task_effect(why)}'}.{also}"


def _barrier(snapshot: Snapshot, why: Explanation, pair: NearPair) -> str:
    """Describe the controller "barrier": the text has the minimum distance, not d_b."""
    least = millimetres(snapshot.config.barrier.d_min)
    limited = next((each for each in why.near if each.limited), None)
    cause = _cause(limited or pair, why, None)
    if limited is None:
        return f"{cause}; this method acts only near its minimum distance of {least}."
    moves = _base_moves(snapshot, why, limited) or "the base stays where it is"
    effect = _task_effect(why, limited=True) + _off_target(snapshot)
    return f"{cause}; the minimum distance of {least} limits the approach; {moves}; {effect}."


def _cause(pair: NearPair, why: Explanation, d_b: float | None) -> str:
    """Describe the overlap of a pair, or its distance and, unless `d_b` is None, d_b [m]."""
    b = _the(pair.b, why).capitalize()
    near = f"{_the(pair.a, why)}'s {words.place(pair.n)}" if pair.mobile else _the(pair.a, why)
    if pair.d < 0.0:
        return f"{b} overlaps {near} by {millimetres(-pair.d)}"
    text = f"{b} is {millimetres(pair.d)} from {near}"
    return text if d_b is None else f"{text} (buffer {millimetres(d_b)})"


def _base_moves(snapshot: Snapshot, why: Explanation, pair: NearPair) -> str | None:
    """Describe the base's motion, or at rest its next commanded motion; None if there is none."""
    ahead = pair.n[0] > -0.5  # in front of the base or beside it
    if (moves := words.motion(planar(why.axes, snapshot.base_velocity), ahead=ahead)) is not None:
        top = any(bound.kind == "speed" for bound in why.bounds)
        return f"the base {moves}" + (", at its speed limit" if top else "")
    will = words.motion(planar(why.axes, why.commanded_acceleration), ahead=ahead, intended=True)
    return None if will is None else f"the base is about to {will}"


def _task_effect(why: Explanation, *, limited: bool = False) -> str:
    """Describe the effect on a person or on the task; if `limited`, the arm resists a person."""
    if why.mode == "guiding":
        if limited or any(pair.limited or links_repel(pair) for pair in why.near):
            return "the arm resists further guiding"
        if any(bound.kind == "position" for bound in why.bounds):
            return "the arm can be guided within its joint limits"
        return "the arm can still be guided freely"
    disturbed = any(
        (level.linear or 0.0) > UNDISTURBED[0] or (level.angular or 0.0) > UNDISTURBED[1]
        for level in why.levels
        if level.name == "ee"
    )
    return f"the end-effector's task is {'reduced' if disturbed else 'not affected'}"


def _off_target(snapshot: Snapshot) -> str:
    """Return the end-effector's error as text; empty if it is below 10 mm, or with a contact."""
    text = f"; the end-effector is {millimetres(snapshot.ee_error)} from its target"
    return "" if snapshot.ee_error < 0.01 or contacts(snapshot) else text


def _the(name: str, why: Explanation) -> str:
    return f"the {words.body(name, why.chain)}"


def _force_rows(why: Explanation) -> list[str]:
    """Return rows: direction, two parts and sum of the force, and accelerations of the base."""
    n_b, f = len(why.axes), _total(why, "f", 2)
    away, turn = (
        (_total(why, part, 2), _total(why, f"{part}_acceleration", n_b))
        for part in ("away", "turn")
    )
    towards = f"{words.direction(*f)}, {words.angle(*f)}" if math.hypot(*f) > 0.05 else _NONE
    rows = [_row("direction", "angle from the base's forward axis", towards, span=1 + n_b)]
    for label, hint, force, acceleration in (
        ("away from the arm", "component along −n, Figure 7b", *away),
        ("towards higher score", "component across n from (12) and (13), Figure 7c", *turn),
        ("sum", "(15)", f, why.base_avoidance),
    ):
        values = [f"{math.hypot(*force):.0f}", *map(words.signed, acceleration)]
        texts = values if why.forces else [_NONE] * len(values)
        rows.append(_row(label, f"{hint}; accelerations: (16), (17), (18) times β_m", *texts))
    for label, hint, acceleration in (
        ("commanded", "input of the admittance law", why.commanded_acceleration),
        ("used for the arm", "base acceleration in the arm's QP", why.assumed_acceleration),
    ):
        rows.append(_row(label, hint, "", *map(words.signed, acceleration)))
    return rows


def _score_rows(why: Explanation) -> list[str]:
    measure, force = measure_of(why.base_kind), next(iter(why.forces), None)

    def text(name: str) -> str:
        return f"{words.scientific(getattr(force, name))} {measure.unit}" if force else _NONE

    reach = f"{force.reachability:.0f}" if force else _NONE
    at_near = "S at the nearest point of the border, without the step (12)"
    return [
        _row(measure.label, measure.hint, text("determinant")),
        _row("reachability R", "(9): how easily the arm reaches it", reach),
        _row("score S", f"(10): {measure.score}", text("score")),
        _row("score at p_n", at_near, text("score_near")),
    ]


def _level_rows(levels: Sequence[Level]) -> list[str]:
    rows = []
    for names, about in _LEVELS.items():
        level = next((each for each in levels if each.name in names), None)
        parts = ((level.linear, "m/s²"), (level.angular, "rad/s²")) if level else ()
        texts = [f"{value:.2f} {unit}" for value, unit in parts if (value or 0.0) >= 0.005]
        rows.append(_row(*about, ", ".join(texts) or (tag("span", "0", FAINT) if level else _NONE)))
    return rows


def _table(title: str, rows: Sequence[str], axes: Sequence[Axis] = ()) -> str:
    """Return a table; `axes` of a base add columns for the force and for each acceleration."""
    columns = [("force<br>[N]", "12%")] if axes else []
    for axis in axes:
        unit = "rad/s²" if axis.angular else "m/s²"
        columns.append((f"{acceleration_symbol(axis)}<br>[{unit}]", f"{44 / len(axes):.0f}%"))
    heads = (cell(column, f"width:{width}", RIGHT, FAINT, ONE_LINE) for column, width in columns)
    head = row(cell(title, "font-weight:600", ONE_LINE), *heads)
    return table((head, *rows), "border-spacing:0;margin-bottom:.4em", tight=True)


def _row(label: str, hint: str, *values: str, span: int = 1) -> str:
    cells = (cell(value, RIGHT, ONE_LINE, span=span) for value in values)
    return row(cell(label, FAINT, ONE_LINE), *cells, hint=hint)


def _more(items: Sequence[object]) -> str:
    """Return the number of items after the first one, as in " (+2)"; "" if there are none."""
    return f" (+{len(items) - 1})" if len(items) > 1 else ""


def _total(why: Explanation, part: str, n: int) -> list[float]:
    """Return the sum (n,) of the field `part` of `ForceSplit` over all forces; 0 without forces."""
    return [sum(getattr(force, part)[i] for force in why.forces) for i in range(n)]
