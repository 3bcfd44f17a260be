"""Where the arm is, how it moves and who pushes it, from readings with noise and known torques."""

from __future__ import annotations

import math

import numpy as np

from app.compiled import compiled
from app.config import EstimateConfig
from app.control.active_sets import backward, cholesky, forward
from app.robot.state import Measurement, RobotState
from app.strict import Array


class ArmEstimate:
    """A Kalman filter of each joint: its position, its velocity, and how others accelerate it.

    Torques and the base's motion say what a joint does by itself; what it does besides is a random
    walk. How far readings are trusted follows from the noise of positions, which is learnt: the
    third differences of what is not known of a motion are noise, with 20 times its variance. So
    readings without noise are followed at once, and noisy ones do not shake the arm.

    Tasks never see who pushes: a guided hand stays free. Limits do, so that a joint's speed and a
    distance are kept while a person pulls.
    """

    def __init__(self, n_m: int) -> None:
        """Prepare for an arm of `n_m` joints."""
        self._n_m = n_m
        self.reset()

    def reset(self) -> None:
        """Nobody touches the robot, and its readings have no noise that is known."""
        self.pushed = np.zeros(self._n_m)
        """(n_m,) [rad/s² or m/s²] M_aa⁻¹ r, with r the torques that others exert on the joints."""
        self._samples, self._seen = 0, np.zeros((4, self._n_m))
        self._x, self._P = np.zeros((3, self._n_m)), np.zeros((self._n_m, 3, 3))
        self.begin_anew()

    def begin_anew(self) -> None:
        """Take the next readings as they come; noise and who pushes stay."""
        self._base_velocity: Array | None = None

    @property
    def noise(self) -> Array:
        """(n_m,) [rad or m] standard deviation of the positions' noise, as learnt so far."""
        return np.sqrt(self._seen[3])

    def update(
        self,
        measured: Measurement,
        state: RobotState,
        u_a: Array | None,
        config: EstimateConfig,
        dt: float,
    ) -> Measurement:
        """The readings with the arm's estimated positions and velocities in their place.

        Args:
            measured: The readings at the end of a period.
            state: The robot's state at its begin, of which M and h are taken.
            u_a: (n_m,) [N m or N] torques given within it; None if there was no period yet.
            config: How noise and pushes are told apart.
            dt: [s] how long it lasted.
        """
        q, qd = measured.q_m, measured.qd_m
        then, self._base_velocity = self._base_velocity, measured.base_velocity
        if then is None or u_a is None or _elsewhere(self._x, q, state.model.qd_max, dt):
            self._seen[:3] = q - dt * qd, q, np.full_like(q, np.nan)
            return self._as_read(measured, config)
        qdd_b = state.model.J_m_inv @ ((measured.base_velocity - then) / dt)
        known = _known(state.M, state.h, u_a, qdd_b)
        self._samples += not math.isnan(self._seen[2, 0])
        share = max(1.0 / max(self._samples, 1), -math.expm1(-dt / config.window))
        _learn(self._seen, q, known, share, dt)
        if self._samples < _FEWEST:
            return self._as_read(measured, config)
        least, ratio, change = config.least_noise, config.velocity_noise, config.push_change
        _follow(self._x, self._P, known, q, qd, self._seen[3], least, ratio, change, dt)
        self.pushed = self._x[2].copy()
        return measured._replace(q_m=self._x[0].copy(), qd_m=self._x[1].copy())

    def _as_read(self, measured: Measurement, config: EstimateConfig) -> Measurement:
        """Begin the filter at readings, which are as good as their noise."""
        variance = np.maximum(self._seen[3], config.least_noise**2)
        self._x[:] = measured.q_m, measured.qd_m, self.pushed
        self._P[:] = np.diag([0.0, 0.0, config.push_change**2])
        self._P[:, 0, 0], self._P[:, 1, 1] = variance, config.velocity_noise**2 * variance
        return measured


