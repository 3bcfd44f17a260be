"""People who hold the robot, each with one hand, at the end-effector or any point of the arm.

A hand is a spring, a damper, a limited strength and, if it has one, a mass.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import pinocchio as pin

from app.compiled import compiled, direct
from app.config import HandConfig
from app.errors import TargetError
from app.robot.model import RobotModel
from app.robot.state import RobotState
from app.simulation.plants.interface import Push
from app.strict import Array

_ARM = 2  # pinocchio's first joint of the arm; 1 is the planar joint of the base
_QUICKNESS = 20.0  # [rad/s] of the hand's motion towards a new target
_TOP_SPEED = 1.5  # [m/s] of the hand
_FARTHEST = 1e4  # [m] from the world's origin
_LINK_SIZE = 1.0  # [m] no part of a link is farther from its origin
_GRIP = 2e4  # [N/m] of the flesh between a hand with a mass and the robot
_GRIP_DAMPING = 0.5  # [-] of that spring with the hand's mass on it, of the critical one


class Hold(NamedTuple):
    """Where somebody holds the robot, and where to."""

    who: int
    """Number of the person."""
    target: Array
    """(3,) [m] where the point is pulled, in the world."""
    link: str | None = None
    """Name of a frame of the arm, one of `held_links`; None is the end-effector."""
    point: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """(3,) [m] the point that is held, in the link's frame; without a link it is the end-effector's
    origin."""


class PullReading(NamedTuple):
    """One person's pull at one instant; positions and force in the world."""

    who: int
    link: str | None
    """As in `Hold`."""
    point: Array
    """(3,) [m] where the robot is held."""
    target: Array
    """(3,) [m] where to."""
    force: Array
    """(3,) [N] the person's force on that point."""


class PersonForces(NamedTuple):
    """What people do to the robot in one control step."""

    hand: Array
    """(3,) [N] sum of the forces on the end-effector's origin, in the world."""
    pushes: tuple[Push, ...] = ()
    """Those on other points of the arm."""


class People:
    """One `PersonHand` for each who holds; forces on the same point add up."""

    def __init__(self, model: RobotModel, config: HandConfig, dt: float) -> None:
        """Nobody holds the robot; `config` is the strength of each, `dt` [s] between two `pull`."""
        self.config = config
        self._model, self._dt = model, dt
        self._hands: dict[tuple[object, ...], PersonHand] = {}

    def pull(
        self, state: RobotState, holds: Sequence[Hold]
    ) -> tuple[tuple[PullReading, ...], PersonForces]:
        """What each does in one period, and all together; who is not among them lets go.

        Whoever takes another point lets go of the one before, and takes hold without a jerk. Each
        `who` has at most one hold.

        Raises:
            TargetError: A target lies below the floor, or is not three finite numbers.
        """
        hands, readings, pushes = {}, [], []
        total = np.zeros(3)
        for who, target, link, point in holds:
            same = who, link, point
            hand = hands[same] = self._hands.get(same) or PersonHand(self.config, self._dt)
            hand.config = self.config
            if link is None:
                p = state.p_ee
                force = hand.force(p, state.v_ee[:3], target)
                total = total + force
            else:
                joint, at = held_point(self._model, link, point)
                p = state.data.oMi[joint].act(at)
                force = hand.force(p, state.point_velocity(joint, p), target)
                pushes.append(Push(self._model.pin.names[joint], at, force))
            readings.append(PullReading(who, link, p.copy(), target, force))
        self._hands = hands
        return tuple(readings), PersonForces(total, tuple(pushes))


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
        """A person who does not hold the robot; `dt` [s] is between two calls of `force`."""
        self.config, self._dt = config, dt
        """K, D, f_max and the mass; may be replaced at any time."""
        self.motion: Array | None = None
        """(2, 3) p [m] and its velocity [m/s]; None while the robot is not held."""
        self._mass: Array | None = None  # (2, 3) the same of the mass in the hand

    def force(self, p_ee: Array, v_ee: Array, target: Sequence[float] | Array | None) -> Array:
        """(3,) [N] the person's force on the end-effector for one period, in the world.

        The end-effector is at p_ee (3,) [m] with a velocity (3,) [m/s]; without a target (3,) [m]
        the person lets go.

        Raises:
            TargetError: The target lies below the floor, or is not three finite numbers.
        """
        if target is None:
            self.motion = self._mass = None
            return np.zeros(3)
        place = np.asarray(target, dtype=float)
        if place.shape != (3,) or not _within_reach(place):
            checked_target(target)
        if self.motion is None:
            self.motion = np.array([p_ee, np.zeros(3)], dtype=float)
        config = self.config
        spring = config.stiffness, config.damping, config.f_max
        self.motion, force = _pull_once(self.motion, place, p_ee, v_ee, *spring, self._dt)
        if config.mass == 0.0:
            self._mass = None
            return force
        if self._mass is None:  # it moves with what it takes hold of
            self._mass = np.array([p_ee, v_ee], dtype=float)
        self._mass, force = _push_once(
            self._mass, self.motion[0], p_ee, v_ee, *spring, config.mass, self._dt
        )
        return force


