"""The arm's estimate for the oracle: Kalman filters with explicit matrices."""

from __future__ import annotations

import numpy as np

from app.config import EstimateConfig
from app.robot.state import Measurement

Array = np.ndarray

FEWEST = 8  # samples of the noise before the filter starts
CLEAR = 0.01  # [-] of the speed limit: least unexplained change that counts before the filter
PLAUSIBLE = 6.0  # [-] largest ratio of a sample to the variance
SMALL = 1e-11  # [rad²] smallest variance for the outlier test
SUDDEN = 2e4  # [1/s²] largest rate of the external acceleration, relative to the speed limit
RESPONSE = 0.004  # [s] smallest response time of the filter
SHAKE = 0.01  # [-] noise of the estimated speed, relative to its limit, that slows the filter
FARTHEST = 10.0  # [-] largest plausible position change, in steps at the joint's speed limit


class Estimate:
    """Position, velocity and external acceleration of each joint, and its measurement noise."""

    def __init__(self, qd_max: Array, n_b: int, dt: float) -> None:
        n_m = len(qd_max)
        self._qd_max, self._dt = qd_max, dt
        self.x, self.P, self.variances = (
            np.zeros((3, n_m)),
            np.zeros((n_m, 3, 3)),
            np.zeros((2, n_m)),
        )
        self.jumped = False
        """Whether the last reading is too far away for a motion of the arm."""
        self.last, self.samples, self.v_last = np.zeros((4, n_m)), 0, np.full(n_b, np.nan)

    def gap(self) -> None:
        """A step without a measurement: the base's acceleration is unknown in the next step."""
        self.v_last = np.full_like(self.v_last, np.nan)

    def update(
        self, m: Measurement, predicted: Array, blind_time: float, config: EstimateConfig
    ) -> None:
        """Take m; `predicted` (n_m,) [rad/s²] is the effect of torques and base, NaN if unknown."""
        q, qd, dt = m.q_m, m.qd_m, self._dt
        way = np.abs(q - self.x[0] - dt * self.x[1])
        self.jumped = bool(np.isfinite(predicted[0]) and (way > FARTHEST * dt * self._qd_max).any())
        continued = np.isfinite(predicted[0]) and not self.jumped
        if self.jumped:
            self.x[2] = 0.0
        sigma = np.sqrt(self.variances[0] * dt)
        time = np.maximum(max(RESPONSE, blind_time), np.cbrt(sigma / (SHAKE * self._qd_max)) ** 2)
        response = sigma / time**3
        if continued:
            self._learn(q, qd, predicted, config.noise_window)
        else:
            self.last = np.array([qd, q, np.full_like(q, np.nan), 0.0 * q])
        least, ratio = config.least_noise, config.velocity_noise
        of_q, of_qd = self.variances
        noise = np.maximum(of_q, least**2)
        noise = np.array(
            [noise, np.max([of_qd, ratio**2 * of_q, np.full_like(q, (least / dt) ** 2)], axis=0)]
        )
        if continued and self.samples >= FEWEST:
            self._filter(q, qd, predicted, noise, np.maximum(config.external_drift, response))
        else:
            external = self.x[2]
            if continued:
                unexplained = (qd - self.x[1]) / dt - predicted - external
                clear = np.abs(unexplained) * dt > CLEAR * self._qd_max
                external = external + np.where(clear, unexplained / FEWEST, 0.0)
            self.x = np.array([q, qd, external])
            drift = np.full_like(q, config.external_drift**2)
            self.P = np.array([np.diag(each) for each in np.array([*noise, drift]).T])
        self.v_last = m.base_velocity.copy()

    def _learn(self, q: Array, qd: Array, predicted: Array, window: float) -> None:
        """Learn the noise of positions (third differences) and velocities (two positions)."""
        speed_before, now, unexplained_before, _ = self.last
        speed = (q - now) / self._dt
        unexplained = self._dt * (speed - speed_before) - self._dt**2 * predicted
        of_q, of_qd = (unexplained - unexplained_before) ** 2 / 20, (qd - speed) ** 2
        counted = np.isfinite(of_q)
        self.samples += int(counted[0])
        share = max(1 / max(self.samples, 1), -np.expm1(-self._dt / window))
        self.variances[1] += share * (of_qd - self.variances[1])
        weights = np.full(len(q), share)
        if self.samples >= FEWEST:  # an outlier counts as the largest plausible sample
            largest = PLAUSIBLE * np.maximum(self.variances[0], SMALL)
            weights[of_q > largest] = -np.expm1(-self._dt / window)
            of_q = np.minimum(of_q, largest)
        self.variances[0, counted] += (weights * (of_q - self.variances[0]))[counted]
        self.last = np.array([speed, q, unexplained, 0.0 * q])

    def _filter(self, q: Array, qd: Array, predicted: Array, noise: Array, drift: Array) -> None:
        """Predict over dt, then correct by the position, then by the velocity."""
        dt = self._dt
        F, G = np.array([[1, dt, dt**2], [0, 1, dt], [0, 0, 1]]), np.array([dt**2, dt, 0])
        for i in range(len(q)):
            x = F @ self.x[:, i] + G * predicted[i]
            P = F @ self.P[i] @ F.T + np.diag([0, 0, drift[i] ** 2 * dt])
            for k, reading in enumerate((q[i], qd[i])):
                gain, error = P[:, k] / (P[k, k] + noise[k, i]), reading - x[k]
                sudden = SUDDEN * dt * self._qd_max[i]
                if abs(gain[2] * error) > sudden:
                    gain[2] = np.copysign(sudden, gain[2] * error) / error
                left = np.eye(3) - np.outer(gain, np.eye(3)[k])
                x = x + gain * error
                P = left @ P @ left.T + noise[k, i] * np.outer(gain, gain)
            self.x[:, i], self.P[i] = x, P
