"""Position, motion and external acceleration of the arm, estimated from noisy readings.

A Kalman filter of each joint estimates its position, its velocity and its external acceleration.
Torques and the base's motion predict a joint's acceleration; the external acceleration is a random
walk. The noise is estimated from the readings (`_learn`); the weight of a velocity depends on its
agreement with the difference of the last two positions. Thus the filter follows readings without
noise within 4 ms, noisy ones do not shake the arm, and wrong velocities have little or no effect.

The estimate belongs to the newest reading; `advance` predicts the present state from it, and
`estimate_load` finds loads in the external torques that the external accelerations imply. Tasks do
not use the external acceleration: a guided end-effector stays free. Limits use it, so that joint
speeds and distances stay within their limits while a person pulls. The arguments `w` and `gains`
are a `STEP` and `GAINS`.
"""

import math
from typing import Any

import numpy as np

from app.compiled import compiled
from app.control.qp import backward, cholesky, dot, fill, forward, put, times
from app.strict import Array

FEWEST = 8
"""Number of samples of the noise with which the filter starts."""
_CLEAR = 0.01  # [-] share of a speed limit beyond which a change between readings is clear
_PLAUSIBLE = 6.0  # [-] largest ratio of a sample of the positions' noise to its variance
_SUDDEN = 2e4  # [1/s²] largest change of the external acceleration in a second, relative to a
# speed limit: a person's force grows within milliseconds, the error of an old reading at once
_MOST_DRIFT = 20.0  # [rad/s²] largest process noise in one second that prediction errors imply
RESPONSE = 0.004  # [s] response time of the filter to fresh readings, unless they are too noisy
_SHAKE = 0.01  # [-] largest noise of an estimated speed, relative to a speed limit
_SMALL = 1e-11  # [rad²] lower bound of the variance of positions for `_PLAUSIBLE`
FARTHEST = 10.0  # [-] largest plausible ratio of a motion, or of a velocity, to the speed limit
_REVERSED = 4.0  # [-] largest remaining friction after a push upwards, relative to the push
_SETTLED = 20  # [-] samples of the noise before a load can be estimated
_SOON = 0.005  # [s] largest age of readings at which a load after these samples counts as sudden
_LEAST_LOAD = 0.3  # [kg] smallest reported load
_SAMPLED = 0.02  # [s] shortest interval of a mean of the external torques
_SIGNIFICANT = 5.0  # [-] smallest reported load in standard deviations of the estimate
_NOISE = 1.0 / 18.0  # [-] part of the variance of an estimated velocity that is due to noise
_FRICTION = 0.2  # [N m or N] standard deviation of changes of a joint's friction
_EXPLAINED = 0.95  # [-] smallest share of a squared change that a load explains
_GROWTH = 0.15  # [-] largest growth after a sudden load, relative to the change by the load
_GRAVITY = 9.81  # [m/s²]


@compiled()
def has_jumped(x: Array, q: Array, qd_max: Array, steps: int, dt: float, waited: Array) -> bool:
    """Whether the arm cannot move from the state x (3, n_m) to q (n_m,) in `steps` times dt [s].

    `waited` (n_m,), the steps from each joint's last reading to the time of x, permit more.
    """
    for i in range(len(q)):
        way = abs(q[i] - x[0, i] - steps * dt * x[1, i])
        if way > (FARTHEST + steps - 1 + waited[i]) * dt * qd_max[i]:  # not NaN
            return True
    return False


@compiled()
def predicted_joint_acceleration(
    M: Array, h: Array, L_aa: Array, u_a: Array, qdd_b: Array
) -> Array:
    """M_aa⁻¹ (u_a − h_a − M_ab q̈_b) (n_m,): joint accelerations without external forces."""
    n_b = len(qdd_b)
    return backward(L_aa, forward(L_aa, u_a - h[n_b:] - times(M[n_b:, :n_b], qdd_b)))


