"""The reference of each control step, and the interpolation of a planner's samples.

The references of a planner arrive in steps, for example at 10 or 30 Hz with jitter. A reference is
a sample if its pose jumps, which means that its own velocity does not explain the change of the
pose. At each sample a polynomial of fifth degree starts from the present motion of the reference.
It ends at the sample after two mean intervals, with the sample's own velocity, or with the mean
velocity since the previous sample if the own velocity is 0 or does not match the poses. If its
acceleration would exceed about `_LEAP`, the polynomial ends later, and beyond the sample along this
velocity. Without a further sample the reference comes to rest at the last sample. If the second
reference is a sample, the polynomial begins at rest, because no pose confirms the first velocity.

The first sample after a pause, an outlier or noise can require more than the correction speed
(`task.ee_speed`). The reference then approaches the sample within this speed and about `_LEAP`:
each polynomial ends at rest, at the sample or on the way to it; in the second case each step starts
a new polynomial. The first reference, and references without jumps while no polynomial lasts, are
used unchanged, except for an acceleration that does not explain the change of the velocity. A
repeated reference is no sample, and counts as a reference at rest.

If a reading of the base's pose jumps, the reference in use is shifted with the end-effector, and
the shift returns to 0 on a polynomial (`shift_reference`).
"""

import math
from typing import Any

import numpy as np
from numba import types
from numba.core.typing.templates import Signature

from app.compiled import compiled
from app.control.inputs import GAINS
from app.control.qp import fill, put, put_rows
from app.control.quantities import STEP
from app.control.readings import MAX_AGE, count_periods
from app.control.tasks import pose_error, rotation_by
from app.strict import Array

RUSH = 0.05  # [s] shortest time in which a reference can reach the end-effector's largest speed
_LEAP = 10.0  # [m/s², rad/s²] largest acceleration that a reference does not have to explain
_RATE = 0.3  # [-] weight of the newest interval in the mean interval
_LONGEST = 0.25  # [s] longest time between samples of one motion
_OVERDUE = 1.75  # [-] mean intervals after which no further sample is expected
_STEEPEST = 3.0  # [-] ratio of a polynomial's largest acceleration to its top speed per duration
_PEAK = 1.875  # [-] ratio of largest to mean speed of the polynomial from rest to rest
_OWN_SPEED = 1.5  # [-] largest relative difference of a sample's own velocity from the mean one
_ROUNDING = 1e-4  # [-] tolerance of a rotation matrix in single precision
_LEAST_SHIFT = 1e-4  # [m or rad] smallest jump of the end-effector that shifts the reference
_RETURN = 0.2  # [s] shortest duration of the return of a shifted reference

_VECTOR = types.Array(types.f8, 1, "A")
_FIELDS = types.Array(types.f8, 2, "A"), _VECTOR, _VECTOR, _VECTOR  # of a `Reference`


@compiled(Signature(types.b1, (*_FIELDS, _VECTOR), None))
def is_motion(R: Array, p: Array, v: Array, a: Array, top: Array) -> bool:
    """Whether R (3, 3) is a rotation, p (3,) finite, |v_i| ≤ top_i and |a_i| ≤ top_i / `RUSH`."""
    slow = (np.abs(v) <= top).all() and (np.abs(a) <= top / RUSH).all()  # not NaN
    if not (slow and math.isfinite(p.sum())):
        return False
    # A rotation matrix equals the matrix of its cofactors; of other matrices, only 0 does.
    for i in range(3):
        above, below = R[(i + 1) % 3], R[(i + 2) % 3]
        for j in range(3):
            k, m = (j + 1) % 3, (j + 2) % 3
            if not abs(above[k] * below[m] - above[m] * below[k] - R[i, j]) < _ROUNDING:
                return False
    return bool(np.abs(R).max() > 0.5)


@compiled()
def _leaps(change: Array, rate: Array, interval: float, dt: float, order: int) -> bool:
    """Whether `rate` (6,) explains `change` (6,), of order 1 or 2, neither in `interval` nor dt."""
    late = (np.abs(change - interval * rate) > _LEAP * max(interval, dt) ** order).any()
    return bool(late and (np.abs(change - dt * rate) > _LEAP * dt**order).any())


@compiled()
def _largest(motion: Array) -> float:
    """The larger of the lengths of the linear and the angular part of a motion (6,)."""
    return math.sqrt(max((motion[:3] ** 2).sum(), (motion[3:] ** 2).sum()))


