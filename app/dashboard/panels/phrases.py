"""Numbers in words: directions, places on the base, bodies, motions, limits."""

from __future__ import annotations

import math
from collections.abc import Sequence

from app.control.active_bounds import Bound, BoundKind

AT_REST = (0.01, 0.02)
"""[m/s], [rad/s] below which the base stands still."""

_DIRECTIONS = (
    "forward",
    "forward left",
    "left",
    "backward left",
    "backward",
    "backward right",
    "right",
    "forward right",
)
_PLACES = (
    "front",
    "front left corner",
    "left side",
    "rear left corner",
    "rear",
    "rear right corner",
    "right side",
    "front right corner",
)
_FROM_OUTSIDE = ("hand", "forearm", "upper arm", "shoulder")
_TOP = 0.8  # [-] height of a normal from which on it points out of the top, as in activation.py

_BOUNDS: dict[BoundKind, str] = {
    "torque": "torque limit",
    "position": "end of its range",
    "velocity": "velocity limit",
    "barrier": "hard limit of its distance",
    "torque rate": "torque cannot change faster",
    "acceleration": "largest acceleration",
    "angular acceleration": "largest turning acceleration",
    "speed": "top speed",
    "turning speed": "top turning speed",
}


def bearing_deg(x: float, y: float) -> float:
    """[°] from forward, left positive, in (-180, 180]; 0 without a direction."""
    degrees = math.degrees(math.atan2(y, x))
    return 180.0 if degrees == -180.0 else degrees


def angle(x: float, y: float) -> str:
    """A direction in degrees from forward, as in "150° to the left"."""
    degrees = round(bearing_deg(x, y))
    if degrees in (0, 180, -180):
        return f"{abs(degrees)}°"
    return f"{abs(degrees)}° to the {'left' if degrees > 0 else 'right'}"


def direction(x: float, y: float) -> str:
    """A direction in the base's frame, as one of eight: forward, forward left, ..."""
    return _DIRECTIONS[_sector(x, y)]


def place(n: Sequence[float]) -> str:
    """Where on the base something is near, by the unit normal out of the base, in its frame."""
    if abs(n[2]) > _TOP:
        return "top" if n[2] > 0 else "underside"
    return _PLACES[_sector(n[0], n[1])]


def body(name: str, chain: Sequence[str]) -> str:
    """A body by its place in the chain: base, shoulder, upper arm, forearm, hand.

    Args:
        name: As in `lEE`.
        chain: Names of all bodies, the mobile robot first, then outwards; a door that the hand
            holds is called `door`.
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


def bound(reading: Bound, chain: Sequence[str]) -> str:
    """A limit that was met, as in "panda_joint4: torque limit"."""
    where = reading.where
    if reading.kind == "barrier":
        a, _, b = where.partition("-")
        where = pair(a, b, chain)
    return f"{where}: {_BOUNDS[reading.kind]}"


def length(d: float) -> str:
    """A length of metres in whole centimetres, or in millimetres below one."""
    return f"{1000 * d:.0f} mm" if abs(d) < 0.01 else f"{100 * d:.0f} cm"


def motion(v: float, w: float, *, ahead: bool, left: float = 0.0) -> str | None:
    """What a base does, as in "backs away at 0.21 m/s and turns left"; None if it stands still.

    Args:
        v: [m/s].
        w: [rad/s], left positive.
        ahead: Whether what it avoids is not behind it.
        left: [m/s] to the left, of a base that moves sideways.
    """
    parts = []
    if abs(left) >= AT_REST[0]:
        way = direction(v, left)
        parts.append(f"drives {way} at {math.hypot(v, left):.2f} m/s")
    elif abs(v) >= AT_REST[0]:
        back = "backs away" if ahead else "drives backward"
        parts.append(f"{back if v < 0 else 'drives forward'} at {abs(v):.2f} m/s")
    if abs(w) >= AT_REST[1]:
        side = "left" if w > 0 else "right"
        parts.append(f"turns {side}" + ("" if parts else f" at {math.degrees(abs(w)):.0f}°/s"))
    return " and ".join(parts) or None


def intention(v_dot: float, w_dot: float, *, ahead: bool, left: float = 0.0) -> str | None:
    """What a base at rest is about to do, as in "back away and turn left"; None if nothing.

    Args:
        v_dot: [m/s²] asked for.
        w_dot: [rad/s²] asked for, left positive.
        ahead: Whether what it avoids is not behind it.
        left: [m/s²] to the left, of a base that moves sideways.
    """
    parts = []
    if abs(left) >= AT_REST[0]:
        parts.append(f"drive {direction(v_dot, left)}")
    elif abs(v_dot) >= AT_REST[0]:
        back = "back away" if ahead else "drive backward"
        parts.append(back if v_dot < 0 else "drive forward")
    if abs(w_dot) >= AT_REST[1]:
        parts.append("turn left" if w_dot > 0 else "turn right")
    return " and ".join(parts) or None


def signed(value: float, digits: int = 2) -> str:
    """With a sign, a true minus, and no minus before zero."""
    return f"{round(value, digits) + 0.0:+.{digits}f}".replace("-", "−")


def scientific(value: float) -> str:
    """As in 2.3·10⁻⁴, with a true minus; 0 is 0."""
    if value == 0.0:
        return "0"
    mantissa, _, exponent = f"{value:.1e}".partition("e")
    power = str(int(exponent)).translate(str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹"))
    return f"{mantissa}·10{power}".replace("-", "−")


def _sector(x: float, y: float) -> int:
    return round(bearing_deg(x, y) / 45.0) % 8