@compiled()
def _begin_at(
    w: Any, trusted: Array, predicted: Array, q: Array, qd: Array, qd_max: Array, gains: Any
) -> None:
    """Take a reading without a filter; reset P to the noise variances `trusted` (2, n_m).

    x is `w.x_read`. A clear change of the velocity that the external acceleration x[2] and
    `predicted` do not explain changes x[2]. A joint without a position is only predicted. The other
    arguments are those of `estimate_arm`.
    """
    x, P, steps, dt = w.x_read, w.P_est, len(predicted), gains.dt
    expected = x.copy()
    advance(expected, predicted, dt)
    for i in range(len(q)):
        if math.isnan(q[i]):
            x[0, i], x[1, i] = expected[0, i], expected[1, i]
            continue
        speed = w.q_last[0, i] if math.isnan(qd[i]) else qd[i]
        if steps > 0:
            gained = speed - x[1, i] - steps * dt * x[2, i] - dt * predicted[:, i].sum()
            if abs(gained) > _CLEAR * qd_max[i]:
                x[2, i] += gained / (max(FEWEST, steps) * dt)
        x[0, i], x[1, i] = q[i], speed
        for j in range(3):
            fill(P[i, j], 0.0)
        P[i, 0, 0], P[i, 1, 1], P[i, 2, 2] = trusted[0, i], trusted[1, i], gains.external_drift**2


@compiled()
def process_noise(w: Any, qd_max: Array, periods: Array, gains: Any) -> Array:
    """(n_m,) [rad/s² or m/s²] standard deviation of the change of the external acceleration in 1 s.

    It is at least `gains.external_drift`, and so large that the filter responds within the longest
    of `RESPONSE`, the blind time, and the control periods from the joint's last reading until now,
    `periods` (n_m,); noise above about 0.2 mrad at 1 kHz slows the response. A fast response keeps
    a light joint below its speed limit; a slow one suits readings that can be older than assumed.
    If a joint's `periods` > 1, its recent `w.v_error` raises its result up to `_MOST_DRIFT`.
    """
    drift = np.full(len(periods), gains.external_drift)
    for i in range(len(periods)):
        time = periods[i] * gains.dt
        noise = math.sqrt(w.noise_var[0, i] * time)
        slow = (noise / (_SHAKE * qd_max[i])) ** (2.0 / 3.0)
        drift[i] = max(drift[i], noise / max(RESPONSE, time, slow, w.blind_time[()]) ** 3)
        if periods[i] > 1.0:
            implied = w.v_error[i] * math.sqrt(3.0 / time**3)
            drift[i] = max(drift[i], min(implied, _MOST_DRIFT))
    return drift


@compiled()
def estimate_arm(
    w: Any, predicted: Array, read: Array, qd_max: Array, drift: Array, gains: Any
) -> bool:
    """Update the estimate by one reading; return whether the arm cannot have moved to this reading.

    After such a jump, the filter restarts at the reading with an external acceleration of 0; after
    a gap it restarts with the last external acceleration. Until the estimate of the noise has
    `FEWEST` samples, `_begin_at` replaces the filter. A joint without a position is only predicted.
    A measured velocity counts as the mean velocity of the last control period, as in drives and
    simulators.

    `predicted` (k, n_m) has the `predicted_joint_acceleration` in each of the k control periods
    since the last reading; no rows after a gap. `read` (2, n_m) has positions [rad or m] and
    velocities [rad/s or m/s], NaN if one is unknown. `qd_max` (n_m,) are the joints' speed limits,
    and `drift` (n_m,) is `process_noise`.
    """
    x, P, last, steps, dt = w.x_read, w.P_est, w.q_last, len(predicted), gains.dt
    q, qd = read
    jumped = steps > 0 and has_jumped(x, q, qd_max, steps, dt, last[3])
    continued, periods = steps > 0 and not jumped, steps + last[3]
    if jumped:
        fill(x[2], 0.0)
    if continued:
        w.samples[()] += 0.0 if math.isnan(last[2, 0]) else 1.0
        _learn(w, predicted, q, qd, gains)
    else:
        for i in range(len(q)):
            if not math.isnan(q[i]):
                last[0, i], last[1, i] = 0.0 if math.isnan(qd[i]) else qd[i], q[i]
                last[3, i] = 0.0
            last[2, i] = math.nan
    trusted = _at_least(w.noise_var, gains.least_noise, gains.velocity_noise, max(steps, 1) * dt)
    if not continued or w.samples[()] < FEWEST:
        _begin_at(w, trusted, predicted if continued else predicted[:0], q, qd, qd_max, gains)
        return jumped
    advance(x, predicted, dt)
    for i in range(len(q)):
        grow(P[i], drift[i], steps, dt)
        sudden = _SUDDEN * dt * periods[i] * qd_max[i]
        for k in range(2):
            if not (math.isnan(q[i]) or math.isnan(read[k, i])):
                _correct(x[:, i], P[i], k, read[k, i], trusted[k, i], sudden)
    return jumped


