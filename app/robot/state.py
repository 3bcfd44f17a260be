"""The robot's present state, computed once per step: kinematics and dynamics.

The kernels use pinocchio's Jacobian `J` (6, 3 + n_m) of a serial chain on a planar base. Column k
is the twist that one unit of the k-th velocity gives to all bodies that this velocity moves:
linear, at the origin of the world, then angular. Joint 1 is the planar base with the columns 0 to
2, and a body on joint j moves with the columns 0 to j + 1. `B` (3, n_b) maps the reduced velocities
q̇_b of the base to its twist (v_x, v_y, ω_z). S and `J_m_inv` are those of `RobotModel`. Points p
(3,) [m] are in the world.
"""

import math
from collections.abc import Sequence
from numbers import Real
from typing import Any, NamedTuple

import coal
import numpy as np
import pinocchio as pin
from numpy.lib.stride_tricks import as_strided

from app.compiled import compiled, direct
from app.errors import MeasurementError, shown
from app.robot.model import RobotModel
from app.strict import Array

_FLOAT = np.dtype(float)
_LATEST = 1e11  # [s] a larger time must be in nanoseconds
_GRAVITY = 9.81  # [m/s²]
_Vector = Array | tuple[float, float, float]


class Measurement(NamedTuple):
    """The readings of the robot's sensors in one control step."""

    base_pose: Array  #: (3,) x, y [m] and heading φ [rad] of the base's frame in the world
    base_velocity: Array
    """(n_b,) [m/s or rad/s] velocity along the base's axes: v and ω for a differential base; NaN or
    None if it is not measured."""
    q_m: Array  #: (n_m,) [rad or m] the arm's joint positions
    qd_m: Array
    """(n_m,) [rad/s or m/s] the arm's joint velocities; NaN or None if they are not measured."""
    drive: Array = np.zeros(0)
    """(n_d,) further states of the base's drive, such as a steering angle [rad]; empty: at rest."""
    now: float = np.nan
    """[s] time of this control step, by any clock that does not jump; NaN without a clock."""
    time: float = np.nan
    """[s] time at which the joints were measured, by the clock of `now`; NaN without a stamp."""
    base_time: float = np.nan
    """[s] time at which the base's pose and velocity were measured; NaN: at the joints' time."""


def numbers(name: str, values: Any, *sizes: int, finite: bool = False) -> Array:
    """An array of floats from a caller's values; masked values become NaN.

    Raises a MeasurementError if they are not real numbers, their count is not in `sizes` or, with
    `finite`, one of them is not finite.
    """
    try:
        found = np.asarray(np.ma.filled(values, np.nan)).astype(float, "K", "same_kind", copy=False)
        reason = f" (shape {found.shape})"
    except Exception as error:  # such as torch's error about a tensor that requires grad
        found, reason = None, f" ({error})"
    if found is None or found.shape not in [(size,) for size in sizes]:
        raise MeasurementError(f"{name} must be {sizes[0]} numbers, was {shown(values)}{reason}")
    if finite and not np.isfinite(found).all():
        raise MeasurementError(f"{name} must be finite numbers, was {shown(found)}")
    return found


def real(value: Any) -> float:
    """A real number as a float; infinite for another type, and if the conversion fails."""
    try:
        is_real = isinstance(value, Real) and not isinstance(value, bool | np.timedelta64)
        return float(value) if is_real else math.inf
    except Exception:  # an integer is too large, or a class has an error
        return math.inf


def velocities(name: str, values: Any, size: int) -> Array:
    """An array (size,) of velocities; None or an empty array becomes NaN. Errors: as `numbers`."""
    found = numbers(name, () if values is None else values, size, 0)
    return found if found.size == size else np.full(size, np.nan)


