"""People who hold the robot, each with one hand: a spring, a damper and optionally a mass."""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import pinocchio as pin

from app.compiled import compiled, direct
from app.config import PersonConfig
from app.control.qp import fill, put
from app.errors import TargetError
from app.robot.model import RobotModel
from app.robot.state import RobotState
from app.simulation.plants.interface import Push
from app.strict import Array

_ARM = 2  # pinocchio's index of the arm's first joint; joint 1 is the base's planar joint
_QUICKNESS = 20.0  # [rad/s] natural frequency of the motion of the spring's free end
_TOP_SPEED = 1.5  # [m/s] largest speed of this end
_FARTHEST = 1e4  # [m] largest coordinate of a target in the world
_LINK_SIZE = 1.0  # [m] largest distance of a held point from the origin of its link
_GRIP = 2e4  # [N/m] stiffness of the grip between a hand with a mass and the robot
_GRIP_DAMPING = 0.5  # [-] damping ratio of that spring with the hand's mass


class Hold(NamedTuple):
    """A person's grip: the held point and its target."""

    who: int  # number of the person
    target: Array  # (3,) [m] target of the held point, in the world
    link: str | None = None  # one of `held_links`; None is the end-effector
    point: tuple[float, float, float] = (0.0, 0.0, 0.0)  # [m] in the frame of `link`, if any


class PullReading(NamedTuple):
    """One person's pull at one instant; positions and force are in the world."""

    who: int  # number of the person
    link: str | None  # as in `Hold`
    point: Array  # (3,) [m] the held point
    target: Array  # (3,) [m] target of the held point
    force: Array  # (3,) [N] the person's force on the held point


class PersonForces(NamedTuple):
    """The forces of people on the robot in one control step."""

    hand: Array  # (3,) [N] sum of the forces on the end-effector's origin, in the world
    pushes: tuple[Push, ...] = ()  # forces on the held points of links


class People:
    """One `PersonHand` for each person who holds the robot; forces on the same point add."""

    def __init__(self, model: RobotModel, config: PersonConfig, dt: float) -> None:
        """Start without people; `dt` [s] is the time between two calls of `pull`."""
        self._model, self._config, self._dt = model, config, dt
        self._hands: dict[tuple[object, ...], PersonHand] = {}

    def configure(self, config: PersonConfig) -> None:
        """Use other parameters of all people from the next call of `pull` on."""
        self._config = config
        for hand in self._hands.values():
            hand.configure(config)

    def pull(
        self, state: RobotState, holds: Sequence[Hold]
    ) -> tuple[tuple[PullReading, ...], PersonForces]:
        """The pull of each person in one control step, and the forces of all on the robot. `holds`
        has at most one hold of each person; a person without a hold releases the robot. A hold at a
        new point starts with an unstretched spring. An invalid target raises a TargetError.
        """
        hands, readings, pushes, total = {}, [], [], np.zeros(3)
        for who, target, link, point in holds:
            same = who, link, point
            hand = hands[same] = self._hands.get(same) or PersonHand(self._config, self._dt)
            if link is None:
                p = state.p_ee
                force = hand.force(p, state.v_ee, target)
                total += force
            else:
                joint, at = held_point(self._model, link, point)
                p = state.data.oMi[joint].act(at)
                force = hand.force(p, state.point_velocity(joint, p), target)
                pushes.append(Push(self._model.pin.names[joint], at, force))
            readings.append(PullReading(who, link, p.copy(), target, force))
        self._hands = hands
        return tuple(readings), PersonForces(total, tuple(pushes))


class PersonHand:
    """A person's hand during one hold of the robot's point p_ee, which has velocity v_ee.
    A hand without a mass exerts F = K (p - p_ee) - D v_ee on the held point, limited to f_max. p,
    the free end of the hand's spring, starts at p_ee and moves towards the latest target as a
    critically damped point with limited speed. Thus, a new target causes no step of F. A similar
    force moves the mass of a hand (`_push_mass`). The robot then receives the force of the grip, a
    spring and a damper between mass and robot. While the robot stops the mass, the grip's force can
    exceed f_max. While p rests, the hand is passive.
    """

    def __init__(self, config: PersonConfig, dt: float = 0.001) -> None:
        """Begin one hold; `dt` [s] is the time between two calls of `force`."""
        self._dt = dt
        self.motion = np.full((4, 3), np.nan)  # [m, m/s] p, ṗ; x, ẋ of the mass
        self.configure(config)

    def configure(self, config: PersonConfig) -> None:
        """Use other parameters from the next call of `force` on."""
        spring = config.stiffness, config.damping, config.f_max, config.mass
        self._spring = np.array([*spring, self._dt])

    def force(self, p_ee: Array, v_ee: Array, target: Sequence[float] | Array) -> Array:
        """Compute the person's force (3,) [N] on the held point for one step, in the world. The
        point is at `p_ee` (3,) [m], its velocity [m/s] is in the first three entries of `v_ee`, and
        its target is `target` (3,) [m]. An invalid target raises a TargetError.
        """
        force = np.empty(3)
        _pull_once(self.motion, checked_target(target), p_ee, v_ee, self._spring, force)
        return force


def held_links(model: RobotModel) -> tuple[str, ...]:
    """Names of the frames at which people can hold the arm: joints, links and end-effector."""
    names = [frame.name for frame in model.pin.frames if frame.parentJoint >= _ARM]
    return tuple(dict.fromkeys(names))