def held_links(model: RobotModel) -> tuple[str, ...]:
    """Names of the frames at which the arm can be held: its joints, links and the end-effector."""
    names = [frame.name for frame in model.pin.frames if frame.parentJoint >= _ARM]
    return tuple(dict.fromkeys(names))


def held_point(model: RobotModel, link: str, point: Sequence[float]) -> tuple[int, Array]:
    """The joint that carries a point of a link's frame, and (3,) [m] the point in its frame."""
    frame: pin.Frame = model.pin.frames[model.pin.getFrameId(link)]
    return frame.parentJoint, frame.placement.act(np.array(point, dtype=float))


def checked_target(target: Sequence[float] | Array) -> Array:
    """(3,) [m] a place in the world to which a person may pull.

    Raises:
        TargetError: It lies below the floor or farther away than 10 km, or is not three finite
            numbers.
    """
    place = _finite_point(target, "the hand's target")
    if _within_reach(place):
        return place
    z = place.item(2)
    if z < 0:
        raise TargetError(f"the hand's target is at z = {z:.3f} m, below the floor, which is z = 0")
    raise TargetError(f"the hand's target is farther away than {_FARTHEST:g} m: {target!r}")


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


@compiled("b1(f8[:])")
def _within_reach(p: Array) -> bool:
    """Whether a person can pull to p (3,) [m]; False where a coordinate is not a number."""
    return bool(0.0 <= p[2] <= _FARTHEST and max(abs(p[0]), abs(p[1])) <= _FARTHEST)


@compiled()
def _shortened(vector: Array, longest: float) -> Array:
    length = math.sqrt(vector[0] ** 2 + vector[1] ** 2 + vector[2] ** 2)
    return vector * (longest / length) if length > longest else vector


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
    a = _QUICKNESS**2 * (target - hand[0]) - 2 * _QUICKNESS * hand[1]
    v = _shortened(hand[1] + a * dt, _TOP_SPEED)
    p = hand[0] + v * dt
    return np.stack((p, v)), _shortened(stiffness * (p - p_ee) - damping * v_ee, f_max)


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
    grip = p_ee + dt * v_ee
    driven = mass * held[1] + dt * (grip_damping * v_ee - _GRIP * (held[0] - grip))
    pull = K * (p - held[0])
    unlimited = (driven + dt * pull) / (alone + dt * (damping + dt * K))  # [m/s]
    push = _shortened(pull - (damping + dt * K) * unlimited, f_max)
    v = (driven + dt * push) / alone
    x = held[0] + dt * v
    return np.stack((x, v)), _GRIP * (x - grip) + grip_damping * (v - v_ee)


_pull_once, _push_once = direct(_pull), direct(_push_mass)
