"""Numbers in words: directions, places on the base, bodies, motions, limits."""

import math
from collections.abc import Sequence

from app.control.active_bounds import Bound, BoundKind

AT_REST = (0.01, 0.02)  # [m/s], [rad/s] below which the base stands still

_SECTORS = (
    ("forward", "front"),
    ("forward left", "front left corner"),
    ("left", "left side"),
    ("backward left", "rear left corner"),
    ("backward", "rear"),
    ("backward right", "rear right corner"),
    ("right", "right side"),
    ("forward right", "front right corner"),
)
"""Direction and place on the base of the eighths of a turn, from forward to the left."""
_FROM_OUTSIDE = ("hand", "forearm", "upper arm", "shoulder")
_TOP = 0.8  # [-] height of a normal from which on it points out of the top

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


def angle(x: float, y: float) -> str:
    """A direction in degrees from forward, as in "150° to the left"."""
    degrees = round(math.degrees(math.atan2(y, x)))
    if degrees in (0, 180, -180):
        return f"{abs(degrees)}°"
    return f"{abs(degrees)}° to the {'left' if degrees > 0 else 'right'}"


def direction(x: float, y: float) -> str:
    """A direction in the base's frame, as one of eight: forward, forward left, ..."""
    return _sector(x, y)[0]


def place(n: Sequence[float]) -> str:
    """Where on the base something is near, by the unit normal out of the base, in its frame."""
    if abs(n[2]) > _TOP:
        return "top" if n[2] > 0 else "underside"
    return _sector(n[0], n[1])[1]


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


def spoken(name: str, chain: Sequence[str]) -> str:
    """A link pair by its name, such as `lm-lEE`."""
    a, _, b = name.partition("-")
    return pair(a, b, chain)


def bound(reading: Bound, chain: Sequence[str]) -> str:
    """A limit that was met, as in "panda_joint4: torque limit"."""
    where = reading.where
    if reading.kind == "barrier":
        where = spoken(where, chain)
    return f"{where}: {_BOUNDS[reading.kind]}"


def length(d: float) -> str:
    """A length of metres in whole centimetres, or in millimetres below one."""
    return f"{1000 * d:.0f} mm" if abs(d) < 0.01 else f"{100 * d:.0f} cm"


def borne(bound: float) -> str:
    """What follows a person's force, as in ", the arm bears 62 N"; nothing while no bound is known.

    The bound [N] is that of `Snapshot.force_bound`.
    """
    return "" if math.isnan(bound) else f", the arm bears {bound:.0f} N"


def motion(v: float, w: float, *, ahead: bool, left: float = 0.0) -> str | None:
    """What a base does, as in "backs away at 0.21 m/s and turns left"; None if it stands still.

    Args:
        v: [m/s].
        w: [rad/s], left positive.
        ahead: Whether what it avoids is not behind it.
        left: [m/s] to the left, of a base that moves sideways.
    """
    speed = f" at {math.hypot(v, left):.2f} m/s"
    turning = f" at {math.degrees(abs(w)):.0f}°/s"
    return _moves(v, w, ahead, left, "s", speed, turning)


def intention(v_dot: float, w_dot: float, *, ahead: bool, left: float = 0.0) -> str | None:
    """What a base at rest is about to do, as in "back away and turn left"; None if nothing.

    Its arguments are the accelerations [m/s²], [rad/s²] that are asked for, in the place of the
    velocities of `motion`.
    """
    return _moves(v_dot, w_dot, ahead, left, "", "", "")


def _moves(
    v: float, w: float, ahead: bool, left: float, s: str, speed: str, turning: str
) -> str | None:
    """The parts along and about, the verbs with the ending `s`; the first part has its speed."""
    parts = []
    if abs(left) >= AT_REST[0]:
        parts.append(f"drive{s} {direction(v, left)}{speed}")
    elif v <= -AT_REST[0]:
        parts.append((f"back{s} away" if ahead else f"drive{s} backward") + speed)
    elif v >= AT_REST[0]:
        parts.append(f"drive{s} forward{speed}")
    if abs(w) >= AT_REST[1]:
        side = "left" if w > 0 else "right"
        parts.append(f"turn{s} {side}" + ("" if parts else turning))
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


def _sector(x: float, y: float) -> tuple[str, str]:
    return _SECTORS[round(math.degrees(math.atan2(y, x)) / 45.0) % 8]
