"""Judge the readings, and estimate the present state of the robot from them.

A step runs once in each control period ("period" in this module), with or without a new reading. It
first predicts the motion in the period by the known torques and the motion of the base. A usable
new reading then corrects the state of the arm at the time of the reading (Kalman filter), and the
present state is predicted from it. Thus repeated, lost, impossible and late readings are the same
case: a reading has an age. Time stamps show the age, the caller's clock shows the period; otherwise
both are estimated from the readings. The module decides on four properties:

- **The lag**, the delay of the readings in periods. A delay that changes during a motion is the age
  at which the predicted state equals the reading (`_match_lag`). Any other delay is the time until
  accelerations due to the torques and the base appear in the measured positions (`_find_lag`).
- **The period**, without a clock, is right if positions integrate velocities (`_find_period`).
- **The contradiction**. A joint moves far above its speed limit, and at each lag the commanded
  torques explain its motion worse than no torques (`_weigh_lags`). Many successive jumps count too.
- **The velocities** are not used if they exceed the speed limits by far, or do not match the
  positions at any plausible period, or the recent poses of the base. The positions and the model
  of the base's drive replace them.
"""

import math
from typing import Any

import numpy as np
from numba import types
from numba.core.typing.templates import Signature

from app.compiled import compiled
from app.control.estimate import (
    FARTHEST,
    FEWEST,
    advance,
    estimate_arm,
    estimate_load,
    grow,
    has_jumped,
    predicted_joint_acceleration,
    process_noise,
)
from app.control.inputs import GAINS, ROBOT
from app.control.qp import dot, fill, put, put_rows, solved, times
from app.control.quantities import STEP
from app.strict import Array

FAULTS = {
    "invalid": "a position, the base's pose or its drive's state is not a finite number, or the "
    "time stamp is later than the control step",
    "implausible": "a joint is beyond its limits by more than half its range: check the unit "
    "(degrees?) and the order of the joints",
    "velocity": "velocities of joints or base are missing, impossible, or do not match the "
    "positions: positions and the model of the base's drive are used instead",
    "repeated": "readings of joints have the last time stamp, or the same values although the "
    "joints move: the motion since the last new reading is predicted",
    "stale": "for 0.1 s, all readings were invalid, implausible, too old, or repeated: the step "
    "returns the fallback command",
    "jump": "the arm cannot have moved to this reading: the estimate restarts from this reading",
    "lag": "the readings are older than `estimate.delay`: the age is compensated, up to 24 periods "
    "or, with time stamps, the smaller of 0.1 s and 127 periods",
    "period": "the loop does not run at its stated period: it uses the measured period from now on",
    "localisation": "the base's pose has jumped, or contradicts its velocity: use a frame without "
    "jumps, such as odom, and check the unit and the sign of pose and velocity",
    "load": "the weight of a load suddenly acts, or no longer acts, on the end-effector: set "
    "`payload.mass` to the mass of the present load",
    "base": "the base does not follow its commands: check its brakes, its driver, the sign of its "
    "velocity, and its `drive_time_constant_s`",
    "contradictory": "the arm's motion does not agree with the commanded torques: brake the drives "
    "and check the order, the signs and the age of the joints' readings; the step returns the "
    "fallback command until `reset`",
    "stall": "by the clock, the loop has missed control periods: the motion by its last commands "
    "is predicted; after a pause of more than 0.1 s the estimate restarts",
}
"""The possible faults of readings, by name, in the order of `ControlStep.faults`."""

INVALID, IMPLAUSIBLE, VELOCITY, REPEATED, STALE, JUMP, LAG, PERIOD = range(8)
LOCALISATION, LOAD, BASE, CONTRADICTORY, STALL = range(8, 13)

HISTORY = 128
"""Number of rows of `history`; a reading must be fewer control periods old than this number."""
MAX_AGE = 0.1
"""[s] largest time without a new reading before the fallback command."""
EARLY = 0.01
"""[s] largest difference by which a time stamp can be later than the control step."""

# Repetitions
_GRAINS, _CLEARLY_FAR = 2.5, 10.0  # [-] smallest motions, relative to an encoder's resolution,
# that change its reading, and that cause a report if the reading remains
_EQUAL = 1e-9  # [rad or m] rounding error of this resolution
_STILL = 1e-7  # [rad] largest predicted motion in a period of a robot at rest
# The period and the clock
_LEAST_WAY = 0.002  # [rad] smallest motion of a joint for a measurement of the period
_NOISES = 50.0  # [-] the same, relative to the standard deviation of the positions' noise
_FILTER = 0.01  # [s] largest delay of a driver's filter of velocities
_RIGHT, _MEASURED_RIGHT = 1.1, 1.02  # [-] largest ratio, or its inverse, that counts as 1, for a
# stated period and for a measured one
_RIGHT_BY_CLOCK = 1.05  # [-] the same for a control period that a clock shows
_PRECISELY = 3.0  # [-] ratio of the smallest motions for a measured period and for a stated one
_SMALLEST, _LARGEST = 0.125, 10.0  # [-] bounds of a plausible ratio; rpm instead of rad/s has 0.105
_AGREED = 0.05  # [s] shortest time in which successive measurements agree on a ratio other than 1
_JITTER = 0.9  # [periods] largest difference of an age by a time stamp from an unchanged lag
_LATE_BY, _EARLY_BY = 0.9, 0.5  # [periods] largest delay and lead of a step that counts as one
_DRIFT = 0.05  # [-] relative difference of the true control period that causes no missed periods
_SPREAD = 0.75  # [-] standard deviations of the clock's intervals within which a mean counts as 1
_MEASURED, _FEWEST_PERIODS = 0.03, 5  # [s], [periods] shortest measurement of the period by a clock
_ALIKE_PERIODS = 0.05  # [-] largest relative difference of two such measurements that agree
# The lag, doubts about it, and contradictions
_DOUBTFUL = 60.0  # [1/s] largest error of a used speed, relative to a speed limit and to the
# control period, that does not cast doubt on the age of the readings
_LATE = 0.024  # [s] additional age of the readings in case of doubt
_MOST_LAG = 24  # [periods] largest estimated or stated lag; time stamps can show a larger one
_GROUP = 5.0  # [periods] duration of a group of readings
_FEWEST_GROUPS, _CUBIC = 5, 8  # [-] smallest numbers of groups for a parabola, and for a cubic
_EXACT, _MOST_NOISE = 5e-6, 1e-4  # [rad] bounds of the assumed error of a predicted motion
_DRY_FRICTION = 0.03  # [-] dry friction of a joint, relative to its torque limit
_REVERSAL = 0.002  # [-] RMS error of a cubic that is fitted to a step of acceleration, relative to
# the step and to the squared duration; that of a parabola would hide delays from the first groups
_DOUBT, _LARGEST_GAIN = 0.7, 3.0  # [-] threshold and upper bound of the evidence by one group
_CONVINCING = 3.0  # [-] evidence that changes the lag
_VIOLENT = 1.5  # [-] smallest speed, relative to its limit, of a joint that can contradict the
# torques; friction and stiff contacts let slower joints move less than their torques
_RECENTLY = 2  # [-] number of the newest differences of groups, at least one of them that fast
_CONTRADICTORY, _JUMPS = 8.0, 0.5  # [-] evidence at which the readings are no longer used, and the
# evidence of one jump; a strong pull lets a light joint jump in some ten successive steps
_CLEARLY = 4.0  # [-] factor by which the squared error of a lag must be smaller than the others
_UNEXPECTED = 30.0  # [rad/s²] acceleration that a prediction over one period can miss
_ALIKE = 0.25  # [-] largest squared difference of two velocities, relative to their square
# The base and the angles
_FOLLOWS = 0.5  # [s] time constant of the comparison of the base with its drive's model
_ASTRAY = 1.5  # [-] largest difference of the two, relative to the largest command
_RECENT = 2.0  # [s] time constant of the comparison of the base's pose with its velocity
_NEAR = 0.02  # [m or rad] difference of the two that is always plausible
_SELDOM = 0.21  # [s] age of a pose of the base from which the motion since then is compared
_NOISY = 0.05  # [rad] noise of a wrapped position at a joint limit
_EARTH = 1e8  # [m or rad] bound of plausible poses; map coordinates such as UTM remain below 1e7


