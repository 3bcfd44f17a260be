"""Numbers in words: directions, places on the base, bodies, motions, limits."""

import math
from collections.abc import Sequence

from app.control.active_bounds import Bound, BoundKind
from app.simulation.trace.words import body as body
from app.simulation.trace.words import pair as pair
from app.simulation.trace.words import spoken as spoken
from app.strict import Array

AT_REST = (0.01, 0.02)  # [m/s], [rad/s] below which the base stands still
SLIGHT = (0.05, 0.1)  # [m/s²], [rad/s²] below which a commanded acceleration moves nothing yet

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
_TOP = 0.8  # [-] height of a normal from which on it points out of the top

_BOUNDS: dict[BoundKind, str] = {
    "torque": "torque limit",
    "position": "joint limit",
    "velocity": "velocity limit",
    "barrier": "minimum distance reached",
    "torque rate": "torque rate limit",
    "acceleration": "acceleration limit",
    "angular acceleration": "turning acceleration limit",
    "speed": "speed limit",
    "turning speed": "turning speed limit",
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
    """What follows a person's force, as in ", arm can hold 62 N"; nothing while no bound is known.

    The bound [N] is that of `Snapshot.force_bound`.
    """
    return "" if math.isnan(bound) else f", arm can hold {bound:.0f} N"


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
    return _moves((v, left, w), ahead, AT_REST, ("s", speed, turning))


def intention(v_dot: float, w_dot: float, *, ahead: bool, left: float = 0.0) -> str | None:
    """What a base at rest is about to do, as in "back away and turn left"; None if nothing.

    Its arguments are the accelerations [m/s²], [rad/s²] that are asked for, in the place of the
    velocities of `motion`.
    """
    return _moves((v_dot, left, w_dot), ahead, SLIGHT, ("", "", ""))


def _moves(
    along: tuple[float, float, float],
    ahead: bool,
    least: tuple[float, float],
    verb: tuple[str, str, str],
) -> str | None:
    """The parts forward, left and about that are at `least` so large; the first has its speed.

    The verbs have an ending, then come the texts of the speeds along and about.
    """
    (v, left, w), (s, speed, turning) = along, verb
    parts = []
    if abs(left) >= least[0]:
        parts.append(f"drive{s} {direction(v, left)}{speed}")
    elif v <= -least[0]:
        parts.append((f"back{s} away" if ahead else f"drive{s} backward") + speed)
    elif v >= least[0]:
        parts.append(f"drive{s} forward{speed}")
    if abs(w) >= least[1]:
        side = "left" if w > 0 else "right"
        parts.append(f"turn{s} {side}" + ("" if parts else turning))
    return " and ".join(parts) or None


def speeds(velocity: Array) -> str:
    """A base's velocity, as in "0.09 m/s, 5°/s left"; its last axis turns."""
    *linear, w = velocity
    turn = math.degrees(abs(w))
    side = "" if turn < 0.5 else " left" if w > 0 else " right"
    return f"{math.hypot(*linear):.2f} m/s, {turn:.0f}°/s{side}"


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