@compiled()
def _take_sample(gains: Any, w: Any, way: Array) -> None:
    """Start a polynomial to the newest sample, `way` (6,) away from the caller's last reference."""
    between = max(w.since_sample[()], gains.dt)
    w.since_sample[()] = 0.0
    if between > _LONGEST:  # the first sample of a motion
        w.sample_interval[()] = 0.0
        _aim(gains, w, np.zeros(6))
        return
    mean = w.sample_interval[()] if w.sample_interval[()] > 0.0 else between
    w.sample_interval[()] = mean + _RATE * (between - mean)
    v = way / between
    own = (w.v_sent != 0.0).any() and ((w.v_sent - v) ** 2).sum() <= _OWN_SPEED**2 * (v**2).sum()
    _aim(gains, w, w.v_sent if own else v)


@compiled()
def _aim(gains: Any, w: Any, v_end: Array) -> None:
    """Start a polynomial from the present reference to the newest sample, with v_end (6,) there.

    It ends at rest if v_end is 0, or if the correction speed is too low for v_end or the distance
    of the sample; for a distant sample it ends on the way (`w.way_capped`).
    """
    at, v, a = _state(w.way, w.way_time[()])
    _put_moved(w.x_origin, w.x_origin.copy(), at)
    goal = pose_error(w.x_origin[3], w.x_origin[:3].T, w.x_sent[3], w.x_sent[:3].T)
    steady = 2.0 * max(w.sample_interval[()], gains.dt)
    far, error = _largest(goal), _largest(goal - 0.5 * steady * (v + v_end))
    needed = _STEEPEST * _largest(v_end - v) / _LEAP + math.sqrt(2.0 * _STEEPEST * error / _LEAP)
    duration = max(steady, needed)
    goal += (duration - steady) * v_end
    top = gains.ee_speed
    rests = _PEAK * _largest(goal) > 2.0 * duration * top or _largest(v_end) > _PEAK * top
    rests = rests or not (v_end**2).sum() > 0.0
    w.way_capped[()] = 0.0
    if rests:
        goal -= (duration - steady) * v_end
        shortest = min(math.sqrt(6.0 * far / _LEAP), _STEEPEST * top / _LEAP)
        duration = max(steady, shortest, _STEEPEST * _largest(v) / _LEAP)
        within = duration * top / _PEAK
        if far > within:  # a later step aims again
            goal, w.way_capped[()] = goal * (within / far), 1.0
        v_end = np.zeros(6)
    _write_quintic(w.way, v, a, goal, v_end, duration)
    w.way_continues[()], w.way_time[()], w.way_duration[()] = not rests, 0.0, duration


@compiled()
def _continue_way(gains: Any, w: Any, time: float) -> None:
    """Evaluate the polynomial `time` [s] later, and write the result as the reference.

    A new polynomial replaces it if no sample arrives in time, or if it ends on the way to the
    sample. After its end, the duration becomes 0, and no reference is written.
    """
    late = w.since_sample[()] > _OVERDUE * w.sample_interval[()]
    if w.way_capped[()] != 0.0 or (w.way_continues[()] != 0.0 and late):
        _aim(gains, w, np.zeros(6))
    w.way_time[()] += time
    if w.way_time[()] > w.way_duration[()]:
        w.way_time[()] = w.way_duration[()] = w.sample_interval[()] = 0.0
        return
    at, v, a = _state(w.way, w.way_time[()])
    _put_moved(w.x_ref, w.x_origin, at)
    put(w.v_ref, v)
    put(w.a_ref, a)


@compiled()
def _state(way: Array, t: float) -> tuple[Array, Array, Array]:
    """Pose difference, velocity, acceleration (6,) of the polynomial `way` (6, 6) at time t [s]."""
    at, v, a = np.zeros(6), np.zeros(6), np.zeros(6)
    for k in range(5, -1, -1):
        at = at * t + way[k]
        if k >= 1:
            v = v * t + k * way[k]
        if k >= 2:
            a = a * t + k * (k - 1) * way[k]
    return at, v, a


@compiled()
def _put_moved(x: Array, origin: Array, way: Array) -> None:
    """Write into x (4, 3) the pose `origin` (4, 3), moved by the pose difference `way` (6,)."""
    R = rotation_by(way[3:])
    for i in range(3):
        x[3, i] = origin[3, i] + way[i]
        for j in range(3):
            x[i, j] = R[j, 0] * origin[i, 0] + R[j, 1] * origin[i, 1] + R[j, 2] * origin[i, 2]


@compiled()
def _write_quintic(way: Array, v: Array, a: Array, goal: Array, v_end: Array, T: float) -> None:
    """Write a polynomial of fifth degree to `way` (6, 6), its coefficients by the power of time.

    It starts at 0 with the velocity v (6,) and the acceleration a (6,). After T [s] it reaches the
    goal (6,) with the velocity v_end (6,) and without acceleration.
    """
    rest = goal - T * v - T**2 / 2.0 * a
    slope, bend = T * (v_end - v - T * a), -(T**2) * a
    fill(way[0], 0.0)
    put(way[1], v)
    put(way[2], a / 2.0)
    put(way[3], (10.0 * rest - 4.0 * slope + 0.5 * bend) / T**3)
    put(way[4], (-15.0 * rest + 7.0 * slope - bend) / T**4)
    put(way[5], (6.0 * rest - 3.0 * slope + 0.5 * bend) / T**5)


