"""Opening a door whose hinge is unknown: velocity along the estimated tangent, force along the
estimated radius (§4.2.3; Karayiannidis et al., 2016).

The problem is planar, about the vertical: the hinge is upright. The hand holds the door firmly, so
that the radial direction is fixed in the hand, which turns with the door. What is learnt while the
hand moves: that direction, from the radial force, and the path's curvature, from the torque.
"""

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import pinocchio as pin

from app.control.tasks import Reference
from app.simulation.plants.door import Door, DoorReading
from app.simulation.scenarios.leading import Lead
from app.simulation.session import Session
from app.strict import Array


@dataclass(frozen=True)
class DoorOpeningGains:
    """Gains of the adaptive controller."""

    speed: float = 0.02
    """[m/s] v_d, of the hand along the estimated tangent."""
    ramp: float = 1.5
    """[s] in which the speed rises from zero."""
    turn: float = math.radians(88)
    """[rad] of the hand's own turning at which the door is open enough."""
    braking: float = math.radians(4)
    """[rad] before that from which on the hand moves slower."""
    radial_force: float = 0.0
    """[N] f_d, wanted along the estimated radius, towards the hinge."""
    compliance: float = 0.002
    """[m/(s N)] α_f, speed by which the hand yields to a force."""
    integral_time: float = 4.0
    """[s] of the force's PI regulator."""
    angular_compliance: float = 0.05
    """[rad/(s N m)] α_τ, turning by which the hand yields to a torque."""
    learning_rate: float = 1.5
    """[1/s] of both estimates at the full speed."""
    slow_from: float = 15.0
    """[N] of force from which on the hand moves slower."""
    slow_until: float = 30.0
    """[N] of force at which it does not move on."""
    smoothing: float = 0.02
    """[s] time constant of the filter on what is felt; without it force and motion would ring."""
    leash: float = 0.03
    """[m] how far the reference may lead the hand."""


class HandReading(NamedTuple):
    """What the robot senses of its hand; all in the world."""

    T_world_ee: pin.SE3
    velocity: Array
    """(3,) [m/s] of its origin."""
    force: Array
    """(3,) [N] that the hand exerts on the door."""
    torque: Array
    """(3,) [N m] that it exerts there about the end-effector's origin."""


def tangent(radial: Array, sense: float) -> Array:
    """t̂ = ±e_z × r̂, (3,), from the unit vector r̂ (3,) and the sense of opening, ±1."""
    return sense * np.array([-radial[1], radial[0], 0.0])


def radial_update(
    regulated: float, progress: float, sense: float, gains: DoorOpeningGains
) -> float:
    """[rad/s] law by which the estimate of the radial direction turns about the vertical.

    Where t̂ is e off the true tangent, moving along it pushes against the hinge with
    α_f (f_r - f_d) = -s v_d sin e in the steady state; the law is e's gradient step,
    λ s (v/v_d) α_f (f_r - f_d) / v_d, so that ė = -λ sin e at full speed.

    Args:
        regulated: [N] f_r - f_d with its integral, as the regulator takes it.
        progress: [-] v/v_d, measured speed of the hand along t̂ over the wanted one.
        sense: s, ±1.
        gains: λ, α_f, v_d.
    """
    return gains.learning_rate * sense * progress * gains.compliance * regulated / gains.speed


def curvature_update(torque: float, progress: float, gains: DoorOpeningGains) -> float:
    """[rad/(m s)] law of the estimate of the signed curvature κ = ω/v of the hand's path.

    Where κ̂ is off, the hand's turning leads the door's and twists it: (κ̂ - κ) v_d = α_τ τ_z in the
    steady state; the law is -λ (v/v_d) α_τ τ_z / v_d.

    Args:
        torque: [N m] τ_z that the hand exerts on the door.
        progress: [-] as in `radial_update`.
        gains: λ, α_τ, v_d.
    """
    return -gains.learning_rate * progress * gains.angular_compliance * torque / gains.speed