def checked(measurement: Measurement, model: RobotModel) -> Measurement:
    """The measurement with arrays of floats; missing velocities become NaN.

    Raises a MeasurementError if the value is not a `Measurement`, a field has a wrong type or
    number of values, a time is of single precision or not in seconds, or a stamp has no `now`.
    """
    if not isinstance(measurement, Measurement):
        fields, kind = ", ".join(Measurement._fields), type(measurement).__name__
        raise MeasurementError(f"measured must be a Measurement({fields}), was {kind}")
    pose, v, q, qd, drive, now, time, base_time = measurement
    if type(pose) is type(v) is type(q) is type(qd) is type(drive) is Array:
        shapes = pose.shape, v.shape, q.shape, qd.shape, drive.shape
        floats = pose.dtype is v.dtype is q.dtype is qd.dtype is drive.dtype is _FLOAT
        no_times = now is time is base_time is np.nan  # the defaults
        times = no_times or (
            type(now) is type(time) is type(base_time) is float
            and -_LATEST < min(now, time, base_time) <= max(now, time, base_time) < _LATEST
        )
        if floats and times and shapes in model.reading_shapes:
            return measurement
    names = "now", "time", "base_time"
    now, *stamps = map(_seconds, names, (now, time, base_time))
    for name, stamp in zip(names[1:], stamps, strict=True):
        if stamp == stamp and now != now:
            text = "needs measurement.now, the time of the control step by the same clock"
            raise MeasurementError(f"measurement.{name} {text}")
    return Measurement(
        numbers("measurement.base_pose", pose, 3),
        velocities("measurement.base_velocity", v, model.n_b),
        numbers("measurement.q_m", q, model.n_m),
        velocities("measurement.qd_m", qd, model.n_m),
        numbers("measurement.drive", drive, *dict.fromkeys((model.n_d, 0))),
        now,
        *stamps,
    )


def _seconds(name: str, value: Any) -> float:
    """A time [s], NaN for None; raises a MeasurementError for other types, units or precisions."""
    if value is None:
        return np.nan
    if isinstance(value, np.floating) and value.itemsize < 8:
        coarse = f"{value.dtype} resolves only {np.spacing(value):.2g} s at {value:g} s"
        raise MeasurementError(f"measurement.{name} must be a float of 64 bits: {coarse}")
    found = real(value)
    if abs(found) >= _LATEST:
        form = "seconds as a float" if math.isinf(found) else "seconds, not nanoseconds"
        raise MeasurementError(f"measurement.{name} must be {form}, was {shown(value)}")
    return found


def at_rest(model: RobotModel, q_m: Array, base_pose: Array | None = None) -> Measurement:
    """The readings of a robot at rest at q_m (n_m,); by default, the base is at the origin."""
    pose = np.zeros(3) if base_pose is None else base_pose
    base = model.description.base
    return Measurement(pose, np.zeros(model.n_b), q_m, np.zeros(model.n_m), base.drive_at_rest())


@compiled("Tuple((f8[::1], f8[::1], f8[::1]))(f8[:], f8[:], f8[:], f8[:], f8[:,:], f8[:,:])")
def coordinates(
    base_pose: Array, base_velocity: Array, q_m: Array, qd_m: Array, B: Array, J_m_inv: Array
) -> tuple[Array, Array, Array]:
    """Reduced velocity (n,), and pinocchio's configuration (4 + n_m,) and velocity (3 + n_m,)."""
    n_b, n_m = B.shape[1], len(q_m)
    qd, q, v = np.zeros(n_b + n_m), np.empty(4 + n_m), np.zeros(3 + n_m)
    for i in range(n_b):
        for k in range(len(base_velocity)):
            qd[i] += J_m_inv[i, k] * base_velocity[k]
        for k in range(3):
            v[k] += B[k, i] * qd[i]
    q[0], q[1] = base_pose[0], base_pose[1]
    q[2], q[3] = np.cos(base_pose[2]), np.sin(base_pose[2])
    for i in range(n_m):
        q[4 + i] = q_m[i]
        qd[n_b + i] = v[3 + i] = qd_m[i]
    return qd, q, v


@compiled()
def _swept(v: _Vector, w: _Vector, p: _Vector) -> tuple[float, float, float]:
    """The vector v + ω × p; of each argument, only the first three entries are used."""
    return (
        v[0] + w[1] * p[2] - w[2] * p[1],
        v[1] + w[2] * p[0] - w[0] * p[2],
        v[2] + w[0] * p[1] - w[1] * p[0],
    )


