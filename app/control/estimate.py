"""Where the arm is, how it moves and who pushes it, from readings with noise and known torques."""

from __future__ import annotations

import math

import numpy as np

from app.compiled import compiled
from app.config import EstimateConfig
from app.control.active_sets import backward, cholesky, forward, times
from app.robot.state import Measurement, RobotState
from app.strict import Array


class ArmEstimate:
    """A Kalman filter of each joint: its position, its velocity, and how others accelerate it.

    Torques and the base's motion say what a joint does by itself; what it does besides is a random
    walk. How far readings are trusted is learnt from them. The third differences of what is not
    known of a motion are noise of the positions, with 20 times its variance. A velocity is as good
    as it agrees with the way since the last reading, but never free of the positions' noise: drives
    make it of the same ones. So readings without noise are followed at once, noisy ones do not
    shake the arm, and velocities that are late, wrongly scaled or none at all are left to the
    positions.

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
        self._samples, self._variances = 0, np.zeros((2, self._n_m))
        self._last = np.zeros((3, self._n_m))
        self._x, self._P = np.zeros((3, self._n_m)), np.zeros((self._n_m, 3, 3))
        self.begin_anew()

    def begin_anew(self) -> None:
        """Take the next readings as they come; noise and who pushes stay."""
        self._base_velocity: Array | None = None

    @property
    def noise(self) -> Array:
        """(2, n_m) standard deviations as learnt so far: [rad or m] of the positions, and [rad/s or
        m/s] of the velocities.
        """
        return np.sqrt(self._variances)

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
            self._last[:] = q - dt * qd, q, np.full_like(q, np.nan)
            return self._as_read(measured, self._trusted(config, dt), config)
        gained, J_m_inv = measured.base_velocity - then, state.model.J_m_inv
        known = _known(state.M, state.h, u_a, J_m_inv, gained, dt)
        self._samples += not math.isnan(self._last[2, 0])
        share = max(1.0 / max(self._samples, 1), -math.expm1(-dt / config.window))
        _learn(self._variances, self._last, known, q, qd, share, dt)
        variances = self._trusted(config, dt)
        if self._samples < _FEWEST:
            return self._as_read(measured, variances, config)
        _follow(self._x, self._P, known, q, qd, variances, config.push_change, dt)
        self.pushed = self._x[2].copy()
        return measured._replace(q_m=self._x[0].copy(), qd_m=self._x[1].copy())

    def _trusted(self, config: EstimateConfig, dt: float) -> Array:
        """(2, n_m) variances of positions and velocities, none below what is possible."""
        return _at_least(self._variances, config.least_noise, config.velocity_noise, dt)

    def _as_read(
        self, measured: Measurement, variances: Array, config: EstimateConfig
    ) -> Measurement:
        """Begin the filter at readings, which are as good as their noise."""
        self._x[:] = measured.q_m, measured.qd_m, self.pushed
        self._P[:] = np.diag([0.0, 0.0, config.push_change**2])
        self._P[:, 0, 0], self._P[:, 1, 1] = variances
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


@compiled("f8[::1](f8[:,:], f8[:], f8[:], f8[:,:], f8[:], f8)")
def _known(M: Array, h: Array, u_a: Array, J_m_inv: Array, gained: Array, dt: float) -> Array:
    """M_aa⁻¹ (u_a - h_a - M_ab q̈_b) (n_m,), the base having gained a velocity (n_b,) in dt [s]."""
    n_b = len(gained)
    acting = u_a - h[n_b:] - times(M[n_b:, :n_b], times(J_m_inv, gained / dt))
    L = cholesky(M[n_b:, n_b:])
    return backward(L, forward(L, acting))


@compiled("void(f8[:,::1], f8[:,::1], f8[:], f8[:], f8[:], f8, f8)")
def _learn(
    variances: Array, last: Array, known: Array, q: Array, qd: Array, share: float, dt: float
) -> None:
    """Count one more reading in.

    Args:
        variances: (2, n_m) of the positions' and of the velocities' noise; are updated.
        last: (3, n_m) the last two positions, and the last second difference less the known one, or
            not a number; are updated.
        known: (n_m,) accelerations.
        q: (n_m,) positions.
        qd: (n_m,) velocities.
        share: [-] of the new samples of the variances.
        dt: [s]
    """
    for i in range(len(q)):
        unknown = q[i] - 2.0 * last[1, i] + last[0, i] - dt**2 * known[i]
        of_q, of_qd = (unknown - last[2, i]) ** 2 / 20.0, (qd[i] - (q[i] - last[1, i]) / dt) ** 2
        last[0, i], last[1, i], last[2, i] = last[1, i], q[i], unknown
        variances[1, i] += share * (of_qd - variances[1, i])
        if not math.isnan(of_q):
            variances[0, i] += share * (of_q - variances[0, i])


@compiled("f8[:,::1](f8[:,:], f8, f8, f8)")
def _at_least(variances: Array, least: float, ratio: float, dt: float) -> Array:
    """(2, n_m) variances of positions and velocities, not below what agrees by construction.

    Args:
        variances: (2, n_m) as learnt.
        least: Standard deviation of the positions' noise at least.
        ratio: [1/s] of the velocities' noise to it at least: drives make them of the same ones.
        dt: [s]
    """
    found = np.empty_like(variances)
    for i in range(variances.shape[1]):
        of_q, of_qd = variances[0, i], variances[1, i]
        found[0, i] = max(of_q, least**2)
        found[1, i] = max(of_qd, ratio**2 * of_q, (least / dt) ** 2)
    return found


@compiled()
def _correct(x: Array, p: Array, k: int, reading: float, variance: float) -> None:
    """Correct x (3,) and its covariance p (3, 3) by a reading of x[k]."""
    share, error = 1.0 / (p[k, k] + variance), reading - x[k]
    gain_0, gain_1, gain_2 = share * p[0, k], share * p[1, k], share * p[2, k]
    for j in range(3):
        of_k = p[k, j]
        p[0, j] -= gain_0 * of_k
        p[1, j] -= gain_1 * of_k
        p[2, j] -= gain_2 * of_k
    x[0] += gain_0 * error
    x[1] += gain_1 * error
    x[2] += gain_2 * error


@compiled("void(f8[:,::1], f8[:,:,::1], f8[:], f8[:], f8[:], f8[:,:], f8, f8)")
def _follow(
    x: Array,
    P: Array,
    known: Array,
    q: Array,
    qd: Array,
    variances: Array,
    change: float,
    dt: float,
) -> None:
    """Predict each joint over dt [s], and correct it by its position, then by its velocity.

    The velocity is that of the way since the last position, as drives and simulators have it.

    Args:
        x: (3, n_m) position, velocity and acceleration by others; is updated.
        P: (n_m, 3, 3) covariances; are updated.
        known: (n_m,) accelerations besides.
        q: (n_m,) positions.
        qd: (n_m,) velocities.
        variances: (2, n_m) of the positions' and of the velocities' noise.
        change: Of the acceleration by others, in a second.
        dt: [s]
    """
    for i in range(len(q)):
        p = P[i]
        x[1, i] += dt * (known[i] + x[2, i])
        x[0, i] += dt * x[1, i]
        for j in range(3):
            p[1, j] += dt * p[2, j]
            p[0, j] += dt * p[1, j]
        for j in range(3):
            p[j, 1] += dt * p[j, 2]
            p[j, 0] += dt * p[j, 1]
        p[2, 2] += change**2 * dt
        _correct(x[:, i], p, 0, q[i], variances[0, i])
        _correct(x[:, i], p, 1, qd[i], variances[1, i])
