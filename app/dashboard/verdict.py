"""Verdict on a snapshot: it determines the colours of texts, bars, lines and labels on the page."""

from collections.abc import Mapping
from typing import Literal, NamedTuple

from app.control.explanation import NearPair
from app.control.inputs import MOVES_BASE
from app.dashboard.phrases import AT_REST, SLIGHT
from app.dashboard.scene.colours import Rgb
from app.simulation.trace.snapshot import PairReading, Snapshot
from app.simulation.trace.words import millimetres

State = Literal["clear", "near", "giving way", "resisting", "contact"]

COLOURS: dict[State, Rgb] = {  # from the best state to the worst
    "clear": (128, 138, 150),  # a pair outside its buffer
    "near": (235, 205, 70),  # a pair inside its buffer, without the reactions below
    "giving way": (240, 150, 40),  # a pair for which the base gives way
    "resisting": (224, 84, 36),  # a pair that the arm keeps apart
    "contact": (226, 16, 56),  # contact or overlap
}
LATE = 0.05  # [-] noticeable share of late steps, or of missing real time
STEEP = 0.9  # [-] lost share of the force: up to 6° from vertical, base motion hardly helps


class Verdict(NamedTuple):
    state: State  # worst of `pairs` and `touching`; at least "resisting" with the fallback command
    pairs: tuple[State, ...]  # in the order of the snapshot
    touching: str  # text of the function `touching`


def judge(snapshot: Snapshot, spoken: Mapping[str, str] | None = None) -> Verdict:
    """Return the verdict on a snapshot; `spoken` has words for pairs, by default their names."""
    why = snapshot.explanation
    known = {} if why is None else {f"{pair.a}-{pair.b}": pair for pair in why.near}
    rates = (snapshot.base_velocity, AT_REST), (snapshot.base_acceleration, SLIGHT)
    moves = any(  # whether the base moves, or begins to move
        max(map(abs, linear)) >= slow[0] or abs(turn) >= slow[1] for (*linear, turn), slow in rates
    )
    pairs: tuple[State, ...] = tuple(
        _state(pair, known.get(pair.name), snapshot.controller, moves=moves)
        for pair in snapshot.pairs
    )
    states: list[State] = ["clear", *pairs]
    if why is not None and not why.solved:
        states.append("resisting")  # the fallback command damps the arm and brakes the base
    touches = touching(snapshot, spoken)
    return Verdict("contact" if touches else max(states, key=list(COLOURS).index), pairs, touches)


def is_slow(snapshot: Snapshot) -> bool:
    """Whether the running simulation noticeably misses its desired speed."""
    return not snapshot.paused and snapshot.realtime_factor < (1.0 - LATE) * snapshot.speed


def links_repel(pair: NearPair | PairReading) -> bool:
    """Whether a pair is within the arm and so near that its repulsion, if any, can be felt."""
    return not pair.mobile and pair.beta >= 0.1


def _state(pair: PairReading, near: NearPair | None, controller: str, *, moves: bool) -> State:
    """Return a pair's state; `near` explains it if active; `moves`: the base moves or begins to."""
    if pair.d < 0.0:
        return "contact"
    if near is not None and near.limited:
        return "resisting"
    if pair.beta == 0.0:
        return "clear"
    if controller in ("none", "barrier") or (near is not None and near.above >= STEEP):
        return "near"
    if not pair.mobile:
        return "resisting" if links_repel(pair) else "near"
    if controller not in MOVES_BASE:
        return "resisting"
    return "giving way" if moves else "near"


def contacts(snapshot: Snapshot) -> list[str]:
    """Return the contacts that the plant has reported, in words."""
    touches = {
        "arm and base": snapshot.in_contact,
        "links of the arm": snapshot.arm_in_contact,
        "arm and floor": snapshot.floor_contact,
        "door and base": snapshot.door is not None and snapshot.door.contact,
    }
    return [text for text, touch in touches.items() if touch]


def touching(snapshot: Snapshot, spoken: Mapping[str, str] | None = None) -> str:
    """Return the reported contacts and the deepest overlap in words, or "" without any."""
    texts = contacts(snapshot)
    name, _, d, *_ = snapshot.nearest
    if d < 0.0:
        texts.append(f"{(spoken or {}).get(name, name)} overlap by {millimetres(-d)}")
    return ", ".join(texts)