@compiled()
def unwrap(q: Array, last: Array, limits: Array, first: bool) -> Array:
    """The joint positions q (n_m,) without the jumps by full turns that some drivers make.

    A position between −2π and 2π moves by full turns to the value nearest to `last` (n_m,), if this
    value is at most 0.05 rad beyond the limits (2, n_m). In the `first` reading, a position more
    than 0.05 rad beyond a limit moves by one turn, unless it is then beyond the other limit.
    """
    found, turn = q.copy(), 2.0 * math.pi
    for i in range(len(q)):
        low, high = limits[0, i] - _NOISY, limits[1, i] + _NOISY
        if first:
            turns = int(q[i] < low and q[i] + turn <= limits[1, i])
            turns -= int(q[i] > high and q[i] - turn >= limits[0, i])
        else:
            turns = round((last[i] - q[i]) / turn)
            turns = turns if abs(q[i]) <= turn and low <= q[i] + turns * turn <= high else 0
        found[i] += turns * turn
    return found


@compiled()
def _same(a: Array, b: Array) -> bool:
    """Whether two arrays are equal; two entries that are NaN count as equal."""
    same = True
    for i in range(len(a)):
        same = same and (a[i] == b[i] or (a[i] != a[i] and b[i] != b[i]))
    return same


@compiled()
def _compare_joints(w: Any, read: Array, stamp: float, dt: float) -> tuple[Array, float, Array]:
    """Compare the readings (2, n_m) of each joint with its last ones, which they can repeat.

    Repetitions are all readings with the last time stamp [s], and equal readings of a joint that
    moves; without a velocity or with a new stamp, its motion since the last new reading must exceed
    2.5 encoder steps. If no reading has changed, one repetition shows that all are repetitions;
    otherwise a joint's repetitions count up to 0.1 s. Without stamps, if a new reading is farther
    than two periods at the joint's new velocity, equal readings before it were repetitions.

    Returns (n_m,) whether each reading is a repetition; the number of the equal readings before a
    new one that were repetitions of all joints; and (n_m,) the further number of each joint.
    """
    n, clear, farthest, stamped = read.shape[1], False, 0.0, not math.isnan(stamp)
    found, sure, equal = np.zeros(n, np.bool_), np.zeros(n, np.bool_), np.zeros(n, np.bool_)
    rested, waited = w.rested.min(), np.zeros(n)
    for i in range(n):
        q, qd, grain = read[0, i], read[1, i], w.grain[i]
        known, speed = w.no_velocity[()] == 0.0 and qd == qd, w.x_est[1, i]
        equal[i] = _same(read[:, i], w.reading[:, i])
        if not equal[i]:
            change = abs(q - w.reading[0, i])
            # One step of Euclid's algorithm: the resolution divides each change.
            grain = grain if grain > 0.0 else change
            rest = abs(change - grain * round(change / grain)) if grain > 0.0 else 0.0
            w.grain[i] = rest if rest > _EQUAL else grain
            far = change - 2.0 * dt * (0.0 if math.isnan(qd) else abs(qd)) > _STILL
            waited[i] = w.rested[i] if far and not stamped else 0.0
        elif not (known and qd == 0.0):
            waits = w.age[()] + w.q_last[3, i] > 0.0
            way = abs(w.x_est[0, i] - w.lag[()] * dt * speed - q) + dt * abs(speed)
            farthest = max(farthest, way)
            enough = max(_CLEARLY_FAR * grain, 0.0 if known else _LEAST_WAY)
            clear = clear or (grain > 0.0 and way > enough)
            sure[i] = 0.0 < _GRAINS * grain < way or w.q_last[3, i] > 0.0 or (known and not stamped)
            moves = dt * abs(speed) > _STILL and (sure[i] or w.interval[()] > 1.0)
            found[i] = waits or moves
    ends = (w.q_last[3].max() + w.age[()] + 1.0) * dt > MAX_AGE
    if stamp == w.stamp[()]:
        found[:], clear = True, True
    elif equal.all() and not stamped:
        fill(found, bool(found.any()) and not (ends and farthest < _LEAST_WAY))
    else:
        found &= sure & (not ends)
    w.faults[REPEATED] = clear and found.any()
    rested = rested if waited.any() else 0.0
    for i in range(n):
        waited[i] = waited[i] - rested if 0.0 < (waited[i] - rested) * dt <= MAX_AGE else 0.0
        if not found.all():
            at_rest = equal[i] and not (found[i] or stamped)
            w.rested[i] = w.rested[i] + 1.0 if at_rest else 0.0
    return found, rested, waited