@compiled()
def advance(x: Array, predicted: Array, dt: float) -> None:
    """Advance x (3, n_m) by k periods of dt [s]; accelerations are `predicted` (k, n_m) + x[2]."""
    for k in range(len(predicted)):
        for i in range(x.shape[1]):
            x[1, i] += dt * (predicted[k, i] + x[2, i])
            x[0, i] += dt * x[1, i]


@compiled()
def _learn(w: Any, predicted: Array, q: Array, qd: Array, gains: Any) -> None:
    """Include one more reading, q and qd (n_m,), in the noise estimate.

    By `predicted`, two successive intervals imply two velocities at the reading between them. Their
    difference, times the newer interval's duration, is the unexplained second difference of the
    positions. Its change since the last reading, squared / 20, is a sample of the positions' noise.
    After `FEWEST` samples, an outlier is bounded and has the weight of one period: a delay, a stop
    or a force in a gap causes it. (qd − newest implied velocity)² is a sample of qd's noise.
    """
    steps, dt, last, variances, samples = len(predicted), gains.dt, w.q_last, w.noise_var, w.samples
    window = gains.noise_window
    share = max(1.0 / max(float(samples[()]), 1.0), -math.expm1(-steps * dt / window))
    for i in range(len(q)):
        gained = way = 0.0
        for k in range(steps):
            gained += dt * predicted[k, i]
            way += dt * gained
        if math.isnan(q[i]):
            last[1, i] += steps * dt * last[0, i] + way
            last[0, i] += gained
            last[3, i] += steps
            continue
        begin = (q[i] - last[1, i] - way) / (steps * dt)
        unexplained = steps * dt * (begin - last[0, i])
        if last[3, i] > 0.0:  # the predicted periods before the newest ones count too
            begin = last[0, i] + unexplained / ((steps + last[3, i]) * dt)
            last[3, i] = 0.0
        of_q = (unexplained - last[2, i]) ** 2 / 20.0
        last[0, i], last[1, i], last[2, i] = begin + gained, q[i], unexplained
        if not math.isnan(qd[i]):
            variances[1, i] += share * ((qd[i] - last[0, i]) ** 2 - variances[1, i])
        if not math.isnan(of_q):
            weight, largest = share, _PLAUSIBLE * max(variances[0, i], _SMALL)
            if samples[()] >= FEWEST and of_q > largest:
                weight, of_q = -math.expm1(-dt / window), largest
            variances[0, i] += weight * (of_q - variances[0, i])


@compiled()
def _at_least(variances: Array, least: float, ratio: float, dt: float) -> Array:
    """The variances (2, n_m) of positions and velocities, with lower bounds.

    The standard deviation of a position is at least `least` [rad or m], that of a velocity `ratio`
    [1/s] times that of its position and `least` / dt: drives compute velocities from the same
    positions. dt [s] is the time since the last reading.
    """
    of_q, of_qd = variances
    of_qd = np.maximum(np.maximum(of_qd, ratio**2 * of_q), (least / dt) ** 2)
    return np.stack((np.maximum(of_q, least**2), of_qd))


@compiled()
def _correct(x: Array, p: Array, k: int, reading: float, variance: float, sudden: float) -> None:
    """Correct x (3,) and its covariance p (3, 3) by a reading of x[k]; x[2] by at most `sudden`.

    The variance of x[2] falls less if `sudden` limits the correction.
    """
    share, error = 1.0 / (p[k, k] + variance), reading - x[k]
    gain_0, gain_1, gain_2 = share * p[0, k], share * p[1, k], share * p[2, k]
    for j in range(3):
        of_k = p[k, j]
        p[0, j] -= gain_0 * of_k
        p[1, j] -= gain_1 * of_k
        p[2, j] -= gain_2 * of_k
    x[0] += gain_0 * error
    x[1] += gain_1 * error
    correction = min(max(gain_2 * error, -sudden), sudden)
    x[2] += correction
    if correction != gain_2 * error:
        p[2, 2] += (gain_2 - correction / error) ** 2 / share