@compiled()
def shift_reference(gains: Any, w: Any) -> None:
    """Shift the reference of this step by the end-effector's motion at jumps of the base's pose.

    The shift returns to 0, not faster than the correction speed. The first reference after guiding
    has no shift. `w.tracking` and the kinematics are still those of the last step.
    """
    x, y, turn = w.p_ee[0] - w.p_o[0], w.p_ee[1] - w.p_o[1], w.pose_jump[2]
    c, s, moved = math.cos(turn), math.sin(turn), np.zeros(6)
    moved[0] = w.pose_jump[0] + c * x - s * y - x
    moved[1] = w.pose_jump[1] + s * x + c * y - y
    moved[5] = turn
    fill(w.pose_jump, 0.0)
    if w.tracking[()] == 0.0:
        w.shift_duration[()] = 0.0
    elif _largest(moved) > _LEAST_SHIFT:
        _return_from(gains, w, moved)
    if w.shift_duration[()] == 0.0:
        return
    w.shift_time[()] += gains.dt
    if w.shift_time[()] > w.shift_duration[()]:
        w.shift_duration[()] = 0.0
        return
    at, v, a = _state(w.shift, w.shift_time[()])
    _put_moved(w.x_ref, w.x_ref.copy(), at)
    put(w.v_ref, w.v_ref + v)
    put(w.a_ref, w.a_ref + a)


@compiled()
def _return_from(gains: Any, w: Any, moved: Array) -> None:
    """Add `moved` (6,) [m, rad] to the present shift, and start the return of the sum to 0."""
    at, v, a = np.zeros(6), np.zeros(6), np.zeros(6)
    if w.shift_duration[()] > 0.0:
        at, v, a = _state(w.shift, w.shift_time[()])
    at += moved
    far, top = _largest(at), gains.ee_speed
    fast = max(_PEAK * far / top, math.sqrt(2.0 * _STEEPEST * far / _LEAP))
    w.shift_duration[()] = max(_RETURN, fast, _STEEPEST * _largest(v) / _LEAP)
    w.shift_time[()] = 0.0
    _write_quintic(w.shift, v, a, -at, np.zeros(6), w.shift_duration[()])
    put(w.shift[0], at)


@compiled(Signature(types.void, (GAINS.type, STEP.type, *_FIELDS, types.f8, types.b1), None))
def take_reference(
    gains: Any, w: Any, R: Array, p: Array, v: Array, a: Array, now: float, interpolate: bool
) -> None:
    """Write the reference of this step into x_ref, v_ref and a_ref.

    The fields of the caller's `Reference` are R (3, 3) and p (3,) [m], v (6,) [m/s, rad/s] and
    a (6,) [m/s², rad/s²], linear above angular, in the world. `now` [s] is the time of the step, or
    NaN. If `interpolate`, references that jump are interpolated.
    """
    way, dt, interval = np.zeros(6), gains.dt, now - w.clock[()]
    is_sample = surges = False
    time = count_periods(w, now, dt)[0] * dt
    follows = interpolate and not math.isnan(w.x_sent[3, 0])
    if not (follows and 0.0 < interval < MAX_AGE):  # NaN too
        time = interval = dt
    moved = (w.x_sent[:3] != R.T).any() or (w.x_sent[3] != p).any()
    rests = follows and not (moved or (w.v_sent != v).any() or (w.a_sent != a).any())
    if follows and not rests:
        way = pose_error(w.x_sent[3], w.x_sent[:3].T, p, R)
        is_sample = _leaps(way, v, interval, dt, 2)
        surges = _leaps(v - w.v_sent, a, interval, dt, 1)
    if is_sample and w.way_duration[()] == 0.0:  # a polynomial continues the last reference
        put_rows(w.x_origin, w.x_sent)
        if w.since_sample[()] <= dt:  # the last reference was the first: no pose confirms its speed
            w.way[:] = 0.0
    put_rows(w.x_sent, R.T)
    put(w.x_sent[3], p)
    put(w.v_sent, v)
    put(w.a_sent, a)
    w.since_sample[()] += time
    if is_sample:
        _take_sample(gains, w, way)
    if w.way_duration[()] > 0.0:
        _continue_way(gains, w, time)
    if w.way_duration[()] == 0.0:
        w.way[:] = 0.0
        if not rests:
            put(w.way[1], v)
            put(w.way[2], a * (0.0 if surges else 0.5))
        put_rows(w.x_ref, w.x_sent)
        put(w.v_ref, w.way[1])
        put(w.a_ref, 2.0 * w.way[2])