@compiled()
def _usable_velocity(robot: Any, w: Any, read: Array, fresh: bool, first: bool) -> Array:
    """The base's velocity: the reading `read` (n_b,), or the prediction by its drive's model.

    A reading is not used if it is not `fresh`, is missing, or exceeds twice the limit of its axis.
    The prediction does not pass the command; after a gap it is the command, at the first reading 0.
    """
    found = read.copy()
    for i in range(len(read)):
        possible = abs(read[i]) <= 2.0 * robot.v_max[i]  # not NaN
        if not (possible and fresh):
            rest = min(max(w.v_cmd[i], -robot.v_max[i]), robot.v_max[i]) - w.base_velocity[i]
            change = w.elapsed[()] * w.a_base_meas[i]
            if math.isnan(w.v_last[i]) or change * rest > rest * rest:
                change = rest
            found[i] = 0.0 if first else w.base_velocity[i] + change
            if fresh:
                w.faults[VELOCITY] = 1.0
    return found


@compiled()
def _recall(w: Any, ago: int, count: int) -> Array:
    """(count, n_m) predicted accelerations in `count` periods; the last is `ago` periods old."""
    found = np.empty((count, w.history.shape[1]))
    for k in range(count):
        put(found[k], w.history[(int(w.periods[()]) - ago - count + 1 + k) % HISTORY])
    return found


@compiled()
def _store(w: Any, qdd: Array, a_base: Array) -> None:
    """Store the accelerations of arm (n_m,) and base (n_b,) in a further control period."""
    row = (int(w.periods[()]) + 1) % HISTORY
    w.periods[()], w.known[()] = row, min(w.known[()] + 1.0, 1.0 * HISTORY)
    put(w.history[row], qdd)
    put(w.base_history[row], a_base)


@compiled()
def _predict(robot: Any, gains: Any, w: Any, velocity: Array, fresh: bool, missed: float) -> None:
    """Predict the arm's motion in the period after the last step, and in `missed` periods after it.

    In missed periods the accelerations remain constant, and `w.qd_used` gets the predicted
    velocities, because the law has used none. If the last torques or the base's last velocity are
    unknown, or with `HISTORY` or more missed periods, the history ends (`w.known` = 0). With -1
    missed periods, for a second step in a period, nothing is predicted.
    """
    if missed >= 0.0:
        if math.isnan(w.v_last[0]) or math.isnan(w.u_a[0]):
            w.known[()] = 0.0
        else:
            late = w.lag[()] != 0.0 or w.base_late[()] != 0.0 or w.base_lost[()] != 0.0
            measured = fresh and not late and w.elapsed[()] == gains.dt
            a_base = (velocity - w.v_last) / gains.dt if measured else w.a_base_meas
            qdd_b = times(robot.J_m_inv, a_base)
            _store(w, predicted_joint_acceleration(w.M, w.h, w.L_aa, w.u_a, qdd_b), a_base)
        advance(w.x_est, _recall(w, 0, 1), gains.dt)
    if missed >= HISTORY:
        w.known[()] = 0.0
        fill(w.v_last, math.nan)
    elif missed > 0.0 and w.known[()] > 0.0:
        for _ in range(int(missed)):
            row = int(w.periods[()])
            put(w.qd_used[row], w.x_est[1])
            _store(w, w.history[row], w.base_history[row])
            advance(w.x_est, _recall(w, 0, 1), gains.dt)
        w.blind_time[()] = max(w.blind_time[()], w.elapsed[()])


@compiled()
def _explained(w: Any, dt: float, count: int) -> Array:
    """(n_m, count) [rad]; column k: motion by `w.history` from `count` - 1 to k periods ago."""
    n_m = w.history.shape[1]
    found, speed, way = np.zeros((n_m, count)), np.zeros(n_m), np.zeros(n_m)
    for k in range(count - 2, -1, -1):
        speed += dt * w.history[(int(w.periods[()]) - k) % HISTORY]
        way += dt * speed
        put(found[:, k], way)
    return found


@compiled()
def _polynomials(ages: Array, count: int) -> Array:
    """(count, n) orthonormal values of polynomials of degree 0 to count - 1 at the ages (n,)."""
    found = np.ones((count, len(ages)))
    for j in range(count):
        if j > 0:
            put(found[j], found[j - 1] * ages / ages[-1])
        for _ in range(2):  # the second time against rounding errors
            for i in range(j):
                put(found[j], found[j] - dot(found[i], found[j]) * found[i])
        put(found[j], found[j] / math.sqrt(dot(found[j], found[j])))
    return found


@compiled()
def _find_lag(robot: Any, w: Any, q: Array, age: int, gains: Any) -> None:
    """Estimate `w.lag` if the newest group of readings is full; then a new group begins.

    Add the positions q (n_m,), `age` + 1 periods after the last reading, to the newest group.
    """
    ages = w.group_age
    ages += age + 1.0
    if ages[0] >= 0.5 * (_GROUP + 1.0):
        _weigh_lags(robot, w, gains)
        for k in range(len(ages) - 1, 0, -1):
            put(w.group[k], w.group[k - 1])
            ages[k] = ages[k - 1]
        w.group_size[()] = 0.0
    w.group_size[()] += 1.0
    share = 1.0 / w.group_size[()]
    ages[0] *= 1.0 - share
    put(w.group[0], w.group[0] + share * (q - w.group[0]))


@compiled()
def _residuals(q: Array, ways: Array, ages: Array, basis: Array, lags: int) -> Array:
    """(lags + 1,) [rad²] sums of squared residuals of one joint: each lag, then no prediction.

    q (n,) [rad] and `ages` (n,) are the mean positions and ages [control periods] of the groups,
    `ways` (count,) [rad] the predicted motion until 0, 1, ... control periods ago. The best fit of
    `basis` (m, n), orthonormal polynomials, is subtracted.
    """
    found, fitted, rest = np.zeros(lags + 1), np.zeros((len(basis), lags + 1)), np.empty(lags + 1)
    for k in range(len(q)):
        age, moved = int(ages[k]), q[k] - q[0]
        share = ages[k] - age
        for lag in range(lags):
            rest[lag] = moved - (1.0 - share) * ways[age + lag] - share * ways[age + 1 + lag]
        rest[lags] = moved
        for lag in range(lags + 1):
            found[lag] += rest[lag] * rest[lag]
            for j in range(len(basis)):
                fitted[j, lag] += basis[j, k] * rest[lag]
    for j in range(len(basis)):
        found -= fitted[j] * fitted[j]
    return found


