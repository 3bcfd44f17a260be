"""Opening a door with an unknown vertical hinge (§4.2.3; Karayiannidis et al., 2016).

The end-effector has velocity control along the estimated tangent, and force control along the
estimated radius. The grasp is rigid, so the radial direction is constant in the end-effector's
frame. `DoorOpening` estimates this direction from the radial force, and the curvature of the
end-effector's path from the torque.
"""

import math
from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from app.control.tasks import Reference
from app.simulation.plants.door import Door, DoorView
from app.simulation.plants.interface import Wrench
from app.simulation.scenarios.leading import Driver, StepInput
from app.simulation.session import Session
from app.strict import Array


@dataclass(frozen=True)
class DoorOpeningGains:
    speed: float = 0.02  # [m/s] v_d, speed of the end-effector along the estimated tangent
    ramp: float = 1.5  # [s] rise time of the speed from zero
    turn: float = math.radians(88)  # [rad] rotation since the start at which the end-effector stops
    braking: float = math.radians(4)  # [rad] range of rotation before `turn` with reduced speed
    radial_force: float = 0.0  # [N] f_d, desired force towards the estimated hinge
    compliance: float = 0.002  # [m/(s N)] α_f, ratio of velocity to force error
    integral_time: float = 4.0  # [s] integral time of the force's PI regulator
    angular_compliance: float = 0.05  # [rad/(s N m)] α_τ, ratio of rotation rate to torque
    learning_rate: float = 1.5  # [1/s] adaptation rate of both estimates at full speed
    slow_from: float = 15.0  # [N] force above which the end-effector slows down
    slow_until: float = 30.0  # [N] force at which the end-effector stops
    smoothing: float = 0.02  # [s] time constant of the filter of force and torque
    leash: float = 0.03  # [m] largest distance of the reference from the end-effector


def tangent(radial: Array, sense: float) -> Array:
    """t̂ = ±e_z × r̂, (3,), from the unit vector r̂ (3,) and the sense of opening, ±1."""
    return sense * np.array([-radial[1], radial[0], 0.0])


def radial_update(
    regulated: float, progress: float, sense: float, gains: DoorOpeningGains
) -> float:
    """Rotation rate [rad/s] of the estimated radial direction about the vertical.
    If the estimated tangent t̂ deviates by the angle e from the true one, the door stops the radial
    part of the motion along t̂. In the steady state at full speed, the force's PI regulator
    R = (f_r - f_d) + ∫(f_r - f_d) dt / T_i [N], with the radial force f_r, satisfies
    α_f R = -s v_d tan e. The rate λ s (v/v_d) α_f R / v_d then reduces the error: ė = -λ tan e.
    `regulated` is R, `progress` is v/v_d along t̂, `sense` is s, ±1.
    """
    return gains.learning_rate * sense * progress * gains.compliance * regulated / gains.speed


def curvature_update(torque: float, progress: float, gains: DoorOpeningGains) -> float:
    """Rate of change [rad/(m s)] of the estimated curvature κ = ω/v of the end-effector's path.
    If the estimate κ̂ is wrong, the end-effector twists the door: (κ̂ - κ) v_d = α_τ τ_z in the
    steady state. The rate is -λ (v/v_d) α_τ τ_z / v_d. `torque` is τ_z [N m], the torque on the
    door about the vertical; `progress` is v/v_d, as in `radial_update`.
    """
    return -gains.learning_rate * progress * gains.angular_compliance * torque / gains.speed