@compiled()
def chain_motion(J: Array, v: Array) -> tuple[Array, Array]:
    """Twists (2 + n_m, 6) of the bodies on all joints, at the origin of the world, and their
    derivatives at q̈ = 0; the first row is the world's. v (3 + n_m,) is pinocchio's velocity.

    v[:3] has axes fixed to the base. At q̈ = 0 the base moves on a circle, with a constant twist.
    """
    joints = J.shape[1] - 1
    twists, biases = np.zeros((joints, 6)), np.zeros((joints, 6))
    for k in range(3):
        for i in range(6):
            twists[1, i] += J[i, k] * v[k]
    for joint in range(2, joints):
        k, before, bias = joint + 1, biases[joint - 1], biases[joint]
        for i in range(6):
            twists[joint, i] = twists[joint - 1, i] + J[i, k] * v[k]
        moved = twists[joint - 1]
        linear = J[0, k] * v[k], J[1, k] * v[k], J[2, k] * v[k]
        angular = J[3, k] * v[k], J[4, k] * v[k], J[5, k] * v[k]
        turned = _swept(before, moved[3:], linear)
        bias[0], bias[1], bias[2] = _swept(turned, moved, angular)
        bias[3], bias[4], bias[5] = _swept(before[3:], moved[3:], angular)
    return twists, biases


@compiled("f8[::1](f8[:,:], f8[:], f8[:])")
def seen_from(R: Array, p: Array, at: Array) -> Array:
    """Rᵀ (at − p): the point `at` (3,) [m] in a frame with rotation R (3, 3), origin p (3,) [m]."""
    x, y, z = at[0] - p[0], at[1] - p[1], at[2] - p[2]
    return R[0] * x + R[1] * y + R[2] * z


@compiled("UniTuple(f8, 3)(f8[:], f8[:])")
def point_velocity(twist: Array, p: Array) -> tuple[float, float, float]:
    """Velocity [m/s] of a body's point at p (3,), from the body's twist (6,)."""
    return _swept(twist, twist[3:], p)


@compiled("UniTuple(f8, 3)(f8[:], f8[:], f8[:])")
def point_bias(twist: Array, bias: Array, p: Array) -> tuple[float, float, float]:
    """Acceleration [m/s²] at q̈ = 0 of a body's point at p (3,), from its twist and bias (6,)."""
    return _swept(point_velocity(bias, p), twist[3:], point_velocity(twist, p))


@compiled()
def carrying(joint: int) -> int:
    """How many of pinocchio's velocities, the first ones, move the body on a joint; world: 0."""
    return joint + 2 if joint > 0 else 0


@compiled()
def _column(J: Array, k: int, p: Array) -> tuple[float, float, float]:
    """Velocity, per unit of the k-th velocity, of the point p (3,) of a body that it moves."""
    return _swept(J[:3, k], J[3:, k], p)


@compiled()
def _in_reduced(rows: Array, B: Array) -> Array:
    """Rows (k, n) for the reduced velocity q̇, from rows (k, 3 + n_m) for pinocchio's velocity."""
    n_b = B.shape[1]
    found = np.zeros((len(rows), n_b + rows.shape[1] - 3))
    for i in range(len(rows)):
        for j in range(n_b):
            for k in range(3):
                found[i, j] += rows[i, k] * B[k, j]
        for j in range(n_b, found.shape[1]):
            found[i, j] = rows[i, 3 + j - n_b]
    return found


@compiled("Tuple((f8[:,::1], f8[::1], f8[::1]))(f8[:,:], f8[:], f8[:,:], f8[:,:], f8[:,:])")
def reduced_dynamics(
    M: Array, h: Array, J: Array, Y: Array, B: Array
) -> tuple[Array, Array, Array]:
    """Sᵀ M S (n, n), Sᵀ h, Sᵀ g (n,), S = diag(B, 1); `pinocchio_views` has M, h, J, Y (for g)."""
    n_b, g = B.shape[1], np.empty(len(h))
    for k in range(len(h)):  # weight of the moved bodies times vertical velocity of their centre
        moved = Y[max(k - 1, 1)]  # the first three velocities are those of joint 1
        g[k] = _GRAVITY * moved[0] * _column(J, k, moved[1:])[2]
    n = n_b + len(h) - 3
    reduced, h_r, g_r = np.zeros((n, n)), np.zeros(n), np.zeros(n)
    reduced[n_b:, n_b:], h_r[n_b:], g_r[n_b:] = M[3:, 3:], h[3:], g[3:]
    for i in range(n_b):
        for k in range(3):
            h_r[i] += B[k, i] * h[k]
            g_r[i] += B[k, i] * g[k]
            for j in range(n_b):
                for l in range(3):
                    reduced[i, j] += B[k, i] * M[k, l] * B[l, j]
            for j in range(n_b, n):
                reduced[i, j] += B[k, i] * M[k, 3 + j - n_b]
        reduced[n_b:, i] = reduced[i, n_b:]
    return reduced, h_r, g_r