@compiled()
def grow(p: Array, drift: float, periods: int, dt: float) -> None:
    """Predict a joint's covariance p (3, 3) over periods of dt [s]; `drift` is `process_noise`."""
    for _ in range(periods):
        for j in range(3):
            p[1, j] += dt * p[2, j]
            p[0, j] += dt * p[1, j]
        for j in range(3):
            p[j, 1] += dt * p[j, 2]
            p[j, 0] += dt * p[j, 1]
        p[2, 2] += drift**2 * dt


@compiled()
def _torque_change(M: Array, J: Array, P: Array, loaded: float, interval: float) -> Array:
    """(n_m, n_m) covariance by noise of the change of mean external torques between two intervals.

    For the torques by the arm's inertia matrix M, the part `_NOISE` of the velocities' variance in
    P (n_m, 3, 3) counts as noise; for the inertia forces of the mass `loaded` [kg], one half of
    this variance. An interval lasts `interval` [s]; J (3, n_m) is the arm's part of the
    end-effector's linear Jacobian. `_FRICTION`² is added to the diagonal.
    """
    inertia, C = np.empty_like(M), np.zeros_like(M)
    for i in range(len(M)):
        for j in range(len(M)):
            inertia[i, j] = loaded * dot(J[:, i], J[:, j])
    for i in range(len(M)):
        for j in range(len(M)):
            for k in range(len(M)):
                square = _NOISE * M[i, k] * M[j, k] + 0.5 * inertia[i, k] * inertia[j, k]
                C[i, j] += 4.0 * square * P[k, 1, 1] / interval**2
        C[i, i] += _FRICTION**2
    return C


@compiled()
def _sudden_mass(torques: Array, lifts: Array, C: Array) -> float:
    """[kg] mass of a load that has just begun to act; negative if it has ceased; 0 without one.

    A load changes the external torques at once, and only by its weight and its inertia. A force
    that changes in a different direction, has changed before, or grows for longer is a person's.
    `torques` and `lifts` (8, n_m) are those of `STEP`, but `torques` without those by the known
    load. The covariance C (n_m, n_m) by noise of a change of `torques` gives noisy joints a smaller
    weight.
    """
    first, last, L, usual = 3, len(torques) - 1, cholesky(C), np.eye(len(C))
    lift, change = forward(L, lifts[1]), forward(L, torques[3] - torques[1])
    along, size = dot(change, lift), dot(lift, lift)
    total = dot(change, change) - 2.0 * len(C)  # the square of noise is rarely above twice its mean
    if abs(along) <= _LEAST_LOAD * size or along**2 < _EXPLAINED * total * size:
        return 0.0
    for k in range(first, last):
        before = forward(L, torques[k] - torques[k + 1])
        for i in range(len(C)):
            for j in range(len(C)):
                usual[i, j] += before[i] * before[j] / (last - first)
    U = cholesky(usual)
    weight = backward(U, forward(U, lift))
    along, size = dot(change, weight), dot(lift, weight)
    if abs(along) <= max(_LEAST_LOAD * size, _SIGNIFICANT * math.sqrt(size)):
        return 0.0
    mass = along / size
    after = forward(L, torques[1] - torques[0] + mass * (lifts[1] - lifts[0]))
    growth = dot(after, weight) / along
    if growth > _GROWTH:
        return 0.0
    begun = dot(forward(L, torques[3] - torques[2]), weight) / along  # share before interval 1
    return mass if begun > 0.5 * _GROWTH else mass * (1.0 + max(growth, 0.0))


@compiled()
def _mass(torque: Array, lift: Array) -> float:
    """[kg] mass of a load that best explains external torques (n_m,); `lift` as in `w.lifts`."""
    size = dot(lift, lift)
    return -dot(torque, lift) / size if size > 0.0 else 0.0


