"""The interface of a kind of mobile base: all data of a base that the method uses, except shapes.

A base has velocity axes ν (n_b,). `T` maps ν to the base's twist (v_x, v_y, ω_z) in the base's
frame: origin on the floor, x forward. `J_m` maps the reduced velocities q̇_b (n_b,), such as the
wheels' speeds, to ν.
"""

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from functools import cache
from logging import getLogger
from typing import Any, ClassVar, Literal, NamedTuple

import numpy as np
from pydantic import model_validator

from app.strict import Array, Positive, Sourced


class Axis(NamedTuple):
    """One of the velocity axes ν."""

    symbol: str  # displayed name, such as "v"
    angular: bool  # whether the motion turns the base; its unit is then rad/s, otherwise m/s
    way: Literal["forward", "left"] = "forward"  # direction of a linear motion in the base's frame


FORWARD = Axis("v", False)
TURN = Axis("ω", True)


def acceleration_symbol(axis: Axis) -> str:
    """Symbol of the acceleration along an axis: v̇, v̇_x or ω̇, for example."""
    return axis.symbol[:1] + "\u0307" + axis.symbol[1:]


class Planar(NamedTuple):
    """Components of a motion in the base's frame, for example [m/s], [m/s] and [rad/s]."""

    forward: float
    left: float
    turn: float  # positive to the left


def planar(axes: Sequence[Axis], values: Sequence[float] | Array) -> Planar:
    """The motion in the base's frame for values (n_b,) along the axes, in the same units."""
    return Planar(*(twist_map(axes) @ np.asarray(values, dtype=float)).tolist())


def twist_map(axes: Sequence[Axis]) -> Array:
    """(3, n_b) matrix from values along the axes to the fields of `Planar`; TᵀT = I."""
    columns = [Planar._fields.index("turn" if axis.angular else axis.way) for axis in axes]
    return np.eye(3)[:, columns]


class Measure(NamedTuple):
    """The signed measure of how well the base can move a point, in a unit of the kind of base."""

    constant: float
    per_square_metre: float

    def at(self, x: Array) -> Array:
        """(…) the measure at x (…) [m] in the base's frame."""
        return self.constant + self.per_square_metre * x * np.abs(x)


PAPERS_MEASURE = 4 * 0.51**2 * (0.165 / (2 * 0.51)) ** 4
"""[m²/rad⁴] (7) of the paper's robot, divided by x²; the gain S_0 of (13) is chosen for it."""


class Channel(NamedTuple):
    """One of the independent motions by which a base moves away from the arm."""

    twist: tuple[float, float, float]  # v_x, v_y [m/s] and ω [rad/s] at unit speed
    a_max: float  # [m/s² or rad/s²] largest acceleration
    v_max: float  # [m/s or rad/s] largest speed
    delay: float = 0.0  # [s] time before the motion starts


class Wheels(NamedTuple):
    """Wheels that turn by the same angle, for drawings and logs."""

    name: str
    field: str  # name of the base's field with the names of the joints
    joints: tuple[str, ...]  # names of the joints in the URDF


Follower = Callable[[list[float], Array, list[float]], tuple[list[float], Array]]
"""Function from the velocity (n_b,), the drive as in `BaseKind.drive_at_rest` and the velocity
command (n_b,) to the velocity and the drive one step later; it does not change its arguments."""


@cache
def _tell_of_link() -> None:
    getLogger(__name__).warning("base.link of robot.toml has no effect; remove this line")