@compiled("f8[:,::1](f8[:,:], f8[:,:], i8, f8[:])")
def point_jacobian(J: Array, B: Array, joint: int, p: Array) -> Array:
    """(3, n) [m/rad or 1] Jacobian of the point at p (3,) of the body on a joint."""
    rows = np.zeros((3, J.shape[1]))
    for k in range(carrying(joint)):
        rows[0, k], rows[1, k], rows[2, k] = _column(J, k, p)
    return _in_reduced(rows, B)


@compiled(
    "Tuple((f8[:,::1], f8[::1], f8[::1]))"
    "(f8[:,:], f8[:,:], f8[:,:], f8[:,:], i8[:,:], f8[:,:], f8[:,:])"
)
def distance_motions(
    J: Array, B: Array, twists: Array, biases: Array, joints: Array, at: Array, normals: Array
) -> tuple[Array, Array, Array]:
    """The terms of ḋ and d̈: motions of points along normals that are fixed to other bodies.

    J_r = nᵀ(J_b − J_a) at the point `core` of l_b. n is fixed to l_a and points out of l_a, because
    the paper's (p_b − p_a)/‖p_b − p_a‖ changes its sign in penetration. d̈ is exact for a round link
    near a face: the normal of the face is constant while the closest points slide along the face,
    and the point of the core does not move on the link. The term |v_⊥|²/d of the distance of two
    fixed points would make the error of d̈ ten times as large.

    `joints` (k, 2) are the indices of the joints that move the bodies with the normal and with the
    point. `at` (k, 3) [m] are the points, and `normals` (k, 3) unit vectors, or shorter as in
    `ClosestPoints`, all in the world. The results are J_r (k, n), J̇_r q̇ (k,) [m/s²] with the
    rotation of the normals, and J_r q̇ (k,) [m/s].

    Paper: Eq. (21).
    """
    count = len(joints)
    rows, accelerations, speeds = np.zeros((count, J.shape[1])), np.empty(count), np.empty(count)
    for k in range(count):
        a, b, p, n = joints[k, 0], joints[k, 1], at[k], normals[k]
        # Joints that move both bodies do not move them relative to each other.
        sign = 1.0 if a < b else -1.0
        for l in range(carrying(min(a, b)), carrying(max(a, b))):
            u, v, w = _column(J, l, p)
            rows[k, l] = sign * (n[0] * u + n[1] * v + n[2] * w)
        v_b, v_a = point_velocity(twists[b], p), point_velocity(twists[a], p)
        a_b = point_bias(twists[b], biases[b], p)
        a_a = point_bias(twists[a], biases[a], p)
        x, y, z = v_b[0] - v_a[0], v_b[1] - v_a[1], v_b[2] - v_a[2]
        w_x, w_y, w_z = twists[a, 3], twists[a, 4], twists[a, 5]
        speeds[k] = n[0] * x + n[1] * y + n[2] * z
        accelerations[k] = (
            n[0] * (a_b[0] - a_a[0] - 2.0 * (w_y * z - w_z * y))
            + n[1] * (a_b[1] - a_a[1] - 2.0 * (w_z * x - w_x * z))
            + n[2] * (a_b[2] - a_a[2] - 2.0 * (w_x * y - w_y * x))
        )
    return _in_reduced(rows, B), accelerations, speeds