@compiled()
def estimate_load(gains: Any, w: Any, elapsed: float, jumped: bool) -> None:
    """Estimate the mass of a load at the end-effector, and detect a load that begins or ceases.

    A load of mass m exerts the torques -m f, with f = J_eeᵀ (ẍ - g⃗) by its weight and its inertia.
    `elapsed` [s] is the time between the last two steps, whose difference of `w.v_ee` shows ẍ;
    `jumped` states whether the arm cannot have moved to the newest reading. Before `_SETTLED`
    samples of the noise nothing changes. `_judge_load` writes the results.
    """
    n_b, dt = len(w.g) - len(w.q_m), gains.dt
    if w.samples[()] < _SETTLED:
        return
    begins, late = w.samples[()] == _SETTLED, w.blind_time[()] > _SOON
    corrected = w.corrected[()] + w.lag[()] > w.stated_lag[()]
    restarted = jumped or w.known[()] == 0.0 or (begins and (late or corrected))
    if elapsed == 0.0 and not (begins or restarted):  # a second step in the same period
        return
    M, torque, lift = w.M[n_b:, n_b:], times(w.M[n_b:, n_b:], w.x_est[2]), np.zeros(len(w.q_m))
    for k in range(3):
        a = _GRAVITY if k == 2 else 0.0
        if not (begins or restarted):
            a += (w.v_ee[k] - w.v_tip[k]) / elapsed
        for i in range(len(lift)):
            lift[i] += w.J_ee[k, n_b + i] * a
    put(w.v_tip, w.v_ee[:3])
    if restarted:
        w.torques_age[()], w.torques[1, 0] = 0.0, math.nan  # no earlier interval
    time = max(elapsed, dt)
    w.torques_age[()] += time
    share = time / w.torques_age[()]
    for i in range(len(torque)):
        w.torques[0, i] += share * (torque[i] - w.torques[0, i])
        w.lifts[0, i] += share * (lift[i] - w.lifts[0, i])
    interval = max(_SAMPLED, w.blind_time[()])
    if w.torques_age[()] > interval - 0.5 * dt:
        J = w.J_ee[:3, n_b:]
        _judge_load(gains, w, _torque_change(M, J, w.P_est, w.loaded[()], interval))
        w.torques_age[()] = 0.0
        for k in range(len(w.torques) - 1, 0, -1):
            put(w.torques[k], w.torques[k - 1])
            put(w.lifts[k], w.lifts[k - 1])


@compiled()
def _judge_load(gains: Any, w: Any, C: Array) -> None:
    """Update `w.load`, `w.loaded` and `w.unstated` at the end of an interval.

    If a load is detected, the intervals before it are changed as if the load had been present, so
    that no load counts twice. `w.loaded` becomes 0 below `_LEAST_LOAD`, or if none of the intervals
    0, 1 and 3 (0 is the newest) contains more than half of it. `w.unstated` is `w.loaded` while
    interval 0 or 1 contains more than half of it. A load that would make the mass at the
    end-effector negative is a person's push upwards, and is not reported. C is as in
    `_sudden_mass`.
    """
    torques, lifts = w.torques, w.lifts
    if math.isnan(torques[1, 0]):  # the first interval after a gap
        for k in range(1, len(torques)):
            put(torques[k], torques[0])
            put(lifts[k], lifts[0])
    w.load[()] = _mass(torques[0], lifts[0])
    sudden = _sudden_mass(torques + w.loaded[()] * lifts, lifts, C)
    newest, before, older = w.load[()], _mass(torques[1], lifts[1]), _mass(torques[3], lifts[3])
    if sudden != 0.0:
        pushed, rest = w.loaded[()] < -gains.payload_mass - _LEAST_LOAD, w.loaded[()] + sudden
        # After a person's push upwards, a small rest is friction that has changed its sign.
        w.loaded[()] = 0.0 if pushed and 0.0 < rest < -_REVERSED * w.loaded[()] else rest
        for k in range(1, len(torques)):
            put(torques[k], torques[0] + w.loaded[()] * (lifts[0] - lifts[k]))
    half = 0.5 * w.loaded[()] ** 2
    acts = max(newest * w.loaded[()], before * w.loaded[()]) > half
    if abs(w.loaded[()]) < _LEAST_LOAD or not (acts or older * w.loaded[()] > half):
        w.loaded[()] = 0.0
    possible = w.loaded[()] >= -gains.payload_mass - _LEAST_LOAD
    w.unstated[()] = w.loaded[()] if acts and possible else 0.0
