"""Words for the results of a run, the same on the page, in reports and on the command line."""

import math
from collections.abc import Sequence
from typing import Any, Literal

Outcome = Literal["contact", "overlap", "no contact"]

METHOD_WORDS = {
    "dbb": "with avoidance",
    "hqp": "paper's hierarchy",
    "repulsive": "arm repulsion only",
    "barrier": "minimum distance only",
    "none": "without avoidance",
}
"""Description of each controller, by its name."""

_FROM_OUTSIDE = ("end-effector", "forearm", "upper arm", "shoulder")
_NOTHING = 5e-7  # [-] smaller magnitudes count as rounding errors


def body(name: str, chain: Sequence[str]) -> str:
    """The displayed name of a body by its position in the chain, such as "base" or "forearm".

    `chain` has the names of all bodies from the mobile base outwards; `door` is a held door and
    keeps this name. Bodies of the arm before the outermost four are "link", then their own name.
    """
    if name == chain[0]:
        return "base"
    if name == "door":
        return "door"
    arm = [link for link in chain[1:] if link != "door"]
    outwards = len(arm) - 1 - arm.index(name)
    return _FROM_OUTSIDE[outwards] if outwards < len(_FROM_OUTSIDE) else f"link {name}"


def pair(a: str, b: str, chain: Sequence[str]) -> str:
    """The displayed name of the link pair of bodies a and b, such as "end-effector – base"."""
    return f"{body(b, chain)} – {body(a, chain)}"


def spoken(name: str, chain: Sequence[str]) -> str:
    """The displayed name of a link pair with a name such as `lm-lEE`."""
    a, _, b = name.partition("-")
    return pair(a, b, chain)


def outcome(least: float, *, touched: bool) -> Outcome:
    """Classify a run by its smallest distance [m], and by whether bodies `touched` in the plant."""
    return "contact" if touched else "overlap" if least < 0.0 else "no contact"


def millimetres(distance: float) -> str:
    """A distance [m] in whole millimetres, with a typographic minus; "– mm" if it is not finite."""
    text = f"{round(1000 * distance)}" if math.isfinite(distance) else "–"
    return f"{text} mm".replace("-", "−")


def number_text(value: Any, none: str = "–") -> str:
    """A result, or a list or dictionary of results, as text; `none` is the text for None.

    A float that is not finite counts as None. Another float has three significant digits, but at
    most six decimals. From a magnitude of 100 on it is an integer; below 5e-7 it is 0.
    """
    if isinstance(value, dict):
        texts = (f"{name} {number_text(each, none)}" for name, each in value.items())
        return ", ".join(texts) or "none"
    if isinstance(value, (list, tuple)):
        return ", ".join(number_text(each, none) for each in value)
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, float) and math.isfinite(value):
        few = float(f"{value:.3g}") if abs(value) < 100 else round(value)
        text = f"{few:.6f}" if abs(few) >= _NOTHING else "0.0"
        return text.rstrip("0").rstrip(".")
    return none if value is None or isinstance(value, float) else str(value)


def missing(key: str) -> str:
    """The text for a figure without a value, according to the figure's key."""
    if key.startswith(("stuck", "left_way")):
        return "no"
    return "never" if key.endswith("_s") else "not measured"
