"""Tab "Why": why the robot moved, in one plain sentence, and every quantity behind it."""

from collections.abc import Sequence

from app.config import Config
from app.control.explanation import Explanation, Level, LevelName, NearPair
from app.dashboard.markup import FAINT, ONE_LINE, RIGHT, cell, minus, row, table
from app.dashboard.panels import phrases as words
from app.dashboard.scene.colours import css
from app.dashboard.scene.legend import measure_of
from app.dashboard.verdict import Verdict, base_cannot_help
from app.robot.bases.kind import Axis, acceleration_symbol, planar
from app.simulation.trace.snapshot import Snapshot

LONGEST = 280  # characters of the longest answer of `sentence`

UNDISTURBED = (0.05, 0.2)
"""[m/s²], [rad/s²] of slack below which the hand's own task is met: 0.06 mm at its gain."""

BOUNDS_SHOWN = 3  # lines for limits that were met; of more than that the number is shown

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
_BEHIND = -0.5  # [-] forward part of a normal above which what is near is not behind the base


def why_html(snapshot: Snapshot, verdict: Verdict) -> str:
    """The whole panel; its number of lines is the same whatever it says."""
    why, colour = snapshot.explanation, css(verdict.colour)
    tables = "" if why is None else _tables(snapshot, why)
    loud = f"background:{colour};color:white;" if verdict.state == "contact" else ""
    return (
        f'<div style="{loud}border-left:6px solid {colour};margin:.4em .7em;padding-left:.6em;'
        'height:8.6em;overflow:hidden;font-size:.85em;line-height:1.4"><b style="font-size:1.1em">'
        f"{verdict.state.capitalize()}</b><br>{sentence(snapshot)}</div>"
        f'<div style="font-size:.8em;line-height:1.55;padding:0 1.1em .4em .7em">{tables}</div>'
    )


def strip_html(snapshot: Snapshot, verdict: Verdict) -> str:
    """What the panel says first, for a page that is too narrow for panels beside the scene."""
    colour = css(verdict.colour)
    return (
        f'<div data-strip style="border-left:6px solid {colour}"><b style="color:{colour}">'
        f"{verdict.state.capitalize()}</b> {sentence(snapshot)}</div>"
    )


def sentence(snapshot: Snapshot) -> str:
    """Why the robot does what it does at a snapshot's instant."""
    why = snapshot.explanation
    if why is None:
        return "There is no explanation for this instant."
    touch = "Parts of the arm touch! " if snapshot.arm_in_contact else ""
    return ("Arm and base touch! " if snapshot.in_contact else touch) + _answer(snapshot, why)


def _hand_is_disturbed(why: Explanation) -> bool:
    """Whether the end-effector's task gave up more than what nobody notices."""
    return any(
        (level.linear or 0.0) > UNDISTURBED[0] or (level.angular or 0.0) > UNDISTURBED[1]
        for level in why.levels
        if level.name == "hand"
    )


def _answer(snapshot: Snapshot, why: Explanation) -> str:
    if not why.solved:
        return (
            "The solver found no motion that keeps all limits, so the arm holds itself up and the "
            "base brakes."
        )
    pair = why.bearing
    if pair is None:
        return _nothing_near(snapshot, why)
    if why.controller == "none":
        return f"{_cause(pair, why, snapshot.config)}, but avoidance is off: nothing gives way."
    if why.controller == "barrier":
        return _barrier(snapshot, why, pair)
    if not pair.mobile:
        return _links(snapshot, why, pair)
    if why.controller == "repulsive":
        return _repulsive(snapshot, why, pair)
    return _gives_way(snapshot, why, pair)


def _nothing_near(snapshot: Snapshot, why: Explanation) -> str:
    a, b, d = why.nearest
    buffer = words.length(snapshot.config.border.d_b)
    text = f"Nothing is near: {_the(b, why)} is {_beside(d, snapshot)} from {_the(a, why)}"
    if why.controller == "none":
        return f"{text}. Avoidance is off."
    text += f" (buffer {buffer}), so nothing has to give way"
    moves = _motion(snapshot, why, ahead=False)
    if moves is None:
        return f"{text}."
    if why.mode == "tracking":
        return f"{text}; the base {moves} to carry the hand along."
    return f"{text}; the base, which {moves}, comes to rest."


def _gives_way(snapshot: Snapshot, why: Explanation, pair: NearPair) -> str:
    """The paper's method: the base gives way; where its barrier is met, the arm resists."""
    cause, also = _cause(pair, why, snapshot.config), _also(why)
    if base_cannot_help(pair):
        where = f"{cause}, where no motion of the base helps"
        if why.controller == "hqp":
            return f"{where}, and the printed controller has nothing else that holds the arm.{also}"
        if pair.held:
            return f"{where}: the arm itself keeps its distance{_off_target(snapshot)}.{also}"
        least = words.length(snapshot.config.barrier.d_min)
        return f"{where}: the arm itself will stay {least} away.{also}"
    moves = _base_moves(snapshot, why, pair)
    moved = f"so {moves}" if moves else "too little yet to move the base"
    if pair.held:
        return f"{cause}, {moved}, and the arm itself keeps its distance.{also}"
    return f"{cause}, {moved}; {_hand(why)}.{also}"


def _repulsive(snapshot: Snapshot, why: Explanation, pair: NearPair) -> str:
    cause = _cause(pair, why, snapshot.config)
    text = f"{cause}, so this method pushes the arm away and does not ask the base"
    return f"{text}; {_hand(why, held=True)}{_off_target(snapshot)}."


