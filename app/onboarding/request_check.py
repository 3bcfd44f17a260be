"""Whether what is asked of `dbb new-robot` goes together, before anything is read."""

from __future__ import annotations

from typing import NamedTuple

from app.config import parameter
from app.errors import ConfigError, UnknownNameError
from app.onboarding.request import Request
from app.robot.description import KINDS
from app.strict import MOST_SEEDS, check_range


class Bounds(NamedTuple):
    """Of a number that may be given.

    Attributes:
        low, high: The least and the largest.
        unit: Of them.
    """

    low: float
    high: float
    unit: str = ""


BOUNDS = {
    "half_track": Bounds(0.02, 3.0, "m"),
    "wheel_radius": Bounds(0.01, 1.0, "m"),
    "wheelbase": Bounds(0.05, 10.0, "m"),
    "steering_limit": Bounds(0.02, 1.5, "rad"),
    "steering_rate": Bounds(0.01, 20.0, "rad/s"),
    "bodies": Bounds(1, 8),
}
"""By the field of `Request`."""
_FARTHEST = 10.0  # [m] or [rad] of a place or a turn; more is a slip of the keys
OF_KIND = {
    "half_track": "differential",
    "wheel_radius": "differential",
    "wheelbase": "car-like",
    "steering_limit": "car-like",
    "steering_rate": "car-like",
}
"""Kind of base that a number belongs to."""


def option(field: str) -> str:
    """The option of `dbb new-robot` that sets a field of `Request`."""
    return "--" + field.replace("_", "-")


def check_request(request: Request) -> None:
    """Refuse numbers out of bounds, and those of another kind of base.

    Raises:
        UnknownNameError: There is no such kind of base.
        ConfigError: Names the option and what would be right.
    """
    known = parameter("border.d_b")
    check_range("--buffer-distance", request.d_b, known.low, known.high, known.unit)
    check_range("--seed", request.seed, 0, MOST_SEEDS)
    for field in ("mount_xyz", "mount_rpy", "tip_xyz", "tip_rpy"):
        for coordinate in getattr(request, field):
            check_range(option(field), coordinate, -_FARTHEST, _FARTHEST)
    kind = request.kind
    if kind not in KINDS:
        raise UnknownNameError("kind of base", kind, KINDS)
    for field, bounds in BOUNDS.items():
        value = getattr(request, field)
        if value is None:
            continue
        check_range(option(field), value, *bounds)
        if OF_KIND.get(field, kind) != kind:
            raise ConfigError(
                f"{option(field)}: a {kind} base has none; leave it out, or give "
                f"--kind {OF_KIND[field]}"
            )
    if kind == "holonomic" and request.wheels is not None:
        raise ConfigError("--wheels: a holonomic base is described without them; leave them out")
    if request.wheel_radius is not None and (
        request.half_track is None or request.wheels is not None
    ):
        raise ConfigError("--wheel-radius: needs --half-track, and no --wheels")
