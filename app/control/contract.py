"""Checks of the input from your own loop: control period, gains, units, joint order, references."""

from __future__ import annotations

from collections.abc import Sequence
from decimal import ROUND_DOWN, Context
from itertools import chain

import numpy as np
import pinocchio as pin

from app.border.cache import BorderData
from app.config import Config, sections
from app.control.readings import EARLY, HISTORY, MAX_AGE
from app.control.references import RUSH
from app.control.tasks import Reference
from app.errors import ConfigError, MeasurementError, did_you_mean, shown
from app.robot.model import RobotModel
from app.robot.state import Measurement, numbers, real, velocities
from app.strict import Array

SHORTEST, LONGEST = 1e-4, 0.02  # [s] range of control periods
_FLOAT = np.dtype(float)
_FASTEST_JOINT = 20.0  # [rad/s, m/s] higher speed limits of joints or base count as this
_FASTEST = 0.6  # [-] largest product of a gain [1/s], or of the root of one in 1/s², and the period
_POWERS = {"1/s": 1, "1/s²": 2}
_down = Context(prec=3, rounding=ROUND_DOWN).create_decimal_from_float


def checked_period(dt: float) -> float:
    """The control period dt [s] as a float; a ConfigError outside of `SHORTEST` to `LONGEST`."""
    if not SHORTEST <= (found := real(dt)) <= LONGEST:
        raise ConfigError(f"dt must be a float from {SHORTEST:g} to {LONGEST:g} s, was {shown(dt)}")
    return found


def check_types(model: RobotModel, data: BorderData | None, interpolate: bool) -> None:
    """Raise a ConfigError if `model`, `data` or `interpolate` has a wrong type."""
    for name, value, kinds, form in (
        ("model", model, RobotModel, "a RobotModel, such as RobotModel(load_robot('husky_panda'))"),
        ("data", data, BorderData | None, "a BorderData or None"),
        ("interpolate", interpolate, bool | np.bool_, "True or False"),
    ):
        if not isinstance(value, kinds):
            raise ConfigError(f"{name} must be {form}, was {shown(value)}")


def check_gains(config: Config, dt: float) -> None:
    """Raise a ConfigError if `config` is no `Config` or a gain is too large for a period dt [s]."""
    if not isinstance(config, Config):
        raise ConfigError(
            f"config must be a Config, was {type(config).__name__}; Config().changed(...) changes "
            "parameters, and app.config_file.read_config reads a file"
        )
    if too_large := too_large_gain(config, dt):
        raise ConfigError(too_large)


def too_large_gain(config: Config, dt: float) -> str:
    """A message about the gain that needs the shortest period if this is below dt [s], or ""."""
    strictest = 0.0, "", 0.0, ""  # rate [1/s], path, value and unit of a gain
    for each in chain.from_iterable(section.tunables for section in sections()):
        if each.unit in _POWERS and each.path != "estimate.velocity_noise":
            value = float(config.value(each.path))
            rate = value ** (1.0 / _POWERS[each.unit])
            strictest = max(strictest, (rate, each.path, value, each.unit))
    rate, path, value, unit = strictest
    if rate * dt <= _FASTEST:
        return ""
    most, longest = _down((_FASTEST / dt) ** _POWERS[unit]), _down(1000.0 * _FASTEST / rate)
    return (
        f"{path} = {value:g} {unit} is too large for a control period of {dt * 1000:g} ms: the "
        f"gain must be at most {most:f}, or the period at most {longest:f} ms"
    )


def implausible(model: RobotModel, q_m: Array) -> MeasurementError:
    """Build the error for positions q_m (n_m,); it names the joint farthest outside its limits."""
    low, high, joints = model.q_lower, model.q_upper, model.description.arm.joints
    i = int(np.argmax(np.abs(q_m - 0.5 * (high + low)) / (high - low)))
    return MeasurementError(
        f"measurement.q_m: {joints[i]} is at {q_m[i]:g}, its limits are {low[i]:.4g} and "
        f"{high[i]:.4g} rad or m: send radians, in the order of {', '.join(joints)} "
        "(`ControlLoop.joint_order` sorts by name)"
    )


def clocks_differ(measurement: Measurement) -> MeasurementError:
    """Build the error for a first reading whose time stamp is too far from the time of the step."""
    age = measurement.now - measurement.time
    side = "before" if age > 0.0 else "after"
    return MeasurementError(
        f"measurement.time is {abs(age):.4g} s {side} measurement.now: "
        "both must be seconds of the same clock; readings can be up to "
        f"{MAX_AGE} s and up to {HISTORY - 1} control periods old{rounding(measurement, EARLY)}"
    )