class DoorOpening:
    """The adaptive controller, which computes the end-effector's reference from sensor readings."""

    def __init__(
        self, T_world_ee: pin.SE3, radial_guess: Array, gains: DoorOpeningGains, dt: float
    ) -> None:
        """Start at the handle of a door that opens towards the end-effector. The end-effector's z
        axis points into the door. `radial_guess` (2,) is the first estimate of the horizontal
        direction to the hinge; `dt` [s] is the time between calls of `step`.
        """
        self._gains, self._dt = gains, dt
        self._R_start = T_world_ee.rotation.copy()
        self._angle = math.atan2(radial_guess[1], radial_guess[0])  # initial r̂
        self._pose = T_world_ee.copy()
        into_door = tangent(self.radial(T_world_ee), 1.0) @ self._R_start[:, 2]
        self._sense = -1.0 if into_door > 0.0 else 1.0
        self.curvature = self.speed = self._integral = self._t = 0.0
        """`curvature` is κ̂ [1/m], positive for counter-clockwise turns; `speed` [m/s] is the
        commanded speed along the tangent."""
        self._felt = np.zeros(6)

    def radial(self, T_world_ee: pin.SE3) -> Array:
        """(3,) r̂, the estimated direction to the hinge at a pose of the end-effector."""
        angle = self._angle + self._turned(T_world_ee)
        return np.array([math.cos(angle), math.sin(angle), 0.0])

    def step(self, T_world_ee: pin.SE3, velocity_ee: Array, wrench: Wrench) -> Reference:
        """Update the estimates with sensor readings, and return the reference of the control step.
        The readings are the end-effector's pose, the velocity (3,) [m/s] of its origin in the
        world, and its wrench on the door.
        """
        gains, dt = self._gains, self._dt
        share = -math.expm1(-dt / gains.smoothing)  # of a first-order filter
        self._felt += share * (np.concatenate(wrench) - self._felt)
        force, torque = self._felt[:3], self._felt[3:]
        radial = self.radial(T_world_ee)
        along = tangent(radial, self._sense)
        error = float(force @ radial) - gains.radial_force
        self._integral += error * dt / gains.integral_time
        regulated = error + self._integral
        self.speed = self._desired_speed(force, abs(self._turned(T_world_ee)))
        relief = gains.compliance * (regulated * radial + force * [0.0, 0.0, 1.0])
        velocity = self.speed * along - relief
        turning = np.array([0.0, 0.0, self.curvature * self.speed])
        turning -= gains.angular_compliance * torque
        progress = _share(float(velocity_ee @ along) / gains.speed)
        self._angle += radial_update(regulated, progress, self._sense, gains) * dt
        self.curvature += curvature_update(float(torque[2]), progress, gains) * dt
        lead = self._pose.translation + velocity * dt - T_world_ee.translation
        longest = max(float(np.linalg.norm(lead)) / gains.leash, 1.0)
        self._pose.translation = T_world_ee.translation + lead / longest  # at most a leash ahead
        self._pose.rotation = pin.exp3(turning * dt) @ self._pose.rotation
        self._t += dt
        return Reference(self._pose.copy(), np.concatenate([velocity, turning]), np.zeros(6))

    def _turned(self, T_world_ee: pin.SE3) -> float:
        """[rad] rotation of the end-effector about the vertical since the start."""
        R = T_world_ee.rotation @ self._R_start.T
        return math.atan2(R[1, 0] - R[0, 1], R[0, 0] + R[1, 1])

    def _desired_speed(self, force: Array, turned: float) -> float:
        """[m/s] v_d, reduced at the start, if the door resists, and near the rotation `turn`."""
        gains = self._gains
        left = (gains.turn - turned) / gains.braking
        begun = min(self._t / gains.ramp, 1.0)
        slack = gains.slow_until - float(np.linalg.norm(force))
        slack /= gains.slow_until - gains.slow_from
        return gains.speed * begun**2 * (3 - 2 * begun) * _share(slack) * _share(left)


def opener(door: Door, session: Session, *, rate: float, guess: float) -> Driver:
    """The driver that opens a door at `rate` [deg/s]; `guess` [deg]: the option `radial_guess`."""
    gains = DoorOpeningGains(speed=math.radians(rate) * door.handle_radius)
    turn = -door.side * math.radians(guess)
    turned = np.array([[math.cos(turn), -math.sin(turn)], [math.sin(turn), math.cos(turn)]])
    start, held = session.T_world_ee, session.physics.door
    assert held is not None
    radial = turned @ door.radial(start.translation)
    opening = DoorOpening(start, radial, gains, session.physics.dt)

    def lead(session: Session) -> StepInput:
        wrench, T_ee = held.wrench(), session.T_world_ee
        truth, estimate = door.radial(T_ee.translation), opening.radial(T_ee)
        across = truth[0] * estimate[1] - truth[1] * estimate[0]
        error = math.atan2(across, float(truth @ estimate[:2]))
        view = DoorView(door, held.angle(), wrench.force, float(wrench.force[:2] @ truth), error)
        velocity = session.controller.state.v_ee[:3]
        return StepInput(reference=opening.step(T_ee, velocity, wrench), door=view)

    return lead


def _share(value: float) -> float:
    return min(max(value, 0.0), 1.0)
