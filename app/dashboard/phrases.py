"""Words for directions, places on the base, motions, limits and numbers."""

import math
from collections.abc import Sequence

from app.control.explanation import Bound, BoundKind
from app.robot.bases.kind import Planar
from app.simulation.trace.words import body as body
from app.simulation.trace.words import pair as pair
from app.simulation.trace.words import spoken as spoken
from app.strict import Array

AT_REST = (0.005, 0.0087)  # [m/s], [rad/s] slower motions, displayed as 0, count as rest
SLIGHT = (0.05, 0.1)  # [m/s²], [rad/s²] smaller commanded accelerations begin no motion

_SECTORS = (  # direction and place on the base, for eighths of a turn counterclockwise from forward
    ("forward", "front"),
    ("forward left", "front left corner"),
    ("left", "left side"),
    ("backward left", "rear left corner"),
    ("backward", "rear"),
    ("backward right", "rear right corner"),
    ("right", "right side"),
    ("forward right", "front right corner"),
)
_BOUNDS: dict[BoundKind, str] = {  # limits whose name is not their kind
    "position": "joint limit",
    "barrier": "minimum distance",
    "angular acceleration": "turning acceleration limit",
}


def sentence(text: str) -> str:
    """Capitalise a text; it is unchanged if its first word is not of letters only, such as d_b."""
    return f"{text[:1].upper()}{text[1:]}" if text.split(" ")[0].isalpha() else text


def angle(x: float, y: float) -> str:
    """Return a direction of the base's frame in degrees from forward: "150° to the left"."""
    degrees = round(math.degrees(math.atan2(y, x)))
    if degrees in (0, 180, -180):
        return f"{abs(degrees)}°"
    return f"{abs(degrees)}° to the {'left' if degrees > 0 else 'right'}"


def direction(x: float, y: float) -> str:
    """Return one of eight directions in the base's frame: forward, forward left, ..."""
    return _sector(x, y)[0]


def place(n: Sequence[float]) -> str:
    """Return the place on the base with this outward normal (3,), in the base's frame."""
    if abs(n[2]) > 0.8:  # within 37° of the vertical
        return "top" if n[2] > 0 else "underside"
    return _sector(n[0], n[1])[1]


def bound(reading: Bound, chain: Sequence[str]) -> str:
    """Return an active limit in words, such as "panda_joint4: torque limit"."""
    where = spoken(reading.where, chain) if reading.kind == "barrier" else reading.where
    return f"{where}: {_BOUNDS.get(reading.kind, f'{reading.kind} limit')}"


def motion(v: Planar, *, ahead: bool, intended: bool = False) -> str | None:
    """Describe a base's motion, such as "backs away at 0.21 m/s and turns left"; None at rest.

    v is the velocity [m/s, m/s, rad/s]: forward, left and turning. If `intended`, v is the
    commanded acceleration [m/s², m/s², rad/s²] of a base at rest, and the text is the base's next
    motion: "back away and turn left". If `ahead`, the avoided body is in front of the base or
    beside it, and a backward motion is called "back away".
    """
    forward, left, turn = v
    (slow, slow_turn), s = (SLIGHT, "") if intended else (AT_REST, "s")
    speed = "" if intended else f" at {math.hypot(forward, left):.2f} m/s"
    parts = []
    if abs(left) >= slow:
        parts.append(f"drive{s} {direction(forward, left)}{speed}")
    elif forward <= -slow:
        parts.append((f"back{s} away" if ahead else f"drive{s} backward") + speed)
    elif forward >= slow:
        parts.append(f"drive{s} forward{speed}")
    if abs(turn) >= slow_turn:
        alone = "" if parts or intended else f" at {math.degrees(abs(turn)):.0f}°/s"
        parts.append(f"turn{s} {'left' if turn > 0 else 'right'}{alone}")
    return " and ".join(parts) or None


def speeds(velocity: Array) -> str:
    """Return a base's velocity (n_b,) [m/s, rad/s] in words, such as "0.09 m/s, 5°/s left"."""
    *linear, w = velocity
    turn = math.degrees(abs(w))
    side = "" if turn < 0.5 else " left" if w > 0 else " right"
    return f"{math.hypot(*linear):.2f} m/s, {turn:.0f}°/s{side}"


def acceleration(*axes: float) -> str:
    """Return a base's acceleration in words; axes: forward, left [m/s²] and turning [rad/s²]."""
    units = "m/s²", "m/s²", "rad/s²"
    ways = ("forward", "backward"), ("left", "right"), ("turning left", "turning right")
    parts = zip(axes, units, ways, strict=True)
    texts = [f"{abs(a):.2f} {unit} {way[a < 0.0]}" for a, unit, way in parts if abs(a) >= 0.005]
    return ", ".join(texts) or "none"


def signed(value: float, digits: int = 2) -> str:
    """Format a number with its sign; the minus is typographic, and zero has a plus."""
    return f"{round(value, digits) + 0.0:+.{digits}f}".replace("-", "−")


def scientific(value: float) -> str:
    """Format a number as in 2.3·10⁻⁴; the minus is typographic, and zero is "0"."""
    if value == 0.0:
        return "0"
    mantissa, _, exponent = f"{value:.1e}".partition("e")
    power = str(int(exponent)).translate(str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹"))
    return f"{mantissa}·10{power}".replace("-", "−")


def _sector(x: float, y: float) -> tuple[str, str]:
    return _SECTORS[round(math.degrees(math.atan2(y, x)) / 45.0) % 8]