@compiled()
def _compare_lags(
    robot: Any, w: Any, ways: Array, n: int, dt: float
) -> tuple[Array, Array, float, float]:
    """Compare the possible lags by the newest n groups; dt [s] is the control period.

    A lag predicts the motion by `ways`, the result of `_explained`, up to a polynomial of time for
    the motion by external forces, and up to an error by dry friction. The noise of each joint is
    unknown. "The present" is the better of two: the present lag, and no prediction.

    Returns (lags,) the logarithm of the likelihood ratio of each lag to the present, (lags,) [rad²]
    the sum of the squared residuals of each lag, and the sum [rad²] below which a lag is clearly
    better than the present. The last result is the logarithm of the likelihood ratio of no
    prediction to the best lag, for the joints that have just been faster than `_VIOLENT` times
    their speed limit.
    """
    lags, present, ages = len(w.evidence), int(w.lag[()]), w.group_age
    basis = _polynomials(ages[:n], 4 if n >= _CUBIC else 3)
    ratios, totals, worse = np.ones(lags), np.zeros(lags + 1), np.ones(lags)
    steps, friction = w.group[: n - 1] - w.group[1:n], np.zeros(len(ways))
    for i in range(len(ways)):  # dry friction changes at once where a joint turns back
        torque, turned = np.zeros(len(ways)), min(steps[:, i].max(), -steps[:, i].min())
        if turned > 3.0 * math.sqrt(w.noise_var[0, i]) + _EXACT:
            torque[i] = _REVERSAL * _DRY_FRICTION * robot.tau_max[i]
            friction += np.abs(solved(w.L_aa, torque))
    friction *= (ages[n - 1] * dt) ** 2
    for i in range(len(ways)):
        error = min(w.noise_var[0, i], _MOST_NOISE**2) / w.group_size[()] + _EXACT**2
        error += friction[i] ** 2
        residuals = _residuals(w.group[:n, i], ways[i], ages, basis, lags)
        for lag in range(lags + 1):
            residuals[lag] = max(residuals[lag], 0.0) + (n - len(basis)) * error
            totals[lag] += residuals[lag]
        least, violent = min(residuals[present], residuals[lags]), False
        for k in range(_RECENTLY):
            speed = abs(steps[k, i]) / (dt * (ages[k + 1] - ages[k]))
            violent = violent or speed > _VIOLENT * robot.qd_max[i]
        for lag in range(lags):
            ratios[lag] *= least / residuals[lag]
            worse[lag] *= residuals[lag] / residuals[lags] if violent else 1.0
    clear = min(totals[present], totals[lags]) / _CLEARLY
    return 0.5 * np.log(ratios), totals[:lags], clear, 0.5 * math.log(worse[: _MOST_LAG + 1].min())


