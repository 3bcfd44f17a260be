"""Words of a run, the same on the page, in reports and on the command line."""

import math
from collections.abc import Sequence
from typing import Any, Literal

Outcome = Literal["contact", "overlap", "no contact"]

METHODS = {
    "dbb": "with avoidance",
    "hqp": "hierarchy as printed",
    "points": "with avoidance (sampled border)",
    "repulsive": "arm repulsion only",
    "barrier": "minimum distance only",
    "none": "without avoidance",
}
"""Description of each controller, by its name."""

_FROM_OUTSIDE = ("hand", "forearm", "upper arm", "shoulder")
_NOTHING = 5e-7  # [-] a smaller number is rounding


def body(name: str, chain: Sequence[str]) -> str:
    """The name of a body by its place in the chain: base, shoulder, upper arm, forearm, hand.

    Args:
        name: As in `lEE`.
        chain: Names of all bodies, the mobile robot first, then outwards; a held door is called
            `door`.
    """
    if name == chain[0]:
        return "base"
    if name == "door":
        return "door"
    arm = [link for link in chain[1:] if link != "door"]
    outwards = len(arm) - 1 - arm.index(name)
    return _FROM_OUTSIDE[outwards] if outwards < len(_FROM_OUTSIDE) else f"link {name}"


def pair(a: str, b: str, chain: Sequence[str]) -> str:
    """A link pair, as in "hand – base"."""
    return f"{body(b, chain)} – {body(a, chain)}"


def spoken(name: str, chain: Sequence[str]) -> str:
    """A link pair by its name, such as `lm-lEE`."""
    a, _, b = name.partition("-")
    return pair(a, b, chain)


def outcome(least: float, *, touched: bool) -> Outcome:
    """Classify a run by its smallest distance [m] and the contact that the plant reported.

    Distances are between convex bodies that enclose the links, so bodies can overlap without
    contact.
    """
    return "contact" if touched else "overlap" if least < 0.0 else "no contact"


def millimetres(distance: float) -> str:
    """A distance [m] with a true minus; never "−0 mm"."""
    text = f"{round(1000 * distance)}" if math.isfinite(distance) else "–"
    return f"{text} mm".replace("-", "−")


def kept(least: float, *, touched: bool) -> str:
    """The outcome with its distance [m], as in "no contact, least distance 105 mm"."""
    if least < 0.0:
        overlap = f"bodies overlap by {millimetres(-least)}"
        return f"contact, {overlap}" if touched else overlap
    return f"{outcome(least, touched=touched)}, least distance {millimetres(least)}"


def number_text(value: Any, none: str = "–") -> str:
    """A figure in readable form: three digits, 0 for rounding errors; `none` replaces None."""
    if isinstance(value, dict):
        return ", ".join(f"{name} {number_text(each)}" for name, each in value.items())
    if isinstance(value, (list, tuple)):
        return ", ".join(map(number_text, value))
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, float):
        few = float(f"{value:.3g}") if abs(value) < 100 else round(value)
        text = f"{few:.6f}" if abs(few) >= _NOTHING else "0.0"
        return text.rstrip("0").rstrip(".")
    return none if value is None else str(value)


def missing(key: str) -> str:
    """The meaning of a figure without a value, by its key."""
    if key.startswith(("stuck", "left_way")):
        return "no"
    return "never" if key.endswith("_s") else "not measured"