def rounding(measurement: Measurement, dt: float) -> str:
    """A note if single precision has rounded a time to multiples of more than dt [s], else "".

    A whole number below a UNIX time, or a large age, gives no note: the time is rather in ms or µs.
    """
    times = {name: np.float64(getattr(measurement, name)) for name in ("now", "time", "base_time")}
    for name, value in times.items():
        step = float(np.spacing(np.float32(value)))
        other = abs(times["now"] - times["time"]) > step + MAX_AGE or (
            step < 128.0 and value % 1 == 0
        )
        if step > dt and value == np.float32(value) and not other:
            return f" (measurement.{name} seems to be a float32, which resolves only {step:.2g} s)"
    return ""


class JointOrder:
    """A function that selects the arm's positions and velocities from a driver's joint states.

    The joint states can have any order of joints, further joints, and no velocities, as in
    `sensor_msgs/JointState`::

        order = loop.joint_order(message.name)  # once
        Measurement(base_pose, base_velocity, *order(message.position, message.velocity))
    """

    def __init__(self, model: RobotModel, names: Sequence[str]) -> None:
        """Find the arm's joints in the `names` of a driver; errors as `ControlLoop.joint_order`."""
        try:
            if isinstance(names, str | bytes | set | frozenset):
                raise TypeError
            wanted, names = model.description.arm.joints, [str(each) for each in names]
        except Exception:  # `names` can be no iterable, or its iterator can raise any exception
            text = f"the names must be a list of the driver's joints, were {shown(names)}"
            raise MeasurementError(f"joint states: {text}") from None
        for fault, count in (("does not name", 0), ("names more than once", 2)):
            if wrong := [each for each in wanted if min(names.count(each), 2) == count]:
                raise MeasurementError(
                    f"joint states: the driver {fault} {', '.join(wrong)}"
                    f"{did_you_mean(wrong[0], names) if count == 0 else ''}; "
                    f"names: {', '.join(names) or '(none)'}"
                )
        self._size = len(names)
        self._places = np.array([names.index(each) for each in wanted])

    def __call__(
        self, position: Sequence[float] | Array, velocity: Sequence[float] | Array | None = None
    ) -> tuple[Array, Array]:
        """(n_m,) positions and (n_m,) velocities in the order of the description's `arm.joints`.

        If `velocity` is None or empty, the velocities are NaN.

        Raises:
            MeasurementError: The values are not numbers, or not as many as the names.
        """
        q = numbers("joint states: position", position, self._size)
        qd = velocities("joint states: velocity", velocity, self._size)
        return q[self._places], qd[self._places]


def checked_reference(reference: Reference) -> Reference:
    """The reference with arrays of floats; a MeasurementError for a wrong type or shape."""
    if not isinstance(reference, Reference):
        raise MeasurementError(
            "reference must be a Reference(pose, velocity, acceleration) or None, was "
            f"{type(reference).__name__}"
        )
    pose, v, a = reference
    if not isinstance(pose, pin.SE3):
        raise MeasurementError(
            f"reference.pose must be a pinocchio.SE3, was {type(pose).__name__}; "
            "pinocchio.SE3(T) converts a 4x4 matrix T"
        )
    if type(v) is type(a) is Array and v.dtype == a.dtype == _FLOAT and v.shape == a.shape == (6,):
        return reference
    return Reference(
        pose, numbers("reference.velocity", v, 6), numbers("reference.acceleration", a, 6)
    )


def largest_speeds(model: RobotModel) -> Array:
    """(6,) [m/s, rad/s] bounds of the end-effector's velocity: ready posture, all speed limits."""
    ready, base = np.array(model.description.arm.ready_position), model.description.base
    q, data = model.configuration((0.0, 0.0, 0.0), ready), model.pin.createData()
    J = pin.computeFrameJacobian(model.pin, data, q, model.ee_frame, pin.LOCAL_WORLD_ALIGNED)
    limits = np.minimum([*np.abs(base.T) @ base.max_velocity, *model.qd_max], _FASTEST_JOINT)
    return np.repeat((np.abs(J) @ limits).reshape(2, 3).max(axis=1), 3)


def no_motion(reference: Reference, top: Array) -> MeasurementError:
    """Build the error for an impossible reference, with the reason; `top`: `largest_speeds`."""
    pose, v, a = reference
    poses = ("pose.translation", pose.translation), ("pose.rotation", pose.rotation.ravel())
    for name, values in *poses, ("velocity", v), ("acceleration", a):
        numbers(f"reference.{name}", values, len(values), finite=True)
    for name, values, most in (("velocity", v, top), ("acceleration", a, top / RUSH)):
        i = int(np.argmax(np.abs(values) / most))
        if abs(values[i]) > most[i]:
            unit, wrong = ("m", "mm") if i < 3 else ("rad", "deg")
            per = "/s" if values is v else "/s²"
            return MeasurementError(
                f"reference.{name}[{i}]: {values[i]:g} {unit}{per} is beyond {most[i]:.3g}, "
                f"a bound from the robot's speed limits; is it in {wrong}{per}?"
            )
    return MeasurementError(
        "reference.pose: its rotation is no rotation matrix (orthogonal, with determinant 1); "
        "normalise a quaternion first"
    )