def held_point(model: RobotModel, link: str, point: Sequence[float]) -> tuple[int, Array]:
    """Index of the joint that moves a link; the link's `point` (3,) [m] in that joint's frame."""
    frame: pin.Frame = model.pin.frames[model.pin.getFrameId(link)]
    return frame.parentJoint, frame.placement.act(np.array(point, dtype=float))


def checked_target(target: Sequence[float] | Array) -> Array:
    """A person's target in the world as an array (3,) [m]. A target that is not three finite
    numbers, is below the floor, or has a coordinate beyond ±10 km raises a TargetError.
    """
    place = _finite(target, "the hand's target")
    x, y, z = place.tolist()
    if z < 0:
        raise TargetError(f"the hand's target is at z = {z:.3f} m, below the floor at z = 0")
    if max(abs(x), abs(y), z) > _FARTHEST:
        raise TargetError(f"a coordinate of the hand's target exceeds {_FARTHEST:g} m: {target!r}")
    return place


def checked_hold(point: Sequence[float] | Array) -> Array:
    """A held point in the frame of a link as an array (3,) [m]. A point that is not three finite
    numbers, or is more than 1 m from the link's origin, raises a TargetError.
    """
    place = _finite(point, "the held point")
    if np.linalg.norm(place) > _LINK_SIZE:
        why = f"the held point is farther than {_LINK_SIZE:g} m from its link's origin"
        raise TargetError(f"{why}: {point!r}")
    return place


def _finite(point: Sequence[float] | Array, name: str) -> Array:
    try:
        place = np.asarray(point, dtype=float)
        x, y, z = place.tolist()
        if math.isfinite(x) and math.isfinite(y) and math.isfinite(z):
            return place
    except (TypeError, ValueError):
        pass
    raise TargetError(f"{name} must be three finite numbers, not {point!r}")


@compiled()
def _shorten(vector: Array, longest: float) -> None:
    """Shorten a vector (3,), in place, to the length `longest` if it is longer."""
    length = math.sqrt(vector[0] ** 2 + vector[1] ** 2 + vector[2] ** 2)
    if length > longest:
        for i in range(3):
            vector[i] *= longest / length


@compiled()
def _push_mass(
    x: Array, x_dot: Array, p: Array, p_ee: Array, v_ee: Array, spring: Array, force: Array
) -> None:
    """Move the mass m, at `x` with velocity `x_dot`, by one implicit Euler step of m ẍ = F - G.
    F = K' (p - x) - D ẋ, shortened to f_max, acts on the mass at x; G = k (x - p_ee) + c (ẋ - v_ee)
    is the grip's force on the robot, written to `force`. Both forces are those at the end of the
    step, for a held point with constant velocity. K' and k in series have the stiffness K of
    `PersonHand`. The rule is stable for every mass, spring and damper.
    """
    stiffness, damping, f_max, mass, dt = spring
    K = stiffness * _GRIP / (_GRIP - stiffness)
    grip_damping = 2.0 * _GRIP_DAMPING * math.sqrt(_GRIP * mass)
    alone = mass + dt * (grip_damping + dt * _GRIP)  # [kg] mass that F moves in this rule
    grip = p_ee + dt * v_ee
    driven = mass * x_dot + dt * (grip_damping * v_ee - _GRIP * (x - grip))
    pull = K * (p - x)
    unlimited = (driven + dt * pull) / (alone + dt * (damping + dt * K))  # [m/s]
    push = pull - (damping + dt * K) * unlimited
    _shorten(push, f_max)
    put(x_dot, (driven + dt * push) / alone)
    put(x, x + dt * x_dot)
    put(force, _GRIP * (x - grip) + grip_damping * (x_dot - v_ee))


@compiled("void(f8[:,:], f8[:], f8[:], f8[:], f8[:], f8[:])")
def _pull(
    motion: Array, target: Array, p_ee: Array, v_ee: Array, spring: Array, force: Array
) -> None:
    """Move the hand for one step, and write its force (3,) [N] on the held point to `force`.
    The free end p of the spring follows p̈ = ω² (target - p) - 2 ω ṗ, with limited speed. `motion`
    (4, 3), changed in place, has the rows p [m], ṗ [m/s], and the mass's x [m] and ẋ [m/s]. Before
    the first step it is NaN; without a mass, x is NaN. `spring` (5,) is K [N/m], D [N s/m],
    f_max [N], the mass [kg] and the step [s].
    """
    p, v, x, x_dot = motion
    stiffness, damping, f_max, mass, dt = spring
    if math.isnan(p[0]):
        put(p, p_ee)
        fill(v, 0.0)
    for i in range(3):
        v[i] += (_QUICKNESS**2 * (target[i] - p[i]) - 2 * _QUICKNESS * v[i]) * dt
    _shorten(v, _TOP_SPEED)
    for i in range(3):
        p[i] += v[i] * dt
        force[i] = stiffness * (p[i] - p_ee[i]) - damping * v_ee[i]
    _shorten(force, f_max)
    if mass == 0.0:
        fill(x, np.nan)
        return
    if math.isnan(x[0]):  # the mass starts with the held point's velocity
        put(x, p_ee)
        put(x_dot, v_ee[:3])
    _push_mass(x, x_dot, p, p_ee, v_ee[:3], spring, force)


_pull_once = direct(_pull)
