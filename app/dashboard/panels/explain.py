"""Explanation in words: why the robot moved, in one plain sentence."""

from __future__ import annotations

from app.config import Config
from app.control.explanation import Explanation, NearPair
from app.dashboard.panels import phrases as words
from app.robot.bases.kind import planar
from app.simulation.trace.snapshot import Snapshot

LONGEST = 280
"""Characters of the longest answer of `sentence`."""

UNDISTURBED = (0.05, 0.2)
"""[m/s²], [rad/s²] of slack below which the hand's own task is met: 0.06 mm at its gain."""

_ABOVE = 0.9  # [-] n_z² from which on hardly any motion of the base helps: 18° from the vertical
_BEHIND = -0.5  # [-] forward part of a normal above which what is near is not behind the base


def sentence(snapshot: Snapshot) -> str:
    """Why the robot does what it does at a snapshot's instant."""
    why = snapshot.explanation
    if why is None:
        return "There is no explanation for this instant."
    return _contact(snapshot) + _answer(snapshot, why)


def hand_is_disturbed(why: Explanation) -> bool:
    """Whether the end-effector's task gave up more than what nobody notifier."""
    return any(
        (level.linear or 0.0) > UNDISTURBED[0] or (level.angular or 0.0) > UNDISTURBED[1]
        for level in why.levels
        if level.name == "hand"
    )


def _contact(snapshot: Snapshot) -> str:
    if snapshot.in_contact:
        return "Arm and base touch! "
    return "Parts of the arm touch! " if snapshot.arm_in_contact else ""


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
    if pair.above >= _ABOVE:
        where = f"{cause}, where no motion of the base helps"
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
    if hand_is_disturbed(why):
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
