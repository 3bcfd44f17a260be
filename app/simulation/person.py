"""The person who takes the robot by one hand: a spring, a damper, a limited strength, a mass."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from app.compiled import compiled
from app.config import HandConfig
from app.errors import TargetError

Array = np.ndarray

_QUICKNESS = 20.0  # [rad/s] of the hand's motion towards a new target
_TOP_SPEED = 1.5  # [m/s] of the hand
_FARTHEST = 1e4  # [m] from the world's origin
_LINK_SIZE = 1.0  # [m] no part of a link is farther from its origin
_GRIP = 2e4  # [N/m] of the flesh between a hand with a mass and the robot
_GRIP_DAMPING = 0.5  # [-] of that spring with the hand's mass on it, of the critical one


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


@compiled()
def _shorten(vector: Array, longest: float) -> None:
    """Make a vector (3,) no longer than this."""
    length = math.sqrt(vector[0] ** 2 + vector[1] ** 2 + vector[2] ** 2)
    if length > longest:
        for i in range(3):
            vector[i] *= longest / length


@compiled("Tuple((f8[:,::1], f8[::1]))(f8[:,:], f8[:], f8[:], f8[:], f8, f8, f8, f8)")
def _pull(
    hand: Array,
    target: Array,
    p_ee: Array,
    v_ee: Array,
    stiffness: float,
    damping: float,
    f_max: float,
    dt: float,
) -> tuple[Array, Array]:
    """Move the person's hand for one period: p̈ = ω² (target - p) - 2 ω ṗ, with limited speed.

    Args:
        hand: (2, 3) p [m] and ṗ [m/s].
        target: (3,) [m]
        p_ee: (3,) [m]
        v_ee: (3,) [m/s]
        stiffness: [N/m]
        damping: [N s/m]
        f_max: [N]
        dt: [s]

    Returns:
        The hand a period later, and (3,) [N] what the person does then.
    """
    moved, force = np.empty((2, 3)), np.empty(3)
    for i in range(3):
        a = _QUICKNESS**2 * (target[i] - hand[0, i]) - 2 * _QUICKNESS * hand[1, i]
        moved[1, i] = hand[1, i] + a * dt
    _shorten(moved[1], _TOP_SPEED)
    for i in range(3):
        moved[0, i] = hand[0, i] + moved[1, i] * dt
        force[i] = stiffness * (moved[0, i] - p_ee[i]) - damping * v_ee[i]
    _shorten(force, f_max)
    return moved, force


@compiled("Tuple((f8[:,::1], f8[::1]))(f8[:,:], f8[:], f8[:], f8[:], f8, f8, f8, f8, f8)")
def _push_mass(
    held: Array,
    p: Array,
    p_ee: Array,
    v_ee: Array,
    stiffness: float,
    damping: float,
    f_max: float,
    mass: float,
    dt: float,
) -> tuple[Array, Array]:
    """Move the mass in the hand for one period; m ẍ = F - G, by the implicit Euler rule.

    F = K' (p - x) - D ẋ, no stronger than f_max, moves it, and the grip G = k (x - p_ee) +
    c (ẋ - v_ee) moves the robot, all at the period's end, to which the end-effector is taken to
    go on as it does. K' and the grip in a row are as stiff as K. The rule is stable for every mass,
    spring and damper; where F is stronger than f_max, it is f_max that way.

    Args:
        held: (2, 3) x [m] and ẋ [m/s].
        p: (3,) [m] to where the spring pulls.
        p_ee: (3,) [m]
        v_ee: (3,) [m/s]
        stiffness: [N/m] K
        damping: [N s/m] D
        f_max: [N]
        mass: [kg]
        dt: [s]

    Returns:
        The mass a period later, and (3,) [N] G.
    """
    K = stiffness * _GRIP / (_GRIP - stiffness)
    grip_damping = 2.0 * _GRIP_DAMPING * math.sqrt(_GRIP * mass)
    alone = mass + dt * (grip_damping + dt * _GRIP)  # [kg] what F has to move, in this rule
    push, driven, grip = np.empty(3), np.empty(3), np.empty(3)
    for i in range(3):
        grip[i] = p_ee[i] + dt * v_ee[i]
        driven[i] = mass * held[1, i] + dt * (
            grip_damping * v_ee[i] - _GRIP * (held[0, i] - grip[i])
        )
        pull = K * (p[i] - held[0, i])
        v = (driven[i] + dt * pull) / (alone + dt * (damping + dt * K))
        push[i] = pull - (damping + dt * K) * v
    _shorten(push, f_max)
    moved, force = np.empty((2, 3)), np.empty(3)
    for i in range(3):
        moved[1, i] = (driven[i] + dt * push[i]) / alone
        moved[0, i] = held[0, i] + dt * moved[1, i]
        force[i] = _GRIP * (moved[0, i] - grip[i]) + grip_damping * (moved[1, i] - v_ee[i])
    return moved, force


class PersonHand:
    """F = K (p - p_ee) - D v_ee, no stronger than f_max, where p follows the target smoothly.

    Targets come 20 times a second and jump; p moves towards the latest as a critically damped
    point of limited speed, from where the person took hold. So F has no steps at 1 kHz. The damper
    acts against the world: with p at rest the person only takes energy out.

    A hand with a mass stands between the two: F moves the mass, and the robot feels what the grip
    on it transmits. That is more than f_max while the mass is being stopped, and less while it is
    set in motion; at rest it is F. Spring, damper, mass and grip are passive, so with p at rest
    such a hand only takes energy out as well.
    """

    def __init__(self, config: HandConfig, dt: float = 0.001) -> None:
        """A person who does not hold the robot.

        Args:
            config: K, D, f_max and the mass; may be replaced at any time through `config`.
            dt: [s] between two calls of `force`.
        """
        self.config = config
        self._dt = dt
        self._hand: Array | None = None  # (2, 3) place [m] and velocity [m/s]
        self._mass: Array | None = None  # (2, 3) the same of the mass in it

    @property
    def place(self) -> Array | None:
        """(3,) [m] where the person's hand is, in the world; None if it does not hold the robot."""
        return None if self._hand is None else self._hand[0].copy()

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
            self._hand = self._mass = None
            return np.zeros(3)
        place = np.asarray(target)
        if not _allowed(place):
            place = checked_target(target)
        if self._hand is None:
            self._hand = np.array([p_ee, np.zeros(3)], dtype=float)
        config = self.config
        spring = config.stiffness, config.damping, config.f_max
        self._hand, force = _pull(self._hand, place, p_ee, v_ee, *spring, self._dt)
        if config.mass == 0.0:
            self._mass = None
            return force
        if self._mass is None:  # it moves with what it takes hold of
            self._mass = np.array([p_ee, v_ee], dtype=float)
        self._mass, force = _push_mass(
            self._mass, self._hand[0], p_ee, v_ee, *spring, config.mass, self._dt
        )
        return force


def _allowed(place: Array) -> bool:
    """Whether a target needs no closer look; each step has one, so this has to be quick."""
    if place.shape != (3,) or place.dtype != np.float64:
        return False
    x, y, z = place.tolist()
    return -_FARTHEST <= x <= _FARTHEST and -_FARTHEST <= y <= _FARTHEST and 0.0 <= z <= _FARTHEST