class BaseKind(Sourced, ABC):
    """A base: its numbers, its limits and its drive.

    A kind derives from this class and defines `axes`, its fields and the abstract methods; the
    other methods suit a base whose axes follow their commands independently of each other.
    """

    axes: ClassVar[tuple[Axis, ...]]  # the velocity axes ν, in order

    kind: str
    mass_kg: Positive  # [kg] m of (17)
    inertia_kgm2: Positive  # [kg m²] I of (18), about the frame's origin
    max_linear_velocity_mps: Positive  # [m/s]
    max_linear_acceleration_mps2: Positive  # [m/s²]
    traction_limit_n: Positive  # [N] largest force of the wheels on the floor
    drive_time_constant_s: Positive  # [s] of the drive's first-order response to a velocity command

    @model_validator(mode="before")
    @classmethod
    def _ignore_former_link(cls, data: Any) -> Any:
        if not isinstance(data, Mapping) or "link" not in data or "link" in cls.model_fields:
            return data
        _tell_of_link()
        found = {key: value for key, value in data.items() if key != "link"}
        if isinstance(source := data.get("source"), Mapping):
            found["source"] = {key: value for key, value in source.items() if key != "link"}
        return found

    @property
    def n_b(self) -> int:
        """Number of velocity axes."""
        return len(self.axes)

    @property
    def T(self) -> Array:
        """(3, n_b) map from ν to the twist (v_x, v_y, ω_z) in the base's frame; TᵀT = I."""
        return twist_map(self.axes)

    @property
    @abstractmethod
    def J_m(self) -> Array:
        """(n_b, n_b) map from q̇_b to ν; it is invertible and constant."""

    @property
    @abstractmethod
    def max_velocity(self) -> tuple[float, ...]:
        """(n_b,) [m/s or rad/s] largest velocity of each axis."""

    @property
    @abstractmethod
    def max_acceleration(self) -> tuple[float, ...]:
        """(n_b,) [m/s² or rad/s²] largest acceleration of each axis."""

    @property
    @abstractmethod
    def yaw_limit_nm(self) -> float:
        """[N m] largest torque of the wheels about the frame's origin."""

    @property
    def wheels(self) -> tuple[Wheels, ...]:
        """The drawn wheels, in the order of the angles of `turned`."""
        return ()

    @property
    def score_unit(self) -> float:
        """S_u, the divisor of the score in (13), in the unit of `measure` per m⁴/rad⁴. It is 1 for
        the measure (7), because the gain S_0 [m⁴/rad⁴] of (13) is chosen for this measure.
        """
        return 1.0

    @property
    @abstractmethod
    def measure(self) -> Measure:
        """The measure that replaces sign(x) det(J_c J_cᵀ) in (10); it must not decrease with x."""

    @property
    def A_b(self) -> Array:
        """(n_b, 3) map from (f_x, f_y, τ_z) [N, N, N m] on the base, in its frame, to ẍ_m.

        Paper: Eq. (17), (18).
        """
        return self.T.T / (self.mass_kg, self.mass_kg, self.inertia_kgm2)

    def by_axis(self, linear: float, angular: float) -> Array:
        """(n_b,) the number `linear` for each linear axis, `angular` for each angular one."""
        return np.array([angular if axis.angular else linear for axis in self.axes])

    def retreats(self) -> tuple[tuple[Channel, ...], ...]:
        """Alternative motions away from the arm, each of independent channels; here only one."""
        limits = zip(self.T.T.tolist(), self.max_acceleration, self.max_velocity, strict=True)
        return (tuple(Channel((x, y, w), a, v) for (x, y, w), a, v in limits),)

    def admissible(self, wanted: Array, before: Array) -> Array:
        """(n_b,) [m/s or rad/s] the feasible velocity nearest to `wanted`; here, `wanted` itself.

        `wanted` (n_b,) is within the limits of each axis; `before` (n_b,) is the previous command.
        """
        del before
        return wanted

    def drive_at_rest(self) -> Array:
        """(n_d,) states of the drive at rest, besides its velocity, such as a steering angle."""
        return np.zeros(0)

    def follower(self, dt: float) -> Follower:
        """A function for the drive's response in a step dt [s], within the limits of each axis."""
        # Exact for a constant command during the step, so that any dt is stable.
        gain = -math.expm1(-dt / self.drive_time_constant_s)
        limits = list(zip(self.max_velocity, (a * dt for a in self.max_acceleration), strict=True))

        def follow(v: list[float], drive: Array, v_cmd: list[float]) -> tuple[list[float], Array]:
            axes = zip(v, v_cmd, limits, strict=True)
            return [
                now + clamp((clamp(cmd, top) - now) * gain, most) for now, cmd, (top, most) in axes
            ], drive

        return follow

    def drive_acceleration(
        self, v: Sequence[float] | Array, drive: Array, v_cmd: Sequence[float] | Array
    ) -> Array:
        """(n_b,) [m/s² or rad/s²] acceleration by the drive: (v_cmd − v)/τ, clipped to the limits.

        First v_cmd is clipped to the limits of the velocity. `drive` is as in `drive_at_rest`.
        """
        del drive
        gain, limits = 1.0 / self.drive_time_constant_s, (self.max_velocity, self.max_acceleration)
        axes = zip(map(float, v), map(float, v_cmd), *limits, strict=True)
        return np.array([clamp((clamp(to, top) - at) * gain, most) for at, to, top, most in axes])

    def turned(
        self, angles: list[float], qd_b: list[float], drive: Array, dt: float
    ) -> list[float]:
        """(n_w,) [rad] `angles` of `wheels` after a step of dt [s]; here, they do not change."""
        del qd_b, drive, dt
        return angles


class TurningBase(BaseKind):
    """A base whose angular axis has limits of its own; a kind derives from this class."""

    max_angular_velocity_radps: Positive  # [rad/s]
    max_angular_acceleration_radps2: Positive  # [rad/s²]

    @property
    def max_velocity(self) -> tuple[float, ...]:
        v, w = self.max_linear_velocity_mps, self.max_angular_velocity_radps
        return tuple(self.by_axis(v, w).tolist())

    @property
    def max_acceleration(self) -> tuple[float, ...]:
        v, w = self.max_linear_acceleration_mps2, self.max_angular_acceleration_radps2
        return tuple(self.by_axis(v, w).tolist())


def clamp(value: float, limit: float) -> float:
    """The value within ±limit; `min` and `max` are several times slower."""
    return limit if value > limit else -limit if value < -limit else value