_FEWEST = 8  # samples of the noise with which the filter begins
_FARTHEST = 10.0  # [-] of the way at a joint's top speed; else it was moved while nobody looked


@compiled("b1(f8[:,:], f8[:], f8[:], f8)")
def _elsewhere(x: Array, q: Array, qd_max: Array, dt: float) -> bool:
    """Whether positions q (n_m,) are none that x (3, n_m), a period dt [s] ago, can have led to."""
    for i in range(len(q)):
        if abs(q[i] - x[0, i] - dt * x[1, i]) > _FARTHEST * dt * qd_max[i]:
            return True
    return False


@compiled("f8[::1](f8[:,:], f8[:], f8[:], f8[:])")
def _known(M: Array, h: Array, u_a: Array, qdd_b: Array) -> Array:
    """M_aa⁻¹ (u_a - h_a - M_ab q̈_b) (n_m,)."""
    n_b, acting = len(qdd_b), u_a.copy()
    for i in range(len(u_a)):
        acting[i] -= h[n_b + i]
        for j in range(n_b):
            acting[i] -= M[n_b + i, j] * qdd_b[j]
    L = cholesky(M[n_b:, n_b:])
    return backward(L, forward(L, acting))


@compiled("void(f8[:,::1], f8[:], f8[:], f8, f8)")
def _learn(seen: Array, q: Array, known: Array, share: float, dt: float) -> None:
    """Count one more reading q (n_m,) in.

    Args:
        seen: (4, n_m) the last two positions, the last second difference less the known one, or
            not a number, and the noise's variance; is updated.
        q: (n_m,) the position.
        known: (n_m,) the acceleration.
        share: [-] of the new sample of the variance.
        dt: [s]
    """
    for i in range(len(q)):
        unknown = q[i] - 2.0 * seen[1, i] + seen[0, i] - dt**2 * known[i]
        sample = (unknown - seen[2, i]) ** 2 / 20.0
        seen[0, i], seen[1, i], seen[2, i] = seen[1, i], q[i], unknown
        if not math.isnan(sample):
            seen[3, i] += share * (sample - seen[3, i])


@compiled("void(f8[:,::1], f8[:,:,::1], f8[:], f8[:], f8[:], f8[:], f8, f8, f8, f8)")
def _follow(
    x: Array,
    P: Array,
    known: Array,
    q: Array,
    qd: Array,
    variance: Array,
    least: float,
    ratio: float,
    change: float,
    dt: float,
) -> None:
    """Predict each joint over dt [s], and correct it by its position, then by its velocity.

    Args:
        x: (3, n_m) position, velocity and acceleration by others; is updated.
        P: (n_m, 3, 3) covariances; are updated.
        known: (n_m,) accelerations besides.
        q: (n_m,) positions.
        qd: (n_m,) velocities.
        variance: (n_m,) of the positions' noise.
        least: Standard deviation of that noise at least.
        ratio: [1/s] of the velocities' noise to it.
        change: Of the acceleration by others, in a second.
        dt: [s]
    """
    F = np.array([[1.0, dt, 0.5 * dt**2], [0.0, 1.0, dt], [0.0, 0.0, 1.0]])
    for i in range(len(q)):
        acceleration = known[i] + x[2, i]
        x[0, i] += dt * x[1, i] + 0.5 * dt**2 * acceleration
        x[1, i] += dt * acceleration
        p = F @ P[i] @ F.T
        p[2, 2] += change**2 * dt
        noise = max(variance[i], least**2)
        for k in range(2):
            reading, of_reading = (q[i], noise) if k == 0 else (qd[i], ratio**2 * noise)
            gain, row, error = p[:, k] / (p[k, k] + of_reading), p[k].copy(), reading - x[k, i]
            for j in range(3):
                x[j, i] += gain[j] * error
                p[j] -= gain[j] * row
        P[i] = p