class DoorOpening:
    """The adaptive controller; gives the end-effector's reference from what the hand senses."""

    def __init__(
        self, T_world_ee: pin.SE3, radial_guess: Array, gains: DoorOpeningGains, dt: float
    ) -> None:
        """Take hold of a door that opens towards where the hand comes from, whose z axis is into
        the door.

        `radial_guess` (2,) is the first guess of the direction towards the hinge, in plan; `dt` [s]
        is between two calls of `step`.
        """
        self._gains, self._dt = gains, dt
        self._R_start = T_world_ee.rotation.copy()
        self._angle = math.atan2(radial_guess[1], radial_guess[0])  # of r̂, were the hand unturned
        self._pose = T_world_ee.copy()
        self._sense = 1.0
        out_of_door = -self._R_start[:, 2]
        if tangent(self.radial(T_world_ee), 1.0) @ out_of_door < 0.0:
            self._sense = -1.0
        self.curvature = self.speed = self._integral = self._t = 0.0
        """κ̂ [1/m], signed: positive turns counter-clockwise; v [m/s] along the tangent that is
        asked now."""
        self._felt = np.zeros(6)

    def radial(self, T_world_ee: pin.SE3) -> Array:
        """(3,) r̂, the estimated direction towards the hinge, for the hand at a pose."""
        angle = self._angle + self._turned(T_world_ee)
        return np.array([math.cos(angle), math.sin(angle), 0.0])

    def step(self, hand: HandReading) -> Reference:
        """The reference of one control step; the estimates learn from the reading."""
        gains, dt = self._gains, self._dt
        share = -math.expm1(-dt / gains.smoothing)  # of a filter of first order
        self._felt += share * (np.concatenate([hand.force, hand.torque]) - self._felt)
        force, torque = self._felt[:3], self._felt[3:]
        radial = self.radial(hand.T_world_ee)
        along = tangent(radial, self._sense)
        error = float(force @ radial) - gains.radial_force
        self._integral += error * dt / gains.integral_time
        regulated = error + self._integral
        self.speed = self._asked_speed(force, abs(self._turned(hand.T_world_ee)))
        velocity = self.speed * along - gains.compliance * (
            regulated * radial + force * [0.0, 0.0, 1.0]
        )
        turning = np.array([0.0, 0.0, self.curvature * self.speed])
        turning -= gains.angular_compliance * torque
        progress = _share(float(hand.velocity @ along) / gains.speed)
        self._angle += radial_update(regulated, progress, self._sense, gains) * dt
        self.curvature += curvature_update(float(torque[2]), progress, gains) * dt
        self._lead(hand.T_world_ee, velocity, turning)
        self._t += dt
        return Reference(self._pose.copy(), np.concatenate([velocity, turning]), np.zeros(6))

    def _turned(self, T_world_ee: pin.SE3) -> float:
        """[rad] how far the hand has turned about the vertical since the start."""
        R = T_world_ee.rotation @ self._R_start.T
        return math.atan2(R[1, 0] - R[0, 1], R[0, 0] + R[1, 1])

    def _asked_speed(self, force: Array, turned: float) -> float:
        """[m/s] v_d after a smooth start, less where the door resists or is open enough."""
        gains = self._gains
        left = (gains.turn - turned) / gains.braking
        begun = min(self._t / gains.ramp, 1.0)
        slack = (gains.slow_until - float(np.linalg.norm(force))) / (
            gains.slow_until - gains.slow_from
        )
        return gains.speed * begun**2 * (3 - 2 * begun) * _share(slack) * _share(left)

    def _lead(self, T_world_ee: pin.SE3, velocity: Array, turning: Array) -> None:
        """Move the reference on, no farther from the hand than the leash."""
        lead = self._pose.translation + velocity * self._dt - T_world_ee.translation
        longest = max(float(np.linalg.norm(lead)) / self._gains.leash, 1.0)
        self._pose.translation = T_world_ee.translation + lead / longest
        self._pose.rotation = pin.exp3(turning * self._dt) @ self._pose.rotation


class Opener:
    """The adaptive controller at the sensors of a session."""

    def __init__(self, door: Door, session: Session, *, rate: float, guess: float) -> None:
        """Begin with the hand of a session at the handle of the door that it holds.

        `rate` [deg/s] is the door's turning that the hand's speed gives, and `guess` [deg] by how
        much the first guess of the direction to the hinge is wrong.
        """
        self._door = door
        T_ee = session.T_world_ee
        speed = math.radians(rate) * door.handle_radius
        gains = DoorOpeningGains(speed=speed)
        turn = -door.side * math.radians(guess)
        turned = np.array([[math.cos(turn), -math.sin(turn)], [math.sin(turn), math.cos(turn)]])
        radial = turned @ door.radial(T_ee.translation)
        self._opening = DoorOpening(T_ee, radial, gains, session.physics.dt)

    def __call__(self, session: Session) -> Lead:
        assert session.physics.door is not None
        wrench = session.physics.door.wrench()
        T_ee, velocity = session.T_world_ee, session.controller.state.v_ee[:3]
        truth = self._door.radial(T_ee.translation)
        guess = self._opening.radial(T_ee)
        reading = DoorReading(
            session.physics.door.angle(),
            wrench.force,
            float(wrench.force[:2] @ truth),
            math.atan2(truth[0] * guess[1] - truth[1] * guess[0], float(truth @ guess[:2])),
        )
        reference = self._opening.step(HandReading(T_ee, velocity, wrench.force, wrench.torque))
        return Lead(reference=reference, door=reading)


def _share(value: float) -> float:
    return min(max(value, 0.0), 1.0)