def _barrier(snapshot: Snapshot, why: Explanation, pair: NearPair) -> str:
    """The inequality's distance stands in the place of the buffer, which it does not know."""
    held = next((p for p in why.near if p.held), None)
    shown = held or pair
    cause = _cause(shown, why, None)
    least = words.length(snapshot.config.barrier.d_min)
    if held is None:
        return f"{cause}; only nearer than {least} is forbidden, so nothing gives way yet."
    moves = _base_moves(snapshot, why, shown) or "the base stays where it is"
    hand = _hand(why, held=True) + _off_target(snapshot)
    return f"{cause}, held back by the hard limit of {least}; {moves}; {hand}."


def _links(snapshot: Snapshot, why: Explanation, pair: NearPair) -> str:
    cause = _cause(pair, why, snapshot.config)
    text = f"{cause}, so the arm pushes the two apart; the base has no part in it"
    if why.mode == "tracking":
        return f"{text}; {_hand(why)}."
    return f"{text}{_off_target(snapshot)}."


def _cause(pair: NearPair, why: Explanation, config: Config | None) -> str:
    """What is near what; with the buffer if a configuration is given."""
    b = _the(pair.b, why).capitalize()
    near = f"{_the(pair.a, why)}'s {words.place(pair.n)}" if pair.mobile else _the(pair.a, why)
    if pair.d < 0.0:
        return f"{b} is {words.length(-pair.d)} inside the outline of {near}"
    if config is None:
        return f"{b} is {words.length(pair.d)} from {near}"
    buffer = words.length(config.border.d_b)
    if pair.d > config.border.d_b - 0.005:
        return f"{b} is at the edge of the {buffer} buffer around {near}"
    return f"{b} came within {words.length(pair.d)} of {near} (its buffer is {buffer})"


def _base_moves(snapshot: Snapshot, why: Explanation, pair: NearPair) -> str | None:
    """What the base does now, or is about to do; None if nothing."""
    ahead = pair.n[0] > _BEHIND
    moves = _motion(snapshot, why, ahead=ahead)
    if moves is not None:
        top = any(bound.kind == "speed" for bound in why.bounds)
        return f"the base {moves}" + (", as fast as it may" if top else "")
    asked = planar(why.axes, why.base_asked)
    will = words.intention(asked.forward, asked.turn, ahead=ahead, left=asked.left)
    return None if will is None else f"the base is about to {will}"


def _motion(snapshot: Snapshot, why: Explanation, *, ahead: bool) -> str | None:
    v = planar(why.axes, snapshot.base_velocity)
    return words.motion(v.forward, v.turn, ahead=ahead, left=v.left)


def _hand(why: Explanation, *, held: bool = False) -> str:
    """How the hand fares; `held` if the arm itself keeps its distance."""
    if why.mode == "guiding":
        return "the hand cannot be led on freely" if held else "the hand stays free to be led"
    if _hand_is_disturbed(why):
        return "the hand's own task has to give way"
    return "the hand's own task is not disturbed"


def _off_target(snapshot: Snapshot) -> str:
    if snapshot.ee_error < 0.01:
        return ""
    return f"; the hand stays {words.length(snapshot.ee_error)} off its target"


def _beside(d: float, snapshot: Snapshot) -> str:
    """A distance, to the millimetre where it is near the buffer distance."""
    near = abs(d - snapshot.config.border.d_b) < 0.01
    return f"{100 * d:.1f} cm" if near else words.length(d)


def _also(why: Explanation) -> str:
    """Links of the arm that are pushed apart besides."""
    for pair in why.near:
        if not pair.mobile:
            a, b = words.body(pair.a, why.chain), words.body(pair.b, why.chain)
            return f" {b.capitalize()} and {a} are pushed apart as well."
    return ""


def _the(name: str, why: Explanation) -> str:
    return f"the {words.body(name, why.chain)}"


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
        _row("pair", "the link pair that counts most", name + more),
        _row("distance d, of buffer d_b", "signed distance of its bodies", distance + buffer),
        _row("activation β", "0 outside of the buffer, 1 in full force", f"{beta:.2f}{held}"),
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
        _row("direction", "from forward, as the base sees it", towards, span=1 + len(why.axes)),
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
    measure, values = measure_of(why.base_kind), [_NONE] * 4
    if why.forces:
        first = why.forces[0]
        values = [
            f"{words.scientific(first.determinant)} {measure.unit}",
            f"{first.reachability:.0f}",
            f"{words.scientific(first.score)} {measure.unit}",
            f"{words.scientific(first.score_near)} {measure.unit}",
        ]
    labels = (
        (measure.label, measure.hint),
        ("reachability R", "(9): how well the arm reaches the point"),
        ("score S", f"(10): {measure.score}"),
        ("score without the step, p_n", "S where the force would act without (12)"),
    )
    return [_row(*label, value) for label, value in zip(labels, values, strict=True)]


def _level_rows(levels: Sequence[Level]) -> list[str]:
    by_name = {level.name: level for level in levels}
    rows = []
    for label, hint, names in _LEVELS:
        level = next((by_name[name] for name in names if name in by_name), None)
        rows.append(_row(label, hint, _NONE if level is None else _given_up(level)))
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


def _row(label: str, hint: str, value: str, *, span: int = 1) -> str:
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
