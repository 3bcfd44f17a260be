"""Smooth random motions of the whole robot, with exact velocities and accelerations."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from app.robot.model import RobotModel
from app.robot.state import Measurement, RobotState

Array = np.ndarray

_BAND = 0.3, 1.5  # [Hz] range of the frequencies
_WAVES = 3  # [-] sines of each coordinate
_SAMPLES = 16  # [-] samples of a motion for the computation of its largest speed


class Waves(NamedTuple):
    """x(t) = x_0 + Σ a_k sin(ω_k t + φ_k) for some coordinates.

    Attributes:
        middle: (m,) x_0.
        amplitude, phase: (k, m) a and φ.
        rate: (k, m) [rad/s] ω.
    """

    middle: Array
    amplitude: Array
    phase: Array
    rate: Array

    def at(self, t: float) -> tuple[Array, Array, Array]:
        """x, ẋ and ẍ (m,) at time t [s]."""
        angle = self.rate * t + self.phase
        s, c = self.amplitude * np.sin(angle), self.amplitude * np.cos(angle)
        return (
            self.middle + s.sum(axis=0),
            (self.rate * c).sum(axis=0),
            -(self.rate**2 * s).sum(axis=0),
        )


class Motion(NamedTuple):
    """A motion of arm and base. The base's pose is constant, because no distance depends on it.

    Attributes:
        arm: Motion of the joints (n_m,) [rad or m].
        base: Motion along the base's axes; its first derivative (n_b,) is the base's velocity.
    """

    arm: Waves
    base: Waves

    def at(self, t: float) -> tuple[Measurement, Array, Array]:
        """The readings and the accelerations of base (n_b,) and arm (n_m,) at time t [s]."""
        q, qd, qdd = self.arm.at(t)
        _, v, vd = self.base.at(t)
        return Measurement(np.zeros(3), v, q, qd), vd, qdd


def random_motion(
    model: RobotModel, q: Array, speed: float, rng: np.random.Generator, duration: float
) -> Motion:
    """A motion in which the arm passes q (n_m,) at half of the duration, with a bounded speed.

    Args:
        model: The robot.
        q: (n_m,) [rad or m] joint positions at half of the duration.
        speed: [m/s] largest speed of the end-effector in the world.
        rng: Random generator.
        duration: [s] duration of the motion.
    """
    motion = Motion(random_waves(q, rng, 1.0), random_waves(np.zeros(model.n_b), rng, 0.2))
    scale = speed / _fastest(model, motion, duration)
    arm, base = (
        waves._replace(amplitude=scale * waves.amplitude) for waves in (motion.arm, motion.base)
    )
    offset = arm.at(0.5 * duration)[0] - q
    return Motion(arm._replace(middle=arm.middle - offset), base)


def one_joint_motion(model: RobotModel, q: Array, joint: int, speed: float, t: float) -> Motion:
    """A motion of joint number `joint` that passes q (n_m,) at t [s] with a speed [rad/s]."""
    rate = 2 * math.pi * _BAND[0]
    amplitude = np.zeros((1, model.n_m))
    amplitude[0, joint] = speed / rate
    arm = Waves(q, amplitude, np.full_like(amplitude, -rate * t), np.full_like(amplitude, rate))
    still = np.zeros((1, model.n_b))
    return Motion(arm, Waves(still[0], still, still, still))


def random_waves(middle: Array, rng: np.random.Generator, size: float) -> Waves:
    """Sines about a middle (m,), with random frequencies and rates of change of the size `size`."""
    shape = _WAVES, len(middle)
    rate = 2 * math.pi * rng.uniform(_BAND[0], _BAND[1], shape)
    return Waves(
        middle, size * rng.normal(size=shape) / rate, rng.uniform(0, 2 * math.pi, shape), rate
    )


def _fastest(model: RobotModel, motion: Motion, duration: float) -> float:
    """[m/s] largest speed of the end-effector, with the constant joint positions `arm.middle`."""
    state, fastest = RobotState(model), 1e-9
    for t in np.linspace(0.0, duration, _SAMPLES):
        measured = motion.at(float(t))[0]._replace(q_m=motion.arm.middle)
        state.update_kinematics(measured)
        fastest = max(fastest, float(np.linalg.norm(state.v_ee[:3])))
    return fastest