@compiled(
    "Tuple((f8[:,::1], f8[:,::1], f8[:,::1], f8[::1], f8[::1]))(f8[:,:], f8[:,:], f8[:], f8[:])"
)
def tip_motion(J: Array, B: Array, v: Array, p: Array) -> tuple[Array, Array, Array, Array, Array]:
    """The results of `chain_motion`, and for the last body's point at p (3,) [m] its Jacobian
    (6, n), its velocity (6,) and J̇ q̇ (6,).

    The last three have linear, then angular rows, in axes of the world.
    """
    twists, biases = chain_motion(J, v)
    J_p, twist, bias = J.copy(), twists[-1], biases[-1]
    for k in range(J.shape[1]):
        J_p[0, k], J_p[1, k], J_p[2, k] = _column(J, k, p)
    v_p, Jdqd = twist.copy(), bias.copy()
    v_p[0], v_p[1], v_p[2] = point_velocity(twist, p)
    Jdqd[0], Jdqd[1], Jdqd[2] = point_bias(twist, bias, p)
    return twists, biases, _in_reduced(J_p, B), v_p, Jdqd


def compute_dynamics(model: pin.Model, data: pin.Data, q: Array, v: Array) -> None:
    """Compute the values of `pinocchio_views`; `pin.computeAllTerms` would take twice as long."""
    pin.crba(model, data, q, pin.Convention.WORLD)  # computes the Jacobian too
    pin.nonLinearEffects(model, data, q, v)


def pinocchio_views(data: pin.Data) -> dict[str, Array]:
    """Views of M, C q̇ + g, the Jacobian, placements and masses, by their names in a control step.

    `oMi` (n_j, 4, 3) has the columns of the rotation and the origin [m] of each joint; pinocchio
    stores them contiguously. `Y_pin` (n_j, 4) has the mass [kg] and the centre of mass [m], in the
    world, of all bodies that each joint moves; pinocchio stores a mass before its centre.
    """
    joints, first = len(data.oMi), data.oMi[0].rotation
    oMi = as_strided(first, (joints, 4, 3), (96, 24, 8))
    last = data.oMi[joints - 1].translation
    assert (oMi[-1, 3] == last).all(), "pinocchio does not store placements as assumed here"
    Y = as_strided(_before(data.oYcrb[0].lever, joints, 80), (joints, 4), (80, 8))
    of_last = data.oYcrb[joints - 1]
    as_read = np.array([of_last.mass, *of_last.lever])
    assert np.array_equal(Y[-1], as_read, equal_nan=True), "pinocchio stores masses in another way"
    return {"M_pin": data.M, "h_pin": data.nle, "J_pin": data.J, "Y_pin": Y, "oMi": oMi}


def _before(vector: Array, count: int, size: int) -> Array:
    """(count,) view of the number before each vector: `vector`, then one every `size` bytes."""
    return as_strided(vector, (count, 2), (size, -8))[:, 1]


def geometry_data(geometry: pin.GeometryModel) -> pin.GeometryData:
    """Data for distances that depend only on the present poses: each search starts anew."""
    data = pin.GeometryData(geometry)
    for k in range(len(data.distanceRequests)):
        data.distanceRequests[k] = coal.DistanceRequest()
    return data


def distance_view(results: Sequence[pin.DistanceResult]) -> Array:
    """(k,) [m] a view of the signed distances in coal's results: it changes with these results.

    This call overwrites the distances. Reading the results one by one would take as long as
    computing them.
    """
    if len(results) == 0:
        return np.zeros(0)
    first, last = (each.normal.__array_interface__["data"][0] for each in (results[0], results[-1]))
    size = (last - first) // max(len(results) - 1, 1)
    view = _before(results[0].normal, len(results), size)
    for k, each in enumerate(results):
        each.min_distance = float(k)
    assert (view == np.arange(len(view))).all(), "coal does not store distances as assumed here"
    return view


@compiled("void(f8[:], i8[::1], i8[::1], f8[:])")
def put_least(values: Array, order: Array, firsts: Array, into: Array) -> None:
    """Write the smallest value of each group of `values` (n,) into the array `into` (k,).
    Group i has the values with the indices `order[firsts[i]:firsts[i + 1]]`.
    """
    for k in range(len(into)):
        into[k] = values[order[firsts[k]]]
        for j in range(firsts[k] + 1, firsts[k + 1]):
            into[k] = min(into[k], values[order[j]])