@compiled()
def _weigh_lags(robot: Any, w: Any, gains: Any) -> None:
    """Update the evidence for lags and for a contradiction; change the lag by sufficient evidence.

    The evidence for each lag is a CUSUM test: each group adds a logarithm of a likelihood ratio,
    with an upper bound, minus `_DOUBT`. Sufficient evidence must also follow from the newest two
    thirds of the groups alone, or exceed the largest evidence that all groups can add. Otherwise a
    force that begins within the oldest groups would look like a delay.
    """
    ages, lags, n = w.group_age, len(w.evidence), 0
    oldest = min(int(w.known[()]), HISTORY) - lags - 1
    while n < len(ages) and ages[n] < oldest:
        n += 1
    if n < _FEWEST_GROUPS or w.lag[()] > _MOST_LAG:
        return
    ways = _explained(w, gains.dt, int(ages[n - 1]) + lags + 1)
    gain, totals, clear, against = _compare_lags(robot, w, ways, n, gains.dt)
    # The prediction is right if the period and the base's acceleration are right.
    right = w.ratio[()] == 1.0 and w.faults[LOCALISATION] == w.faults[BASE] == 0.0
    if right and math.isfinite(against):
        w.contradiction[()] += min(max(against, -_LARGEST_GAIN), _LARGEST_GAIN)
    lasting, gain = len(ages) * (_LARGEST_GAIN - _DOUBT), np.where(totals < clear, gain, 0.0)
    gain = np.where(totals < clear, gain - max(gain.max() - _LARGEST_GAIN, 0.0), 0.0)
    put(w.evidence, np.minimum(np.maximum(w.evidence + gain - _DOUBT, 0.0), 2.0 * lasting))
    best = int(np.argmax(w.evidence))
    known = np.argmin(totals) <= _MOST_LAG  # the residuals of longer lags are larger
    if not known or best > _MOST_LAG or w.evidence[best] <= _CONVINCING:
        return
    newest = max(2 * n // 3, _FEWEST_GROUPS)
    _, totals, clear, _ = _compare_lags(robot, w, ways, newest, gains.dt)
    if w.evidence[best] > lasting or totals[best] < clear:
        w.hidden_lag[()] += best - w.lag[()]
        w.lag[()] = best
        w.samples[()] = 0.0
        fill(w.noise_var, 0.0)
        fill(w.evidence, 0.0)


@compiled()
def _measure_from(w: Any, q: Array, qd: Array) -> None:
    """Restart the measurement of the control period at positions q and velocities qd (n_m,)."""
    put(w.travel[0], q)
    fill(w.travel[1], 0.0)
    put(w.travel[2], qd)
    w.since[()] = w.travel_time[()] = 0.0


@compiled()
def _find_period(w: Any, q: Array, qd: Array, steps: int, gains: Any) -> None:
    """Estimate `w.ratio`, the displacement of a joint divided by the integral of its velocity.

    A driver's filter delays velocities by up to 0.01 s, and rare readings seem to delay them by
    half an interval; thus the ratio has a range. It counts as 1 if the range comes within 10 % of
    1, or contains 0. A ratio outside of 1/8 to 10 sets `w.no_velocity`. Successive ratios other
    than 1 that agree within 15 % for 0.05 s set the fault `period`, or `w.no_velocity` if a clock
    confirms the period. After the fault, 2 % replaces 10 %.
    """
    gap = steps > HISTORY or (steps == 1 and w.known[()] == 0.0)  # of unknown duration
    if gap or w.elapsed[()] > gains.dt or w.faults[PERIOD] != 0.0:
        _measure_from(w, q, qd)
        return
    corrected = w.corrected[()] != 0.0
    right, precisely = (_MEASURED_RIGHT, _PRECISELY) if corrected else (_RIGHT, 1.0)
    far, most, time = -1, 1.0, steps * gains.dt
    w.since[()] += 1.0
    w.travel_time[()] += time
    for i in range(len(q)):
        w.travel[1, i] += time * 0.5 * (w.reading[1, i] + qd[i])
        if w.q_last[3, i] > 0.0:  # its readings are older
            w.travel[0, i], w.travel[1, i], w.travel[2, i] = q[i], 0.0, qd[i]
        way = precisely * max(_LEAST_WAY, _NOISES * math.sqrt(w.noise_var[0, i]))
        share = abs(q[i] - w.travel[0, i]) / way
        if share > most:
            far, most = i, share
    if far < 0 or w.since[()] < 4.0:
        return
    way, integral = q[far] - w.travel[0, far], w.travel[1, far]
    later = integral + (_FILTER + 0.5 * time) * (qd[far] - w.travel[2, far])
    ratio = way / integral if integral != 0.0 else math.inf
    late = way / later if later != 0.0 else math.inf
    low, high = min(ratio, late), max(ratio, late)
    unclear = low < 0.0 < high  # the readings show neither a right nor a wrong ratio
    if unclear or (low < right and high > 1.0 / right):
        found = 1.0
    elif low > 0.0 and high < math.inf:
        found = math.sqrt(low * high)
    else:
        found = low if low > 1.0 else high
    by_clock = w.clock_ratio[()] == 1.0  # then the velocities are wrong, not the period
    plausible = _SMALLEST < found < _LARGEST  # not NaN
    if not unclear and (found == 1.0 or not (by_clock and plausible)):
        w.no_velocity[()] = 0.0 if plausible else 1.0
    if w.no_velocity[()] != 0.0 or found == 1.0:
        found, w.agreed[()] = 1.0, 0.0
    else:
        lasts = w.travel_time[()] * (1.0 if by_clock else found)
        w.agreed[()] = w.agreed[()] + lasts if abs(found - w.ratio[()]) < 0.15 * found else 0.0
        if w.agreed[()] >= max(_AGREED, 1.5 * lasts):
            if by_clock:
                w.no_velocity[()] = 1.0
            elif w.clock_ratio[()] == 0.0:
                w.faults[PERIOD] = w.corrected[()] = 1.0
        w.samples[()] = 0.0  # the estimate restarts until the period is known
    w.ratio[()] = found
    _measure_from(w, q, qd)


@compiled()
def count_periods(w: Any, now: float, dt: float) -> tuple[float, float]:
    """Number of control periods dt [s] since the last step, and the lead of the clock [periods].

    `now` [s] is the time of this step. The number is 1 without a clock or if `now` does not grow,
    infinite after a pause of more than 0.1 s, and 0 for a second step in the same period, because
    some loops catch up after a stall. A step that is up to 0.9 periods late, or up to half a period
    early, counts as one period; if a coarse clock has not changed for some steps, these bounds
    count for each of them. The lead, for `w.clock_ahead`, is the clock's time minus that of all
    counted periods; thus the numbers add up to the true time. It is 0 for a coarse clock, and
    decays by up to 5 % of dt in each period, because the true period can differ by 5 % from dt.
    """
    interval, steps, missed = (now - w.clock[()]) / dt, 1.0 + w.clock_rest[()], 0.0
    if not interval > 0.0:  # NaN too
        return 1.0, 0.0
    ahead, drift = w.clock_ahead[()] + interval - steps, _DRIFT * min(interval, 1.0)
    if ahead * dt >= MAX_AGE:
        return math.inf, 0.0
    if ahead > _LATE_BY * steps or ahead < -_EARLY_BY * steps:
        missed = 1.0 * max(round(ahead), -1)
    ahead -= missed
    return 1.0 + missed, ahead - min(max(ahead, -drift), drift) if steps == 1.0 else 0.0


@compiled()
def _watch_clock(w: Any, now: float, dt: float) -> float:
    """Compare the control period dt [s] with the caller's clock `now` [s]; NaN without one.

    A step after missed periods sets the fault `stall` if the clock has confirmed the period, or
    after a pause of more than 0.1 s. A measurement of `w.clock_ratio`, the true control period
    relative to dt, is the mean interval in periods dt. It counts as 1 if it differs from 1 by less
    than 5 % or 0.75 standard deviations of the intervals: stalls and jitter do not show a wrong
    period. Two successive ratios other than 1 that agree set the fault `period`. The result is the
    number of missed periods; it is -1 for a second step in the same period.
    """
    interval, steps, span = (now - w.clock[()]) / dt, 1.0 + w.clock_rest[()], w.clock_span
    periods, w.clock_ahead[()] = count_periods(w, now, dt)
    w.clock[()], w.clock_rest[()] = now, steps if interval == 0.0 else 0.0
    w.faults[STALL] = periods > 1.0 and (w.clock_ratio[()] == 1.0 or periods == math.inf)
    if not (interval >= 0.0 and periods < math.inf):  # NaN too
        fill(span, 0.0)
        w.clock_ratio[()] = 0.0 if math.isnan(now) else w.clock_ratio[()]
    elif interval > 0.0:
        span[0] += steps
        span[1] += interval
        span[2] += interval**2 / steps
        if span[1] * dt >= _MEASURED and span[0] >= _FEWEST_PERIODS:
            mean = span[1] / span[0]
            deviation = math.sqrt(max(span[2] / span[0] - mean**2, 0.0))
            if abs(mean - 1.0) < max(_RIGHT_BY_CLOCK - 1.0, _SPREAD * deviation):
                mean = 1.0
            elif abs(mean - w.clock_ratio[()]) < _ALIKE_PERIODS * mean:
                w.faults[PERIOD] = 1.0
            w.clock_ratio[()] = mean
            fill(span, 0.0)
    return periods - 1.0


@compiled()
def _forget_groups(w: Any) -> None:
    """Forget all groups of readings, and the evidence for lags: the groups' ages are unknown."""
    fill(w.evidence, 0.0)
    put(w.group_age, HISTORY * np.arange(1.0, len(w.group_age) + 1.0))


@compiled()
def _use_stated_lag(gains: Any, w: Any) -> None:
    """Update the lag if the stated delay, or its number of control periods, changes.

    With time stamps, `w.lag` follows from `w.hidden_lag` at the next reading.
    """
    stated = min(round(gains.delay / gains.dt), _MOST_LAG)
    more = stated - w.stated_lag[()]
    w.hidden_lag[()] = min(max(w.hidden_lag[()] + more, 0.0), _MOST_LAG)
    if more != 0.0 and math.isnan(w.stamp[()]):
        w.lag[()] = min(max(w.lag[()] + more, 0.0), _MOST_LAG)
    w.stated_lag[()] = stated


@compiled()
def _motion(robot: Any, heading: float, velocity: Array, time: float) -> Array:
    """(3,) motion x, y, φ in the world of a base with a heading [rad], in a time [s]."""
    twist = times(robot.T_J_m, times(robot.J_m_inv, velocity))
    c, s = math.cos(heading), math.sin(heading)
    x, y = c * twist[0] - s * twist[1], s * twist[0] + c * twist[1]
    return time * np.array([x, y, twist[2]])


READING = types.Array(types.f8, 1, "A")
"""The type of a reading's array, for signatures of compiled functions."""


@compiled(
    Signature(
        types.UniTuple(types.f8[::1], 2),
        (ROBOT.type, GAINS.type, STEP.type, READING, READING, types.f8),
        None,
    )
)
def later_base(
    robot: Any, gains: Any, w: Any, pose: Array, velocity: Array, age: float
) -> tuple[Array, Array]:
    """The pose (3,) and the velocity (n_b,) of the base, `age` [s] after their readings.

    The velocity changes by the assumed accelerations of the last control periods; if the age is
    negative, it is constant. A missing or impossible entry becomes NaN; in the pose's motion the
    entry of `w.base_velocity` replaces it. With an age above `_SELDOM`, all results are NaN.
    """
    w.base_late[()] = 1.0
    if not age <= _SELDOM:
        return np.full(3, math.nan), np.full(len(velocity), math.nan)
    possible, dt = np.abs(velocity) <= 2.0 * robot.v_max, gains.dt  # not NaN
    x, v = pose.copy(), np.where(possible, velocity, w.base_velocity)
    known, newest = int(max(min(round(age / dt), w.known[()]), 0.0)), int(w.periods[()])
    time = age - known * dt
    for k in range(known, -1, -1):  # k further periods
        x += _motion(robot, x[2], v, time)
        time = dt
        if k == 1:
            v += dt * w.a_base_meas
        elif k > 1:
            v += dt * w.base_history[(newest - k + 2) % HISTORY]
    return x, np.where(possible, v, math.nan)


@compiled()
def _differs(error: Array, way: float, turn: float) -> bool:
    """Whether the error (3,) of a motion exceeds `_NEAR` + half of `way` [m] or `turn` [rad]."""
    far = math.hypot(error[0], error[1]) > _NEAR + 0.5 * way
    return far or abs(error[2]) > _NEAR + 0.5 * turn


@compiled()
def _take_pose(robot: Any, w: Any, pose: Array, v: Array, time: float) -> None:
    """Update `w.pose_last` by a reading (3,) of the base's pose, `time` [s] after the last one.

    The base's velocity replaces an equal or invalid reading. The fault `localisation` shows a jump,
    or recent changes of the pose that differ from the integral of v (n_b,) by more than `_NEAR`
    plus half of the path, also without a new pose for `_SELDOM`. Jumps between poses of
    `later_base` can also have half of the path in `_SELDOM`.
    """
    moved, decay = _motion(robot, w.pose_last[2], w.base_velocity, time), math.exp(-time / _RECENT)
    shown = _motion(robot, w.pose_last[2], v, time)
    put(w.pose_last, w.pose_last + moved)
    put(w.pose_moved, w.pose_moved + moved)
    put(w.pose_error, decay * (w.pose_error - shown))
    w.pose_way[0] = decay * (w.pose_way[0] + math.hypot(shown[0], shown[1]))
    w.pose_way[1] = decay * (w.pose_way[1] + abs(shown[2]))
    w.pose_age[()] += time
    if not math.isfinite(pose.sum()):
        put(w.pose_error, -w.pose_moved)
        return
    jumped, compared = False, w.pose_age[()] > _SELDOM
    if not _same(pose, w.pose_read):
        jump = pose - w.pose_last
        jump[2] = (jump[2] + math.pi) % (2.0 * math.pi) - math.pi
        late = w.base_late[()] * _motion(robot, w.pose_last[2], w.base_velocity, _SELDOM)
        path = np.abs(w.pose_moved) + np.abs(late)
        jumped, compared = _differs(jump, math.hypot(path[0], path[1]), path[2]), True
        put(w.pose_error, w.pose_error + (jump + w.pose_moved))
        fill(w.pose_moved, 0.0)
        w.pose_age[()] = 0.0
        put(w.pose_jump, jump)
        put(w.pose_last, pose)
    if jumped or (compared and _differs(w.pose_error, w.pose_way[0], w.pose_way[1])):
        w.faults[LOCALISATION] = 1.0


@compiled()
def _take_base(
    robot: Any, gains: Any, w: Any, pose: Array, velocity: Array, v: Array, fresh: bool, first: bool
) -> None:
    """Store the base's readings, and compare them with each other and with the drive's model.

    `velocity` (n_b,) is the one in use, v is compared with the pose. A pose that is not `fresh` is
    a repetition. The fault `base` shows changes of velocity that the drive does not explain.
    """
    time = w.elapsed[()]
    begins = first or w.known[()] == 0.0  # after a gap the motion is unknown
    pose = pose if fresh else w.pose_read
    moved = math.isfinite(pose.sum()) and (first or not _same(pose, w.pose_read))
    if begins or (moved and math.isinf(w.pose_way[0])):
        if moved:
            put(w.pose_last, pose)
        fill(w.pose_moved, 0.0)
        fill(w.pose_error, 0.0)
        fill(w.pose_way, 0.0 if moved else math.inf)
        w.pose_age[()] = 0.0
    else:
        _take_pose(robot, w, pose, v, time)
    if not math.isnan(w.v_last[0]):
        astray = w.astray + velocity - w.v_last - time * w.a_base_meas
        put(w.astray, math.exp(-time / _FOLLOWS) * astray)
        w.faults[BASE] = np.any(np.abs(w.astray) > _ASTRAY * gains.largest_command)
    put(w.v_last, velocity)
    put(w.base_velocity, velocity)
    w.base_late[()], w.base_lost[()] = 0.0, 0.0 if fresh else 1.0
    if fresh:
        put(w.pose_read, pose)
        put(w.v_read, velocity)


@compiled()
def _advance_blind(robot: Any, gains: Any, w: Any) -> None:
    """Predict the arm's velocity for the fallback command; 0 with the fault `contradictory`."""
    w.age[()] += 1.0
    w.known[()] = w.unstated[()] = 0.0
    fill(w.v_last, math.nan)
    if not (math.isnan(w.q_posture[0]) or math.isnan(w.u_a[0])):
        at_rest = np.zeros(robot.n_b)
        qdd = predicted_joint_acceleration(w.M, w.h, w.L_aa, w.u_a, at_rest)
        advance(w.x_est, qdd.reshape((1, len(qdd))), gains.dt)
        # An external force does not stay constant.
        put(w.x_est[2], math.exp(-gains.dt / gains.noise_window) * w.x_est[2])
        if w.faults[CONTRADICTORY] != 0.0:  # wrong speeds; their damping could accelerate the arm
            fill(w.x_est[1], 0.0)
        put(w.qd[robot.n_b :], w.x_est[1])


@compiled()
def _match_lag(w: Any, q: Array, qd: Array, gains: Any) -> None:
    """Change lag and age if a different lag explains a new reading q, qd (n_m,) far better.

    The positions are compared with those predicted for the last control periods. The velocities
    must agree too: a robot that stops is no delay. The lag changes only after `FEWEST` samples of
    the noise and with a `w.ratio` of 1.
    """
    count, lag, dt = int(min(w.known[()], _MOST_LAG + 1.0)), int(w.lag[()]), gains.dt
    if w.samples[()] < FEWEST or lag >= count or w.ratio[()] != 1.0:
        return
    x, errors, alike = w.x_est.copy(), np.zeros(count), np.zeros(count, np.bool_)
    more = w.q_last[3] + np.minimum(w.rested, MAX_AGE / dt)  # periods without a reading
    missed = _UNEXPECTED * dt**2 * ((1.0 + more) * (1.0 + more))
    used = w.age[()] * dt * w.v_error
    variance = w.noise_var[0] + missed * missed + used * used
    for k in range(count):
        off, turned = q - x[0], qd - x[1]
        errors[k] = (off * off / variance).sum()
        alike[k] = dot(turned, turned) < _ALIKE * dot(x[1], x[1])
        if k == lag and errors[k] < _CLEARLY**2 * len(q):
            return
        x[0] -= dt * x[1]
        x[1] -= dt * (w.history[(int(w.periods[()]) - k) % HISTORY] + x[2])
    best = int(np.argmin(errors))
    if alike[best] and errors[lag] > _CLEARLY**2 * (errors[best] + len(q)):
        w.lag[()] = best
        w.age[()] += lag - best
        fill(w.evidence, 0.0)


@compiled()
def _learn_errors(
    robot: Any, gains: Any, w: Any, predicted: Array, periods: Array, jumped: bool
) -> None:
    """Update `w.v_error` and `w.blind_time` after a new reading.

    The error is that of the velocities that the law used for the time of the reading: `predicted`
    (n_m,), or `w.qd_used` if the reading has a lag. It counts in `w.v_error` if the `periods`
    (n_m,) of a joint, as in `process_noise`, are more than one. After a large error or a jump of
    the arm, the readings can be older than assumed, so `w.blind_time` grows, unless time stamps
    have shown an age of more than one period.
    """
    steps, lag = 1.0 + w.age[()], int(w.lag[()])
    decay, stamped = math.exp(-steps * gains.dt / gains.noise_window), not math.isnan(w.stamp[()])
    used = w.qd_used[(int(w.periods[()]) - lag) % len(w.qd_used)] if lag > 0 else predicted
    compared = not jumped and (lag == 0 or w.known[()] > lag)
    doubtful = jumped and not (stamped and steps + lag > 1.0)
    for i in range(len(predicted)):
        error = abs(w.x_read[1, i] - used[i]) if compared else 0.0
        blind, large = periods[i] > 1.0, error > _DOUBTFUL * gains.dt * robot.qd_max[i]
        doubtful = doubtful or (large and not (stamped and blind))
        w.v_error[i] = max(error if blind else 0.0, decay * w.v_error[i])
    if doubtful:
        w.blind_time[()] = max(w.blind_time[()], min((steps + lag) * gains.dt, MAX_AGE) + _LATE)


@compiled()
def _use_estimate(robot: Any, gains: Any, w: Any) -> None:
    """Write the present state, and update `w.qd_used` and `w.blind_time`."""
    put(w.q_m, w.x_est[0])
    put(w.qd_m, w.x_est[1])
    decayed = math.exp(-gains.dt / gains.noise_window) * w.blind_time[()]
    periods = w.age[()] + w.lag[()] + w.q_last[3].max() + 1.0
    w.blind_time[()] = max(periods * gains.dt, decayed)
    put(w.qd_used[int(w.periods[()]) % len(w.qd_used)], w.qd_m)
    moved = _motion(robot, w.pose_last[2], w.base_velocity, w.lag[()] * gains.dt)
    put(w.base_pose, w.pose_last + moved)


@compiled()
def _checked_positions(
    robot: Any, w: Any, base_pose: Array, q_m: Array, drive: Array, first: bool
) -> tuple[Array, bool]:
    """The positions (n_m,) without jumps by full turns, and whether the reading is unusable.

    Clears the faults of the last step, and sets `invalid` and `implausible`.
    """
    fill(w.faults, 0.0)
    if not math.isfinite(q_m.sum() + drive.sum()):
        w.faults[INVALID] = 1.0
        return q_m.copy(), True
    w.faults[INVALID] = not math.isfinite(base_pose.sum())
    q = unwrap(q_m, w.q_last[1], robot.q_limits, first)
    low, high = robot.q_limits
    half = 0.5 * (high - low)
    lost = w.faults[IMPLAUSIBLE] = bool(np.any((q < low - half) | (q > high + half)))
    return q, lost


@compiled()
def take_readings(
    robot: Any, gains: Any, w: Any, readings: tuple[Array, ...], now: float, time: float
) -> None:
    """Check the readings, and estimate the present state of the robot (Algorithm 2, line 2).

    A prediction replaces unusable readings. `w.valid` becomes 0, and no state is estimated, before
    the first usable reading, after 0.1 s without one, and from the fault `contradictory` until
    `reset`. The arguments from `readings` on are fields of a `Measurement`, the first five first.
    """
    _use_stated_lag(gains, w)
    read_pose, v, q_m, qd_m, drive = readings
    base_pose = np.where(np.abs(read_pose) <= _EARTH, read_pose, math.nan)
    first, stamped, age, older = math.isnan(w.q_posture[0]), time == time, now - time, False
    q, lost = _checked_positions(robot, w, base_pose, q_m, drive, first)
    read, shown, missed = np.stack((q, qd_m)), np.stack((q, qd_m)), _watch_clock(w, now, gains.dt)
    before, w.elapsed[()] = w.elapsed[()], (1.0 + missed if missed < HISTORY else 1.0) * gains.dt
    old, rested, waited = np.zeros(len(q), np.bool_), 0.0, np.zeros(len(q))
    if not (lost or first):
        old, rested, waited = _compare_joints(w, read, time, gains.dt)
    w.age[()] += 0.0 if first else min(missed, 1.0 * HISTORY)
    changed, oldest = not old.all(), min(MAX_AGE, (HISTORY - 1) * gains.dt)
    future, too_old = changed and age < -EARLY, changed and age > oldest  # not NaN
    w.faults[INVALID], w.faults[LAG] = max(w.faults[INVALID], 1.0 * future), too_old
    not_new = future or too_old or not changed
    lost = lost or not_new
    w.faults[STALE] = lost and (w.age[()] + 1.0) * gains.dt > MAX_AGE
    w.faults[CONTRADICTORY] = w.contradiction[()] > _CONTRADICTORY
    w.valid[()] = w.faults[STALE] == w.faults[CONTRADICTORY] == 0.0 and not (lost and first)
    if w.valid[()] == 0.0:
        _advance_blind(robot, gains, w)
        return
    # Without a time stamp of its own, the base's reading is as old as that of the joints.
    base_new = w.base_late[()] != 0.0 or not (stamped and not_new)
    moves = bool(np.any(v != 0.0))  # NaN too
    base_new = base_new and not (moves and _same(base_pose, w.pose_read) and _same(v, w.v_read))
    wrong = _differs(w.pose_error + w.pose_moved, w.pose_way[0], w.pose_way[1])
    velocity = _usable_velocity(robot, w, v, base_new and not wrong, first)
    _predict(robot, gains, w, velocity, base_new and not wrong, missed)
    if not lost:
        older = _is_older(gains, w, read, old, age, first)
        if older:
            base_new, velocity = False, _usable_velocity(robot, w, v, False, first)
    v = v if wrong and np.all(np.abs(v) <= 2.0 * robot.v_max) else w.base_velocity.copy()
    _take_base(robot, gains, w, base_pose, velocity, v, base_new, first)
    if lost or older:
        w.age[()] += 1.0
    else:
        _take_new(robot, gains, w, read, old, rested, waited)
    if not lost:
        w.stamp[()] = time
        put_rows(w.reading, shown)
    w.faults[LAG] = max(w.faults[LAG], 1.0 * (w.lag[()] > w.stated_lag[()]))
    estimate_load(gains, w, before, w.faults[JUMP] != 0.0)
    w.faults[LOAD] = w.unstated[()] != 0.0
    _use_estimate(robot, gains, w)


@compiled()
def _is_older(gains: Any, w: Any, read: Array, old: Array, age: float, first: bool) -> bool:
    """Whether new readings are older than the last ones; predictions replace those of `old` joints.

    `read` (2, n_m) are positions and velocities, and `age` [s] is their age by the time stamp, or
    NaN: then `_match_lag` can change the lag. An age sets the lag, together with the delay that
    time stamps do not show. A difference below 0.9 periods does not change the lag: jitter of the
    clock must not change the number of periods between two readings. A reading can be later by a
    part of a period than the counted periods and the lag assume. Clock and time stamp each show
    this part; the motion in the smaller part, if their signs agree, is subtracted from positions.
    """
    stamped, later, dt = not math.isnan(age), 0.0, gains.dt
    if stamped:
        lag, periods = w.lag[()], age / dt + w.hidden_lag[()]
        if first or abs(periods - lag) > _JITTER:
            lag = 1.0 * max(round(periods), 0)
        if not first:
            w.age[()] += w.lag[()] - lag
        w.lag[()] = lag
        by_clock = w.clock_ahead[()]
        by_stamp = by_clock + lag - w.hidden_lag[()] - age / dt
        later = max(min(by_clock, by_stamp), 0.0) + min(max(by_clock, by_stamp), 0.0)
    for i in range(len(old)):
        read[0, i] -= later * dt * w.x_est[1, i]
        if old[i]:
            read[0, i] = w.x_est[0, i] - w.lag[()] * dt * w.x_est[1, i]
            read[1, i] = w.x_est[1, i]
    if not (stamped or first):
        _match_lag(w, read[0], read[1], gains)
    return w.age[()] < 0.0


@compiled()
def _take_new(
    robot: Any, gains: Any, w: Any, read: Array, old: Array, rested: float, waited: Array
) -> None:
    """Update the estimate of the arm's motion by new readings (2, n_m).

    The readings of `old` joints (n_m,) are predictions. `rested` and `waited` (n_m,) are results of
    `_compare_joints`. More than 0.1 s of repetitions are a gap of unknown duration; after it, a
    reading that the arm cannot reach within 0.1 s is a jump.
    """
    first, q = math.isnan(w.q_posture[0]), read[0].copy()
    w.q_last[3] += waited
    if rested > 0.0:
        _forget_groups(w)
    w.age[()] += rested
    gap, longest = rested * gains.dt > MAX_AGE, round(MAX_AGE / gains.dt)
    leapt = gap and has_jumped(w.x_read, q, robot.qd_max, longest, gains.dt, 0.0 * q)
    age, predicted = int(w.age[()]), w.x_est[1].copy()
    if first or gap:
        _measure_from(w, q, read[1])
    else:
        _find_lag(robot, w, q, age, gains)
        _find_period(w, q, read[1], age + 1, gains)
    if first:
        put(w.q_posture, q)
        w.ratio[()] = 0.0
        _forget_groups(w)
    lag, w.interval[()] = int(w.lag[()]), age + 1.0
    steps = age + 1 if w.known[()] >= age + 1 + lag and not gap else 0
    known, periods = _recall(w, lag, steps), age + 1 + lag + w.q_last[3]
    for i in range(len(old)):
        if w.no_velocity[()] != 0.0 or not abs(read[1, i]) <= FARTHEST * robot.qd_max[i]:
            read[1, i] = math.nan
            w.faults[VELOCITY] = 1.0
        if old[i] and steps > 0:  # a prediction is no reading
            read[0, i] = read[1, i] = math.nan
    if leapt:
        fill(w.x_read[2], 0.0)
    drift = process_noise(w, robot.qd_max, periods, gains)
    for i in range(len(drift)):
        grow(w.P_est[i], drift[i], int(waited[i]), gains.dt)
    jumped = estimate_arm(w, known, read, robot.qd_max, drift, gains) or leapt
    w.faults[JUMP] = jumped
    forgotten = min(age + 1.0, _GROUP) * _DOUBT / _GROUP
    w.contradiction[()] = max(w.contradiction[()] + _JUMPS * jumped - forgotten, 0.0)
    if jumped:
        _forget_groups(w)
        put(w.q_posture, q)
        _measure_from(w, q, read[1])
    put_rows(w.x_est, w.x_read)
    if lag > 0:
        advance(w.x_est, _recall(w, 0, min(lag, int(w.known[()]))), gains.dt)
    if not first:
        _learn_errors(robot, gains, w, predicted, periods, jumped)
    w.age[()] = 0.0
