"""The person who takes the robot by one hand: a spring, a damper, a limited strength."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from app.config import HandConfig
from app.errors import TargetError

Array = np.ndarray

_QUICKNESS = 20.0  # [rad/s] of the hand's motion towards a new target
_TOP_SPEED = 1.5  # [m/s] of the hand
_FARTHEST = 1e4  # [m] from the world's origin
_LINK_SIZE = 1.0  # [m] no part of a link is farther from its origin


def checked_target(target: Sequence[float] | Array) -> Array:
    """(3,) [m] a place in the world to which a person may pull.

    Raises:
        TargetError: It lies below the floor or farther away than 10 km, or is not three finite
            numbers.
    """
    place = _finite_point(target, "the hand's target")
    x, y, z = place.tolist()
    if z < 0:
        raise TargetError(f"the hand's target is at z = {z:.3f} m, below the floor, which is z = 0")
    if max(abs(x), abs(y), z) > _FARTHEST:
        raise TargetError(f"the hand's target is farther away than {_FARTHEST:g} m: {target!r}")
    return place


def checked_hold(point: Sequence[float] | Array) -> Array:
    """(3,) [m] a point of a link, in its frame, that a person may hold.

    Raises:
        TargetError: It is nothing of a link's, or is not three finite numbers.
    """
    place = _finite_point(point, "the point that is held")
    if np.linalg.norm(place) > _LINK_SIZE:
        raise TargetError(
            f"the point that is held is farther than {_LINK_SIZE:g} m from its link: {point!r}"
        )
    return place


def _finite_point(point: Sequence[float] | Array, what: str) -> Array:
    try:
        place = np.array(point, dtype=float)
    except (TypeError, ValueError):
        place = np.empty(0)
    if place.shape != (3,) or not all(map(math.isfinite, place.tolist())):
        raise TargetError(f"{what} must be three finite numbers, was {point!r}")
    return place


class PersonHand:
    """F = K (p - p_ee) - D v_ee, no stronger than f_max, where p follows the target smoothly.

    Targets come 20 times a second and jump; p moves towards the latest as a critically damped
    point of limited speed, from where the person took hold. So F has no steps at 1 kHz. The damper
    acts against the world: with p at rest the person only takes energy out.
    """

    def __init__(self, config: HandConfig, dt: float = 0.001) -> None:
        """A person who does not hold the robot.

        Args:
            config: K, D and f_max; may be replaced at any time through `config`.
            dt: [s] between two calls of `force`.
        """
        self.config = config
        self._dt = dt
        self._p: Array | None = None

    @property
    def place(self) -> Array | None:
        """(3,) [m] where the person's hand is, in the world; None if it does not hold the robot."""
        return None if self._p is None else self._p.copy()

    def force(self, p_ee: Array, v_ee: Array, target: Sequence[float] | Array | None) -> Array:
        """The person's force on the end-effector for one period.

        Args:
            p_ee: (3,) [m] the end-effector in the world.
            v_ee: (3,) [m/s] its velocity.
            target: (3,) [m] where the person pulls it, in the world; None lets go.

        Returns:
            (3,) [N] in the world.

        Raises:
            TargetError: The target lies below the floor, or is not three finite numbers.
        """
        if target is None:
            self._p = None
            return np.zeros(3)
        if self._p is None:
            self._p, self._v = np.array(p_ee, dtype=float), np.zeros(3)
        self._follow(checked_target(target))
        pull = self.config.stiffness * (self._p - p_ee) - self.config.damping * v_ee
        return _limited(pull, self.config.f_max)

    def _follow(self, target: Array) -> None:
        """Move p: p̈ = ω² (target - p) - 2 ω ṗ, with limited speed."""
        a = _QUICKNESS**2 * (target - self._p) - 2 * _QUICKNESS * self._v
        self._v = _limited(self._v + a * self._dt, _TOP_SPEED)
        self._p = self._p + self._v * self._dt


def _limited(vector: Array, longest: float) -> Array:
    """The vector, shortened to a length."""
    length = math.sqrt(vector @ vector)
    return vector if length <= longest else vector * (longest / length)