_write_least = direct(put_least)


class ShapeDistances:
    """Present signed distances of groups of pairs of shapes, by the collision library.

    `signed` is the `distance_view` of all pairs of shapes; `order` and `firsts` define the groups
    as in `put_least`.
    """

    def __init__(
        self, model: RobotModel, shapes: Sequence[tuple[int, int]], groups: Sequence[range]
    ) -> None:
        """Prepare pairs of `shapes` (indices in `model.geometry`), and `groups` of these pairs."""
        self._model, self._geometry = model, model.geometry.copy()
        self._geometry.removeAllCollisionPairs()
        for pair in shapes:
            self._geometry.addCollisionPair(pin.CollisionPair(*pair))
        self._placed = geometry_data(self._geometry)
        self.order = np.concatenate([np.arange(0), *groups])
        self.firsts = np.cumsum([0, *map(len, groups)])
        self.signed = distance_view(self._placed.distanceResults)

    def update_from(self, data: pin.Data) -> None:
        """Compute all distances from the joints' placements in pinocchio's data."""
        pin.updateGeometryPlacements(self._model.pin, data, self._geometry, self._placed)
        pin.computeDistances(self._geometry, self._placed)

    def write_distances(self, into: Array) -> None:
        """Write the smallest signed distance [m] of each group into an array."""
        _write_least(self.signed, self.order, self.firsts, into)


