"""People who hold the robot, each with one hand, at the end-effector or any point of the arm.

A hand is a spring and a damper with a force limit, and optionally a mass.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import pinocchio as pin

from app.compiled import compiled, direct
from app.config import PersonConfig
from app.errors import TargetError
from app.robot.model import RobotModel
from app.robot.state import RobotState
from app.simulation.plants.interface import Push
from app.strict import Array

_ARM = 2  # pinocchio's first joint of the arm; 1 is the planar joint of the base
_QUICKNESS = 20.0  # [rad/s] bandwidth of the hand's motion towards a new target
_TOP_SPEED = 1.5  # [m/s] largest speed of the hand
_FARTHEST = 1e4  # [m] farthest target from the world's origin
_LINK_SIZE = 1.0  # [m] largest distance of a link's point from its origin
_GRIP = 2e4  # [N/m] stiffness of the grip between a hand with a mass and the robot
_GRIP_DAMPING = 0.5  # [-] damping ratio of that spring with the hand's mass


class Hold(NamedTuple):
    """A person's grip: the held point and its target."""

    who: int
    """Number of the person."""
    target: Array
    """(3,) [m] target of the held point, in the world."""
    link: str | None = None
    """Name of a frame of the arm, one of `held_links`; None is the end-effector."""
    point: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """(3,) [m] the held point, in the link's frame; without a link it is the end-effector's
    origin."""


class PullReading(NamedTuple):
    """One person's pull at one instant; positions and force in the world."""

    who: int
    link: str | None
    """As in `Hold`."""
    point: Array
    """(3,) [m] the held point."""
    target: Array
    """(3,) [m] its target."""
    force: Array
    """(3,) [N] the person's force on that point."""


class PersonForces(NamedTuple):
    """The forces of people on the robot in one control step."""

    hand: Array
    """(3,) [N] sum of the forces on the end-effector's origin, in the world."""
    pushes: tuple[Push, ...] = ()
    """Forces on other points of the arm."""


class People:
    """One `PersonHand` for each person who holds the robot; forces on the same point add."""

    def __init__(self, model: RobotModel, config: PersonConfig, dt: float) -> None:
        """Without people; `config` is the strength of each, `dt` [s] the period of `pull`."""
        self.config = config
        self._model, self._dt = model, dt
        self._hands: dict[tuple[object, ...], PersonHand] = {}

    def pull(
        self, state: RobotState, holds: Sequence[Hold]
    ) -> tuple[tuple[PullReading, ...], PersonForces]:
        """The pull of each person in one period, and all forces; people without a hold release.

        A person who changes to another point releases the previous one and grips without a jerk.
        Each `who` has at most one hold.

        Raises:
            TargetError: A target is below the floor, or is not three finite numbers.
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
    """F = K (p - p_ee) - D v_ee, limited to f_max, where p follows the target smoothly.

    Targets arrive 20 times a second with jumps; p moves towards the latest as a critically damped
    point of limited speed, from the point of the grip. Thus F has no steps at 1 kHz. The damper
    acts against the world: with p at rest the person only absorbs energy.

    A hand with a mass is between the two: F moves the mass, and the robot receives the force that
    the grip transmits. It exceeds f_max while the mass stops, is smaller while the mass
    accelerates, and equals F at rest. Spring, damper, mass and grip are passive, so with p at rest
    such a hand only absorbs energy as well.
    """

    def __init__(self, config: PersonConfig, dt: float = 0.001) -> None:
        """A person who does not hold the robot; `dt` [s] is the period of `force`."""
        self.config, self._dt = config, dt
        """K, D, f_max and the mass; may be replaced at any time."""
        self.motion: Array | None = None
        """(2, 3) p [m] and its velocity [m/s]; None while the robot is not held."""
        self._mass: Array | None = None  # (2, 3) position and velocity of the hand's mass

    def force(self, p_ee: Array, v_ee: Array, target: Sequence[float] | Array | None) -> Array:
        """(3,) [N] the person's force on the end-effector for one period, in the world.

        The end-effector is at p_ee (3,) [m] with a velocity (3,) [m/s]; without a target (3,) [m]
        the person releases.

        Raises:
            TargetError: The target is below the floor, or is not three finite numbers.
        """
        if target is None:
            self.motion = self._mass = None
            return np.zeros(3)
        place = checked_target(target)
        if self.motion is None:
            self.motion = np.array([p_ee, np.zeros(3)], dtype=float)
        config = self.config
        spring = config.stiffness, config.damping, config.f_max
        self.motion, force = _pull_once(self.motion, place, p_ee, v_ee, *spring, self._dt)
        if config.mass == 0.0:
            self._mass = None
            return force
        if self._mass is None:  # starts with the robot's velocity
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
    """(3,) [m] a valid target of a person, in the world.

    Raises:
        TargetError: The place is below the floor, farther away than 10 km, or not three finite
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
        TargetError: The point is too far from the link, or not three finite numbers.
    """
    place = _finite_point(point, "the held point")
    if np.linalg.norm(place) > _LINK_SIZE:
        raise TargetError(
            f"the held point is farther than {_LINK_SIZE:g} m from its link: {point!r}"
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
        The hand a period later, and (3,) [N] its force in that period.
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

    F = K' (p - x) - D ẋ, limited to f_max, moves it, and the grip G = k (x - p_ee) +
    c (ẋ - v_ee) moves the robot. Both hold at the period's end, with the end-effector
    extrapolated by its velocity. K' and the grip in series are as stiff as K. The rule is stable
    for every mass, spring and damper; if F exceeds f_max, its direction does not change.

    Args:
        held: (2, 3) x [m] and ẋ [m/s].
        p: (3,) [m] target of the spring.
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
    alone = mass + dt * (grip_damping + dt * _GRIP)  # [kg] effective mass of F in this rule
    grip = p_ee + dt * v_ee
    driven = mass * held[1] + dt * (grip_damping * v_ee - _GRIP * (held[0] - grip))
    pull = K * (p - held[0])
    unlimited = (driven + dt * pull) / (alone + dt * (damping + dt * K))  # [m/s]
    push = _shortened(pull - (damping + dt * K) * unlimited, f_max)
    v = (driven + dt * push) / alone
    x = held[0] + dt * v
    return np.stack((x, v)), _GRIP * (x - grip) + grip_damping * (v - v_ee)


_pull_once, _push_once = direct(_pull), direct(_push_mass)