class RobotState:
    """Kinematics and dynamics at one instant, in the reduced coordinates q̇ = (q̇_b, q̇_m).

    `drive` and the first four arrays are the measurement of the last update. `R_world_base` (3, 3)
    is the rotation of the base, and `p_o` (3,) [m] its centre on the floor, in the world.
    """

    base_pose: Array
    base_velocity: Array
    q_m: Array
    qd_m: Array
    qd: Array  #: (n,) q̇: wheel speeds [rad/s] or other coordinates of the base, then the joints'
    M: Array  #: (n, n) inertia matrix of (26)
    h: Array  #: (n,) C q̇ + g of (26)
    g: Array  #: (n,) gravity terms of (26)
    R_ee: Array  #: (3, 3) rotation of the end-effector in the world
    p_ee: Array  #: (3,) [m] position of the end-effector in the world
    J_ee: Array  #: (6, n) Jacobian of the end-effector in axes of the world, linear rows first
    v_ee: Array  #: (6,) J_ee q̇, velocity of the end-effector
    Jdqd_ee: Array  #: (6,) J̇_ee q̇, acceleration of the end-effector at q̈ = 0
    twists: Array  #: (2 + n_m, 6) of `chain_motion`
    biases: Array  #: (2 + n_m, 6) of `chain_motion`

    def __init__(self, model: RobotModel) -> None:
        self.model = model
        self.data = model.pin.createData()
        # These are views of pinocchio's memory, because reading them again takes longer.
        root, self.views = self.data.oMi[1], pinocchio_views(self.data)
        self.R_world_base, self.p_o, self._J = root.rotation, root.translation, self.views["J_pin"]
        self._dynamics = self.views["M_pin"], self.views["h_pin"], self._J, self.views["Y_pin"]
        self.pin, self._factor, self._load = model.pin, 1.0, pin.Inertia.Zero()
        self._B = np.ascontiguousarray(model.S[:3, : model.n_b])
        self._shared = False
        self.update(at_rest(model, np.array(model.description.arm.ready_position)))

    def share(self, step: Any) -> None:
        """Copy the arrays into those of a control step; then both have the same arrays."""
        for name in RobotState.__annotations__:
            present, shared = getattr(self, name), getattr(step, name)
            shared[...] = present
            setattr(self, name, shared)
        self._shared = True

    def _store(self, **arrays: Array) -> None:
        for name, value in arrays.items():
            if self._shared:
                getattr(self, name)[...] = value
            else:
                setattr(self, name, value)

    @property
    def measurement(self) -> Measurement:
        """The measurement of the last update, without times."""
        return Measurement(self.base_pose, self.base_velocity, self.q_m, self.qd_m, self.drive)

    @property
    def T_world_ee(self) -> pin.SE3:
        """Pose of the end-effector in the world."""
        return pin.SE3(self.R_ee, self.p_ee)

    def scale_arm_inertias(self, factor: float) -> None:
        """From the next update on, scale mass and inertia of the arm's moving links by a factor."""
        self._factor = factor
        self._compile()

    def carry(self, mass: float, centre: Sequence[float]) -> None:
        """From the next update on, the end-effector carries a point mass `mass` [kg] instead of a
        former one; `centre` (3,) [m] is its place in the end-effector's frame.
        """
        at = self.model.pin.frames[self.model.ee_frame].placement
        self._load = pin.Inertia(mass, at.act(np.array(centre, dtype=float)), np.zeros((3, 3)))
        self._compile()

    def _compile(self) -> None:
        """Set the model with the present inertias; until then other threads use the former one."""
        made, factor = self.model.pin, self._factor
        if factor != 1.0 or self._load.mass > 0.0:
            made = made.copy()
            for joint in range(2, made.njoints):  # 1 is the planar joint of the base
                Y = made.inertias[joint]
                made.inertias[joint] = pin.Inertia(factor * Y.mass, Y.lever, factor * Y.inertia)
            made.inertias[made.njoints - 1] += self._load
        self.pin = made

    def update(self, measurement: Measurement) -> None:
        """Recompute all arrays from a measurement; in a control step, `algorithm_2` does this."""
        q, v = self._take(measurement)
        compute_dynamics(self.pin, self.data, q, v)
        M, h, g = reduced_dynamics(*self._dynamics, self._B)
        self._store(M=M, h=h, g=g)
        self._update_motion(v)

    def update_kinematics(self, measurement: Measurement) -> None:
        """Recompute all arrays except M, h and g, which keep their former values."""
        q, v = self._take(measurement)
        pin.computeJointJacobians(self.pin, self.data, q)
        self._update_motion(v)

    def _take(self, measurement: Measurement) -> tuple[Array, Array]:
        base_pose, base_velocity, q_m, qd_m, self.drive, *_ = measurement
        qd, q, v = coordinates(*measurement[:4], self._B, self.model.J_m_inv)
        self._store(base_pose=base_pose, base_velocity=base_velocity, q_m=q_m, qd_m=qd_m, qd=qd)
        return q, v

    def _update_motion(self, v: Array) -> None:
        """Update `twists`, `biases` and the end-effector's arrays for pinocchio's v (3 + n_m,)."""
        T_ee = pin.updateFramePlacement(self.pin, self.data, self.model.ee_frame)
        R_ee, p_ee = T_ee.rotation.copy(), T_ee.translation.copy()
        twists, biases, J_ee, v_ee, Jdqd_ee = tip_motion(self._J, self._B, v, p_ee)
        self._store(R_ee=R_ee, p_ee=p_ee, J_ee=J_ee, v_ee=v_ee, Jdqd_ee=Jdqd_ee)
        self._store(twists=twists, biases=biases)

    def to_base(self, p_world: Array) -> Array:
        """(3,) [m] the point `p_world` (3,) [m] of the world, in the base's frame."""
        return seen_from(self.R_world_base, self.p_o, p_world)

    def to_world(self, p_base: Array) -> Array:
        """(3,) [m] the point `p_base` (3,) [m] of the base's frame, in the world."""
        return self.R_world_base @ p_base + self.p_o

    def point_jacobian(self, joint: int, p_world: Array) -> Array:
        """(3, n) [m/rad or 1] Jacobian of the point at `p_world` of the body on a joint."""
        return point_jacobian(self._J, self._B, joint, p_world)

    def point_velocity(self, joint: int, p_world: Array) -> Array:
        """(3,) [m/s] velocity of the point at `p_world` of the body on a joint."""
        return np.array(point_velocity(self.twists[joint], p_world))

    def distance_motions(self, joints: Array, p: Array, n: Array) -> tuple[Array, Array, Array]:
        """`distance_motions` of points p (k, 3) [m] and normals n (k, 3) on joints (k, 2)."""
        return distance_motions(self._J, self._B, self.twists, self.biases, joints, p, n)
